//! `nonrigid rig convert`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;

use super::inputs::{RigInput, rig_files};
use super::units::UnitArguments;
use super::{
    Failure, Stage, check_output, check_output_folder, check_plan, has_extension, materials_for, refuse_beside,
    same_place, say, warn, write_json,
};
use crate::io::{self, FilePlan, MaterialFiles, PlanError, WriteError};
use crate::rig::{Family, NAMED_LANDMARKS, RIG_FILES, Rig, Shape};

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

    /// Writes the rig, made of the one of `input`, with its materials, and says so and what the form does not hold.
    pub fn write(&self, rig: &Rig, input: &Path) -> Result<(), Failure> {
        let shapes_folder = !self.is_file() && self.format == Format::Shapes;
        let npz = self.is_file() && has_extension(&self.out, "npz");
        let write: fn(&Rig, &Path) -> Result<(), WriteError> = match (self.is_file(), self.format) {
            (false, Format::Npy) => Rig::write,
            (false, Format::Shapes) => Rig::write_meshes,
            (true, _) if npz => Rig::write_npz,
            (true, _) => Rig::write_gltf,
        };
        let mesh = self.out.join(if shapes_folder { "neutral.obj" } else { "template.obj" });
        let of_input = ["template.obj", "neutral.obj"].map(|name| input.join(name)).into_iter().find(|p| p.is_file());
        let materials = of_input.filter(|_| !self.is_file()).map(|input| materials_beside(rig, &mesh, &input));
        let materials = materials.transpose()?.unwrap_or_default();
        write(rig, &self.out).map_err(Failure::writing)?;
        bring_materials(rig, &mesh, &materials)?;
        let lost = |what: &str| warn(format_args!("{}: this form of a rig holds no {what}", self.out.display()));
        if shapes_folder && rig.shapes().iter().any(|s| s.family == Family::Identity) {
            lost("families: identity modes are shapes like all others there");
        }
        if shapes_folder && rig.landmarks().is_some() {
            lost("landmarks");
        }
        let named: Vec<&str> = NAMED_LANDMARKS.into_iter().filter(|name| input.join(name).is_file()).collect();
        if self.is_file() && !named.is_empty() {
            lost(&format!("named landmarks: {}", named.join(", ")));
        }
        for name in named.into_iter().filter(|_| !self.is_file()) {
            // those by vertex hold on the new rig, whose vertices are in the old one's order
            let path = input.join(name);
            let vertices =
                std::fs::read(&path).ok().and_then(|b| serde_json::from_slice::<BTreeMap<String, u32>>(&b).ok());
            match vertices {
                Some(vertices) => write_json(&self.out.join(name), &vertices)?,
                None => warn(format_args!("{}: not taken along, since not all of it are vertices", path.display())),
            }
        }
        if npz && rig.mesh().is_some_and(|m| !m.metadata.statements.is_empty()) {
            lost("groups and materials");
        }
        let (vertices, shapes) = (rig.neutral().len(), rig.shapes().len());
        say(format_args!("wrote {}: {vertices} vertices, {shapes} shapes", self.out.display()))
    }
}

/// The materials of a rig's mesh, which was read from `input`, to be copied beside `out`.
pub fn materials_beside(rig: &Rig, out: &Path, input: &Path) -> Result<MaterialFiles, Failure> {
    let materials = rig.mesh().map(|mesh| materials_for(out, input, mesh)).unwrap_or_default();
    refuse_beside(out, materials.writes(out).into_iter().map(|path| ("--out", path)))?;
    Ok(materials)
}

/// Copies materials beside the mesh of a rig that was written to `out`, which then names them.
pub fn bring_materials(rig: &Rig, out: &Path, materials: &MaterialFiles) -> Result<(), Failure> {
    let Some(mesh) = rig.mesh().filter(|_| !materials.is_empty()) else { return Ok(()) };
    let mut mesh = mesh.with_positions(rig.neutral().to_vec());
    let copied = materials.write(out, &mut mesh).map_err(Failure::writing)?;
    io::write_obj(out, &mesh).map_err(Failure::writing)?;
    copied.keep();
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
