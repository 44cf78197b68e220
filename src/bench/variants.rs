//! Ways to make rows that [`super::rows`] compares.

use manyview_pipeline::rows::{POINT_BITS_ABOVE_VOXELS, RowsFrom, RowsOptions};
use manyview_shaders::directions::{DirectionSet, Fit};

/// Which of a direction's points set a bit; all of them in the bake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Keep {
    /// Every point.
    All,
    /// Points at least this far (in voxels) from their voxel's borders across the row, and along it.
    Core {
        /// Distance from the row's four sides.
        across: f64,
        /// Distance from the voxel's two ends.
        along: f64,
    },
    /// All points of voxels that hold at least so many.
    AtLeast(u8),
}

impl std::fmt::Display for Keep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::All => write!(f, "all"),
            Self::Core { across, along } => write!(f, "core {across} across {along} along"),
            Self::AtLeast(count) => write!(f, "at least {count} a voxel"),
        }
    }
}

/// One way to make rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variant {
    /// What the bake is told.
    pub options: RowsOptions,
    /// log2 of points per voxel edge.
    pub point_bits: u32,
    /// Which points count.
    pub keep: Keep,
}

/// How many variants to measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// The paper's ways and the neighbours of the default: half a minute for a scene of 100,000 triangles.
    Brief,
    /// Sources × fits × sets too: the paper's way is slow, and is measured in every one of them.
    Full,
}

/// The variants that the default is chosen from: sources, fits, sets, resolutions, densities and choices of points.
pub fn variants(detail: Detail) -> Vec<Variant> {
    let paper_set = DirectionSet::LatLong { thetas: 90, phis: 90 };
    let octahedral = DirectionSet::Octahedral { size: 90 };
    let usual = RowsOptions { bits: 7, directions: paper_set, fit: Fit::Extent, from: RowsFrom::Points };
    let plain = |options| Variant { options, point_bits: POINT_BITS_ABOVE_VOXELS, keep: Keep::All };
    let mut all = Vec::new();
    for directions in [paper_set, octahedral] {
        for fit in [Fit::Cube, Fit::Extent] {
            for (from, _) in RowsFrom::ALL {
                let paper = (directions, fit, from) == (paper_set, Fit::Cube, RowsFrom::Peel);
                let one_step = [directions == paper_set, fit == Fit::Extent, from == RowsFrom::Points];
                if detail == Detail::Full || paper || one_step.iter().filter(|same| **same).count() >= 2 {
                    all.push(plain(RowsOptions { directions, fit, from, ..usual }));
                }
            }
        }
    }
    for bits in [5, 6] {
        if detail == Detail::Full {
            all.push(plain(RowsOptions { bits, from: RowsFrom::Peel, ..usual }));
        }
        all.push(plain(RowsOptions { bits, ..usual }));
    }
    for n in [30, 60] {
        all.push(plain(RowsOptions { directions: DirectionSet::LatLong { thetas: n, phis: n }, ..usual }));
    }
    let core = |across, along| Keep::Core { across, along };
    let keeps = [
        (0, vec![Keep::All]),
        (1, vec![core(0.1875, 0.0), core(0.125, 0.0), Keep::AtLeast(2), core(0.25, 0.0)]),
        (2, vec![Keep::All, core(0.25, 0.0), core(0.125, 0.0), core(0.125, 0.125), Keep::AtLeast(4)]),
        (3, vec![Keep::All, core(0.25, 0.0)]),
    ];
    for (point_bits, keeps) in keeps {
        let keeps = keeps.into_iter().enumerate().filter(|(i, _)| detail == Detail::Full || i % 2 == 0);
        all.extend(keeps.map(|(_, keep)| Variant { options: usual, point_bits, keep }));
    }
    let octahedral = RowsOptions { directions: octahedral, ..usual };
    all.push(Variant { options: octahedral, point_bits: 1, keep: core(0.125, 0.0) });
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_has_every_source_and_no_variant_twice() {
        let all = variants(Detail::Full);
        assert!(variants(Detail::Brief).iter().all(|v| all.contains(v)));
        for (i, variant) in all.iter().enumerate() {
            assert!(!all[..i].contains(variant));
        }
        assert!(RowsFrom::ALL.iter().all(|(from, _)| all.iter().any(|v| v.options.from == *from)));
    }
}
