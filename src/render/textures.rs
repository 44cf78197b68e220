//! Textures as a picture's pixels see them: halved again and again, and read between texels and levels.

use glam::{DVec2, Vec3};
use manyview_pipeline::scene::{Scene, Texture, Wrap};
use manyview_shaders::srgb::{self, LINEAR_FROM_SRGB, srgb_from_linear};
use rayon::prelude::*;

/// The textures of a scene that surfaces show, by index; those that nothing shows are left out.
pub(super) struct Textures {
    chains: Vec<Option<Chain>>,
}

struct Chain {
    wrap: [Wrap; 2],
    levels: Vec<Level>,
}

struct Level {
    size: [u32; 2],
    texels: Vec<[u8; 3]>,
}

impl Textures {
    /// Filters the textures of all materials.
    pub(super) fn new(scene: &Scene) -> Self {
        let mut used = vec![false; scene.textures.len()];
        // Colours of what alpha cuts away must not bleed into what stays.
        let mut weighted = vec![false; scene.textures.len()];
        for material in &scene.materials {
            for texture in [material.base_color_texture, material.emissive_texture].into_iter().flatten() {
                used[texture as usize] = true;
            }
            if let Some(texture) = material.base_color_texture {
                weighted[texture as usize] |= material.alpha_mode.cutoff().is_some();
            }
        }
        let chains = scene.textures.par_iter().zip(used).zip(weighted);
        Self { chains: chains.map(|((t, used), weighted)| used.then(|| Chain::new(t, weighted))).collect() }
    }

    /// Texels of the full size along u and v.
    pub(super) fn size(&self, texture: u32) -> Option<DVec2> {
        let size = self.chains.get(texture as usize)?.as_ref()?.levels[0].size;
        Some(DVec2::new(f64::from(size[0]), f64::from(size[1])))
    }

    /// Linear colour where a pixel covers about `texels` texels of the full size in area.
    pub(super) fn sample(&self, texture: u32, uv: DVec2, texels: f64) -> Vec3 {
        let Some(chain) = self.chains.get(texture as usize).and_then(Option::as_ref) else {
            return Vec3::ONE;
        };
        // Half of log2 of an area is log2 of a length; NaN reads the full size.
        let detail = (texels.log2() * 0.5).clamp(0.0, (chain.levels.len() - 1) as f64);
        let level = if detail.is_nan() { 0 } else { detail as usize };
        let fine = chain.bilinear(level, uv);
        match detail - level as f64 {
            blend if blend > 0.0 => fine.lerp(chain.bilinear(level + 1, uv), blend as f32),
            _ => fine,
        }
    }
}

impl Chain {
    fn new(texture: &Texture, weighted: bool) -> Self {
        let mut alphas: Vec<u8> = texture.texels.iter().map(|t| if weighted { t[3] } else { 255 }).collect();
        let mut levels = vec![Level {
            size: [texture.width, texture.height],
            texels: texture.texels.iter().map(|&[r, g, b, _]| [r, g, b]).collect(),
        }];
        while let Some(last) = levels.last().filter(|level| level.size != [1, 1]) {
            let (level, next) = last.halved(&alphas);
            alphas = next;
            levels.push(level);
        }
        Self { wrap: texture.wrap, levels }
    }

    fn bilinear(&self, level: usize, uv: DVec2) -> Vec3 {
        let level = &self.levels[level.min(self.levels.len() - 1)];
        let at = [0, 1].map(|i| wrapped(uv[i], self.wrap[i]) * f64::from(level.size[i]) - 0.5);
        let first = at.map(f64::floor);
        let blend = [0, 1].map(|i| (at[i] - first[i]) as f32);
        let texel = |dx: i64, dy: i64| {
            let [x, y] =
                [(0, dx), (1, dy)].map(|(i, d)| neighbour(first[i] as i64 + d, level.size[i], self.wrap[i]));
            linear(level.texels[y * level.size[0] as usize + x])
        };
        let upper = texel(0, 0).lerp(texel(1, 0), blend[0]);
        upper.lerp(texel(0, 1).lerp(texel(1, 1), blend[0]), blend[1])
    }
}

