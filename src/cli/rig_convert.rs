//! `nonrigid rig convert`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::inputs::{RigInput, rig_files};
use super::units::UnitArguments;
use super::{
    Failure, Stage, check_output, check_output_folder, check_plan, has_extension, is_gltf, refuse_beside, same_place,
    say, warn, warn_of_materials,
};
use crate::io::{FilePlan, MaterialFiles, PlanError};
use crate::mesh::PolygonMesh;
use crate::rig::{Companions, NAMED_LANDMARKS, RIG_FILES, Rig, RigForm, Shape, ShapePca};

/// Arguments of `nonrigid rig convert`.
#[derive(Debug, Args)]
#[command(
    after_help = "A folder of shapes has one .obj a shape, by name, and neutral.obj; it keeps neither families nor the 68 landmarks. .npz has\n\
    the arrays of the .npy folder under the same names; it keeps neither groups nor materials. .glb has metres in 32 bits:\n\
    positions move by less than 1e-4 mm. Landmarks by name (landmarks.json, landmarks_anthropometric.json) go to folders alone.\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` makes:\n  \
    nonrigid rig convert --rig out/data/rig --out rig.glb\n  nonrigid rig convert --rig rig.glb --format shapes --out shapes"
)]
pub struct Arguments {
    #[command(flatten)]
    rig: RigInput,
    #[command(flatten)]
    units: UnitArguments,
    #[command(flatten)]
    output: RigOutput,
}

/// Where a rig goes.
#[derive(Debug, Args)]
pub struct RigOutput {
    /// The new rig: .npz, .glb, or a folder, made if it is not there
    #[arg(long, value_name = "DIR|FILE")]
    out: PathBuf,
    /// What a folder is to hold
    #[arg(long, value_enum, default_value_t = Format::Npy)]
    format: Format,
}

/// Layout of a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// .npy deltas with names, and the template as .obj
    Npy,
    /// One .obj a shape
    Shapes,
}

impl RigOutput {
    /// Refuses what could not be written in the end, or would be mixed with the rig that was read, or overwrite an input.
    pub fn check(&self, input: &Path, others: &[(&str, PathBuf)]) -> Result<(), Failure> {
        if same_place(input, &self.out) {
            let message = format!("--out: {} is the rig that is read", self.out.display());
            return Err(Failure::new(Stage::Arguments, message));
        }
        check_plan(&self.plan(input, others, &[]))?;
        if !self.is_file() {
            return check_output_folder(&self.out);
        }
        if self.format == Format::Shapes {
            let message = format!("--format shapes: {} is a file, not a folder", self.out.display());
            return Err(Failure::new(Stage::Arguments, message));
        }
        check_output(&self.out, &["npz", "glb"])
    }

    /// What is read and written; names of shapes, where they become those of files, are known once the rig is read.
    fn plan(&self, input: &Path, others: &[(&str, PathBuf)], shapes: &[Shape]) -> FilePlan {
        let plan = FilePlan::new().reads_all(rig_files(input)).reads_all(others.iter().cloned());
        match (self.is_file(), self.format) {
            (true, _) => plan.writes("--out", &self.out),
            (_, Format::Npy) => {
                let names = RIG_FILES.into_iter().chain(["template.mtl"]).chain(NAMED_LANDMARKS);
                plan.writes_all(names.map(|name| ("--out", self.out.join(name))))
            }
            (_, Format::Shapes) => {
                let names = shapes.iter().map(|s| format!("{}.obj", s.name));
                let names = names.chain(["neutral.obj", "neutral.mtl", "rig.json", "regions.json"].map(str::to_owned));
                let names = names.chain(NAMED_LANDMARKS.map(str::to_owned));
                plan.writes_all(names.map(|name| ("--out", self.out.join(name))))
            }
        }
    }

    /// Refuses to write over inputs by the names of shapes, or into a folder of another rig.
    pub fn check_shapes(&self, input: &Path, others: &[(&str, PathBuf)], rig: &Rig) -> Result<(), Failure> {
        if self.is_file() {
            return Ok(());
        }
        let shapes_folder = self.format == Format::Shapes;
        refuse_strangers(rig, &self.out, shapes_folder)?;
        // names that are none for files, and twice the same, are refused in the rig's own words
        match self.plan(input, others, rig.shapes()).check() {
            Err(e @ (PlanError::Clash { .. } | PlanError::Name { .. } | PlanError::Folder { .. })) => {
                Err(Failure::new(if e.is_clash() { Stage::Arguments } else { Stage::Writing }, e.to_string()))
            }
            _ => Ok(()),
        }
    }

    /// Anything with an extension, unless it is a folder that is there and no .npz or .glb.
    fn is_file(&self) -> bool {
        let extension = self.out.extension().map(|e| e.to_ascii_lowercase());
        extension.is_some_and(|e| e == "npz" || e == "glb" || !self.out.is_dir())
    }

    fn form(&self) -> RigForm {
        match (self.is_file(), self.format) {
            (false, Format::Npy) => RigForm::Arrays,
            (false, Format::Shapes) => RigForm::Meshes,
            (true, _) if has_extension(&self.out, "npz") => RigForm::Npz,
            (true, _) => RigForm::Gltf,
        }
    }

    /// Writes the rig, made of the one of `input`, with what goes along, and says so and what the form does not hold.
    pub fn write(&self, rig: &Rig, input: &Path) -> Result<(), Failure> {
        write_with(&Companions::of(input), rig, None, &self.out, self.form())?;
        // materials noted from an OBJ have none in the file; that .npz has no materials is said
        let painted = |mesh: &&PolygonMesh| is_gltf(input) && mesh.metadata.material_libraries.is_empty();
        if let Some(mesh) = rig.mesh().filter(painted).filter(|_| self.form() != RigForm::Npz) {
            warn_of_materials(&self.out, input, mesh, &MaterialFiles::default());
        }
        let (vertices, shapes) = (rig.neutral().len(), rig.shapes().len());
        say(format_args!("wrote {}: {vertices} vertices, {shapes} shapes", self.out.display()))
    }
}

/// Writes a rig with its companions, and says what the form does not hold.
pub fn write_with(
    companions: &Companions,
    rig: &Rig,
    pca: Option<&ShapePca>,
    out: &Path,
    form: RigForm,
) -> Result<(), Failure> {
    let materials = companions.materials(rig, out, form);
    materials.missing.iter().for_each(|(_, told)| warn(told));
    if let Some(mesh) = form.mesh_in(out) {
        let copies = materials.writes(&mesh).into_iter().map(|path| ("--out", path));
        refuse_beside(&mesh, copies, &materials)?;
    }
    let notes = companions.write(rig, pca, out, form, &materials).map_err(Failure::writing)?;
    notes.iter().for_each(warn);
    Ok(())
}

/// Refuses a folder with files that are no part of this rig and would be read as one.
pub fn refuse_strangers(rig: &Rig, folder: &Path, shapes: bool) -> Result<(), Failure> {
    match rig.stranger_in(folder, shapes) {
        None => Ok(()),
        Some(name) => {
            let message = format!("{}: {name} is there, which would become a part of the rig", folder.display());
            Err(Failure::writing(message))
        }
    }
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    a.output.check(&a.rig.path, &[])?;
    let mut units = a.units.of(&["rig"])?;
    let rig = a.rig.read(usize::MAX, &mut units)?;
    a.output.check_shapes(&a.rig.path, &[], &rig)?;
    units.say();
    a.output.write(&rig, &a.rig.path)
}
