//! `faulty-scans`: what a registration answers when its scan is at fault: a right result, a refusal, or a result with a warning.
//! What must not be is a wrong result without one.
//!
//! Varied: the fault, with landmarks and without. Held: people, expressions, template and each model's schedule. Measured: the
//! error against the true vertices that the scan still shows, and every sign of [`Doubt`].

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Result;
use nonrigid::cli::say;
use nonrigid::evaluation::ScanDistance;
use nonrigid::mesh::{Pose, TriangleMesh, Vec3};
use nonrigid::registration::{Doubt, ModelFactory, ModelKind, Quality, RegistrationInput, StepRecord, register};
use rayon::prelude::*;
use serde::Serialize;

use crate::generated::{ScanOptions, Shot, Studio};
use crate::output::make_output_folder;
use crate::random_pose::random_pose;
use crate::scan_bench::BenchCase;
use crate::tables::{csv_text, table, write_csv, write_json};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  experiments faulty-scans\n  \
    experiments faulty-scans --people 1 --models hybrid,blendshape")]
pub struct Arguments {
    /// Models to run
    #[arg(long, value_delimiter = ',', default_values_t = [ModelKind::Hybrid], value_parser = str::parse::<ModelKind>)]
    models: Vec<ModelKind>,
    /// Vertices of the template, about
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1000..=100_000))]
    vertices: u32,
    /// People, each with every fault
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    people: u32,
    /// Seed of people and faults
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Where the tables go
    #[arg(long, value_name = "DIR", default_value = "out/faulty-scans")]
    out: PathBuf,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// What is wrong with a scan.
#[derive(Debug, Clone, Copy)]
enum Fault {
    /// So much of its triangles float off the surface.
    Outliers(f64),
    /// So much of its surface is cut off, from a random side.
    Missing(f64),
    /// It is in a unit of so many millimetres.
    Unit(f64),
    /// Left is right, and triangles face outwards.
    Mirrored,
    /// Triangles face inwards.
    InsideOut,
    /// It is turned about a random axis, degrees.
    Turned(f64),
    /// It shows another person beside.
    TwoFaces,
    /// It is right, but each landmark has the name of the next.
    Misnamed,
}

const FAULTS: [(&str, Fault); 19] = [
    ("none", Fault::Turned(0.0)),
    ("outliers 5 %", Fault::Outliers(0.05)),
    ("outliers 10 %", Fault::Outliers(0.1)),
    ("outliers 20 %", Fault::Outliers(0.2)),
    ("missing 20 %", Fault::Missing(0.2)),
    ("missing 40 %", Fault::Missing(0.4)),
    ("missing 60 %", Fault::Missing(0.6)),
    ("in metres", Fault::Unit(1000.0)),
    ("in centimetres", Fault::Unit(10.0)),
    ("in inches", Fault::Unit(25.4)),
    ("mirrored", Fault::Mirrored),
    ("inside out", Fault::InsideOut),
    ("turned 30", Fault::Turned(30.0)),
    ("turned 60", Fault::Turned(60.0)),
    ("turned 90", Fault::Turned(90.0)),
    ("turned 135", Fault::Turned(135.0)),
    ("turned 180", Fault::Turned(180.0)),
    ("two faces", Fault::TwoFaces),
    ("landmarks misnamed", Fault::Misnamed),
];

/// One registration.
#[derive(Debug, Clone, Serialize)]
pub struct FaultRow {
    /// The fault.
    pub fault: String,
    /// Number of landmarks.
    pub landmarks: usize,
    /// The model.
    pub model: String,
    /// The person, from 0.
    pub person: u64,
    /// Root mean square error over the true vertices that the scan shows, millimetres; `None` where there is no result.
    pub rmse: Option<f64>,
    /// What the result measures of itself.
    pub quality: Option<Quality>,
    /// Share of accepted vertices.
    pub inliers: Option<f64>,
    /// Names of the signs that it is wrong.
    pub doubts: Vec<String>,
    /// Why there is no result.
    pub error: Option<String>,
}

/// Error up to which a result counts as right, millimetres: twice the worst of the faultless scans.
const RIGHT: f64 = 4.0;

impl FaultRow {
    /// What came of it.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        match (self.rmse, self.doubts.is_empty()) {
            (None, _) => Verdict::Refused,
            (Some(rmse), true) if rmse <= RIGHT => Verdict::Right,
            (Some(rmse), false) if rmse <= RIGHT => Verdict::RightWithWarning,
            (Some(_), false) => Verdict::WrongWithWarning,
            (Some(_), true) => Verdict::WrongAndSilent,
        }
    }
}

/// What came of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// A right result.
    Right,
    /// A right result with a warning.
    RightWithWarning,
    /// An error that says why.
    Refused,
    /// A wrong result with a warning.
    WrongWithWarning,
    /// A wrong result and no warning.
    WrongAndSilent,
}

