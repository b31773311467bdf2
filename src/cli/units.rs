//! `--unit`: everything inside is millimetres, so every input's unit is stated, by the user or by its format, or found by its
//! size; and said.

use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

use clap::Args;

use super::{Failure, Stage, has_extension, tell, warn};
use crate::io::{self, FACE_EXTENT, FaceUnit, KnownUnit, LengthUnit, MeshFile, Paint, Scan, UnitSource, face_extent};
use crate::landmark::LandmarkSet;
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3, surface_points};
use crate::rig::{Population, Rig};

/// Units of the inputs.
#[derive(Debug, Args)]
pub struct UnitArguments {
    /// Unit of the inputs: mm, cm, m, um, in, or auto: what the format states (glTF: metres), or else the unit in which the input has
    /// the size of a face. For one input alone INPUT=UNIT, such as target=m. Outputs are in millimetres [default: auto]
    #[arg(long = "unit", value_name = "[INPUT=]UNIT", value_delimiter = ',')]
    choices: Vec<Choice>,
}

/// `UNIT` or `INPUT=UNIT`.
#[derive(Debug, Clone, PartialEq)]
struct Choice {
    input: Option<String>,
    /// `None` is auto.
    unit: Option<LengthUnit>,
}

impl FromStr for Choice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (input, unit) = text.split_once('=').map_or((None, text), |(input, unit)| (Some(input), unit));
        let (input, unit) = (input.map(|input| input.trim().to_owned()), unit.trim());
        let unit = if unit == "auto" { None } else { Some(unit.parse().map_err(|e| format!("{e}, or auto"))?) };
        Ok(Self { input, unit })
    }
}

/// The units of a command's inputs, as they become known; each input by the name of its option.
pub struct Units<'a> {
    choices: &'a [Choice],
    known: Vec<(&'static str, KnownUnit)>,
    /// Inputs that could be in another unit, with both and their extent.
    unsure: BTreeMap<&'static str, (LengthUnit, LengthUnit, f64)>,
    /// What is to be said of inputs whose format states a unit that does not fit their size.
    misfits: BTreeMap<&'static str, String>,
}

impl UnitArguments {
    /// [`of`](Self::of) those of the inputs that are given.
    ///
    /// # Errors
    /// As [`of`](Self::of).
    pub fn of_given(&self, inputs: &[(&str, bool)]) -> Result<Units<'_>, Failure> {
        let given: Vec<&str> = inputs.iter().filter(|(_, given)| *given).map(|(input, _)| *input).collect();
        self.of(&given)
    }

    /// For a command that is given these inputs.
    ///
    /// # Errors
    /// When `--unit` names another input, or one twice.
    pub fn of(&self, inputs: &[&str]) -> Result<Units<'_>, Failure> {
        for (k, choice) in self.choices.iter().enumerate() {
            let fail = |message: String| Err(Failure::new(Stage::Arguments, format!("--unit: {message}")));
            match &choice.input {
                Some(input) if !inputs.contains(&input.as_str()) => {
                    return fail(format!("no input '{input}'; there are {}", inputs.join(", ")));
                }
                _ if self.choices[..k].iter().any(|c| c.input == choice.input) => {
                    return fail(choice.input.as_ref().map_or("given twice".into(), |i| format!("{i} given twice")));
                }
                _ => {}
            }
        }
        Ok(Units { choices: &self.choices, known: Vec::new(), unsure: BTreeMap::new(), misfits: BTreeMap::new() })
    }
}

