//! Any bytes as an array file: refused, or exactly as many elements as its shape says, whatever the sizes of the reads.

use manyview::npy::ArrayReader;

/// Fails if the rule is broken.
pub(crate) fn check(data: &[u8]) {
    let Some((&piece, file)) = data.split_first() else { return };
    let shapes: &[&[Option<u64>]] = &[&[None, Some(6)], &[None, Some(9)], &[None], &[None, None, None]];
    let Ok(mut reader) = ArrayReader::<f32, _>::new("fuzz.npy", file, shapes) else { return };
    let elements: u64 = reader.shape().iter().product();
    let mut values = vec![0.0; usize::from(piece) + 1];
    let mut found = 0;
    loop {
        match reader.read(&mut values) {
            Ok(0) => break assert_eq!(found, elements),
            Ok(count) => found += count as u64,
            Err(_) => break,
        }
    }
    assert!(found * 4 <= file.len() as u64);
}
