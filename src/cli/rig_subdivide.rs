//! `nonrigid rig subdivide`.

use clap::Args;

use super::inputs::RigInput;
use super::rig_convert::RigOutput;
use super::units::UnitArguments;
use super::{Failure, warn};
use crate::registration::MOST_ROUNDS;

/// Arguments of `nonrigid rig subdivide`.
#[derive(Debug, Args)]
#[command(
    after_help = "Catmull and Clark's rules, for the neutral and all shapes alike: what `nonrigid register --subdivide` writes has the\n\
    vertices of the rig divided as often.\n\n\
    Example, on what `data-gen --seed 7 --out out/data` makes:\n  \
    nonrigid rig subdivide --rig out/data/rig --rounds 1 --out fine"
)]
pub struct Arguments {
    #[command(flatten)]
    rig: RigInput,
    /// How often, 1 to 3: each makes four quads of one
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=MOST_ROUNDS as i64))]
    rounds: u8,
    #[command(flatten)]
    units: UnitArguments,
    #[command(flatten)]
    output: RigOutput,
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    a.output.check(&a.rig.path, &[])?;
    let mut units = a.units.of(&["rig"])?;
    let rig = a.rig.read(usize::MAX, &mut units)?;
    a.output.check_shapes(&a.rig.path, &[], &rig)?;
    units.say();
    let divided = rig.subdivided(a.rounds).map_err(|e| Failure::loading(format!("{}: {e}", a.rig.path.display())));
    let (fine, warnings) = divided?;
    warnings.iter().for_each(warn);
    a.output.write(&fine, &a.rig.path)
}