const VERDICTS: [(Verdict, &str); 5] = [
    (Verdict::Right, "right"),
    (Verdict::RightWithWarning, "right, warned"),
    (Verdict::Refused, "refused"),
    (Verdict::WrongWithWarning, "wrong, warned"),
    (Verdict::WrongAndSilent, "wrong, silent"),
];

impl Fault {
    /// The case of a person with this fault.
    fn make(self, studio: &Studio, seed: u64) -> Result<BenchCase> {
        let expressions = [("jawOpen", 0.3), ("mouthSmile", 0.5), ("browOuterUp", 0.4)];
        let expressions = expressions.map(|(name, weight)| (name.to_owned(), weight)).to_vec();
        let mut scan = ScanOptions { expressions: Some(expressions), triangles: 20_000, ..ScanOptions::default() };
        if let Self::Outliers(share) = self {
            scan.outliers = share;
        }
        let shot = |scan: &ScanOptions, seed| Shot {
            name: String::new(),
            scan: scan.clone(),
            known: false,
            withheld: Vec::new(),
            seed,
        };
        let mut case = studio.shoot(&shot(&scan, seed))?;
        match self {
            Self::Outliers(_) => {}
            Self::Missing(share) => cut_off(&mut case, share, seed)?,
            Self::Unit(millimetres) => in_place(&mut case, |p| p / millimetres),
            Self::Mirrored => {
                in_place(&mut case, |p| Vec3::new(-p.x, p.y, p.z));
                turn_over(&mut case.scan.mesh);
            }
            Self::InsideOut => turn_over(&mut case.scan.mesh),
            Self::Turned(degrees) => {
                let shift = if degrees > 0.0 { 300.0 } else { 0.0 };
                case = case.moved(&random_pose(degrees, shift, seed, 2));
            }
            Self::TwoFaces => {
                let other =
                    studio.shoot(&shot(&scan, seed + 1000))?.moved(&Pose::rigid(Vec3::y() * 0.4, Vec3::x() * 250.0));
                let first = case.scan.mesh.positions.len() as u32;
                case.scan.mesh.positions.extend(&other.scan.mesh.positions);
                case.scan.mesh.triangles.extend(other.scan.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
            }
            Self::Misnamed => {
                let targets: Vec<Vec3> = case.landmarks.iter().map(|l| l.target).collect();
                let next = targets.iter().cycle().skip(1);
                case.landmarks.iter_mut().zip(next).for_each(|(l, target)| l.target = *target);
            }
        }
        case.scan.normals = None; // those of the triangles as they are now
        Ok(case)
    }
}

/// Moves everything that is in the scan's space.
fn in_place(case: &mut BenchCase, place: impl Fn(Vec3) -> Vec3) {
    let points = case.scan.mesh.positions.iter_mut().chain(&mut case.truth);
    points.chain(case.landmarks.iter_mut().map(|l| &mut l.target)).for_each(|p| *p = place(*p));
}

fn turn_over(mesh: &mut TriangleMesh) {
    mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
}

/// Cuts off the share of the triangles that lies farthest in a random direction, and what they showed.
fn cut_off(case: &mut BenchCase, share: f64, seed: u64) -> Result<()> {
    let direction = random_pose(0.0, 1.0, seed, 3).translation;
    let mesh = &mut case.scan.mesh;
    let height = |t: &[u32; 3]| t.iter().map(|&v| mesh.positions[v as usize].dot(&direction)).sum::<f64>();
    let mut order: Vec<(f64, [u32; 3])> = mesh.triangles.iter().map(|t| (height(t), *t)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.truncate(((1.0 - share) * order.len() as f64) as usize);
    mesh.triangles = order.into_iter().map(|o| o.1).collect();
    let left = ScanDistance::new(mesh, None)?;
    case.observed.iter_mut().zip(&case.truth).for_each(|(observed, p)| *observed &= left.of(p) < 3.0);
    Ok(())
}

/// Registers a case; without `landmarks`, its start is searched.
fn register_case(model: ModelKind, case: &BenchCase, landmarks: bool) -> Result<FaultRow> {
    let marks = if landmarks { &case.landmarks[..] } else { &[] };
    let input = RegistrationInput { landmarks: marks, ..case.input() };
    let mut row = FaultRow {
        fault: String::new(),
        landmarks: marks.len(),
        model: model.name().to_owned(),
        person: 0,
        rmse: None,
        quality: None,
        inliers: None,
        doubts: Vec::new(),
        error: None,
    };
    match register(&input, &model, &model.schedule()?, &mut |_: &StepRecord| ControlFlow::Continue(())) {
        Ok(result) => {
            let quality = Quality::measure(&input, &result.positions)?;
            row.doubts = Doubt::of(&input, &result, &quality).iter().map(|d| d.name().to_owned()).collect();
            row.rmse = Some(case.score(&result.positions)?.0.rmse);
            row.inliers = result.history.last().map(|h| h.inliers);
            row.quality = Some(quality);
        }
        Err(e) => row.error = Some(e.to_string()),
    }
    Ok(row)
}

/// Every fault of every person with every model, with landmarks and without.
///
/// # Errors
/// When a scan cannot be made.
pub fn faulty_scans(vertices: usize, people: u64, models: &[ModelKind], seed: u64) -> Result<Vec<FaultRow>> {
    let studio = Studio::new(vertices)?;
    let jobs: Vec<(usize, u64)> = (0..FAULTS.len()).flat_map(|f| (0..people).map(move |p| (f, p))).collect();
    let run = |&(fault, person): &(usize, u64)| -> Result<Vec<FaultRow>> {
        let (name, fault) = FAULTS[fault];
        let case = fault.make(&studio, seed + person)?;
        // Names of landmarks matter to those who have landmarks.
        let with: &[bool] = if matches!(fault, Fault::Misnamed) { &[true] } else { &[true, false] };
        let runs = models.iter().flat_map(|&model| with.iter().map(move |&landmarks| (model, landmarks)));
        runs.map(|(model, landmarks)| {
            let row = register_case(model, &case, landmarks)?;
            let unit = if let Fault::Unit(millimetres) = fault { millimetres } else { 1.0 };
            Ok(FaultRow { fault: name.to_owned(), person, rmse: row.rmse.map(|e| e * unit), ..row })
        })
        .collect()
    };
    let rows: Result<Vec<Vec<FaultRow>>> = jobs.par_iter().map(run).collect();
    Ok(rows?.concat())
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`](nonrigid::cli::Failure) of writing, or when a scan cannot be made.
pub fn run(a: &Arguments) -> Result<()> {
    make_output_folder(&a.out, [])?;
    let rows = faulty_scans(a.vertices as usize, u64::from(a.people), &a.models, a.seed)?;
    let header =
        "fault,landmarks,model,person,verdict,rmse,inliers,median_within,share_within,flipped,stretch_p99,doubts,error";
    let number = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.6}"));
    let lines = rows.iter().map(|r| {
        let q = r.quality.as_ref();
        let numbers = [
            r.rmse,
            r.inliers,
            q.map(|q| q.median_within),
            q.map(|q| q.to_scan.share_within),
            q.map(|q| q.flipped as f64),
            q.map(|q| q.mesh.stretch.p99),
        ];
        let verdict = VERDICTS.iter().find(|v| v.0 == r.verdict()).map_or("", |v| v.1);
        let cells =
            [csv_text(&r.fault), r.landmarks.to_string(), r.model.clone(), r.person.to_string(), csv_text(verdict)];
        let error = csv_text(r.error.as_deref().unwrap_or_default());
        format!("{},{},{},{error}", cells.join(","), numbers.map(number).join(","), r.doubts.join(" "))
    });
    write_csv(&a.out.join("faulty-scans.csv"), header, lines)?;
    write_json(&a.out.join("faulty-scans.json"), &serde_json::json!({ "rows": rows }))?;
    say(summary(&rows))?;
    say(format_args!("right: at most {RIGHT} mm; faulty-scans.csv and faulty-scans.json are in {}", a.out.display()))?;
    Ok(())
}

/// How often each fault led to which verdict, and the errors of the results.
fn summary(rows: &[FaultRow]) -> comfy_table::Table {
    let header: Vec<&str> = ["fault", "landmarks", "model"]
        .into_iter()
        .chain(VERDICTS.map(|v| v.1))
        .chain(["rmse / mm", "signs"])
        .collect();
    let mut groups: Vec<(&str, bool, &str)> = rows.iter().map(|r| (&*r.fault, r.landmarks > 0, &*r.model)).collect();
    let mut seen = Vec::new();
    groups.retain(|g| {
        !seen.contains(g) && {
            seen.push(*g);
            true
        }
    });
    table(
        &header,
        groups.into_iter().map(|group| {
            let of: Vec<&FaultRow> = rows.iter().filter(|r| (&*r.fault, r.landmarks > 0, &*r.model) == group).collect();
            let mut cells = vec![group.0.to_owned(), if group.1 { "yes" } else { "no" }.to_owned(), group.2.to_owned()];
            cells.extend(VERDICTS.map(|(v, _)| match of.iter().filter(|r| r.verdict() == v).count() {
                0 => String::new(),
                n => n.to_string(),
            }));
            let errors: Vec<String> = of.iter().filter_map(|r| r.rmse).map(|x| format!("{x:.1}")).collect();
            let mut signs: Vec<&str> = of.iter().flat_map(|r| r.doubts.iter().map(String::as_str)).collect();
            signs.sort_unstable();
            signs.dedup();
            cells.extend([errors.join(" "), signs.join(" ")]);
            cells
        }),
    )
}
