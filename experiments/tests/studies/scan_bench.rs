//! `scan_bench` on generated cases with all models, with a user's own model and term, and on a real case where there is one.

use std::path::Path;

use data_gen::{FaceOptions, FaceRig, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use experiments::scan_bench::{BenchCase, BenchRig, LandmarkUse, run_case, scan_bench, summarize};
use nonrigid::energy::{DeformationModel, NamedEnergy, Options, OptionsError, Pointwise, QuadricField, Samples};
use nonrigid::evaluation::{MeshQuality, TruthErrors};
use nonrigid::mesh::{PoseKind, Vec3, closest_pose};
use nonrigid::model::ModelError;
use nonrigid::nlls::{BlockStructure, Kernel, NormalEquations};
use nonrigid::registration::{
    ModelFactory, ModelInput, ModelKind, RegistrationInput, RegistrationModel, RegistrationTerm, Schedule, Silent,
    TERMS, TermFactory, TermInput, register,
};
use nonrigid::term::{Landmarks, TermError};

use crate::real_data::real_data;

/// A rig and two cases, of a known and of an unknown person.
fn cases(folder: &Path) -> Vec<BenchCase> {
    let rig = FaceRig::generate(&FaceOptions { vertices: 2000, ..FaceOptions::default() });
    write_rig(&folder.join("rig"), &rig).unwrap();
    for seed in [7, 8] {
        // A manner far from the rig's: no model but the hybrid reaches it.
        let options = ScanOptions { manner: 0.5, triangles: 20_000, ..ScanOptions::default() };
        let case = simulate_scan(&rig, &options, seed).unwrap();
        let (name, subject) =
            if seed == 7 { ("same", Subject::same(&rig, &case)) } else { ("new", Subject::new(&rig)) };
        write_case(&folder.join("cases").join(name), &rig, &case, &subject, seed).unwrap();
    }
    BenchCase::read_all(&folder.join("cases"), &BenchRig::read(&folder.join("rig")).unwrap()).unwrap()
}

#[test]
fn every_model_gets_a_row_for_every_case() {
    let folder = tempfile::tempdir().unwrap();
    let cases = cases(folder.path());
    assert_eq!(cases.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["new", "same"]);
    for case in &cases {
        assert_eq!(case.neutral.is_some(), case.name == "same");
        let path = folder.path().join("cases").join(&case.name).join("case.json");
        let file: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        let expressions = file["rig_expressions"].as_array().unwrap().len();
        assert_eq!(case.shapes.len(), expressions + file["rig_identity_modes"].as_u64().unwrap() as usize);
    }
    let models: Vec<&dyn ModelFactory> = ModelKind::ALL.iter().map(|m| m as &dyn ModelFactory).collect();
    let rows = scan_bench(&models, &TERMS, &cases, LandmarkUse::All).unwrap();
    let expected = cases.iter().flat_map(|case| ModelKind::ALL.map(|model| (case, model)));
    assert_eq!(rows.len(), cases.len() * ModelKind::ALL.len());
    for (row, (case, model)) in rows.iter().zip(expected) {
        assert_eq!((&row.case, &row.model), (&case.name, &model.to_string()));
        let score = row.score.as_ref().unwrap();
        assert!(score.errors.finite && score.errors.rmse > 0.0 && score.errors.rmse < 8.0, "{row:?}");
        // Poses neither stretch nor fold; no generated face intersects itself at rest.
        assert_eq!(score.mesh.self_intersections_at_rest, 0, "{row:?}");
        if model == ModelKind::Rigid {
            let stretch = &score.mesh.stretch;
            assert!((stretch.min - 1.0).abs() + (stretch.max - 1.0).abs() < 1e-9, "{row:?}");
            assert_eq!(score.mesh.self_intersections, 0, "{row:?}");
        }
        if matches!(model, ModelKind::Rigid | ModelKind::Blendshape) {
            // A row says what a registration of the same input gives.
            let input = RegistrationInput {
                neutral: case.neutral.as_deref(),
                shapes: &case.shapes,
                landmarks: &case.landmarks,
                ..RegistrationInput::new(&case.template, &case.scan.mesh)
            };
            let schedule = model.schedule().unwrap();
            let again = register(&input, &model, &schedule, &mut Silent).unwrap();
            let triangles = case.template.triangulate().triangles;
            let errors = TruthErrors::new(&again.positions, &case.truth, &case.observed, &triangles).unwrap().0;
            assert_eq!((&score.errors, score.iterations), (&errors, Some(again.history.len())));
            let rest = case.neutral.as_ref().unwrap_or(&case.template.positions);
            let rest = case.template.with_positions(rest.clone());
            assert_eq!(score.mesh, MeshQuality::new(&rest, &again.positions).unwrap());
        }
    }
    let summary = summarize(&rows);
    assert_eq!(summary.len(), ModelKind::ALL.len());
    let hybrid = &summary[0];
    assert_eq!(hybrid.model, "hybrid");
    for other in &summary[1..] {
        // The paper's energy alone is the hybrid's without what we added: better on single cases, worse on the whole.
        let bound = if other.model == "klimov2020" { 1.1 * other.mean_rmse } else { other.mean_rmse };
        assert!(hybrid.mean_rmse < bound, "hybrid {} {} {}", hybrid.mean_rmse, other.model, other.mean_rmse);
    }
    for s in &summary {
        let of = || rows.iter().filter(|r| r.model == s.model).filter_map(|r| r.score.as_ref());
        let rmse: Vec<f64> = of().map(|score| score.errors.rmse).collect();
        assert_eq!(of().map(|score| score.mesh.self_intersections).max(), Some(s.worst_self_intersections));
        assert!((s.mean_rmse - (rmse[0] + rmse[1]) / 2.0).abs() < 1e-12 && s.worst_rmse == rmse[0].max(rmse[1]));
    }
}

/// A user's model: the template shifts and does nothing else.
struct Shift {
    rest: Vec<Vec3>,
}

impl DeformationModel for Shift {
    fn name(&self) -> &'static str {
        "shift"
    }

    fn vertex_count(&self) -> usize {
        self.rest.len()
    }

    fn parameter_len(&self) -> usize {
        3
    }

    fn rest_parameters(&self) -> Vec<f64> {
        vec![0.0; 3]
    }

    fn analyse(&mut self, _: &Samples) -> BlockStructure {
        BlockStructure::dense(3)
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend(self.rest.iter().map(|p| p + Vec3::new(x[0], x[1], x[2])));
    }

    fn pull_back(&mut self, _: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        for quadric in field.quadrics() {
            for (a, row) in quadric.matrix().iter().enumerate() {
                equations.gradient[a] += quadric.gradient()[a];
                for (b, m) in row.iter().enumerate() {
                    equations.border[3 * a + b] += m;
                }
            }
        }
    }

    fn regulariser_energy(&mut self, _: &[f64], _: &mut Vec<NamedEnergy>) {}

    fn regularise(&mut self, _: &[f64], _: &mut NormalEquations) {}

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        out.iter_mut().zip(x.iter().zip(step)).for_each(|(o, (x, s))| *o = x + s);
    }
}

