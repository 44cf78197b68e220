//! Learns the probabilities of coded rows, as committed in `src/archive/row_model.bin`.
//!
//! ```console
//! $ cargo run --release -p manyview-cache --example learn_rows -- MODEL.bin ARCHIVE.mvb …
//! ```
//!
//! Counts symbols in rows of 128³ voxels, each archive with the same weight. The committed model is of generated scenes of
//! every kind, so that it is about surfaces and not about somebody's scene: `manyview scene KIND --triangles 200000` with
//! city, forest, hairball, park and a town of `--triangles 100000 --seed 5`; and city, forest, park and town of
//! `--triangles 3000`, which are small, so that walls are large beside a voxel. All baked with `--levels 6`. Contexts are
//! grouped so that those of a group have alike probabilities: k-means under the cost in bits.
//!
//! Tried: four sets of probabilities, each tile under the one that suits it. Indoor scenes became 4 to 5 % smaller, others 1 to
//! 5 %, for four times the tables and a tenth of the coding speed; with probabilities learned from the scenes themselves
//! 6 to 12 %. What is left indoors is not in the neighbours of a byte.

use manyview_cache::archive::{Archive, TILE_BYTES, row_code::visit_symbols, row_model};
use row_model::{CONTENT, CONTEXTS, MAP, ONE, TABLES, escape};
use std::error::Error;

const ROW_BYTES: usize = 16;
/// What each scene's counts sum up to.
const WEIGHT: f64 = 1e7;
const ROUNDS: usize = 25;
/// A symbol needs so many parts of [`ONE`] to have a share where it can be escaped.
const RARE: f64 = 0.6;

type Counts = Vec<[f64; 256]>;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let output = arguments.next().ok_or("usage: learn_rows MODEL.bin ARCHIVE.mvb …")?;
    let mut counts: Counts = vec![[0.0; 256]; CONTEXTS];
    for path in arguments {
        let of_scene = count(&path)?;
        let sum: f64 = of_scene.iter().flatten().sum();
        println!("{path}: {sum} symbols");
        for (all, scene) in counts.iter_mut().flatten().zip(of_scene.iter().flatten()) {
            *all += scene * WEIGHT / sum;
        }
    }
    let mut table_of = Vec::new();
    let mut shares = Vec::new();
    let mut rare = [0.0; 256];
    for (kind, contexts) in [0..MAP, MAP..CONTENT, CONTENT..CONTEXTS].into_iter().enumerate() {
        let first: usize = TABLES[..kind].iter().sum();
        let (groups, tables) = group(&counts[contexts.clone()], TABLES[kind]);
        table_of.extend(groups.iter().map(|group| (first + group) as u8));
        for table in &tables {
            shares.extend(with_escape(table, escape(contexts.start), &mut rare));
        }
    }
    // Any symbol may be rare, but zero: it is the commonest or never there.
    rare[0] = 0.0;
    rare[1..].iter_mut().for_each(|count| *count = count.max(1e-9));
    shares.extend(round(&rare));
    let mut model = table_of;
    model.extend(shares.iter().flat_map(|share: &u16| share.to_le_bytes()));
    fs_err::write(output, zstd::bulk::compress(&model, 19)?)?;
    Ok(())
}

fn count(path: &str) -> Result<Counts, Box<dyn Error>> {
    let archive = Archive::open(path)?;
    let mut counts: Counts = vec![[0.0; 256]; CONTEXTS];
    let rows = archive.sections().iter().filter(|section| section.id.name.as_str() == "rows.bits");
    // A few of all blocks tell enough.
    for section in rows.step_by(11) {
        let content = archive.read_section(section)?;
        for tile in content.chunks(TILE_BYTES).filter(|tile| tile.iter().any(|&byte| byte != 0)) {
            visit_symbols(ROW_BYTES, tile, &mut |context, symbol| {
                counts[context][usize::from(symbol)] += 1.0;
            });
        }
    }
    Ok(counts)
}

