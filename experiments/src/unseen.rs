//! `unseen`: what a registration makes of the vertices that a scan does not show.
//!
//! Each case with ground truth is looked at as less complete scans would see it: crops, side views, a grazing depth frame, a
//! hand before the face, the lower part covered. Varied: the view, the model. Held: the case, its shapes, its landmarks (less
//! those that are out of sight), each model's schedule. Measured: rmse over the vertices that are seen and over those that are
//! not, triangles folded against the truth, and self-intersections, which the truth and the rest shape may have of their own.

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::Result;
use nonrigid::console::{Failure, say, tell, told};
use nonrigid::evaluation::{MeshQuality, TruthErrors, self_intersections};
use nonrigid::mesh::closest_point::ClosestVertices;
use nonrigid::mesh::normals::face_cross;
use nonrigid::mesh::{PoseKind, TriangleMesh, Vec3, closest_pose, rms_size};
use nonrigid::registration::{ModelFactory, ModelKind, Schedule, TERMS, TermFactory};
use serde::Serialize;

use crate::output::{each_once, make_output_folder, write_result};
use crate::scan_bench::{BenchCase, CaseSource, LandmarkUse, fit_case, read_schedule};
use crate::tables::{csv_field, table, write_csv, write_json};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples, on what `data-gen --seed 7 --out out/data` makes:\n  \
    experiments unseen out/data/cases --rig out/data/rig\n  \
    experiments unseen out/data/cases --rig out/data/rig --models hybrid,graph --views whole,half")]
