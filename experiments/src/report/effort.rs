//! How much is run: the same studies, larger or smaller.

use nonrigid::registration::ModelKind;
use serde::Serialize;

use crate::generated::STANDARD_CASES;

/// The sizes of all studies. What a study varies is its own; here is how finely, on what and how often.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Effort {
    /// Its name.
    pub name: &'static str,
    /// Vertices of the template, about.
    pub vertices: usize,
    /// Triangles of a scan, about.
    pub triangles: usize,
    /// Which of the six standard cases are registered.
    pub cases: Vec<&'static str>,
    /// Models that are compared.
    pub models: Vec<ModelKind>,
    /// Whether robust kernels and data terms are compared too.
    pub kernels_and_terms: bool,
    /// Fig. 4: numbers of PCA components.
    pub components: Vec<usize>,
    /// Fig. 4: of these, the numbers at which the paper's differentiation is timed.
    pub components_of_paper: Vec<usize>,
    /// Fig. 4: random faces whose principal components they are.
    pub population: usize,
    /// Fig. 4: scans of random people.
    pub scans: usize,
    /// Studies of time: how often each run is repeated; the least processor time counts.
    pub repetitions: usize,
    /// Ablations: how many of these cases, from the first.
    pub ablation_cases: usize,
    /// Sweeps: values of each quantity, from the easiest to the hardest.
    pub sweep_values: usize,
    /// Sweeps: scans of each value.
    pub sweep_scans: usize,
    /// Sweeps: models.
    pub sweep_models: Vec<ModelKind>,
    /// Sweeps: vertices of the template, about.
    pub sweep_vertices: usize,
    /// Sweeps: triangles of a scan, about.
    pub sweep_triangles: usize,
    /// Resolution: vertices of the template, about.
    pub resolutions: Vec<usize>,
    /// Resolution: how many of the standard cases, from the first.
    pub resolution_cases: usize,
    /// Silence: registrations.
    pub silence_runs: usize,
    /// Solver: vertices of the template, about.
    pub solver_sizes: Vec<usize>,
    /// Solver: blendshapes.
    pub solver_shapes: Vec<usize>,
    /// Solver: nodes.
    pub solver_nodes: Vec<usize>,
    /// Solver: how often each run is repeated.
    pub solver_repeats: usize,
}

/// Models that take seconds where others take tenths: in sweeps with `--full` alone.
const SLOW: [ModelKind; 4] = [ModelKind::Affine, ModelKind::MassSpring, ModelKind::Fem, ModelKind::Ffd];

impl Effort {
    /// About two and a half minutes on two cores.
    #[must_use]
    pub fn quick() -> Self {
        Self {
            name: "quick",
            vertices: 2500,
            triangles: 30_000,
            cases: vec!["same_open", "new_open"],
            kernels_and_terms: false,
            models: models_without(&SLOW),
            components: vec![5, 50, 100, 150],
            components_of_paper: vec![5, 50, 100, 150],
            scans: 2,
            population: 200,
            repetitions: 1,
            ablation_cases: 1,
            sweep_values: 3,
            sweep_scans: 1,
            sweep_models: models_without(
                &[
                    &SLOW[..],
                    &[
                        ModelKind::Sumner,
                        ModelKind::Similarity,
                        ModelKind::Klimov2020,
                        ModelKind::Flame,
                        ModelKind::Poisson,
                        ModelKind::Laplacian,
                        ModelKind::Gpmm,
                        ModelKind::GpmmRig,
                    ],
                ]
                .concat(),
            ),
            sweep_vertices: 1000,
            sweep_triangles: 10_000,
            resolutions: vec![1250, 5000],
            resolution_cases: 1,
            silence_runs: 14,
            solver_sizes: vec![5000, 20_000],
            solver_shapes: vec![10, 100],
            solver_nodes: vec![100, 400],
            solver_repeats: 1,
        }
    }

    /// About a quarter of an hour on two cores.
    #[must_use]
    pub fn usual() -> Self {
        Self {
            name: "usual",
            vertices: 5000,
            triangles: 60_000,
            cases: vec!["same_open", "same_blink", "new_open", "new_asym"],
            models: ModelKind::ALL.to_vec(),
            kernels_and_terms: true,
            components: vec![5, 25, 50, 75, 100, 150],
            components_of_paper: vec![5, 25, 50, 100, 150],
            population: 250,
            scans: 3,
            repetitions: 2,
            ablation_cases: 3,
            sweep_values: 4,
            sweep_scans: 3,
            sweep_models: models_without(&[&SLOW[..], &[ModelKind::Flame]].concat()),
            sweep_vertices: 1500,
            sweep_triangles: 15_000,
            resolutions: vec![1250, 2500, 5000, 10_000],
            resolution_cases: 3,
            silence_runs: 60,
            solver_sizes: vec![5000, 10_000, 20_000, 50_000],
            solver_shapes: vec![5, 25, 50, 100, 150],
            solver_nodes: vec![100, 200, 400, 800, 1600],
            solver_repeats: 3,
        }
    }

    /// As long as it takes.
    #[must_use]
    pub fn full() -> Self {
        Self {
            name: "full",
            cases: STANDARD_CASES.map(|c| c.name).to_vec(),
            components: (1..=30).map(|k| 5 * k).collect(),
            components_of_paper: (1..=15).map(|k| 10 * k).collect(),
            population: 400,
            scans: 6,
            repetitions: 5,
            ablation_cases: 6,
            sweep_values: 9,
            sweep_scans: 4,
            sweep_models: ModelKind::ALL.to_vec(),
            sweep_vertices: 5000,
            sweep_triangles: 60_000,
            resolutions: vec![1250, 2500, 5000, 10_000, 20_000, 40_000],
            resolution_cases: 4,
            silence_runs: 560,
            solver_sizes: vec![5000, 20_000, 100_000, 500_000],
            solver_shapes: vec![5, 10, 25, 50, 75, 100, 125, 150],
            solver_nodes: vec![100, 200, 400, 800, 1600, 3200],
            solver_repeats: 5,
            ..Self::usual()
        }
    }
}

fn models_without(left_out: &[ModelKind]) -> Vec<ModelKind> {
    ModelKind::ALL.into_iter().filter(|m| !left_out.contains(m)).collect()
}