/// Bits of every symbol under what a table counted, smoothed.
fn bits(table: &[f64; 256], prior: &[f64; 256]) -> [f64; 256] {
    let sum: f64 = table.iter().sum();
    std::array::from_fn(|symbol| -((table[symbol] + 8.0 * prior[symbol]) / (sum + 8.0)).log2())
}

/// Puts contexts into groups: the group of each, and what each group counts.
fn group(counts: &[[f64; 256]], groups: usize) -> (Vec<usize>, Counts) {
    let sum = |table: &[f64; 256]| table.iter().sum::<f64>();
    let add = |a: &mut [f64; 256], b: &[f64; 256]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
    let mut all = [0.0; 256];
    counts.iter().for_each(|context| add(&mut all, context));
    let total = sum(&all).max(1.0);
    let prior = all.map(|count| (count + total * 1e-6) / (total * (1.0 + 256e-6)));
    // The first centers: the commonest contexts.
    let mut order: Vec<usize> = (0..counts.len()).collect();
    order.sort_by(|a, b| sum(&counts[*b]).total_cmp(&sum(&counts[*a])));
    let mut centers: Counts = order[..groups].iter().map(|context| counts[*context]).collect();
    let mut group_of = vec![0; counts.len()];
    for round in 0..ROUNDS {
        let costs: Counts = centers.iter().map(|center| bits(center, &prior)).collect();
        let cost = |context: &[f64; 256], group: usize| -> f64 {
            context.iter().zip(&costs[group]).map(|(count, bits)| count * bits).sum()
        };
        let mut whole = 0.0;
        for (context, group) in counts.iter().zip(&mut group_of) {
            // What never occurred goes where the mean is cheapest.
            let context = if sum(context) > 0.0 { context } else { &prior };
            let best = (0..groups).map(|group| (cost(context, group), group));
            let (least, best) = best.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0));
            (whole, *group) = (whole + least, best);
        }
        println!("  round {round}: {:.0} bytes", whole / 8.0);
        centers = vec![[0.0; 256]; groups];
        counts.iter().zip(&group_of).for_each(|(context, group)| add(&mut centers[*group], context));
    }
    // The rare remain possible.
    centers.iter_mut().for_each(|center| {
        let weight = sum(center).max(1.0) * 1e-4;
        center.iter_mut().zip(&prior).for_each(|(count, prior)| *count += weight * prior);
    });
    (group_of, centers)
}

/// Shares of a table whose rare symbols are escaped, and added to `rare`.
fn with_escape(table: &[f64; 256], escape: u8, rare: &mut [f64; 256]) -> Vec<u16> {
    let unit = table.iter().sum::<f64>().max(1.0) / f64::from(ONE);
    let mut kept = *table;
    let mut escaped = 0.0;
    for (symbol, count) in kept.iter_mut().enumerate() {
        if symbol == usize::from(escape) || *count < RARE * unit && symbol > 0 {
            rare[symbol] += *count;
            escaped += std::mem::take(count);
        }
    }
    kept[usize::from(escape)] = escaped.max(unit);
    round(&kept)
}

/// Shares that sum up to [`ONE`], at least one part for each symbol that was counted.
fn round(table: &[f64; 256]) -> Vec<u16> {
    let sum: f64 = table.iter().sum();
    let ideal = table.map(|count| count / sum * f64::from(ONE));
    let mut shares: Vec<u16> =
        ideal.iter().map(|ideal| if *ideal > 0.0 { ideal.round().max(1.0) as u16 } else { 0 }).collect();
    // Where rounding gave too much or too little, the symbol that it costs the fewest bits gives or takes.
    loop {
        let given: u32 = shares.iter().map(|share| u32::from(*share)).sum();
        if given == ONE {
            return shares;
        }
        let by: i32 = if given > ONE { -1 } else { 1 };
        let cost = |symbol: usize| {
            let share = f64::from(shares[symbol]);
            ideal[symbol] * (share / (share + f64::from(by))).log2()
        };
        let candidates = (0..256).filter(|&symbol| shares[symbol] > u16::from(by < 0));
        let best = candidates.min_by(|a, b| cost(*a).total_cmp(&cost(*b))).expect("some symbol has a share");
        shares[best] = (i32::from(shares[best]) + by) as u16;
    }
}
