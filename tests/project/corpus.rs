//! What fuzzing asks of the readers, asked again in a few seconds: of every seed and every input that once broke something, in
//! `fuzz/seeds`, of a fixed number of changes of each, and of short ones cut and broken at every byte.

#[path = "../../fuzz/src/lib.rs"]
mod fuzz;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Changes of each seed.
const CHANGES: usize = 300;

/// Bytes of the longest seed that is cut and broken everywhere.
const SHORT: usize = 600;

/// What each byte of a short seed is broken to.
const BYTES: [u8; 8] = [0, b'\n', b' ', b'"', b'-', b'9', 0x7f, 0xff];

/// Inputs of a target, by name.
fn seeds(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(target);
    let entries = fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut paths: Vec<_> = entries.map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|p| (p.file_name().unwrap().to_string_lossy().into_owned(), fs::read(p).unwrap())).collect()
}

/// The bytes cut before each of them, and with each of them replaced.
fn broken_everywhere(bytes: &[u8]) -> impl Iterator<Item = Vec<u8>> {
    let length = if bytes.len() > SHORT { 0 } else { bytes.len() };
    (0..length).flat_map(move |at| {
        let replaced = move |byte: &u8| [&bytes[..at], &[*byte], &bytes[at + 1..]].concat();
        std::iter::once(bytes[..at].to_vec()).chain(BYTES.iter().map(replaced))
    })
}

/// Bytes as a fuzzer would change them: bits, pieces that are lost, repeated or another seed's, and numbers out of range.
fn changed(rng: &mut ChaCha8Rng, bytes: &[u8], all: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..rng.random_range(1..4) {
        let at = rng.random_range(0..=bytes.len());
        let end = (at + rng.random_range(1..20)).min(bytes.len());
        match rng.random_range(0..6) {
            0 if at < bytes.len() => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes.truncate(at),
            2 => drop(bytes.drain(at..end)),
            3 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => {
                let other = &all.choose(rng).expect("a target has seeds").1;
                let from = rng.random_range(0..=other.len());
                bytes.splice(at..end, other[from..].iter().take(40).copied());
            }
            _ => {
                let odd: &[&[u8]] = &[
                    b"-1",
                    b"4294967296",
                    b"18446744073709551616",
                    b"1e999",
                    b"nan",
                    b"0",
                    b"\xff\xff\xff\xff",
                    b"",
                    b"\0",
                ];
                let number = |b: &u8| b.is_ascii_digit();
                let start = bytes[at..].iter().position(number).map_or(at, |i| at + i);
                let end = bytes[start..].iter().position(|b| !number(b)).map_or(bytes.len(), |i| start + i);
                bytes.splice(start..end, odd.choose(rng).expect("there are some").iter().copied());
            }
        }
    }
    bytes
}

#[test]
fn readers_keep_their_promises_on_the_corpus_and_around_it() {
    std::panic::set_hook(Box::new(|_| {})); // each is told of below, with its input
    let mut faults = Vec::new();
    let mut count = 0;
    for (target, run) in fuzz::TARGETS {
        let all = seeds(target);
        assert!(all.len() >= 4, "{target}: {} seeds", all.len());
        for (name, bytes) in &all {
            let mut rng = ChaCha8Rng::seed_from_u64(11);
            let inputs = std::iter::once(bytes.clone()).chain((0..CHANGES).map(|_| changed(&mut rng, bytes, &all)));
            for (k, input) in inputs.chain(broken_everywhere(bytes)).enumerate() {
                count += 1;
                if catch_unwind(AssertUnwindSafe(|| run(&input))).is_err() {
                    faults.push(format!("{target}, change {k} of {name}: {}", String::from_utf8_lossy(&input)));
                }
            }
        }
    }
    let _ = std::panic::take_hook();
    assert!(faults.is_empty(), "{} of {count} inputs:\n{}", faults.len(), faults.join("\n"));
    println!("{count} inputs");
}