pub struct Arguments {
    /// Folder of cases
    #[arg(value_name = "DIR")]
    cases: PathBuf,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Models to run
    #[arg(long, value_delimiter = ',', default_values_t = [ModelKind::Hybrid], value_parser = str::parse::<ModelKind>)]
    models: Vec<ModelKind>,
    /// Views, by name [default: all]
    #[arg(long, value_delimiter = ',', value_parser = view_name)]
    views: Vec<String>,
    /// Schedule (.toml) for every model instead of its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Where results and tables go
    #[arg(long, value_name = "DIR", default_value = "out/unseen")]
    out: PathBuf,
    /// Write every result as .obj
    #[arg(long)]
    meshes: bool,
    /// Threads [default: all cores]; results do not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// How much of a scan is left; lengths are shares of the template's root-mean-square size.
#[derive(Debug, Clone, Copy, PartialEq)]
enum View {
    /// The scan as it is.
    Whole,
    /// What lies beyond a plane through the middle is cut off: towards this side, the plane so far out.
    Crop(Vec3, f64),
    /// One camera at this azimuth and elevation, degrees; surface is lost where it is turned away by more than so many degrees.
    Camera([f64; 2], f64),
    /// A hand of this radius, so far before the surface, over this direction from the middle; what lies behind is not seen.
    Hand(Vec3, f64, f64),
    /// Below this height the surface is covered by bumps of this thickness, as by a beard or a collar.
    Covered(f64, f64),
}

const VIEWS: [(&str, View); 12] = [
    ("whole", View::Whole),
    ("half", View::Crop(Vec3::new(1.0, 0.0, 0.0), 0.0)),
    ("upper", View::Crop(Vec3::new(0.0, -1.0, 0.0), 0.0)),
    ("lower", View::Crop(Vec3::new(0.0, 1.0, 0.0), 0.1)),
    ("third", View::Crop(Vec3::new(-1.0, 0.3, 0.0), -0.3)),
    ("side 40", View::Camera([40.0, 0.0], 80.0)),
    ("side 70", View::Camera([-70.0, 5.0], 75.0)),
    ("from below", View::Camera([15.0, -40.0], 80.0)),
    ("grazing frame", View::Camera([-25.0, 8.0], 89.5)),
    ("hand on cheek", View::Hand(Vec3::new(0.5, -0.3, 0.8), 0.55, 0.25)),
    ("hand on mouth", View::Hand(Vec3::new(0.0, -0.55, 0.85), 0.5, 0.3)),
    ("beard", View::Covered(-0.45, 0.15)),
];

fn view_name(name: &str) -> Result<String, String> {
    let known: Vec<_> = VIEWS.iter().map(|v| v.0).collect();
    known.contains(&name).then(|| name.to_owned()).ok_or_else(|| format!("'{name}' is none of {}", known.join(", ")))
}

/// One registration.
#[derive(Debug, Clone, Serialize)]
pub struct UnseenRow {
    /// Case.
    pub case: String,
    /// View.
    pub view: String,
    /// Model.
    pub model: String,
    /// Why there is no result.
    pub error: Option<String>,
    /// Vertices that are seen.
    pub seen: usize,
    /// Root mean square error over them, millimetres.
    pub rmse: Option<f64>,
    /// Root mean square error over the others, where there are any.
    pub unseen_rmse: Option<f64>,
    /// Triangles whose normal turned by more than 90 degrees against the truth.
    pub folds: usize,
    /// The same for the subject's rest shape, laid on the truth rigidly: what is no fold but the expression.
    pub folds_at_rest: usize,
    /// Pairs of triangles that pass through each other.
    pub self_intersections: usize,
    /// The same in the rest shape, or in the truth where that has more: what the subject has of its own.
    pub own_self_intersections: usize,
    /// Least and greatest edge over the one at rest: 1st and 99th percentile, and the greatest.
    pub stretch: [f64; 3],
    /// Time of the registration; not part of what is compared.
    #[serde(skip)]
    pub seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`] of the arguments; when something cannot be read or written; of the computation when every run failed.
pub fn run(a: &Arguments) -> Result<()> {
    each_once("--models", &a.models)?;
    each_once("--views", &a.views)?;
    let cases = CaseSource::new(&a.cases, &a.rig).read()?;
    let config = a.config.as_ref().map(|path| read_schedule(path)).transpose()?;
    let reads = [("DIR", &a.cases), ("--rig", &a.rig)].into_iter();
    make_output_folder(&a.out, reads.chain(a.config.iter().map(|path| ("--config", path))), &[])?;
    let mut rows = Vec::new();
    for case in &cases {
        for (name, view) in VIEWS.iter().filter(|v| a.views.is_empty() || a.views.iter().any(|n| n == v.0)) {
            let seen = seen_as(case, *view).and_then(|seen| own_faults(&seen).map(|own| (seen, own)));
            for model in &a.models {
                let row = match &seen {
                    Ok((seen, own)) => {
                        let schedule = config.clone().map_or_else(|| model.schedule(), Ok)?;
                        row_of(seen, name, *model, &TERMS, &schedule, *own, a)?
                    }
                    Err(e) => UnseenRow { error: Some(told(e)), ..UnseenRow::new(&case.name, name, *model) },
                };
                let [rmse, unseen] = [row.rmse, row.unseen_rmse].map(|x| shown(x, 3));
                let outcome = row.error.as_ref().map_or(format!("{rmse} / {unseen}"), |e| format!("failed: {e}"));
                tell(format_args!("{} {} {}: {outcome}", row.case, row.view, row.model));
                rows.push(row);
            }
        }
    }
    write_csv(
        &a.out.join("unseen.csv"),
        "case,view,model,error,seen,rmse,unseen_rmse,folds,folds_at_rest,self_intersections,own_self_intersections",
        rows.iter().map(|r| {
            format!(
                "{},{},{},{},{},{},{},{},{},{},{}",
                csv_field(&r.case),
                csv_field(&r.view),
                r.model,
                csv_field(r.error.as_deref().unwrap_or("")),
                r.seen,
                shown(r.rmse, 6),
                shown(r.unseen_rmse, 6),
                r.folds,
                r.folds_at_rest,
                r.self_intersections,
                r.own_self_intersections
            )
        }),
    )?;
    write_json(&a.out.join("unseen.json"), &serde_json::json!({ "rows": rows }))?;
    say(rows_table(&rows))?;
    say(summary(&rows))?;
    match rows.first().filter(|_| rows.iter().all(|row| row.error.is_some())) {
        None => Ok(()),
        Some(UnseenRow { case, view, model, error, .. }) => {
            let reason = error.as_deref().unwrap_or_default();
            Err(Failure::computation(format!("every run failed; the first, {model} on {case}, {view}: {reason}"))
                .into())
        }
    }
}

/// A number where there is one.
fn shown(x: Option<f64>, decimals: usize) -> String {
    x.map_or(String::new(), |x| format!("{x:.decimals$}"))
}

impl UnseenRow {
    /// Without a result.
    fn new(case: &str, view: &str, model: ModelKind) -> Self {
        Self {
            case: case.to_owned(),
            view: view.to_owned(),
            model: model.name().to_owned(),
            error: None,
            seen: 0,
            rmse: None,
            unseen_rmse: None,
            folds: 0,
            folds_at_rest: 0,
            self_intersections: 0,
            own_self_intersections: 0,
            stretch: [1.0; 3],
            seconds: 0.0,
        }
    }
}

/// Folds and self-intersections that the subject has without any registration.
fn own_faults(case: &BenchCase) -> Result<[usize; 2]> {
    let triangles = case.template.triangulate().triangles;
    let rest = case.rest();
    let pairs: Vec<_> = rest.iter().copied().zip(case.truth.iter().copied()).collect();
    let pose = closest_pose(&pairs, PoseKind::Rigid)?;
    let posed: Vec<Vec3> = rest.iter().map(|&p| pose.apply(p)).collect();
    let (errors, _) = TruthErrors::new(&posed, &case.truth, &case.observed, &triangles)?;
    let crossings = |p: &[Vec3]| self_intersections(p, &triangles).map(|pairs| pairs.len());
    Ok([errors.flipped, crossings(rest)?.max(crossings(&case.truth)?)])
}

fn row_of(
    case: &BenchCase,
    view: &str,
    model: ModelKind,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    own: [usize; 2],
    a: &Arguments,
) -> Result<UnseenRow> {
    let mut row = UnseenRow {
        seen: case.observed.iter().filter(|o| **o).count(),
        folds_at_rest: own[0],
        own_self_intersections: own[1],
        ..UnseenRow::new(&case.name, view, model)
    };
    let (result, seconds) = match fit_case(&model, terms, schedule, case, LandmarkUse::All) {
        Ok(fitted) => fitted,
        Err(e) => return Ok(UnseenRow { error: Some(e.to_string()), ..row }),
    };
    let (errors, MeshQuality { self_intersections, stretch, .. }) = case.score(&result.positions)?;
    (row.rmse, row.folds, row.seconds) = (Some(errors.rmse), errors.flipped, seconds);
    row.unseen_rmse = errors.unobserved;
    (row.self_intersections, row.stretch) = (self_intersections, [stretch.p1, stretch.p99, stretch.max]);
    if a.meshes {
        let name = format!("{}-{}-{}.obj", row.case, row.view.replace(' ', "_"), row.model);
        write_result(&a.out.join(name), &case.template, result.positions)?;
    }
    Ok(row)
}

/// The case as a scan with this view would show it.
fn seen_as(case: &BenchCase, view: View) -> Result<BenchCase> {
    let mut case = case.clone();
    let rest = case.rest();
    let pairs: Vec<_> = rest.iter().copied().zip(case.truth.iter().copied()).collect();
    let pose = closest_pose(&pairs, PoseKind::Rigid)?;
    let middle = rest.iter().sum::<Vec3>() / rest.len() as f64;
    let size = rms_size(rest);
    // In the template's frame, where the subject looks along +Z.
    let local = |p: Vec3| (pose.apply_inverse(p) - middle) / size;
    let scan = &case.scan.mesh;
    let points: Vec<Vec3> = scan.positions.iter().map(|&p| local(p)).collect();
    let (mut added, mut covered) = (None, vec![false; points.len()]);
    let kept: Vec<bool> = match view {
        View::Whole => vec![true; scan.triangles.len()],
        View::Crop(side, out) => {
            let side = side.normalize();
            scan.triangles.iter().map(|t| t.iter().all(|&v| points[v as usize].dot(&side) <= out)).collect()
        }
        View::Camera(angles, grazing) => {
            let [azimuth, elevation] = angles.map(f64::to_radians);
            let towards = Vec3::new(azimuth.sin() * elevation.cos(), elevation.sin(), azimuth.cos() * elevation.cos());
            visible(&points, &scan.triangles, towards, grazing.to_radians().cos())
        }
        View::Hand(direction, radius, before) => {
            // On the frontmost surface along Z; hidden is what lies behind it as a camera in front sees it.
            let across = |p: &Vec3, c: &Vec3| (p.xy() - c.xy()).norm();
            let centre = direction.normalize();
            let near = points.iter().filter(|p| across(p, &centre) < 0.3 * radius);
            let front = near.map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
            let front = if front.is_finite() { front } else { centre.z };
            added = Some(hand(Vec3::new(centre.x, centre.y, front + before), radius));
            let behind = |v: &u32| across(&points[*v as usize], &centre) < radius;
            scan.triangles.iter().map(|t| !t.iter().any(behind)).collect()
        }
        View::Covered(height, thickness) => {
            let normals = nonrigid::mesh::normals::vertex_normals(
                &scan.positions,
                &scan.triangles,
                nonrigid::mesh::normals::NormalWeighting::Area,
            );
            let moved: Vec<Vec3> = scan
                .positions
                .iter()
                .zip(&points)
                .zip(&normals)
                .zip(&mut covered)
                .map(|(((p, q), n), covered)| {
                    let depth = ((height - q.y) / 0.15).clamp(0.0, 1.0);
                    *covered = depth > 0.0;
                    let bumps = 0.7 + 0.3 * (23.0 * q.x).sin() * (29.0 * q.y).cos() * (31.0 * q.z).sin();
                    p + n * (size * thickness * depth * bumps)
                })
                .collect();
            case.scan.normals = None;
            case.scan.mesh.positions = moved;
            vec![true; case.scan.mesh.triangles.len()]
        }
    };
    // A vertex is seen if the part of the scan that showed it is left.
    let whole = ClosestVertices::new(&points)?;
    let mut shown = vec![false; points.len()];
    let left = case.scan.mesh.triangles.iter().zip(&kept).filter(|t| *t.1).map(|t| *t.0);
    let left: Vec<[u32; 3]> = left.collect();
    left.iter().flatten().for_each(|&v| shown[v as usize] = !covered[v as usize]);
    let is_shown = |p: Vec3| whole.query(&local(p)).is_some_and(|c| shown[c.vertex as usize]);
    for (observed, p) in case.observed.iter_mut().zip(&case.truth) {
        *observed &= is_shown(*p);
    }
    case.landmarks.retain(|l| is_shown(l.target));
    case.scan.mesh.triangles = left;
    if let Some(patch) = added {
        let first = case.scan.mesh.positions.len() as u32;
        let to_scan = |p: &Vec3| pose.apply(p * size + middle);
        case.scan.mesh.positions.extend(patch.positions.iter().map(to_scan));
        case.scan.mesh.triangles.extend(patch.triangles.iter().map(|t| t.map(|v| v + first)));
        case.scan.normals = None;
        case.scan.colors = None;
    }
    compact(&mut case);
    Ok(case)
}

/// Drops the vertices that no triangle uses.
fn compact(case: &mut BenchCase) {
    let mesh = &mut case.scan.mesh;
    let mut number: HashMap<u32, u32> = HashMap::new();
    let mut order = Vec::new();
    for v in mesh.triangles.iter_mut().flatten() {
        *v = *number.entry(*v).or_insert_with(|| {
            order.push(*v as usize);
            order.len() as u32 - 1
        });
    }
    mesh.positions = order.iter().map(|&v| mesh.positions[v]).collect();
    if let Some(normals) = &mut case.scan.normals {
        *normals = order.iter().map(|&v| normals[v]).collect();
    }
    case.scan.colors = None;
}

/// Side of a cell of the depth image of [`visible`].
const CELL: f64 = 0.03;

/// Triangles that face a camera far away in direction `towards` by more than `cosine` and are not hidden behind others.
fn visible(points: &[Vec3], triangles: &[[u32; 3]], towards: Vec3, cosine: f64) -> Vec<bool> {
    let right = Vec3::y().cross(&towards).normalize();
    let up = towards.cross(&right);
    let cell = |p: &Vec3| [(p.dot(&right) / CELL).floor() as i64, (p.dot(&up) / CELL).floor() as i64];
    let mut nearest: HashMap<[i64; 2], f64> = HashMap::new();
    for p in points {
        let depth = nearest.entry(cell(p)).or_insert(f64::NEG_INFINITY);
        *depth = depth.max(p.dot(&towards));
    }
    let hidden = |v: &u32| {
        let p = &points[*v as usize];
        nearest[&cell(p)] - p.dot(&towards) > 0.15
    };
    let faces = |t: &[u32; 3]| face_cross(points, *t).try_normalize(0.0).is_some_and(|n| n.dot(&towards) > cosine);
    triangles.iter().map(|t| faces(t) && !t.iter().any(hidden)).collect()
}

/// A slightly domed disc of four fingers facing +Z.
fn hand(centre: Vec3, radius: f64) -> TriangleMesh {
    const SIDE: usize = 41;
    let at = |i: usize| 2.0 * i as f64 / (SIDE - 1) as f64 - 1.0;
    let mut mesh = TriangleMesh { positions: Vec::new(), triangles: Vec::new() };
    for (r, c) in (0..SIDE * SIDE).map(|k| (k / SIDE, k % SIDE)) {
        let (x, y) = (at(c), at(r));
        let fingers = 0.06 * (4.0 * std::f64::consts::PI * y).cos();
        mesh.positions.push(centre + Vec3::new(x, y, fingers - 0.15 * (x * x + y * y)) * radius);
    }
    for (r, c) in (0..(SIDE - 1) * (SIDE - 1)).map(|k| (k / (SIDE - 1), k % (SIDE - 1))) {
        let v = (r * SIDE + c) as u32;
        let below = v + SIDE as u32;
        if at(c).hypot(at(r)) < 0.95 {
            mesh.triangles.extend([[v, v + 1, below + 1], [v, below + 1, below]]);
        }
    }
    mesh
}

fn rows_table(rows: &[UnseenRow]) -> comfy_table::Table {
    let header =
        ["case", "view", "model", "seen", "rmse", "unseen", "folds", "(rest)", "self-int.", "(own)", "stretch", "s"];
    table(
        &header,
        rows.iter().map(|r| {
            let [low, high, most] = r.stretch;
            vec![
                r.case.clone(),
                r.view.clone(),
                r.model.clone(),
                r.seen.to_string(),
                r.error.as_ref().map_or_else(|| shown(r.rmse, 3), |_| "none".to_owned()),
                shown(r.unseen_rmse, 3),
                r.folds.to_string(),
                r.folds_at_rest.to_string(),
                r.self_intersections.to_string(),
                r.own_self_intersections.to_string(),
                format!("{low:.2} {high:.2} {most:.1}"),
                format!("{:.2}", r.seconds),
            ]
        }),
    )
}

/// Means by view and model, and sums of what exceeds the subject's own.
fn summary(rows: &[UnseenRow]) -> comfy_table::Table {
    let mut keys: Vec<(&str, &str)> = Vec::new();
    for r in rows {
        for key in [(r.view.as_str(), r.model.as_str()), ("all", r.model.as_str())] {
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
    }
    keys.sort_by_key(|k| (k.1, k.0 == "all"));
    let header =
        ["view", "model", "no result", "rmse", "unseen", "folds", "over rest", "self-int.", "over own", "most", "s"];
    table(
        &header,
        keys.into_iter().map(|(view, model)| {
            let of: Vec<_> = rows.iter().filter(|r| r.model == model && (view == "all" || r.view == view)).collect();
            let done: Vec<_> = of.iter().filter(|r| r.error.is_none()).collect();
            let mean = |f: fn(&UnseenRow) -> Option<f64>| {
                let known: Vec<f64> = done.iter().filter_map(|r| f(r)).collect();
                (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
            };
            let sum = |f: fn(&UnseenRow) -> usize| done.iter().map(|r| f(r)).sum::<usize>();
            let crossing = |r: &UnseenRow| r.self_intersections.saturating_sub(r.own_self_intersections);
            let worst = done.iter().map(|r| crossing(r)).max().unwrap_or(0);
            vec![
                view.to_owned(),
                model.to_owned(),
                (of.len() - done.len()).to_string(),
                shown(mean(|r| r.rmse), 4),
                shown(mean(|r| r.unseen_rmse), 4),
                sum(|r| r.folds).to_string(),
                sum(|r| r.folds.saturating_sub(r.folds_at_rest)).to_string(),
                sum(|r| r.self_intersections).to_string(),
                sum(|r| r.self_intersections.saturating_sub(r.own_self_intersections)).to_string(),
                worst.to_string(),
                shown(mean(|r| Some(r.seconds)), 2),
            ]
        }),
    )
}
