//! One method, some receivers and lights: how wrong, how fast.

use super::{Errors, MethodSource, Subject, TableSettings};
use crate::bench::{BenchError, Cell};
use crate::visibility::{LightPoint, Receiver, Visibility, light_words};
use manyview_pipeline::rows::RowsOptions;
use std::time::Instant;

/// Receivers and lights with the truth about them.
pub struct Measurement<'a> {
    subject: &'a Subject<'a>,
    repeats: u32,
    receivers: Vec<Receiver>,
    lights: Vec<LightPoint>,
    truth: Vec<u32>,
    truth_seconds: f64,
}

/// What one method did.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Its name.
    pub method: String,
    /// How wrong it was.
    pub errors: Errors,
    /// Time for all pairs, seconds.
    pub seconds: f64,
    /// Time for the same pairs by exact rays, seconds.
    pub exact_seconds: f64,
    /// Memory that it answers from.
    pub bytes: u64,
    /// Time to make it.
    pub prepare_seconds: f64,
}

impl<'a> Measurement<'a> {
    /// Asks the judge about `lights` lights and as many receivers as the settings allow.
    pub fn new(subject: &'a Subject<'a>, lights: u32, settings: &TableSettings) -> Result<Self, BenchError> {
        let most = settings.most_pairs / u64::from(lights.max(1));
        let receivers = subject.some_receivers(usize::try_from(most).unwrap_or(usize::MAX));
        let lights = subject.lights(lights, settings.seed);
        let mut truth = vec![0; receivers.len() * light_words(lights.len())];
        let truth_seconds = timed(&subject.judge, &receivers, &lights, &mut truth)?;
        Ok(Self { subject, repeats: settings.repeats.max(1), receivers, lights, truth, truth_seconds })
    }

    /// Makes a method and asks it.
    pub fn of(
        &self,
        source: &dyn MethodSource,
        name: &str,
        rows: RowsOptions,
    ) -> Result<Measured, BenchError> {
        let method = source.make(name, self.subject, rows)?;
        let (errors, seconds) = self.ask(&*method.visibility)?;
        Ok(Measured {
            method: name.to_owned(),
            errors,
            seconds,
            exact_seconds: self.truth_seconds,
            bytes: method.bytes,
            prepare_seconds: method.prepare_seconds,
        })
    }

    /// Asks a method: how wrong it is, and its shortest time for all pairs in seconds.
    pub fn ask(&self, method: &dyn Visibility) -> Result<(Errors, f64), BenchError> {
        let mut found = vec![0; self.truth.len()];
        let mut seconds = f64::INFINITY;
        for _ in 0..self.repeats {
            seconds = seconds.min(timed(method, &self.receivers, &self.lights, &mut found)?);
        }
        Ok((Errors::compare(&self.truth, &found, &self.receivers, &self.lights), seconds))
    }

    /// Time that exact rays took for all pairs, seconds.
    pub fn exact_seconds(&self) -> f64 {
        self.truth_seconds
    }
}

fn timed(
    method: &dyn Visibility,
    receivers: &[Receiver],
    lights: &[LightPoint],
    hidden: &mut [u32],
) -> Result<f64, BenchError> {
    let begun = Instant::now();
    let failed = |source| BenchError::Method { method: method.name().to_owned(), source };
    method.hidden_lights(receivers, lights, hidden).map_err(failed)?;
    Ok(begun.elapsed().as_secs_f64())
}

impl Measured {
    /// Names of the columns that [`Measured::cells`] fill.
    pub const COLUMNS: [&'static str; 12] = [
        "method",
        "eps_v %",
        "eps_s %",
        "eps_v of lights in front %",
        "wrongly hidden %",
        "hidden in truth %",
        "receivers",
        "ms",
        "million rays a second",
        "times as fast as exact rays",
        "MiB",
        "s to make",
    ];

    /// The figures as cells.
    pub fn cells(&self) -> Vec<Cell> {
        let Errors { receivers, .. } = self.errors;
        vec![
            Cell::Text(self.method.clone()),
            Cell::Number(self.errors.eps_v(), 2),
            Cell::Number(self.errors.eps_s(), 2),
            Cell::Number(self.errors.eps_v_facing(), 2),
            Cell::percent(self.errors.wrongly_hidden, self.errors.pairs),
            Cell::Number(self.errors.hidden_share(), 1),
            Cell::Count(receivers),
            Cell::Number(self.seconds * 1e3, 1),
            Cell::Number(self.rays_per_second() * 1e-6, 2),
            Cell::Number(self.exact_seconds / self.seconds.max(1e-9), 1),
            Cell::Number(self.bytes as f64 / f64::from(1 << 20), 0),
            Cell::Number(self.prepare_seconds, 1),
        ]
    }

    /// Pairs a second.
    pub fn rays_per_second(&self) -> f64 {
        self.errors.pairs as f64 / self.seconds.max(1e-9)
    }
}
