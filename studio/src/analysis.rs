//! Measurements of a face and of its plans, with the lines and outlines that the page draws.

use nonrigid::landmark::TemplatePoint;
use nonrigid::measurement::{FaceState, Formula, LANDMARKS, Landmarks, Measurements, NamedRegion, Plan, Subject};
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::rig::{Companions, Regions};

use crate::case::Case;
use crate::error::{Problem, problem};
use crate::protocol::{Analysis, MeasureRow, Profile, RegionRow};
use crate::store::Store;
use crate::vault::Vault;

/// The landmarks of a case by which a face is measured: those of its rig, or else those of its own that have a name for measuring.
///
/// # Errors
/// When there are none, or they cannot be read.
pub fn landmarks(store: &Store, vault: &Vault, case: &Case, face: &PolygonMesh) -> Result<Landmarks, Problem> {
    let mut known = Landmarks::default();
    if let Some(source) = &case.rig {
        let (path, rig) = (vault.path(&source.at)?, store.rig(vault, source, 0)?);
        known = Landmarks::of_rig(&Companions::of(&path).landmarks, rig.rig.landmarks(), face).map_err(problem)?;
    }
    if known.is_empty() {
        let own = case.wrap.pairs.iter().filter_map(|p| Some((p.name.clone(), TemplatePoint::Vertex(p.vertex?))));
        known = Landmarks::among(&own.collect::<Vec<_>>()).map_err(problem)?;
    }
    if known.is_empty() {
        return Err(problem(
            "nothing says where the landmarks are: add a rig with 68 landmarks, or name the template's landmarks nasion, menton, ...",
        ));
    }
    Ok(known)
}

/// Measures a face and what plans make of it.
///
/// # Errors
/// What the library says.
pub fn analyse(
    face: &PolygonMesh,
    known: &Landmarks,
    regions: &Regions,
    plans: &[(u32, String, Vec<Vec3>)],
) -> Result<Analysis, Problem> {
    let named: Vec<NamedRegion<'_>> = regions
        .names()
        .map(|name| NamedRegion {
            name,
            vertices: regions.vertices(name).unwrap_or_default(),
            polygons: regions.polygons(name),
        })
        .collect();
    let subject = Subject { mesh: face, after: None, landmarks: known, regions: &named };
    let shapes: Vec<Plan<'_>> = plans.iter().map(|(_, name, positions)| Plan { name, positions }).collect();
    let all = subject.compare(&shapes).map_err(problem)?;
    let before = all.before();
    let measured: Vec<&Measurements> = all.plans().map(|plan| plan.1).collect();
    let states: Vec<&FaceState> =
        std::iter::once(&before.before).chain(measured.iter().filter_map(|m| m.after.as_ref())).collect();
    let line = |state: &FaceState, formula: Formula| -> Vec<[f64; 3]> {
        let place = |name: &str| state.landmarks.iter().find(|l| l.0 == name).map(|l| l.1.into());
        formula.landmarks().into_iter().filter_map(place).collect()
    };
    let mut rows: Vec<MeasureRow> = Vec::new();
    for (k, m) in before.values.iter().enumerate() {
        let d = m.definition;
        let after = measured.iter().map(|p| p.values.get(k).and_then(|v| v.after));
        rows.push(MeasureRow {
            group: d.group.to_owned(),
            name: d.title(),
            formula: d.formula.to_string().replace('_', " "),
            unit: d.formula.unit().to_owned(),
            values: std::iter::once(m.before).chain(after).collect(),
            typical: d.typical.map(|t| [t.low, t.high]),
            source: d.typical.map_or_else(String::new, |t| t.source.to_owned()),
            missing: m.missing.as_ref().map_or_else(String::new, ToString::to_string),
            lines: states.iter().map(|state| line(state, d.formula)).collect(),
        });
    }
    let regions = before.regions.iter().enumerate().map(|(k, r)| RegionRow {
        name: r.name.clone(),
        area: r.before.area,
        asymmetry: r.before.asymmetry.rms,
        plans: measured
            .iter()
            .map(|m| {
                let of = &m.regions[k];
                let state = of.after.unwrap_or(of.before);
                let change = of.change.map_or([0.0; 2], |c| [c.volume, c.displacement_max]);
                [state.area, state.asymmetry.rms, change[0], change[1]]
            })
            .collect(),
    });
    let regions = regions.collect();
    let triangles = face.triangulate().triangles;
    let mut profiles = vec![profile("before", &face.positions, &triangles, before, None)];
    for ((_, name, positions), m) in plans.iter().zip(&measured) {
        profiles.push(profile(name, positions, &triangles, before, m.after.as_ref().map(|a| &a.landmarks[..])));
    }
    Ok(Analysis {
        plans: plans.iter().map(|p| p.0).collect(),
        columns: std::iter::once("before".to_owned()).chain(plans.iter().map(|p| p.1.clone())).collect(),
        rows,
        regions,
        profiles,
    })
}

/// Where the surface meets the mid-sagittal plane of the face before.
fn profile(
    name: &str,
    positions: &[Vec3],
    triangles: &[[u32; 3]],
    before: &Measurements,
    landmarks: Option<&[(&'static str, Vec3)]>,
) -> Profile {
    let mut pieces = Vec::new();
    let mut points = Vec::new();
    if let Some(frame) = before.before.frame.filter(|f| f.vertical.is_some()) {
        let all: Vec<Vec3> = positions.iter().map(|p| frame.coordinates(*p)).collect();
        for t in triangles {
            let corners = t.map(|v| all[v as usize]);
            let cut = |a: Vec3, b: Vec3| ((a.x < 0.0) != (b.x < 0.0)).then(|| a + (b - a) * (a.x / (a.x - b.x)));
            let ends: Vec<Vec3> = (0..3).filter_map(|k| cut(corners[k], corners[(k + 1) % 3])).collect();
            if let [a, b] = ends[..] {
                pieces.push([a.z, a.y, b.z, b.y].map(|x| x as f32));
            }
        }
        for (landmark, place) in landmarks.unwrap_or(&before.before.landmarks) {
            let p = frame.coordinates(*place);
            let midline = LANDMARKS.iter().any(|l| l.name == *landmark && !landmark.contains('_'))
                || landmark.starts_with("labiale");
            if midline && p.x.abs() < 8.0 {
                points.push(((*landmark).to_owned(), p.z as f32, p.y as f32));
            }
        }
    }
    Profile { name: name.to_owned(), pieces, points }
}
