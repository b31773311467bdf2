//! Studies on top of `nonrigid`: the report, and one subcommand for each study of its own.

use std::io;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, Subcommand};
use experiments::{
    ceres, compare_rigs, consistency, flicker, more_garbow_hillstrom, nist, peers, real_scans, report, scaling,
    scan_bench, schedule_search, silence, solver_case, start_bench, this_program, unseen,
};
use nonrigid::console::{Failure, Stage, answer, on_threads, tell, told};
use nonrigid::registration::RegistrationError;

/// Without a subcommand, the report: makes faces and scans whose truth is known, reproduces the figures of Klimov 2020, checks its
/// claims, compares all models, and puts everything on one page, in about a quarter of an hour on two cores.
#[derive(Parser)]
#[command(name = "experiments", version, max_term_width = 110, args_conflicts_with_subcommands = true)]
#[command(
    after_help = "Exit codes: 0 done, 1 arguments, 2 computation, 3 writing, 4 loading. In a checkout, `experiments` is\n\
    `cargo run --release -p experiments --`.\n\n\
    Examples: the report in two and a half minutes; what it would take; some of its studies\n  \
    experiments --quick\n  experiments --list\n  experiments --only sweeps,ablations --out out/some"
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    report: report::Options,
    /// Threads [default: all cores]; results do not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    /// Register every case below DIR and compare with its ground truth: models, robust kernels, data terms, other programs' results
    ScanBench(scan_bench::command::Arguments),
    /// Register scans with all that can be wrong with them: how often a bad result is silent and a good one doubted
    Silence(silence::Arguments),
    /// Register the scans of a folder with every model: one picture sheet, one table
    RealScans(real_scans::Arguments),
    /// Register cases as crops, side views and covered scans show them: errors and folds of what is not seen
    Unseen(unseen::Arguments),
    /// Register generated sequences: error and flicker of the frames, and of what smoothing in time makes of them
    Flicker(flicker::Arguments),
    /// Register a population without truth and measure how well its faces agree on where a template vertex belongs
    Consistency(consistency::Arguments),
    /// Run what one would otherwise take on the same cases: time, memory and error beside ours
    Peers(peers::Arguments),
    /// Solve the same problems by Ceres Solver: equal costs, and the time of an iteration beside ours
    Ceres(ceres::Arguments),
    /// Measure how time and memory of an iteration grow with vertices and nodes, and those of a registration with the scan
    Scaling(scaling::Arguments),
    /// Put rigs side by side: edge lengths, curvature, expressions, spectrum of the identity modes
    CompareRigs(compare_rigs::Arguments),
    /// What maintainers use: reference problems, the search of schedules and of starts
    #[command(subcommand, after_help = DEV_EXAMPLES)]
    Dev(Dev),
}

#[derive(Subcommand)]
enum Dev {
    /// Fit NIST's certified nonlinear regression problems: matching digits of Levenberg-Marquardt and dogleg
    Nist(nist::Arguments),
    /// Minimise the More-Garbow-Hillstrom problems from their standard starts and from ten times these
    MoreGarbowHillstrom(more_garbow_hillstrom::Arguments),
    /// Solve one hybrid problem with fixed correspondences: the same minimum as other solvers, and the time of an iteration
    SolverCase(solver_case::Arguments),
    /// Search the start of every scan without landmarks, as given and moved, and compare with the start by landmarks
    StartBench(start_bench::Arguments),
    /// Search the default schedules: the same search for every model
    SearchSchedules(schedule_search::Options),
}

const DEV_EXAMPLES: &str = "Example:\n  experiments dev more-garbow-hillstrom --json";

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => return answer(&e),
    };
    let Err(e) = run(&cli) else { return ExitCode::SUCCESS };
    tell(format_args!("error: {}", told(&e)));
    exit_code(&e)
}

fn run(cli: &Cli) -> Result<()> {
    match &cli.command {
        None => on_threads(cli.threads, || {
            let program = this_program()?;
            report::run(&cli.report, &cli.report.effort(), &program, &[], &mut io::stdout().lock()).map(drop)
        })?,
        Some(Command::ScanBench(a)) => on_threads(a.threads, || scan_bench::command::run(a))?,
        Some(Command::Dev(Dev::StartBench(a))) => on_threads(a.threads, || start_bench::run(a))?,
        Some(Command::Silence(a)) => on_threads(a.threads, || silence::run(a))?,
        Some(Command::RealScans(a)) => on_threads(a.threads, || real_scans::run(a).map(drop))?,
        Some(Command::Unseen(a)) => on_threads(a.threads, || unseen::run(a))?,
        Some(Command::Flicker(a)) => on_threads(a.threads, || flicker::run(a))?,
        Some(Command::Peers(a)) => on_threads(a.threads, || peers::run(a))?,
        Some(Command::Ceres(a)) => ceres::run(a),
        Some(Command::Consistency(a)) => on_threads(a.threads, || consistency::run(a))?,
        Some(Command::Dev(Dev::SearchSchedules(a))) => on_threads(a.threads, || schedule_search::run(a))?,
        Some(Command::Dev(Dev::SolverCase(a))) => on_threads(a.threads, || solver_case::run(a))?,
        Some(Command::Scaling(a)) => scaling::run(a),
        Some(Command::CompareRigs(a)) => compare_rigs::run(a),
        Some(Command::Dev(Dev::Nist(a))) => nist::run(a),
        Some(Command::Dev(Dev::MoreGarbowHillstrom(a))) => more_garbow_hillstrom::run(a),
    }
}

fn exit_code(error: &anyhow::Error) -> ExitCode {
    if let Some(failure) = error.downcast_ref::<Failure>() {
        return failure.exit_code();
    }
    let input = error.downcast_ref().is_some_and(RegistrationError::is_input);
    ExitCode::from(if input { Stage::Loading } else { Stage::Computation } as u8)
}

#[cfg(test)]
#[path = "../../tests/support/command_page.rs"]
mod command_page;
#[cfg(test)]
#[path = "../../tests/support/generated_page.rs"]
mod generated_page;
#[cfg(test)]
#[path = "../../tests/support/help.rs"]
mod help;

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::{Cli, command_page, generated_page, help};

    #[test]
    fn every_help_ends_with_examples_that_parse() {
        let faults = help::faults(&Cli::command());
        assert!(faults.is_empty(), "{}", faults.join("\n"));
    }

    #[test]
    fn the_reference_of_options_is_that_of_the_code() {
        let repository = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        generated_page::check(repository, "experiments.md", &command_page::page(&Cli::command()));
    }
}
