//! The `nonrigid` command.

fn main() -> std::process::ExitCode {
    nonrigid::cli::main()
}
