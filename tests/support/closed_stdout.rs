//! A reader that goes away, which is no error, and a full disk, which is one.

use std::fs::OpenOptions;
use std::path::Path;
use std::process::{Command, Stdio};

/// A pipe whose reader has gone.
pub fn closed_pipe() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

/// Runs `program` in `folder` with each line, its stdout going to a pipe that nobody reads, and to a full disk.
pub fn minds_a_full_disk_only(program: &str, folder: &Path, lines: &[&str]) {
    for line in lines {
        let into = |stdout: Stdio| {
            let mut command = Command::new(program);
            let output = command.current_dir(folder).args(line.split_whitespace()).stdout(stdout).output().unwrap();
            let said = String::from_utf8(output.stderr).unwrap();
            // `nonrigid` notes the units of what it reads.
            let said = said.lines().filter(|line| !line.starts_with("units: ")).map(str::to_owned);
            (output.status.code(), said.collect::<Vec<_>>())
        };
        assert_eq!(into(closed_pipe()), (Some(0), Vec::new()), "{line}");
        // Linux has a file that is always full.
        if let Ok(full) = OpenOptions::new().write(true).open("/dev/full") {
            let (code, said) = into(full.into());
            assert!(code == Some(3) && said.len() == 1, "{line}: {code:?}, {said:?}");
            assert!(said[0].starts_with("error: stdout: "), "{line}: {said:?}");
        }
    }
}
