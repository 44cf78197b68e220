//! Runs a check over its seeds, and over damaged copies of them, as ordinary tests do; writes the seeds for the fuzzer.

use std::path::Path;

/// Where the seeds are written for the fuzzer: the absolute path of `fuzz/corpus`. Unset in ordinary runs.
const SEEDS_VARIABLE: &str = "MANYVIEW_SEEDS";

/// Checks the seeds, what fuzzing found and was worth keeping (`fuzz/kept/<target>`), and so many damaged copies of each:
/// bytes changed, pieces cut out, doubled or joined with another seed.
pub(crate) fn replay(target: &str, seeds: &[Vec<u8>], copies: u64, check: impl Fn(&[u8])) {
    if let Some(folder) = std::env::var_os(SEEDS_VARIABLE) {
        let folder = Path::new(&folder).join(target);
        fs_err::create_dir_all(&folder).unwrap();
        for (number, seed) in seeds.iter().enumerate() {
            fs_err::write(folder.join(format!("seed-{number:02}")), seed).unwrap();
        }
    }
    let mut inputs = seeds.to_vec();
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let fuzz = package.ancestors().map(|above| above.join("fuzz")).find(|fuzz| fuzz.join("checks").is_dir());
    let kept = fuzz.expect("the repository's folder fuzz").join("kept").join(target);
    if kept.is_dir() {
        let mut paths: Vec<_> = fs_err::read_dir(kept).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        inputs.extend(paths.into_iter().map(|path| fs_err::read(path).unwrap()));
    }
    assert!(!inputs.is_empty());
    inputs.iter().for_each(|input| check(input));
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut below = move |limit: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 20) as usize % limit.max(1)
    };
    for number in 0..inputs.len() * copies as usize {
        let mut input = inputs[number % inputs.len()].clone();
        for _ in 0..=below(4) {
            let at = below(input.len());
            let end = at + below((input.len() - at).min(64));
            match below(5) {
                0 | 1 if !input.is_empty() => input[at] = below(256) as u8,
                2 => drop(input.drain(at..end)),
                3 => {
                    let piece = input[at..end].to_vec();
                    input.splice(at..at, piece);
                }
                _ => {
                    let other = &inputs[below(inputs.len())];
                    input.truncate(at);
                    input.extend(&other[at.min(other.len())..]);
                }
            }
        }
        check(&input);
    }
}
