//! `manyview diff`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use manyview::{Archive, LoadError};
use manyview_cache::archive::{Section, SectionId};
use manyview_shaders::sections::name;
use manyview_shaders::svo::Svo;
use serde_json::{Value, json};

use super::Format;
use super::error::{CliResult, Exit};
use super::output::{Table, count, counted, print, print_json};

/// Directions that differ are listed up to this many; the rest is counted.
const LISTED_DIRECTIONS: usize = 16;

/// Options of `diff`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 the archives hold the same, 1 they differ, more for trouble (as for all commands).\n\
Archives are the same if all sections are, whatever their compression and order."
)]
pub(crate) struct Options {
    /// An archive
    #[arg(value_name = "A.mvb")]
    a: PathBuf,
    /// Another archive
    #[arg(value_name = "B.mvb")]
    b: PathBuf,
    /// How to print it
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// How a section of one archive relates to the other archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum State {
    Same,
    Differs,
    OnlyInA,
    OnlyInB,
}

impl State {
    fn text(self) -> &'static str {
        match self {
            State::Same => "same",
            State::Differs => "differs",
            State::OnlyInA => "only in A",
            State::OnlyInB => "only in B",
        }
    }
}

/// How two octrees differ at one level.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct LevelDifference {
    level: u32,
    /// Cells that only one of them has.
    only_in_a: u64,
    only_in_b: u64,
    /// Cells that both have, with other attributes.
    attributes: u64,
    /// Cells that both have.
    common: u64,
    /// Smallest and largest cell of those that differ in any way.
    region: Option<[[u16; 3]; 2]>,
}

impl LevelDifference {
    fn differs_at(&mut self, cell: [u16; 3]) {
        let [lo, hi] = self.region.unwrap_or([cell; 2]);
        self.region = Some([[0, 1, 2].map(|i| lo[i].min(cell[i])), [0, 1, 2].map(|i| hi[i].max(cell[i]))]);
    }
}

/// How the rows of two bakes of the same directions differ.
#[derive(Debug, Default)]
struct RowsDifference {
    /// Direction and number of bits.
    directions: Vec<(u32, u64)>,
    compared: u32,
    bits_in_a: u64,
    bits_in_b: u64,
}

/// Runs `diff`.
pub(crate) fn run(options: &Options) -> CliResult {
    let a = Archive::open(&options.a)?;
    let b = Archive::open(&options.b)?;
    let states = section_states(&a, &b);
    let differ = |prefix: &str| {
        states.iter().any(|(id, state)| id.name.as_str().starts_with(prefix) && *state != State::Same)
    };
    let levels = if differ("svo.") { Some(compare_octrees(&a, &b)?) } else { None };
    let rows = if differ("rows.") { compare_rows(&a, &b)? } else { None };
    let same = states.values().all(|state| *state == State::Same);
    match options.format {
        Format::Text => print(&text(&a, &b, &states, levels.as_ref(), rows.as_ref()))?,
        Format::Json => print_json(&json(&a, &b, &states, levels.as_ref(), rows.as_ref()))?,
    }
    Ok(if same { Exit::Done } else { Exit::DIFFERENT })
}

/// How the sections of two archives relate.
pub(super) fn section_states(a: &Archive, b: &Archive) -> BTreeMap<SectionId, State> {
    let ids: BTreeSet<SectionId> =
        [a, b].iter().flat_map(|archive| archive.container().sections()).map(|section| section.id).collect();
    let state = |id: &SectionId| {
        let find = |archive: &Archive| archive.container().section(id.name.as_str(), id.item).cloned();
        match (find(a), find(b)) {
            (Some(a), Some(b)) if a.raw_bytes == b.raw_bytes && a.digest == b.digest => State::Same,
            (Some(of_a), Some(of_b)) if has_same_content(a, &of_a, b, &of_b) => State::Same,
            (Some(_), None) => State::OnlyInA,
            (None, Some(_)) => State::OnlyInB,
            _ => State::Differs,
        }
    };
    ids.into_iter().map(|id| (id, state(&id))).collect()
}

