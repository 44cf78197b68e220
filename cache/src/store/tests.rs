//! The store alone: values, broken values, processes that are killed or share it, housekeeping.

use super::*;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const BUCKET: Bucket = Bucket { name: "values", version: 3 };
const OTHER: Bucket = Bucket { name: "other-values", version: 1 };

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().join("cache")).unwrap();
    (folder, store)
}

fn key(number: u64) -> Digest {
    Digest::of(&number.to_le_bytes())
}

/// A value whose bytes follow from its number.
fn value(number: u64) -> Vec<u8> {
    (0..200 + number % 1000).map(|i| (i * 7 + number) as u8).collect()
}

fn names(folder: &Path) -> BTreeSet<String> {
    let entries = fs_err::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn what_is_put_is_found_by_this_process_and_the_next() {
    let (_folder, store) = store();
    assert_eq!(store.get(BUCKET, &key(1)), None);
    store.put(BUCKET, &key(1), &[b"one ", b"value"]);
    store.put(BUCKET, &key(2), &[]);
    assert_eq!(store.get(BUCKET, &key(1)).as_deref(), Some(&b"one value"[..]));
    assert_eq!(store.get(BUCKET, &key(2)).as_deref(), Some(&b""[..]));
    assert_eq!(store.get(OTHER, &key(1)), None, "buckets are apart");
    let next = Store::open(store.root()).unwrap();
    assert_eq!(next.get(BUCKET, &key(1)).as_deref(), Some(&b"one value"[..]));
    assert!(next.contains(BUCKET, &key(2)) && !next.contains(BUCKET, &key(3)));
    // A later value takes the place of an earlier one.
    next.put(BUCKET, &key(1), &[b"another"]);
    assert_eq!(store.get(BUCKET, &key(1)).as_deref(), Some(&b"another"[..]));
    assert!(store.take_warnings().is_empty() && next.take_warnings().is_empty());
}

#[test]
fn the_folder_looks_as_drawn() {
    let (_folder, store) = store();
    store.put(BUCKET, &key(1), &[b"value"]);
    let name = key(1).to_string();
    assert_eq!(
        store.entry_path(BUCKET, &key(1)),
        store.root().join("values-v3").join(&name[..2]).join(&name)
    );
    let expected = ["CACHEDIR.TAG", "claims", "leases", "tmp", "values-v3"].map(str::to_owned);
    assert_eq!(names(store.root()), BTreeSet::from(expected));
    let tag = fs_err::read_to_string(store.root().join("CACHEDIR.TAG")).unwrap();
    assert!(tag.starts_with("Signature: 8a477f597d28d172789f06886806bc55"));
    assert!(names(&store.root().join("tmp")).is_empty());
    // Header: magic, version, size, digest of key and content.
    let bytes = fs_err::read(store.entry_path(BUCKET, &key(1))).unwrap();
    assert_eq!(bytes[..8], *b"\x89MVE\r\n\x1a\n");
    assert_eq!(bytes[8..24], [1, 0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0]);
    let digest = Digest::of(&[&key(1).0[..], b"value"].concat());
    assert_eq!((&bytes[24..56], &bytes[56..]), (&digest.0[..], &b"value"[..]));
}

#[test]
fn every_flipped_bit_and_every_cut_is_a_warning_and_a_miss() {
    let (_folder, store) = store();
    let path = store.entry_path(BUCKET, &key(1));
    store.put(BUCKET, &key(1), &[b"some value"]);
    let good = fs_err::read(&path).unwrap();
    let mut broken: Vec<Vec<u8>> = (0..good.len() * 8)
        .map(|bit| {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes
        })
        .collect();
    broken.extend((0..good.len()).map(|end| good[..end].to_vec()));
    broken.push([&good[..], b"x"].concat());
    for bytes in broken {
        fs_err::write(&path, bytes).unwrap();
        assert_eq!(store.get(BUCKET, &key(1)), None);
        let warnings = store.take_warnings();
        assert!(warnings.len() == 1 && warnings[0].contains(&path.display().to_string()), "{warnings:?}");
        assert!(!path.exists(), "what is broken is removed");
    }
    // A sound entry under another's name.
    store.put(BUCKET, &key(2), &[b"other"]);
    fs_err::rename(store.entry_path(BUCKET, &key(2)), &path).unwrap();
    assert_eq!(store.get(BUCKET, &key(1)), None);
    assert!(store.counters().broken > 0);
}

#[test]
fn verify_finds_all_that_is_broken_and_only_that() {
    let (_folder, store) = store();
    for number in 0..60 {
        store.put(BUCKET, &key(number), &[&value(number)]);
    }
    assert_eq!(store.verify().broken, []);
    let broken: BTreeSet<PathBuf> = (0..60)
        .step_by(7)
        .map(|number| {
            let path = store.entry_path(BUCKET, &key(number));
            let mut bytes = fs_err::read(&path).unwrap();
            let at = (number as usize * 31) % bytes.len();
            bytes[at] ^= 0x10;
            fs_err::write(&path, bytes).unwrap();
            path
        })
        .collect();
    let stray = store.root().join("values-v3/00/notes.txt");
    fs_err::create_dir_all(stray.parent().unwrap()).unwrap();
    fs_err::write(&stray, "not an entry").unwrap();
    let report = store.verify();
    let found: BTreeSet<PathBuf> = report.broken.into_iter().map(|(path, _)| path).collect();
    assert_eq!(found, broken.into_iter().chain([stray]).collect());
    assert_eq!(store.verify().broken, [], "they are removed");
    assert_eq!(store.get(BUCKET, &key(1)), Some(value(1)));
}

/// Makes an entry look as if it was used so many seconds ago.
fn age(store: &Store, bucket: Bucket, key: &Digest, seconds: u64) {
    let file = fs_err::OpenOptions::new().write(true).open(store.entry_path(bucket, key)).unwrap();
    file.file().set_modified(SystemTime::now() - Duration::from_secs(seconds)).unwrap();
}

#[test]
fn gc_removes_what_was_not_used_for_the_longest_time() {
    let (_folder, store) = store();
    let size = 1000 + entry::HEADER_BYTES as u64;
    for number in 0..10 {
        store.put(BUCKET, &key(number), &[&[1; 1000]]);
        age(&store, BUCKET, &key(number), 1000 - number);
    }
    // Reading is using.
    assert!(store.get(BUCKET, &key(0)).is_some());
    let report = store.gc(4 * size, &[BUCKET]);
    assert_eq!((report.removed, report.kept_bytes, report.in_use_bytes), (6, 4 * size, 0));
    let left: Vec<u64> = (0..10).filter(|number| store.contains(BUCKET, &key(*number))).collect();
    assert_eq!(left, [0, 7, 8, 9]);
    // Buckets that this program does not read go first, whatever room there is.
    store.put(OTHER, &key(1), &[&[1; 1000]]);
    let stat = store.stat(&[BUCKET]);
    assert_eq!((stat.entries(), stat.bytes(), stat.other_processes), (5, 5 * size, 0));
    assert_eq!(stat.buckets.iter().map(|b| b.is_current).collect::<Vec<_>>(), [false, true]);
    assert_eq!(store.gc(u64::MAX, &[BUCKET]).removed, 1);
    assert!(!store.contains(OTHER, &key(1)));
}

#[test]
fn gc_keeps_what_a_running_process_has_used() {
    let (_folder, store) = store();
    for number in 0..4 {
        store.put(BUCKET, &key(number), &[&value(number)]);
        age(&store, BUCKET, &key(number), 1000);
    }
    let bake = Store::open(store.root()).unwrap();
    assert!(bake.get(BUCKET, &key(2)).is_some());
    bake.put(BUCKET, &key(9), &[b"made by it"]);
    let report = store.gc(0, &[BUCKET]);
    assert_eq!((report.removed, report.in_use_bytes > 0), (3, true));
    assert!(bake.contains(BUCKET, &key(2)) && bake.contains(BUCKET, &key(9)));
    assert_eq!(store.stat(&[BUCKET]).other_processes, 1);
    drop(bake);
    assert_eq!(store.gc(0, &[BUCKET]).kept_bytes, 0, "it is gone, and so is its claim on them");
}

#[test]
fn a_claim_is_one_processs_at_a_time() {
    let (_folder, store) = store();
    let other = Store::open(store.root()).unwrap();
    let Claim::Mine(mine) = store.claim(&key(1)) else { panic!("nobody else has it") };
    assert!(matches!(other.claim(&key(1)), Claim::Theirs));
    assert!(matches!(other.claim(&key(2)), Claim::Mine(_)), "of another value");
    assert!(matches!(other.claim_or_wait(&key(1), || true), Claim::Theirs), "waiting can be cancelled");
    let waiting =
        std::thread::spawn(move || matches!(other.claim_or_wait(&key(1), || false), Claim::Mine(_)));
    std::thread::sleep(Duration::from_millis(30));
    drop(mine);
    assert!(waiting.join().unwrap());
    assert!(names(&store.root().join("claims")).is_empty());
}

#[cfg(target_os = "linux")]
#[test]
fn a_store_that_cannot_be_written_is_a_warning_once() {
    let (_folder, store) = store();
    // A file where the bucket's folder must be.
    fs_err::write(store.root().join("values-v3"), "").unwrap();
    for number in 0..3 {
        store.put(BUCKET, &key(number), &[b"value"]);
    }
    let warnings = store.take_warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("stores nothing more"), "{warnings:?}");
    assert!(names(&store.root().join("tmp")).is_empty());
    let error = Store::open("/proc/self/cache").err().unwrap().to_string();
    assert!(error.starts_with("cache /proc/self/cache/tmp: cannot make the folder"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Puts, gets, losses and bit flips in any order: a get gives the last value put, or nothing.
    #[test]
    fn a_get_never_gives_what_was_not_put(
        actions in prop::collection::vec((0u64..4, 0u8..4, prop::collection::vec(any::<u8>(), 0..60)), 1..40)
    ) {
        let (_folder, store) = store();
        let mut expected: [Option<Vec<u8>>; 4] = Default::default();
        for (number, action, bytes) in actions {
            let path = store.entry_path(BUCKET, &key(number));
            match action {
                0 => {
                    store.put(BUCKET, &key(number), &[&bytes]);
                    expected[number as usize] = Some(bytes);
                }
                1 => {
                    let found = store.get(BUCKET, &key(number));
                    prop_assert_eq!(&found, &expected[number as usize]);
                }
                2 => {
                    _ = fs_err::remove_file(&path);
                    expected[number as usize] = None;
                }
                // Only what is whole: the same bit flipped twice is the value again.
                _ if expected[number as usize].take().is_some() => {
                    let mut entry = fs_err::read(&path).unwrap();
                    let at = bytes.len() % entry.len();
                    entry[at] ^= 1;
                    fs_err::write(&path, entry).unwrap();
                }
                _ => {}
            }
        }
    }
}

const ROOT_OF_CHILD: &str = "MANYVIEW_TEST_STORE_OF_CHILD";
/// Values that the processes of the stress tests make.
const VALUES: u64 = 400;

/// Not a test: what the processes of the stress tests do. Each makes all values that it does not find, in an order of
/// its own, claims them first, and prints how many it made.
#[test]
#[ignore = "runs as the child of another test"]
fn child_that_makes_values() {
    let Some(root) = std::env::var_os(ROOT_OF_CHILD) else { return };
    let store = Store::open(root).unwrap();
    let mut made = 0;
    let stride = 2 * u64::from(std::process::id()) + 1;
    for step in 0..VALUES {
        // VALUES and an odd stride that is no multiple of 5 have no common divisor.
        let number = (step * if stride.is_multiple_of(5) { stride + 2 } else { stride }) % VALUES;
        if let Some(found) = store.get(BUCKET, &key(number)) {
            assert_eq!(found, value(number));
            continue;
        }
        let _claim = store.claim_or_wait(&key(number), || false);
        match store.get(BUCKET, &key(number)) {
            Some(found) => assert_eq!(found, value(number)),
            None => {
                made += 1;
                store.put(BUCKET, &key(number), &[&value(number)]);
            }
        }
    }
    assert!(store.take_warnings().is_empty());
    println!("made {made}");
}

fn child(root: &Path) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "store::tests::child_that_makes_values", "--ignored", "--nocapture"])
        .env(ROOT_OF_CHILD, root)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// How often the stress tests do what they do: `MANYVIEW_STRESS=20` for twenty times as often.
