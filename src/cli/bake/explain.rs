//! What would become of every step, as text and as JSON.

use std::fmt::Write as _;

use manyview_pipeline::explain::{State, Step};
use manyview_pipeline::steps::StepKind;
use serde_json::{Value, json};

use super::super::Format;
use super::super::output::count;

/// Steps of one kind that are listed one by one; the rest is counted.
const LISTED: usize = 20;

/// Tells on stderr.
pub(super) fn tell(format: Format, steps: &[Step]) {
    match format {
        Format::Text => eprint!("{}", text(steps)),
        Format::Json => eprintln!("{}", json!({ "event": "explain", "steps": json(steps) })),
    }
}

/// One line for each step that would be made, and one for all of a kind that would not.
pub(super) fn text(steps: &[Step]) -> String {
    if steps.is_empty() {
        return "nothing to make: the archive is what a bake would write\n".to_owned();
    }
    let mut text = String::new();
    for kind in StepKind::ALL {
        let of_kind = |is_hit: bool| {
            steps.iter().filter(move |step| step.kind == kind && (step.state == State::Hit) == is_hit)
        };
        let (hits, made): (u64, u64) =
            (of_kind(true).map(|step| step.count).sum(), of_kind(false).map(|step| step.count).sum());
        if hits + made == 0 {
            continue;
        }
        _ = writeln!(text, "{:>12}  {} to make, {} in the cache", kind.name(), count(made), count(hits));
        for step in of_kind(false).take(LISTED) {
            let verb = if step.state == State::Patch { "change" } else { "make" };
            let reasons: Vec<String> = step.reasons.iter().map(ToString::to_string).collect();
            let (item, cost, unit) = (&step.item, count(step.cost), step.unit);
            _ = writeln!(text, "{:>14}{verb} {item} ({cost} {unit}): {}", "", reasons.join("; "));
        }
        let more = of_kind(false).skip(LISTED).count();
        if more > 0 {
            _ = writeln!(text, "{:>14}… and {} more", "", count(more as u64));
        }
    }
    text
}

/// All steps.
pub(super) fn json(steps: &[Step]) -> Value {
    serde_json::to_value(steps).unwrap_or_default()
}
