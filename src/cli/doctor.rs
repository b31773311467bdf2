//! `nonrigid doctor`.

use std::io::IsTerminal as _;

use clap::Args;
use serde::Serialize;

use super::{Failure, on_threads, say, warn};
use crate::self_test::{CHECKS, Check, Finding, Machine};

/// Arguments of `nonrigid doctor`.
#[derive(Debug, Args)]
#[command(after_help = "A check that is WRONG gives exit code 2. Seconds decide nothing.\n\n\
    Examples:\n  nonrigid doctor\n  nonrigid doctor --threads 1\n  nonrigid doctor --json > doctor.json")]
pub struct Arguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Threads [default: all cores, or as RAYON_NUM_THREADS says]; no number but seconds depends on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Report<'a> {
    version: &'static str,
    profile: &'static str,
    machine: Machine,
    stdout_is_terminal: bool,
    ok: bool,
    checks: &'a [Finding],
}

/// How this program was compiled, as far as it can tell.
const PROFILE: &str = if cfg!(debug_assertions) { "debug" } else { "release" };

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    on_threads(a.threads, || examine(a.json, &CHECKS))?
}

fn examine(json: bool, checks: &[Check]) -> Result<(), Failure> {
    if PROFILE == "debug" {
        warn("a debug build, many times slower than a release build: cargo build --release");
    }
    let machine = Machine::new();
    let stdout_is_terminal = std::io::stdout().is_terminal();
    if !json {
        describe(&machine, stdout_is_terminal)?;
    }
    let mut findings = Vec::new();
    for check in checks {
        let finding = check.run();
        if !json {
            say(line(&finding))?;
        }
        findings.push(finding);
    }
    let wrong: Vec<&str> = findings.iter().filter(|f| !f.ok).map(|f| f.what).collect();
    if json {
        let (version, ok) = (env!("CARGO_PKG_VERSION"), wrong.is_empty());
        let report = Report { version, profile: PROFILE, machine, stdout_is_terminal, ok, checks: &findings };
        say(serde_json::to_string_pretty(&report).map_err(Failure::computation)?)?;
    }
    if wrong.is_empty() {
        return Ok(());
    }
    let message = format!("{} of {} checks are WRONG: {}", wrong.len(), checks.len(), wrong.join("; "));
    Err(Failure::computation(message))
}

fn describe(machine: &Machine, stdout_is_terminal: bool) -> Result<(), Failure> {
    let set = &machine.instruction_set;
    let of = |there: bool| {
        let names: Vec<&str> = set.features.iter().filter(|f| f.1 == there).map(|f| f.0).collect();
        if names.is_empty() { "none".to_owned() } else { names.join(" ") }
    };
    let gigabytes = |bytes: Option<u64>| bytes.map_or("not known".to_owned(), |b| format!("{:.1} GB", b as f64 / 1e9));
    say(format_args!("nonrigid {}, {PROFILE} build", env!("CARGO_PKG_VERSION")))?;
    say(format_args!("system      {}, {}", machine.system, machine.architecture))?;
    say(format_args!("processor   {}", machine.processor.as_deref().unwrap_or("not known")))?;
    say(format_args!("kernels     {}, {} numbers at a time", set.name, set.lanes))?;
    say(format_args!("features    {}; not there: {}", of(true), of(false)))?;
    say(format_args!("threads     {} on {} cores", machine.threads, machine.cores))?;
    say(format_args!("memory      {}, {} free", gigabytes(machine.memory), gigabytes(machine.available_memory)))?;
    say(format_args!("stdout      {}", if stdout_is_terminal { "a terminal" } else { "not a terminal" }))?;
    say(format_args!("\n{:78} {:>9} {:>9} {:>7}", "self-test", "found", "expected", "+-"))
}

/// What, found, expected, tolerance, verdict, seconds.
fn line(f: &Finding) -> String {
    let found = f.found.map_or("-".to_owned(), number);
    let verdict = if f.ok { "ok" } else { "WRONG" };
    let error = f.error.as_ref().map_or(String::new(), |e| format!("\n  {e}"));
    let (expected, tolerance) = (number(f.expected), number(f.tolerance));
    format!("{:78} {found:>9} {expected:>9} {tolerance:>7}  {verdict:5} {:6.2} s{error}", f.what, f.seconds)
}

fn number(x: f64) -> String {
    match x {
        0.0 => "0".to_owned(),
        x if x.abs() >= 0.01 && x.abs() < 1e6 => format!("{x:.6}"),
        x => format!("{x:.0e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Stage;

    fn quick(expected: f64) -> Check {
        Check { what: "half of three", expected, tolerance: 1e-9, compute: || Ok(1.5) }
    }

    #[test]
    fn one_wrong_check_is_a_failed_computation_that_names_it() {
        assert!(examine(false, &[quick(1.5), quick(1.5 + 1e-10)]).is_ok());
        for json in [false, true] {
            let failure = examine(json, &[quick(1.5), quick(1.4)]).unwrap_err();
            assert_eq!(failure.stage(), Stage::Computation);
            assert_eq!(failure.to_string(), "1 of 2 checks are WRONG: half of three");
        }
    }

    #[test]
    fn what_cannot_be_computed_is_wrong_and_says_why() {
        let not_a_number = Check { compute: || Ok(f64::NAN), ..quick(1.5) }.run();
        let failed = Check { compute: || Err("no disk".into()), ..quick(1.5) }.run();
        assert!(!not_a_number.ok && !failed.ok && failed.found.is_none());
        assert!(line(&failed).contains("WRONG") && line(&failed).ends_with("no disk"), "{}", line(&failed));
        assert!(line(&quick(1.5).run()).contains("ok"));
    }
}