impl Level {
    /// Half the size, each texel the mean of four in linear light, weighted by `alphas`; and the new alphas.
    fn halved(&self, alphas: &[u8]) -> (Self, Vec<u8>) {
        let size = self.size.map(|side| (side / 2).max(1));
        let count = size[0] as usize * size[1] as usize;
        let (mut texels, mut next_alphas) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for y in 0..size[1] {
            for x in 0..size[0] {
                let (mut sum, mut plain, mut alpha) = ([0u64; 3], [0u64; 3], 0u64);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (sx, sy) = ((x * 2 + dx).min(self.size[0] - 1), (y * 2 + dy).min(self.size[1] - 1));
                    let at = sy as usize * self.size[0] as usize + sx as usize;
                    alpha += u64::from(alphas[at]);
                    for (c, &code) in self.texels[at].iter().enumerate() {
                        let linear = u64::from(LINEAR_FROM_SRGB[usize::from(code)]);
                        sum[c] += linear * u64::from(alphas[at]);
                        plain[c] += linear;
                    }
                }
                texels.push([0, 1, 2].map(|c| {
                    let mean = (sum[c] + alpha / 2).checked_div(alpha).unwrap_or((plain[c] + 2) / 4);
                    srgb_from_linear(mean as u16)
                }));
                next_alphas.push(((alpha + 2) / 4) as u8);
            }
        }
        (Self { size, texels }, next_alphas)
    }
}

/// A coordinate brought into 0 … 1 by a wrap mode.
fn wrapped(c: f64, wrap: Wrap) -> f64 {
    let c = match wrap {
        Wrap::Repeat => c - c.floor(),
        Wrap::MirroredRepeat => {
            let period = c - (c * 0.5).floor() * 2.0;
            period.min(2.0 - period)
        }
        Wrap::ClampToEdge => c,
    };
    c.clamp(0.0, 1.0)
}

/// The texel at an index at most one outside of `0 .. size`.
fn neighbour(index: i64, size: u32, wrap: Wrap) -> usize {
    let last = i64::from(size) - 1;
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(last + 1),
        Wrap::MirroredRepeat | Wrap::ClampToEdge => index.clamp(0, last),
    };
    inside as usize
}

fn linear(color: [u8; 3]) -> Vec3 {
    Vec3::from(color.map(srgb::linear))
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_pipeline::scene::{AlphaMode, Material};

    fn textures(texels: Vec<[u8; 4]>, width: u32, wrap: Wrap, alpha_mode: AlphaMode) -> Textures {
        let height = texels.len() as u32 / width;
        Textures::new(&Scene {
            materials: vec![Material { base_color_texture: Some(0), alpha_mode, ..Material::default() }],
            textures: vec![Texture { width, height, texels, wrap: [wrap; 2] }],
            ..Scene::default()
        })
    }

    #[test]
    fn colours_are_read_between_texels() {
        let black_and_white = vec![[0, 0, 0, 255], [255, 255, 255, 255]];
        let red = |wrap, u: f64| {
            textures(black_and_white.clone(), 2, wrap, AlphaMode::Opaque).sample(0, DVec2::new(u, 0.5), 1.0).x
        };
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} {b}");
        near(red(Wrap::ClampToEdge, 0.25), 0.0);
        near(red(Wrap::ClampToEdge, 0.5), 0.5);
        near(red(Wrap::ClampToEdge, 0.75), 1.0);
        near(red(Wrap::ClampToEdge, -3.0), 0.0);
        near(red(Wrap::Repeat, 2.0), 0.5);
        near(red(Wrap::Repeat, -0.25), 1.0);
        near(red(Wrap::MirroredRepeat, 1.25), 1.0);
        near(red(Wrap::MirroredRepeat, 2.25), 0.0);
        assert!(red(Wrap::Repeat, 1e300).is_finite());
    }

    #[test]
    fn distant_pixels_see_means() {
        let checks = vec![[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]];
        let textures = textures(checks, 2, Wrap::Repeat, AlphaMode::Opaque);
        let at = |texels| textures.sample(0, DVec2::new(0.25, 0.25), texels).x;
        assert_eq!(at(1.0), 0.0);
        assert!((at(4.0) - 0.5).abs() < 0.01 && (at(1e9) - 0.5).abs() < 0.01);
        assert!((at(2.0) - 0.25).abs() < 0.01, "half way between the levels");
        assert!(at(f64::NAN) == 0.0 && at(f64::INFINITY) > 0.4);
    }

    #[test]
    fn what_alpha_cuts_away_does_not_bleed() {
        let leaf = vec![[0, 255, 0, 255], [255, 0, 0, 0], [255, 0, 0, 0], [255, 0, 0, 0]];
        let textures = textures(leaf, 2, Wrap::Repeat, AlphaMode::Mask { cutoff: 0.5 });
        assert_eq!(textures.sample(0, DVec2::splat(0.5), 16.0), Vec3::Y);
    }
}
