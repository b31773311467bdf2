//! `nonrigid doctor` and `nonrigid completions`.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use nonrigid::self_test::CHECKS;
use serde_json::Value;

fn nonrigid(arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nonrigid"));
    command.args(arguments.split_whitespace());
    command
}

#[test]
fn a_healthy_machine_passes_on_as_many_threads_as_asked() {
    let output = nonrigid("doctor --json").env("RAYON_NUM_THREADS", "3").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["ok"], &report["machine"]["threads"]), (&true.into(), &3.into()));
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(report["checks"].as_array().unwrap().len(), CHECKS.len());
    for check in report["checks"].as_array().unwrap() {
        assert!(check["ok"] == true && check["found"].is_f64() && check["error"].is_null(), "{check}");
    }

    let output = nonrigid("doctor --threads 1").env("RAYON_NUM_THREADS", "3").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && text.contains("threads     1 on "), "{text}");
    assert_eq!(text.lines().filter(|line| line.contains("  ok ")).count(), CHECKS.len(), "{text}");
    assert!(text.contains(std::env::consts::ARCH) && text.contains("stdout      not a terminal"), "{text}");
}

#[test]
fn a_reader_of_one_line_is_no_error() {
    let mut child = nonrigid("doctor").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut first = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut first).unwrap(); // and the reader goes away
    let output = child.wait_with_output().unwrap();
    assert!(first.starts_with(concat!("nonrigid ", env!("CARGO_PKG_VERSION"))), "{first}");
    assert_eq!(output.status.code(), Some(0));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!said.contains("error") && !said.contains("panicked"), "{said}");
}

#[test]
fn every_shell_has_completions_for_every_command() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = nonrigid(&format!("completions {shell}")).output().unwrap();
        let script = String::from_utf8(output.stdout).unwrap();
        for word in ["register", "landmarks", "transfer", "doctor", "identity-modes"] {
            assert!(output.status.success() && script.contains(word), "{shell}: {word}");
        }
    }
    assert_eq!(nonrigid("completions tcsh").output().unwrap().status.code(), Some(1));
}

#[test]
fn bash_completes_commands_and_options() {
    let bench = crate::support::Bench::new();
    let script = nonrigid("completions bash").output().unwrap().stdout;
    bench.write("nonrigid.bash", script);
    let bash = |arguments: &[&str]| Command::new("bash").args(arguments).current_dir(bench.path("")).output();
    let Ok(checked) = bash(&["-n", "nonrigid.bash"]) else {
        return crate::skip::skipped("there is no bash here");
    };
    assert!(checked.status.success() && checked.stderr.is_empty(), "{}", String::from_utf8_lossy(&checked.stderr));
    // What bash does at the Tab key: calls the function that the script registers, and reads COMPREPLY.
    let complete = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        let (last, before) = (words[words.len() - 1], words[words.len() - 2]);
        let code = format!(
            "source ./nonrigid.bash; COMP_WORDS=({line}); COMP_CWORD={}; COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}; \
             function=$(complete -p nonrigid | sed 's/.*-F \\([^ ]*\\).*/\\1/'); $function nonrigid '{last}' '{before}'; \
             echo ${{COMPREPLY[@]}}",
            words.len() - 1
        );
        let output = bash(&["--norc", "-c", &code]).unwrap();
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    assert_eq!(complete("nonrigid reg"), "register");
    assert_eq!(complete("nonrigid landmarks tr"), "transfer");
    assert_eq!(complete("nonrigid register --tar"), "--target");
    assert_eq!(complete("nonrigid completions f"), "fish");
}
