//! One method and some views: time, memory, and their cells in tables.

use crate::bench::Cell;
use crate::bench::memory::PeakMemory;
use crate::views::{View, ViewError, ViewRenderer, ViewSettings};
use std::time::Instant;

/// What a method did.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// Time for all views, the shortest of some.
    pub seconds: f64,
    /// How many passes there were.
    pub passes: u64,
    /// How many maps there were: views may share them.
    pub maps: u64,
    /// Bytes of all maps.
    pub maps_bytes: u64,
    /// Bytes of the largest pass's maps.
    pub largest_pass_bytes: u64,
    /// Peak memory above what there was before, if the system tells.
    pub peak_bytes: Option<u64>,
}

impl Drawn {
    /// Names of the columns that `drawn_cells` fill.
    pub const COLUMNS: [&'static str; 7] =
        ["ms", "µs a view", "passes", "maps", "MiB of maps", "MiB of the largest pass", "peak MiB"];
}

/// Draws views some times.
pub(super) fn drawn_of(
    renderer: &dyn ViewRenderer,
    views: &[View],
    settings: &ViewSettings,
    repeats: u32,
    cancelled: &dyn Fn() -> bool,
) -> Result<Drawn, ViewError> {
    let mut best: Option<Drawn> = None;
    for _ in 0..repeats.max(1) {
        let mut drawn = Drawn {
            seconds: 0.0,
            passes: 0,
            maps: 0,
            maps_bytes: 0,
            largest_pass_bytes: 0,
            peak_bytes: None,
        };
        let peak = PeakMemory::watch();
        let begun = Instant::now();
        renderer.render_passes(views, settings, &mut |pass| {
            drawn.passes += 1;
            drawn.maps += pass.centers().len() as u64;
            drawn.maps_bytes += pass.bytes();
            drawn.largest_pass_bytes = drawn.largest_pass_bytes.max(pass.bytes());
            if cancelled() { Err(ViewError::Cancelled) } else { Ok(()) }
        })?;
        drawn.seconds = begun.elapsed().as_secs_f64();
        drawn.peak_bytes = peak.grown_bytes();
        if let Some(best) = &best {
            // Later times find memory that the allocator has kept.
            drawn.peak_bytes = drawn.peak_bytes.max(best.peak_bytes);
            drawn.seconds = drawn.seconds.min(best.seconds);
        }
        best = Some(drawn);
    }
    best.ok_or(ViewError::Cancelled)
}

/// The figures as cells; empty ones of what was left out.
pub(super) fn drawn_cells(drawn: Option<&Drawn>, views: usize) -> Vec<Cell> {
    let Some(drawn) = drawn else { return vec![Cell::None; Drawn::COLUMNS.len()] };
    let mib = |bytes: u64| Cell::Number(bytes as f64 / f64::from(1 << 20), 1);
    vec![
        Cell::Number(drawn.seconds * 1e3, 1),
        Cell::Number(drawn.seconds * 1e6 / views.max(1) as f64, 2),
        Cell::Count(drawn.passes),
        Cell::Count(drawn.maps),
        mib(drawn.maps_bytes),
        mib(drawn.largest_pass_bytes),
        drawn.peak_bytes.map_or(Cell::None, mib),
    ]
}

/// Cells of [`crate::views::agreement::Agreement`].
pub(super) mod agreement_cells {
    use crate::bench::Cell;
    use crate::views::agreement::{Agreement, Counts};

    /// Names of the columns.
    pub(in super::super) const COLUMNS: [&str; 12] = [
        "texels",
        "emptiness %",
        "by most rays %",
        "where clear %",
        "filled wrongly %",
        "empty wrongly %",
        "depth %",
        "by own rays %",
        "emptiness of whole texels %",
        "depth of whole texels %",
        "median error %",
        "mean error %",
    ];

    /// The figures.
    pub(in super::super) fn of(found: &Agreement) -> Vec<Cell> {
        let Counts { texels, filled, .. } = found.all;
        let whole = &found.whole;
        vec![
            Cell::Count(texels),
            Cell::percent(found.all.emptiness, texels),
            Cell::percent(found.all.emptiness_by_most, texels),
            Cell::percent(found.all.clear_emptiness, found.all.clear),
            Cell::percent(found.all.filled_wrongly, texels),
            Cell::percent(found.all.empty_wrongly, texels),
            Cell::percent(found.all.depth, filled),
            Cell::percent(found.all.depth_by_own, filled),
            Cell::percent(whole.emptiness, whole.texels),
            Cell::percent(whole.depth, whole.filled),
            Cell::Number(100.0 * found.error_at(0.5), 3),
            Cell::Number(100.0 * found.mean_error(), 3),
        ]
    }
}