fn stress(usual: u64) -> u64 {
    let factor = std::env::var("MANYVIEW_STRESS").ok().and_then(|factor| factor.parse().ok());
    usual * factor.unwrap_or(1)
}

#[test]
fn four_processes_make_every_value_once() {
    for _ in 0..stress(1) {
        let folder = tempfile::tempdir().unwrap();
        let children: Vec<Child> = (0..4).map(|_| child(folder.path())).collect();
        let mut made = 0;
        for child in children {
            let output = child.wait_with_output().unwrap();
            assert!(output.status.success());
            let text = String::from_utf8(output.stdout).unwrap();
            let count = text.split_once("made ").unwrap().1.split_whitespace().next().unwrap();
            made += count.parse::<u64>().unwrap();
        }
        assert_eq!(made, VALUES, "a value is made by one of them");
        let store = Store::open(folder.path()).unwrap();
        let report = store.verify();
        assert_eq!((report.entries, report.broken.len()), (VALUES, 0));
        assert!(names(&folder.path().join("tmp")).is_empty());
    }
}

#[test]
fn killed_processes_leave_a_sound_store() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = 12345u64;
    for _ in 0..stress(10) {
        let mut victim = child(folder.path());
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        std::thread::sleep(Duration::from_millis(state >> 33 & 63));
        victim.kill().unwrap();
        victim.wait().unwrap();
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.verify().broken, []);
        assert_eq!(names(&folder.path().join("leases")).len(), 1, "ours alone");
        assert!(names(&folder.path().join("tmp")).is_empty(), "unfinished entries go with their lease");
    }
    let last = child(folder.path());
    assert!(last.wait_with_output().unwrap().status.success(), "no claim of the dead is in the way");
    let store = Store::open(folder.path()).unwrap();
    for number in 0..VALUES {
        assert_eq!(store.get(BUCKET, &key(number)), Some(value(number)));
    }
}
