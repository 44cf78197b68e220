//! Pictures in memory: linear light, with what else is known of every pixel.

/// What a picture shows beside its colour.
#[derive(Debug, Clone, PartialEq)]
pub enum Extra {
    /// One number a pixel, as an EXR layer of one channel.
    Scalar(Vec<f32>),
    /// Three numbers a pixel, as an EXR layer of channels X, Y, Z.
    Vector(Vec<[f32; 3]>),
    /// A linear colour a pixel, as an EXR layer of channels R, G, B.
    Color(Vec<[f32; 3]>),
}

/// A picture, row by row from the upper left corner.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear scene light, as EXR stores it.
    pub color: Vec<[f32; 3]>,
    /// The same for screens: tone-mapped and sRGB-encoded, as PNG stores it.
    pub display: Vec<[u8; 3]>,
    /// Further layers with their names.
    pub layers: Vec<(&'static str, Extra)>,
    /// How it was made, as EXR's attribute `manyview`: a JSON object.
    pub note: Option<String>,
}

impl Picture {
    /// A picture whose colours need no tone mapping, only clamping.
    pub fn of_colors(width: u32, height: u32, color: Vec<[f32; 3]>) -> Self {
        let display = color.iter().map(|&c| display(c)).collect();
        Self { width, height, color, display, layers: Vec::new(), note: None }
    }
}

/// The sRGB code of a linear colour, clamped to 0 … 1; NaN becomes 0.
pub(crate) fn display(color: [f32; 3]) -> [u8; 3] {
    color.map(|c| {
        let linear = (c.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16;
        manyview_shaders::srgb::srgb_from_linear(linear)
    })
}

/// The linear colour of an sRGB code.
pub(super) fn linear(color: [u8; 3]) -> [f32; 3] {
    color.map(manyview_shaders::srgb::linear)
}

/// A colour from dark blue over red to pale yellow, for `x` from 0 to 1: brightness grows with `x`, so that it reads
/// without colours too.
pub(crate) fn heat(x: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 5] = [
        [0.005, 0.003, 0.03],
        [0.10, 0.01, 0.19],
        [0.50, 0.04, 0.10],
        [0.95, 0.28, 0.01],
        [0.98, 0.95, 0.45],
    ];
    let x = if x.is_nan() { 0.0 } else { x.clamp(0.0, 1.0) } * 4.0;
    let at = (x as usize).min(3);
    let blend = x - at as f32;
    [0, 1, 2].map(|i| STOPS[at][i] * (1.0 - blend) + STOPS[at + 1][i] * blend)
}
