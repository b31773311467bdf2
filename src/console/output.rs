//! What a program says on stdout and stderr. `println!` and `eprintln!` panic when nobody reads, as in
//! `nonrigid rig info DIR | head -1`.

use std::fmt;
use std::io::{self, Write};

use super::Failure;
#[cfg(feature = "cli")]
use super::Stage;
use crate::text;

/// Writes a line to stdout, or several; control characters are shown. When nobody reads any more, nothing is said and nothing fails: files may still be wanted.
///
/// # Errors
/// When stdout cannot be written for another reason, such as a full disk: a failure at [`Stage::Writing`].
pub fn say(line: impl fmt::Display) -> Result<(), Failure> {
    say_to(&mut io::stdout().lock(), format_args!("{}\n", text::lines(&line.to_string())))
}

/// [`say`], to `out` and without a line's end.
///
/// # Errors
/// As [`say`].
pub fn say_to(out: &mut dyn Write, text: fmt::Arguments<'_>) -> Result<(), Failure> {
    match out.write_fmt(text).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(Failure::writing(format!("stdout: {e}"))),
        _ => Ok(()),
    }
}

/// Writes a line to stderr: progress, warnings, errors; control characters are shown. When nobody reads it there is nowhere to say so, and the exit code still
/// tells.
pub fn tell(line: impl fmt::Display) {
    let _ = writeln!(io::stderr(), "{}", text::lines(&line.to_string()));
}

/// Prints what clap has to say, help or what is wrong with the arguments, and gives the exit code.
#[cfg(feature = "cli")]
#[must_use]
pub fn answer(error: &clap::Error) -> std::process::ExitCode {
    use std::process::ExitCode;

    if error.use_stderr() {
        let plain = error.render().to_string();
        if text::lines(&plain) == plain {
            let _ = error.print(); // in colour; if that fails, there is nowhere to say so
        } else {
            tell(plain.trim_end());
        }
        return ExitCode::from(Stage::Arguments as u8);
    }
    match say_to(&mut io::stdout().lock(), format_args!("{}", error.render())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}