/// Whether two sections that are cut into other chunks, as by other versions of this program, hold the same. Their
/// digests do not tell.
fn has_same_content(a: &Archive, of_a: &Section, b: &Archive, of_b: &Section) -> bool {
    let cuts = |archive: &Archive, section: &Section| -> Vec<u32> {
        let chunks =
            &archive.container().chunks()[section.chunks.start as usize..section.chunks.end as usize];
        chunks.iter().map(|chunk| chunk.raw_bytes).collect()
    };
    if of_a.raw_bytes != of_b.raw_bytes || cuts(a, of_a) == cuts(b, of_b) {
        return false;
    }
    match (a.container().read_section(of_a), b.container().read_section(of_b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Compares the levels that both have, cell by cell; `Err` with a sentence where the cells are not the same places.
type OctreeComparison = Result<Vec<LevelDifference>, &'static str>;

fn compare_octrees(a: &Archive, b: &Archive) -> Result<OctreeComparison, LoadError> {
    let cube = |archive: &Archive| (archive.svo_info().origin, archive.svo_info().size);
    if cube(a) != cube(b) {
        return Ok(Err("the scene cubes differ, so that cells cannot be compared"));
    }
    let last = a.svo_info().levels.min(b.svo_info().levels);
    let (a, b) = (a.svo_levels(..=last)?, b.svo_levels(..=last)?);
    Ok(Ok((0..=last).map(|level| compare_level(&a, &b, level)).collect()))
}

fn compare_level(a: &Svo, b: &Svo, level: u32) -> LevelDifference {
    let l = level as usize;
    let (cells_a, cells_b) = (a.cells(l), b.cells(l));
    let (of_a, of_b) = (&a.levels[l], &b.levels[l]);
    let mut difference = LevelDifference { level, ..LevelDifference::default() };
    let (mut i, mut j) = (0, 0);
    while i < cells_a.len() || j < cells_b.len() {
        let order = match (cells_a.get(i), cells_b.get(j)) {
            (Some(a), Some(b)) => morton_cmp(*a, *b),
            (Some(_), None) => std::cmp::Ordering::Less,
            _ => std::cmp::Ordering::Greater,
        };
        if order.is_lt() {
            difference.only_in_a += 1;
            difference.differs_at(cells_a[i]);
            i += 1;
        } else if order.is_gt() {
            difference.only_in_b += 1;
            difference.differs_at(cells_b[j]);
            j += 1;
        } else {
            difference.common += 1;
            let same = of_a.colors[i] == of_b.colors[j]
                && of_a.normals[i] == of_b.normals[j]
                && of_a.cones[i] == of_b.cones[j]
                && of_a.coverages.get(i) == of_b.coverages.get(j)
                && of_a.emissive.get(i) == of_b.emissive.get(j);
            difference.attributes += u64::from(!same);
            if !same {
                difference.differs_at(cells_a[i]);
            }
            i += 1;
            j += 1;
        }
    }
    difference
}

/// Compares cells in Morton order (x fastest) without computing codes: the axis with the highest differing bit decides.
fn morton_cmp(a: [u16; 3], b: [u16; 3]) -> std::cmp::Ordering {
    let differing = [0, 1, 2].map(|i| a[i] ^ b[i]);
    let mut axis = 2;
    for candidate in [1, 0] {
        // Whether the highest bit of the first is below that of the second.
        let (x, y) = (differing[axis], differing[candidate]);
        if x < y && x < x ^ y {
            axis = candidate;
        }
    }
    a[axis].cmp(&b[axis])
}

/// World bounds of the cells that differ at the deepest level that both have, metres.
fn region(a: &Archive, levels: Option<&OctreeComparison>) -> Option<[[f64; 3]; 2]> {
    let level = levels?.as_ref().ok()?.last()?;
    let [lo, hi] = level.region?;
    let info = a.svo_info();
    let cell = info.size / f64::from(1u32 << level.level);
    let at = |cells: [f64; 3]| [0, 1, 2].map(|i| info.origin[i] + cells[i] * cell);
    Some([at(lo.map(f64::from)), at(hi.map(|c| f64::from(c) + 1.0))])
}

fn compare_rows(a: &Archive, b: &Archive) -> Result<Option<RowsDifference>, LoadError> {
    let (Some(of_a), Some(of_b)) = (a.rows_info(), b.rows_info()) else { return Ok(None) };
    if (a.direction_set(), of_a.bits) != (b.direction_set(), of_b.bits) {
        return Ok(None);
    }
    let mut difference = RowsDifference { compared: of_a.directions, ..RowsDifference::default() };
    let ones = |rows: &[u32]| rows.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
    for direction in 0..of_a.directions {
        let (rows_a, rows_b) = (a.direction_rows(direction)?, b.direction_rows(direction)?);
        difference.bits_in_a += ones(&rows_a);
        difference.bits_in_b += ones(&rows_b);
        let bits: u64 = rows_a.iter().zip(&rows_b).map(|(a, b)| u64::from((a ^ b).count_ones())).sum();
        if bits > 0 {
            difference.directions.push((direction, bits));
        }
    }
    Ok(Some(difference))
}

fn text(
    a: &Archive,
    b: &Archive,
    states: &BTreeMap<SectionId, State>,
    levels: Option<&OctreeComparison>,
    rows: Option<&RowsDifference>,
) -> String {
    let mut text = format!("A: {}\nB: {}\n\n", a.name(), b.name());
    let mut counts: BTreeMap<(&str, State), Vec<u32>> = BTreeMap::new();
    for (id, state) in states {
        counts.entry((id.name.as_str(), *state)).or_default().push(id.item);
    }
    let mut table = Table::new(["section", "state", "items", "which"]);
    for ((name, state), items) in counts {
        let which = match (state, items.as_slice()) {
            (State::Same, _) => String::new(),
            (_, [first, .., last]) if items.len() > 4 => format!("{first} … {last}"),
            _ => items.iter().map(u32::to_string).collect::<Vec<_>>().join(" "),
        };
        table.row([name.to_owned(), state.text().to_owned(), count(items.len() as u64), which]);
    }
    text.push_str(&table.render());
    match levels {
        Some(Ok(levels)) => {
            let mut table = Table::new(["level", "in both", "only in A", "only in B", "other attributes"]);
            for level in levels {
                table.row([
                    level.level.to_string(),
                    count(level.common),
                    count(level.only_in_a),
                    count(level.only_in_b),
                    count(level.attributes),
                ]);
            }
            text.push_str(&format!("\noctree cells\n{}", table.render()));
            if let Some([min, max]) = region(a, Some(&Ok(levels.clone()))) {
                let place = |[x, y, z]: [f64; 3]| format!("({x:.3}, {y:.3}, {z:.3})");
                let (min, max) = (place(min), place(max));
                text.push_str(&format!("all differences of the octree lie from {min} to {max} m\n"));
            }
        }
        Some(Err(reason)) => text.push_str(&format!("\noctree: {reason}\n")),
        None => {}
    }
    if let Some(rows) = rows {
        text.push_str(&rows_text(rows));
    }
    let different = states.values().filter(|state| **state != State::Same).count() as u64;
    text.push_str(&match different {
        0 => "\nthe archives hold the same\n".to_owned(),
        _ => format!("\n{} of {} differ\n", counted(different, "section"), count(states.len() as u64)),
    });
    text
}

fn rows_text(rows: &RowsDifference) -> String {
    let bits: u64 = rows.directions.iter().map(|(_, bits)| bits).sum();
    let share = bits as f64 / rows.bits_in_a.max(1) as f64 * 100.0;
    let mut text = format!(
        "\nrows: {} of {} differ, in {} ({share:.4}% of A's {} set bits; B has {})\n",
        count(rows.directions.len() as u64),
        counted(rows.compared.into(), "direction"),
        counted(bits, "bit"),
        count(rows.bits_in_a),
        count(rows.bits_in_b),
    );
    let mut table = Table::new(["direction", "bits"]);
    for (direction, bits) in rows.directions.iter().take(LISTED_DIRECTIONS) {
        table.row([direction.to_string(), count(*bits)]);
    }
    if rows.directions.len() > LISTED_DIRECTIONS {
        table.row(["…".to_owned(), String::new()]);
    }
    if !rows.directions.is_empty() {
        text.push_str(&table.render());
    }
    text
}

fn json(
    a: &Archive,
    b: &Archive,
    states: &BTreeMap<SectionId, State>,
    levels: Option<&OctreeComparison>,
    rows: Option<&RowsDifference>,
) -> Value {
    let sections: Vec<Value> = states
        .iter()
        .map(|(id, state)| json!({ "name": id.name.as_str(), "item": id.item, "state": state.text() }))
        .collect();
    let region = region(a, levels).map(|[min, max]| json!({ "min": min, "max": max }));
    let levels = levels.map(|levels| match levels {
        Ok(levels) => levels
            .iter()
            .map(|level| {
                json!({
                    "level": level.level,
                    "common": level.common,
                    "only_in_a": level.only_in_a,
                    "only_in_b": level.only_in_b,
                    "attributes": level.attributes,
                })
            })
            .collect(),
        Err(reason) => json!({ "not_compared": reason }),
    });
    let rows = rows.map(|rows| {
        json!({
            "compared": rows.compared,
            "bits_in_a": rows.bits_in_a,
            "bits_in_b": rows.bits_in_b,
            "different_bits": rows.directions.iter().map(|(_, bits)| bits).sum::<u64>(),
            "directions": rows.directions.iter().map(|(direction, bits)| json!({ "direction": direction, "bits": bits })).collect::<Vec<_>>(),
        })
    });
    let same = states.values().all(|state| *state == State::Same);
    json!({ "a": a.name(), "b": b.name(), "same": same, "sections": sections, name::SVO_INFO.trim_end_matches(".info"): levels, "region": region, "rows": rows })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_compare_as_their_morton_codes() {
        let code = |cell: [u16; 3]| {
            (0..48).fold(0u64, |code, bit| code | u64::from(cell[bit % 3] >> (bit / 3) & 1) << bit)
        };
        let values = [0u16, 1, 2, 3, 5, 8, 4095, 4096];
        let cells: Vec<_> = (0..512).map(|i| [values[i & 7], values[i >> 3 & 7], values[i >> 6]]).collect();
        for &a in &cells {
            for &b in &cells {
                assert_eq!(morton_cmp(a, b), code(a).cmp(&code(b)), "{a:?} {b:?}");
            }
        }
    }
}