impl Units<'_> {
    /// What `--unit` says of an input.
    fn asked(&self, input: &str) -> Option<LengthUnit> {
        let of = |name: Option<&str>| self.choices.iter().find(|c| c.input.as_deref() == name);
        of(Some(input)).or_else(|| of(None)).and_then(|choice| choice.unit)
    }

    /// What the lengths of an input, as read, are multiplied by to be millimetres. An input of several files asks for each of them,
    /// and they must have one unit.
    fn factor(&mut self, input: &'static str, path: &Path, points: &[Vec3]) -> Result<f64, Failure> {
        let of_format = LengthUnit::of_format(path);
        let known = match (self.asked(input), of_format) {
            (Some(unit), _) => KnownUnit { unit, by: UnitSource::Option },
            (None, Some(unit)) => {
                let extent = face_extent(points) / unit.millimetres();
                if let Some(said) = unit.misfit(path.display(), extent, |other| format!("--unit {input}={other}")) {
                    self.misfits.entry(input).or_insert(said);
                }
                KnownUnit { unit, by: UnitSource::File }
            }
            (None, None) => {
                let extent = face_extent(points);
                let unit = match FaceUnit::of(extent) {
                    FaceUnit::One(unit) => unit,
                    FaceUnit::Likely(unit, other) => {
                        self.unsure.entry(input).or_insert((unit, other, extent));
                        unit
                    }
                    FaceUnit::Either(a, b) => return Err(unclear(input, path, extent, [a, b])),
                    FaceUnit::Unknown => return Err(unknown(input, path, extent)),
                };
                KnownUnit { unit, by: UnitSource::Size }
            }
        };
        match self.known.iter().find(|(name, _)| *name == input) {
            Some((_, first)) if first.unit != known.unit => {
                let (found, first) = (known.unit, first.unit);
                let message = format!(
                    "{}: by its size in {found}, but the first of {input} in {first}; say --unit {input}={first}, or bring all to one",
                    path.display()
                );
                return Err(Failure::loading(message));
            }
            Some(_) => {}
            None => self.known.push((input, known)),
        }
        // readers have brought formats that state a unit to millimetres by it
        Ok(known.unit.millimetres() / of_format.map_or(1.0, LengthUnit::millimetres))
    }

    /// Reads a mesh.
    pub fn read_mesh(&mut self, input: &'static str, path: &Path) -> Result<PolygonMesh, Failure> {
        Ok(self.read_mesh_file(input, path)?.mesh)
    }

    /// Reads a mesh with what else its file holds.
    pub fn read_mesh_file(&mut self, input: &'static str, path: &Path) -> Result<MeshFile, Failure> {
        let mut file = io::read_mesh_file(path).map_err(Failure::loading)?;
        let mesh = &mut file.mesh;
        let factor = self.factor(input, path, &surface_points(&mesh.positions, mesh.corners.iter().copied()))?;
        mesh.positions.iter_mut().for_each(|p| *p *= factor);
        Ok(file)
    }

    /// Reads a scan.
    pub fn read_scan(&mut self, input: &'static str, path: &Path) -> Result<Scan, Failure> {
        let scan = io::read_scan(path).map_err(Failure::loading)?;
        self.bring_scan(input, path, scan)
    }

    /// Reads a scan with its paint.
    pub fn read_painted_scan(&mut self, input: &'static str, path: &Path) -> Result<(Scan, Option<Paint>), Failure> {
        let (scan, paint) = io::read_painted_scan(path).map_err(Failure::loading)?;
        Ok((self.bring_scan(input, path, scan)?, paint))
    }

    fn bring_scan(&mut self, input: &'static str, path: &Path, mut scan: Scan) -> Result<Scan, Failure> {
        let TriangleMesh { positions, triangles } = &mut scan.mesh;
        let factor = self.factor(input, path, &surface_points(positions, triangles.as_flattened().iter().copied()))?;
        positions.iter_mut().for_each(|p| *p *= factor);
        Ok(scan)
    }

    /// Reads vertex positions from a mesh or an N x 3 array.
    pub fn read_positions(&mut self, input: &'static str, path: &Path) -> Result<Vec<Vec3>, Failure> {
        if !has_extension(path, "npy") {
            return Ok(self.read_mesh(input, path)?.positions);
        }
        let mut positions = io::read_npy_points(path).map_err(Failure::loading)?;
        let factor = self.factor(input, path, &positions)?;
        positions.iter_mut().for_each(|p| *p *= factor);
        Ok(positions)
    }

    /// Brings a rig to millimetres.
    pub fn bring_rig(&mut self, path: &Path, rig: &mut Rig) -> Result<(), Failure> {
        let factor = self.factor("rig", path, &rig.surface_points())?;
        rig.scale(factor);
        Ok(())
    }

    /// Brings the meshes of a population to millimetres.
    pub fn bring_population(&mut self, input: &'static str, population: &mut Population) -> Result<(), Failure> {
        let mut factor = 1.0;
        for (name, sample) in population.names().iter().zip(population.samples()) {
            factor = self.factor(input, Path::new(name), sample)?;
        }
        population.scale(factor);
        Ok(())
    }

    /// The unit of positions on a mesh in a file that states none: what `--unit` says of it, or else that of the mesh, if it is
    /// known.
    pub fn of_points(&self, input: &str, mesh: &str) -> Option<KnownUnit> {
        let asked = self.asked(input).map(|unit| KnownUnit { unit, by: UnitSource::Option });
        let known = || self.known.iter().find(|(name, _)| *name == mesh);
        asked.or_else(|| Some(KnownUnit { unit: known()?.1.unit, by: UnitSource::Mesh }))
    }

    /// Brings landmarks to millimetres, those on a mesh that is known.
    pub fn bring_landmarks(
        &mut self,
        input: &'static str,
        path: &Path,
        mesh: &str,
        set: &mut LandmarkSet,
    ) -> Result<(), Failure> {
        let of_this = self.choices.iter().find(|c| c.input.as_deref() == Some(input)).and_then(|c| c.unit);
        let known = match (set.unit, of_this) {
            (Some(stated), Some(asked)) if stated != asked => {
                let message = format!("--unit {input}={asked}: {} says {stated}; leave that out", path.display());
                return Err(Failure::new(Stage::Arguments, message));
            }
            (Some(unit), _) => Some(KnownUnit { unit, by: UnitSource::File }),
            (None, _) => self.of_points(input, mesh),
        };
        if let Some(known) = known.filter(|_| set.has_positions()) {
            self.known.push((input, known));
            set.assume(known.unit);
        }
        Ok(())
    }

    /// What is known, by input.
    pub fn known(&self) -> BTreeMap<String, KnownUnit> {
        self.known.iter().map(|(input, known)| ((*input).to_owned(), *known)).collect()
    }

    /// Refuses inputs whose format states a unit that does not fit their size.
    pub fn refuse_misfits(&self) -> Result<(), Failure> {
        self.misfits.values().next().map_or(Ok(()), |said| Err(Failure::loading(said)))
    }

    /// Says the units.
    pub fn say(&self) {
        if !self.known.is_empty() {
            let line: Vec<String> = self.known.iter().map(|(input, known)| format!("{input} {known}")).collect();
            tell(format_args!("units: {}", line.join(", ")));
            self.misfits.values().for_each(warn);
            for (input, (unit, other, extent)) in &self.unsure {
                let [taken, not] = [unit, other].map(|unit| extent * unit.millimetres());
                tell(format_args!(
                    "units: {input} is taken for {taken:.0} mm across, in {unit}; if it is in {other}, {not:.0} mm, say --unit {input}={other}"
                ));
            }
        }
    }
}

fn unknown(input: &str, path: &Path, extent: f64) -> Failure {
    let [low, high] = FACE_EXTENT;
    let mut message = format!(
        "{}: {extent:.3} across, which no face is in mm, cm, m or um ({low} to {high} mm); say its unit, such as --unit {input}=mm",
        path.display()
    );
    let inches = extent * LengthUnit::Inch.millimetres();
    if (low..high).contains(&inches) {
        message += &format!("; in inches it would be {inches:.0} mm: --unit {input}=in");
    }
    Failure::loading(message)
}

fn unclear(input: &str, path: &Path, extent: f64, units: [LengthUnit; 2]) -> Failure {
    let [a, b] = units;
    let [of_a, of_b] = units.map(|unit| extent * unit.millimetres());
    Failure::loading(format!(
        "{}: {extent:.3} across, which a face may be in {a} ({of_a:.0} mm) and in {b} ({of_b:.0} mm); say --unit {input}={a} or \
         --unit {input}={b}",
        path.display()
    ))
}