impl RegistrationModel for Shift {
    fn set_level(&mut self, _: &Options, _: f64) -> Result<(), OptionsError> {
        Ok(())
    }
}

struct Shifts;

impl ModelFactory for Shifts {
    fn name(&self) -> &str {
        "shift"
    }

    fn default_schedule(&self) -> &str {
        ModelKind::Rigid.default_schedule()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        Ok(Box::new(Shift { rest: input.rest.positions.clone() }))
    }
}

/// A user's term: the crate's landmarks, pulled to a point off their target.
struct Pull {
    offset: Vec3,
}

impl TermFactory for Pull {
    fn name(&self) -> &str {
        "pull"
    }

    fn build(&self, input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError> {
        let (samples, targets): (Vec<usize>, Vec<Vec3>) =
            input.landmarks.iter().map(|l| (l.sample, l.target + self.offset)).unzip();
        let weights = vec![1.0; samples.len()];
        let residuals = Landmarks { samples, targets, weights, scale: 0.0 };
        Ok(Box::new(Pointwise::new("pull", residuals, Kernel::None)))
    }
}

#[test]
fn a_users_model_and_term_land_in_the_same_table() {
    let folder = tempfile::tempdir().unwrap();
    let cases = cases(folder.path());
    let models: [&dyn ModelFactory; 2] = [&Shifts, &ModelKind::Rigid];
    let rows = scan_bench(&models, &TERMS, &cases, LandmarkUse::All).unwrap();
    assert_eq!(rows.iter().map(|r| r.model.as_str()).collect::<Vec<_>>(), ["shift", "rigid", "shift", "rigid"]);
    assert_eq!(summarize(&rows).iter().map(|s| s.model.as_str()).collect::<Vec<_>>(), ["shift", "rigid"]);

    // With the user's term alone the shift is known: the landmarks' best pose has centred them, what is left is the offset.
    let offset = Vec3::new(1.0, -2.0, 0.5);
    let mut pulled = Schedule::from_toml(Shifts.default_schedule()).unwrap();
    for level in &mut pulled.levels {
        level.terms.clear();
        level.set_term("pull", 1.0);
    }
    for case in &cases {
        let (_, result, _) = run_case(&Shifts, &[&Pull { offset }], &pulled, case, LandmarkUse::All).unwrap();
        let rest = case.neutral.as_deref().unwrap_or(&case.template.positions);
        let pairs: Vec<_> = case.landmarks.iter().map(|l| (l.template.position(rest), l.target)).collect();
        let start = closest_pose(&pairs, PoseKind::Rigid).unwrap();
        let farthest = rest
            .iter()
            .zip(&result.positions)
            .map(|(p, found)| (start.apply(p + offset) - found).norm())
            .fold(0.0, f64::max);
        assert!(farthest < 1e-6, "{}: {farthest}", case.name);
        assert!(result.history[0].energies.iter().any(|e| e.0 == "pull"), "{:?}", result.history[0].energies);
    }
}

#[test]
fn landmarks_for_alignment_only_leave_the_energy() {
    let folder = tempfile::tempdir().unwrap();
    let cases = cases(folder.path());
    for (landmarks, expected) in [(LandmarkUse::All, true), (LandmarkUse::Align, false), (LandmarkUse::Some(9), true)] {
        let schedule = ModelKind::Hybrid.schedule().unwrap();
        let (_, result, _) = run_case(&ModelKind::Hybrid, &TERMS, &schedule, &cases[1], landmarks).unwrap();
        let energy: f64 =
            result.history.iter().flat_map(|h| &h.energies).filter(|e| e.0 == "landmarks").map(|e| e.1).sum();
        assert_eq!(energy > 0.0, expected, "{landmarks:?}: {energy}");
    }
}

#[test]
fn a_real_case_is_as_accurate_as_promised() {
    let (Some(rig), Some(case)) = (real_data("ict-facekit/narrow"), real_data("scanner-bench/same_smile")) else {
        return;
    };
    let case = BenchCase::read(&case, &BenchRig::read(&rig).unwrap()).unwrap();
    let schedule = ModelKind::Hybrid.schedule().unwrap();
    let (score, ..) = run_case(&ModelKind::Hybrid, &TERMS, &schedule, &case, LandmarkUse::All).unwrap();
    println!("{} hybrid: {:.3} mm", case.name, score.errors.rmse);
    assert!(score.errors.rmse <= 0.82, "{} mm", score.errors.rmse);
}
