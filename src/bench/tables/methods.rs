//! The methods that tables compare.

use super::subject::Subject;
use crate::bench::{BenchError, BenchScene};
use crate::exact::ExactRays;
use crate::plain_rows::PlainRows;
use crate::rays::OriginBias;
use crate::reference::Reference;
use crate::visibility::Visibility;
use manyview_pipeline::rows::{RowsOptions, RowsPlan};
use manyview_shaders::directions::Fit;
use rayon::prelude::*;
use std::time::Instant;

/// A method that was made for a scene.
pub struct Method<'a> {
    /// Answers.
    pub visibility: Box<dyn Visibility + 'a>,
    /// Memory that it answers from, bytes.
    pub bytes: u64,
    /// Time to make it from the scene, seconds.
    pub prepare_seconds: f64,
}

/// Makes methods by name.
pub trait MethodSource: Sync {
    /// All names, ours first.
    fn names(&self) -> Vec<&'static str>;

    /// Makes a method for a subject. `rows` are the settings of methods that work by rows.
    fn make<'a>(
        &self,
        name: &str,
        subject: &'a Subject<'_>,
        rows: RowsOptions,
    ) -> Result<Method<'a>, BenchError>;
}

/// The methods of this library.
#[derive(Debug, Clone, Copy, Default)]
pub struct OurMethods;

impl MethodSource for OurMethods {
    fn names(&self) -> Vec<&'static str> {
        vec!["rows", "rows-cube", "bvh"]
    }

    fn make<'a>(
        &self,
        name: &str,
        subject: &'a Subject<'_>,
        rows: RowsOptions,
    ) -> Result<Method<'a>, BenchError> {
        let begun = Instant::now();
        let (visibility, bytes): (Box<dyn Visibility + 'a>, u64) = match name {
            "rows" => boxed(plain_rows(subject, rows)),
            // The paper's grid: one cube around the bounding sphere for all directions.
            "rows-cube" => boxed(plain_rows(subject, RowsOptions { fit: Fit::Cube, ..rows })),
            "bvh" => {
                let scene = subject.scene;
                let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
                // A node of 80 bytes for about 3 triangles, and the triangles in f64.
                let bytes = reference.triangles().len() as u64 * (27 + 72);
                (Box::new(ExactRays::new(reference)), bytes)
            }
            _ => {
                let known = self.names().join(", ");
                return Err(BenchError::NoSuchMethod { name: name.to_owned(), known });
            }
        };
        Ok(Method { visibility, bytes, prepare_seconds: begun.elapsed().as_secs_f64() })
    }
}

fn boxed<'a>(rows: PlainRows) -> (Box<dyn Visibility + 'a>, u64) {
    let bytes = rows.bytes();
    (Box::new(rows), bytes)
}

/// Voxelizes all directions in memory.
fn plain_rows(subject: &Subject<'_>, options: RowsOptions) -> PlainRows {
    plain_rows_of(subject.scene, options)
}

pub(super) fn plain_rows_of(scene: &BenchScene, options: RowsOptions) -> PlainRows {
    let plan = RowsPlan::new(options, scene.lattice, &scene.row_triangles, &scene.cutouts);
    let words = 1usize << (3 * options.bits - 5);
    let mut rows = vec![0; words * plan.frames.len()];
    rows.par_chunks_mut(words)
        .zip(&plan.frames)
        .for_each(|(rows, frame)| rows.copy_from_slice(&plan.block(std::slice::from_ref(frame))));
    let frames = plan.frames.clone();
    PlainRows::new(options.directions, scene.lattice, options.bits, frames, rows, OriginBias::default())
}
