//! `nonrigid rig pca`.

use std::path::PathBuf;

use clap::Args;

use super::inputs::Align;
use super::rig_convert::{refuse_strangers, write_with};
use super::units::UnitArguments;
use super::{Failure, Stage, check_output_folder, check_plan, has_extension, on_threads, same_place, say, warn};
use crate::io::FilePlan;
use crate::mesh::{PoseKind, bounding_box_diagonal};
use crate::rig::{
    COMPONENT_FILES, Companions, MOTIONLESS_SHARE, Population, PopulationError, RIG_FILES, RigForm, ShapeInfo,
    ShapePca, mesh_files,
};

/// Arguments of `nonrigid rig pca`.
#[derive(Debug, Args)]
#[command(
    after_help = "DIR of --out is a rig: the mean as template.obj, with the polygons, UVs, groups and materials of the first\n\
    mesh, and neutral.npy; the modes scaled by their standard deviations, so that weights ~ N(0, 1), as\n\
    identity_deltas.npy (K, V, 3) with identity_names.json. Besides, components.npy (K, V, 3), orthonormal, and\n\
    standard_deviations.npy (K).\n\n\
    Examples, on what `data-gen --seed 7 --out out/data --population 50` makes:\n  \
    nonrigid rig pca --meshes out/data/population --components 40 --out people\n  \
    nonrigid register --template people/template.obj --rig people \\\n      \
    --target out/data/cases/new_neutral/scan.ply --landmarks out/data/cases/new_neutral/landmarks.json --out new.obj"
)]
pub struct Arguments {
    /// Meshes of one topology, such as registered templates: every .obj and .ply in this folder, or where there are none every .glb, by name
    #[arg(long, value_name = "DIR")]
    meshes: PathBuf,
    /// How many components to keep, at most one fewer than meshes
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..))]
    components: u32,
    /// What to take out of the meshes first. Registered meshes lie as their scans did, and pose is not shape
    #[arg(long, value_enum, default_value_t = Align::Rigid)]
    align: Align,
    #[command(flatten)]
    units: UnitArguments,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Folder for the rig; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    on_threads(arguments.threads, || run_here(arguments))?
}

fn run_here(a: &Arguments) -> Result<(), Failure> {
    if ["npz", "glb"].iter().any(|extension| has_extension(&a.out, extension)) {
        let message =
            format!("--out: {} would be a folder; 'nonrigid rig convert' makes such a file of one", a.out.display());
        return Err(Failure::new(Stage::Arguments, message));
    }
    check_output_folder(&a.out)?;
    if same_place(&a.meshes, &a.out) {
        let message = "--out is the folder of --meshes: the mean would be one of the meshes the next time";
        return Err(Failure::new(Stage::Arguments, message));
    }
    let samples = mesh_files(&a.meshes).unwrap_or_default(); // what is wrong with the folder is said when it is read
    let names = RIG_FILES.into_iter().chain(COMPONENT_FILES).chain(["template.mtl"]);
    let plan = FilePlan::new()
        .reads_all(samples.into_iter().map(|(_, path)| ("meshes", path)))
        .writes_all(names.map(|name| ("--out", a.out.join(name))));
    check_plan(&plan)?;
    let mut population = Population::read(&a.meshes).map_err(Failure::loading)?;
    let mut units = a.units.of(&["meshes"])?;
    units.bring_population("meshes", &mut population)?;
    units.say();
    population.doubts(population.mesh()).map_err(Failure::loading)?.iter().for_each(warn);
    let aligned = match a.align {
        Align::Rigid => Some((PoseKind::Rigid, "rigid motions")),
        Align::Similarity => Some((PoseKind::Similarity, "similarities")),
        Align::None => None,
    };
    let alignment = match aligned {
        Some((kind, name)) => {
            let rounds = population.align(kind).map_err(Failure::computation)?;
            format!("aligned by {name} in {rounds} rounds")
        }
        None => "not aligned".to_owned(),
    };
    let pca = ShapePca::fit(&population, a.components as usize).map_err(|e| {
        let fault = matches!(e, PopulationError::Components { .. });
        Failure::new(if fault { Stage::Arguments } else { Stage::Computation }, format!("--components: {e}"))
    })?;
    let (rig, motionless) = pca.to_rig(population.mesh()).map_err(Failure::computation)?;
    if !motionless.is_empty() {
        let message = format!(
            "--components: {} components asked for, but only {} move a vertex by more than {:.1e} mm; the others have no \
             variance to speak of",
            a.components,
            rig.shapes().len(),
            MOTIONLESS_SHARE * bounding_box_diagonal(pca.mean())
        );
        return Err(Failure::new(Stage::Computation, message));
    }
    refuse_strangers(&rig, &a.out, false)?;
    let companions = Companions { mesh: PathBuf::from(&population.names()[0]), ..Companions::default() };
    write_with(&companions, &rig, Some(&pca), &a.out, RigForm::Arrays)?;
    say(format_args!("{} meshes of {} vertices, {alignment}", population.samples().len(), population.vertex_count()))?;
    print_table(&pca, &rig.info())?;
    say(format_args!("wrote {}", a.out.display()))
}

/// How far each mode goes at one standard deviation, and how much of the variance it explains.
fn print_table(pca: &ShapePca, info: &[ShapeInfo]) -> Result<(), Failure> {
    say(format_args!("{:11}  {:>8}  {:>8}  {:>10}  {:>10}", "mode", "rms mm", "max mm", "variance %", "together %"))?;
    let vertices = pca.mean().len() as f64;
    let mut together = 0.0;
    for ((mode, sigma), share) in info.iter().zip(pca.standard_deviations()).zip(pca.explained()) {
        together += share;
        say(format_args!(
            "{:11}  {:8.3}  {:8.3}  {:10.3}  {:10.3}",
            mode.name,
            sigma / vertices.sqrt(),
            mode.max_displacement,
            100.0 * share,
            100.0 * together
        ))?;
    }
    Ok(())
}
