//! The machine that the program runs on, as far as it says.

use std::fs;
use std::process::Command;

use pulp::{Simd, WithSimd};
use serde::Serialize;

use crate::nlls::dense_kernels::dispatch;

/// What results may depend on in their last digits, and seconds in their first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Machine {
    /// Operating system, such as `"linux"`.
    pub system: &'static str,
    /// Architecture that the program was built for, such as `"x86_64"`.
    pub architecture: &'static str,
    /// Model of the processor.
    pub processor: Option<String>,
    /// What the solver's kernels run with.
    pub instruction_set: InstructionSet,
    /// Cores that this process may use.
    pub cores: usize,
    /// Threads of the caller's pool.
    pub threads: usize,
    /// Memory in all, bytes.
    pub memory: Option<u64>,
    /// Memory that a new program could have, bytes.
    pub available_memory: Option<u64>,
}

/// The instruction set that was found at run time to be the best one the solver's kernels are compiled for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InstructionSet {
    /// `"x86-v4"` (AVX-512), `"x86-v3"` (AVX2), `"neon"`, or `"scalar"`.
    pub name: String,
    /// Numbers of 64 bits in one register.
    pub lanes: usize,
    /// Features of the processor that such sets ask for, and whether it has them.
    pub features: Vec<(&'static str, bool)>,
}

impl Machine {
    /// Reads what there is to read.
    #[must_use]
    pub fn new() -> Self {
        let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
        let kibibytes = |name| value(&memory, name)?.trim_end_matches(" kB").parse::<u64>().ok();
        Self {
            system: std::env::consts::OS,
            architecture: std::env::consts::ARCH,
            processor: processor(),
            instruction_set: InstructionSet::new(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads: rayon::current_num_threads(),
            memory: kibibytes("MemTotal").map(|k| 1024 * k),
            available_memory: kibibytes("MemAvailable").map(|k| 1024 * k),
        }
    }
}

impl Default for Machine {
    fn default() -> Self {
        Self::new()
    }
}

/// The first value of a name in lines of `name : value`.
fn value<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let pairs = text.lines().filter_map(|line| line.split_once(':'));
    pairs.map(|(n, v)| (n.trim(), v.trim())).find(|(n, v)| *n == name && !v.is_empty()).map(|(_, v)| v)
}

/// What Linux, Windows or macOS call the processor.
fn processor() -> Option<String> {
    let linux = || value(&fs::read_to_string("/proc/cpuinfo").ok()?, "model name").map(str::to_owned);
    let windows = || std::env::var("PROCESSOR_IDENTIFIER").ok();
    let macos = || {
        let output = Command::new("/usr/sbin/sysctl").args(["-n", "machdep.cpu.brand_string"]).output().ok()?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned()).filter(|name| !name.is_empty())
    };
    linux().or_else(windows).or_else(macos)
}

impl InstructionSet {
    fn new() -> Self {
        let (path, lanes) = dispatch(Chosen);
        let name = match path.rsplit("::").next().unwrap_or(path) {
            "V4" => "x86-v4".to_owned(),
            "V3" => "x86-v3".to_owned(),
            name if name.starts_with("Scalar") => "scalar".to_owned(),
            name => name.to_lowercase(),
        };
        Self { name, lanes, features: features() }
    }
}

/// Says which type of registers the dispatch of kernels hands out.
struct Chosen;

impl WithSimd for Chosen {
    type Output = (&'static str, usize);

    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        (std::any::type_name::<S>(), S::F64_LANES)
    }
}

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
fn features() -> Vec<(&'static str, bool)> {
    macro_rules! detected {
        ($($feature:tt)*) => { vec![$(($feature, std::arch::is_x86_feature_detected!($feature))),*] };
    }
    detected!("sse4.2" "avx" "avx2" "bmi1" "bmi2" "fma" "lzcnt" "avx512f" "avx512bw" "avx512cd" "avx512dq" "avx512vl")
}

#[cfg(target_arch = "aarch64")]
fn features() -> Vec<(&'static str, bool)> {
    vec![("neon", std::arch::is_aarch64_feature_detected!("neon"))]
}

#[cfg(not(any(target_arch = "x86", target_arch = "x86_64", target_arch = "aarch64")))]
fn features() -> Vec<(&'static str, bool)> {
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_their_whole_name() {
        let text = "model\t\t: 85\nmodel name\t: Some CPU @ 2 GHz: new\nMemTotal:  1000 kB\nempty :\nempty: 3\n";
        assert_eq!(value(text, "model name"), Some("Some CPU @ 2 GHz: new"));
        assert_eq!(value(text, "MemTotal"), Some("1000 kB"));
        assert_eq!(value(text, "empty"), Some("3"));
        assert_eq!(value(text, "Mem"), None);
    }

    #[test]
    fn the_instruction_set_is_one_that_the_processor_has() {
        let set = InstructionSet::new();
        let has = |feature: &str| set.features.iter().any(|(name, there)| *name == feature && *there);
        match set.name.as_str() {
            "x86-v4" => assert!(has("avx512f") && has("avx512vl") && has("fma") && set.lanes == 8),
            "x86-v3" => assert!(has("avx2") && has("fma") && set.lanes == 4),
            "neon" => assert!(has("neon") && set.lanes == 2),
            "scalar" => assert!(!has("avx2") && !has("neon")),
            other => panic!("unknown instruction set {other}"),
        }
    }
}
