//! Content that is mostly zero, in records of 16 bytes: the sparse form that [`Codec::Sparse`](super::Codec::Sparse)
//! compresses.
//!
//! Bit voxelizations are such content: one record is one row of 128 voxels. Zero bytes are left out before zstd sees
//! anything, and the others are sorted by their place in the record, where neighbours are alike. Measured on the rows of
//! a town: 1.45 times smaller than zstd alone, and three times as fast to make.
//!
//! For n bytes of content (a multiple of 1,024), with n / 16 records, byte `i` of record `r` has the number
//! `i · n / 16 + r`. The sparse form is, one after the other:
//!
//! | bytes | what |
//! |---|---|
//! | n / 64 | bit k of this bitmap: whether byte k of the next bitmap is not zero |
//! | … | the bytes that are not zero of a bitmap of n bits: bit k tells whether content byte number k is not zero |
//! | … | the content bytes that are not zero, by number |

use std::cell::RefCell;

use super::error::{ArchiveError, corrupt};

/// Bytes of a record.
const RECORD: usize = 16;
/// Content comes in multiples of this, so that every bitmap has whole bytes for every place in the record.
const UNIT: usize = 1024;

/// The sparse form of `raw`, or `None` where it would not be well below `raw`'s size.
pub(super) fn encode(raw: &[u8]) -> Option<Vec<u8>> {
    if raw.is_empty() || !raw.len().is_multiple_of(UNIT) {
        return None;
    }
    let records = raw.len() / RECORD;
    let mut bitmap = vec![0u8; raw.len() / 8];
    // Room for all bytes of a place; how many there are.
    let mut columns = vec![0u8; raw.len()];
    let mut counts = [0usize; RECORD];
    let mut left = raw.len() / 2;
    for (r, record) in raw.as_chunks::<RECORD>().0.iter().enumerate() {
        // Record by record as a number: most are zero, and in the others most bytes are.
        let mut rest = u128::from_le_bytes(*record);
        while rest != 0 {
            let i = rest.trailing_zeros() as usize / 8;
            columns[i * records + counts[i]] = (rest >> (8 * i)) as u8;
            counts[i] += 1;
            bitmap[(i * records + r) / 8] |= 1 << (r % 8);
            rest &= !(0xff << (8 * i));
            left = left.checked_sub(1)?;
        }
    }
    let mut sparse = vec![0; raw.len() / 64];
    for (k, &byte) in bitmap.iter().enumerate() {
        if byte != 0 {
            sparse[k / 8] |= 1 << (k % 8);
            sparse.push(byte);
        }
    }
    for (column, count) in columns.chunks_exact(records).zip(counts) {
        sparse.extend_from_slice(&column[..count]);
    }
    Some(sparse)
}

/// Puts the content of a sparse form into `raw`, which is all zero and whose size is known from elsewhere. Accepts only
/// what [`encode`] makes. Records without content are not touched.
pub(super) fn decode_into_zeros(sparse: &[u8], raw: &mut [u8]) -> Result<(), ArchiveError> {
    thread_local!(static BITMAP: RefCell<Vec<u64>> = const { RefCell::new(Vec::new()) });
    let broken = |found: &str| Err(corrupt("sparse content", "the form of its size", found));
    if raw.is_empty() || !raw.len().is_multiple_of(UNIT) {
        return broken("a size that is no multiple of 1,024");
    }
    let Some((of_bitmap, rest)) = sparse.split_at_checked(raw.len() / 64) else {
        return broken("too few bytes");
    };
    let Some((bitmap, content)) = rest.split_at_checked(count_ones(of_bitmap)) else {
        return broken("too few bytes");
    };
    if content.len() != count_ones(bitmap) || bitmap.contains(&0) || content.contains(&0) {
        return broken("other counts than its bitmaps tell, or a zero where there is none");
    }
    BITMAP.with_borrow_mut(|words| {
        words.clear();
        let mut bytes = bitmap.iter();
        words.extend(of_bitmap.iter().map(|&present| {
            let (mut present, mut word) = (present, 0);
            while present != 0 {
                word |= u64::from(bytes.next().copied().unwrap_or(0)) << (8 * present.trailing_zeros());
                present &= present - 1;
            }
            word
        }));
        scatter(words, content, raw);
    });
    Ok(())
}

/// Writes the bytes of `content` where the bits of the whole bitmap tell. Records are visited once, 64 at a time with
/// all their places, so that each cache line of `raw` is written once and not sixteen times.
fn scatter(bitmap: &[u64], content: &[u8], raw: &mut [u8]) {
    // Words of the bitmap of one place in the record.
    let words = bitmap.len() / RECORD;
    let mut rest = content;
    let mut columns = [&[][..]; RECORD];
    for (column, bits) in columns.iter_mut().zip(bitmap.chunks_exact(words)) {
        let count = bits.iter().map(|word| word.count_ones() as usize).sum();
        // As long as the bits of the whole bitmap: the caller has counted.
        (*column, rest) = rest.split_at(count);
    }
    for (at, records) in raw.chunks_exact_mut(64 * RECORD).enumerate() {
        for (i, column) in columns.iter_mut().enumerate() {
            let mut bits = bitmap[i * words + at];
            if bits == 0 {
                continue;
            }
            let (bytes, behind) = column.split_at(bits.count_ones() as usize);
            *column = behind;
            for &byte in bytes {
                records[bits.trailing_zeros() as usize * RECORD + i] = byte;
                bits &= bits - 1;
            }
        }
    }
}

fn count_ones(bytes: &[u8]) -> usize {
    let (words, rest) = bytes.as_chunks();
    let words = words.iter().map(|&word| u64::from_le_bytes(word).count_ones() as usize);
    words.sum::<usize>() + rest.iter().map(|byte| byte.count_ones() as usize).sum::<usize>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_known_form() {
        let mut raw = vec![0; 1024];
        raw[3 * 16 + 1] = 7; // Record 3, place 1: number 64 + 3 = 67, so byte 8 of the bitmap, bit 3.
        let mut expected = vec![0; 16];
        expected[1] = 1;
        expected.extend([8, 7]);
        assert_eq!(encode(&raw), Some(expected));
    }

    #[test]
    fn dense_or_odd_content_has_no_sparse_form() {
        assert_eq!(encode(&[1; 2048]), None);
        assert_eq!(encode(&[0; 1000]), None);
        assert_eq!(encode(&[]), None);
    }

    proptest! {
        #[test]
        fn sparse_content_round_trips(
            units in 1usize..5, bytes in prop::collection::vec((any::<u16>(), 1u8..), 0..400),
        ) {
            let mut raw = vec![0; units * UNIT];
            for (at, byte) in bytes {
                let at = usize::from(at) % raw.len();
                raw[at] = byte;
            }
            let sparse = encode(&raw).expect("fewer than half of the bytes are set");
            let mut back = vec![0; raw.len()];
            decode_into_zeros(&sparse, &mut back).unwrap();
            prop_assert_eq!(&back, &raw);
            // Nothing shorter, longer or with a zero in it is taken for it.
            prop_assert!(decode_into_zeros(&sparse[..sparse.len() - 1], &mut back).is_err());
            let longer = [&sparse[..], &[1]].concat();
            prop_assert!(decode_into_zeros(&longer, &mut back).is_err());
        }

        #[test]
        fn any_bytes_decode_or_fail(sparse in prop::collection::vec(any::<u8>(), 0..200)) {
            let mut raw = vec![0; UNIT];
            if decode_into_zeros(&sparse, &mut raw).is_ok() {
                prop_assert_eq!(encode(&raw), Some(sparse));
            }
        }
    }
}
