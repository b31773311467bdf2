//! `data-gen`: makes a synthetic face rig and scans of it with exact truth, as folders.

use std::process::ExitCode;

fn main() -> ExitCode {
    data_gen::command::main()
}
