//! How far a bake is, on stderr: bars on a terminal, plain lines elsewhere, JSON events where asked for.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use manyview_pipeline::bake;
use manyview_pipeline::estimate::Estimate;
use serde_json::json;

use super::Format;
use super::output::{bytes, count};

/// Reports a bake's steps on stderr.
pub(crate) struct Progress {
    style: Style,
    cancelled: &'static AtomicBool,
    step: Mutex<Option<Step>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Style {
    Bars,
    Lines,
    Json,
}

struct Step {
    name: &'static str,
    total: u64,
    unit: &'static str,
    done: u64,
    begun: Instant,
    told: Instant,
    bar: ProgressBar,
}

/// Plain lines and events come no more often than this.
const INTERVAL: Duration = Duration::from_secs(2);

impl Progress {
    pub(crate) fn new(format: Format, cancelled: &'static AtomicBool) -> Self {
        let style = match format {
            Format::Json => Style::Json,
            Format::Text if std::io::stderr().is_terminal() => Style::Bars,
            Format::Text => Style::Lines,
        };
        Self { style, cancelled, step: Mutex::new(None) }
    }

    /// Ends the last step's display.
    pub(crate) fn finish(&self) {
        if let Some(step) = self.lock().take() {
            self.end(&step);
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Step>> {
        self.step.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn end(&self, step: &Step) {
        let seconds = step.begun.elapsed().as_secs_f64();
        match self.style {
            Style::Bars => step.bar.finish_and_clear(),
            Style::Lines => {}
            Style::Json => eprintln!(
                "{}",
                json!({"event": "step_end", "step": step.name, "done": step.done, "total": step.total, "seconds": seconds})
            ),
        }
        if self.style != Style::Json {
            eprintln!("{:>12}  {} {} in {seconds:.1} s", step.name, count(step.done), step.unit);
        }
    }
}

impl bake::Progress for Progress {
    fn begin(&self, step: &'static str, total: u64, unit: &'static str) {
        self.finish();
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
        if self.style == Style::Bars {
            let template = "{msg:>12}  {bar:30} {pos}/{len} {prefix}, {per_sec}, {eta} left";
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(step);
            bar.set_prefix(unit);
        } else {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if self.style == Style::Json {
            eprintln!("{}", json!({"event": "step_begin", "step": step, "total": total, "unit": unit}));
        }
        let now = Instant::now();
        *self.lock() = Some(Step { name: step, total, unit, done: 0, begun: now, told: now, bar });
    }

    fn advance(&self, units: u64) {
        let mut step = self.lock();
        let Some(step) = step.as_mut() else { return };
        step.done += units;
        if self.style == Style::Bars {
            step.bar.inc(units);
            return;
        }
        if step.told.elapsed() < INTERVAL || step.done >= step.total {
            return;
        }
        step.told = Instant::now();
        if self.style == Style::Json {
            eprintln!(
                "{}",
                json!({"event": "progress", "step": step.name, "done": step.done, "total": step.total})
            );
        } else {
            let left =
                step.begun.elapsed().as_secs_f64() / step.done as f64 * (step.total - step.done) as f64;
            let (done, total) = (count(step.done), count(step.total));
            eprintln!("{:>12}  {done}/{total} {}, {left:.0} s left", step.name, step.unit);
        }
    }

    fn estimate(&self, estimate: &Estimate) {
        if self.style == Style::Json {
            eprintln!("{}", estimate_event(estimate));
        } else {
            eprintln!("{:>12}  {}", "about to bake", estimate_line(estimate));
        }
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

/// An estimate in one line.
pub(crate) fn estimate_line(estimate: &Estimate) -> String {
    format!(
        "{} triangles, about {} voxels, {} of rows before compression; about {:.1} s, memory {}, archive {}",
        count(estimate.triangles),
        count(estimate.leaves),
        bytes(estimate.rows_raw_bytes),
        estimate.seconds,
        bytes(estimate.peak_bytes),
        bytes(estimate.archive_bytes)
    )
}

/// An estimate as a JSON event.
pub(crate) fn estimate_event(estimate: &Estimate) -> serde_json::Value {
    json!({
        "event": "estimate",
        "triangles": estimate.triangles,
        "leaves": estimate.leaves,
        "points": estimate.points,
        "rows_raw_bytes": estimate.rows_raw_bytes,
        "archive_bytes": estimate.archive_bytes,
        "peak_bytes": estimate.peak_bytes,
        "least_bytes": estimate.least_bytes,
        "seconds": estimate.seconds,
    })
}
