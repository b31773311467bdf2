//! What is compared: a model with a schedule. Each group varies one thing and holds all else.

use nonrigid::nlls::Kernel;
use nonrigid::registration::{Level, ModelKind, Schedule, ScheduleError};
use serde::{Deserialize, Serialize};

use super::{LandmarkUse, each_level};

/// A model with its schedule: one line of the summary, one row for each case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Variant {
    /// What is varied: `model`, `kernel`, `term`, or your own word.
    pub group: String,
    /// Its name in the group.
    pub name: String,
    /// The model.
    pub model: ModelKind,
    /// The schedule.
    pub schedule: Schedule,
    /// How landmarks take part.
    pub landmarks: LandmarkUse,
}

impl Variant {
    /// A model with its default schedule and all landmarks, in the group `model`.
    ///
    /// # Errors
    /// When the default schedule cannot be read.
    pub fn of_model(model: ModelKind) -> Result<Self, ScheduleError> {
        let (name, schedule) = (model.to_string(), model.schedule()?);
        Ok(Self { group: "model".to_owned(), name, model, schedule, landmarks: LandmarkUse::All })
    }

    /// Models with their default schedules.
    ///
    /// # Errors
    /// As [`of_model`](Self::of_model).
    pub fn models(models: &[ModelKind]) -> Result<Vec<Self>, ScheduleError> {
        models.iter().copied().map(Self::of_model).collect()
    }

    /// The hybrid with each robust [`Kernel`] in place of its schedule's at every level, at that one's scale; `huber` is the default.
    ///
    /// # Errors
    /// As [`of_model`](Self::of_model).
    pub fn kernels() -> Result<Vec<Self>, ScheduleError> {
        let (delta, eps) = (1.0, 1.0);
        let kernels = [
            ("none", Kernel::None),
            ("l1", Kernel::L1 { eps }),
            ("lp 0.5", Kernel::Lp { p: 0.5, eps }),
            ("huber", Kernel::Huber { delta }),
            ("cauchy", Kernel::Cauchy { delta }),
            ("geman_mcclure", Kernel::GemanMcClure { delta }),
            ("welsch", Kernel::Welsch { delta }),
            ("tukey", Kernel::Tukey { delta }),
        ];
        let with = |(name, kernel): (&str, Kernel)| {
            Self::hybrid("kernel", name, |s| {
                each_level(s, |l| l.kernel = l.kernel.scale().map_or(l.kernel, |scale| kernel.with_scale(scale)));
            })
        };
        kernels.into_iter().map(with).collect()
    }

    /// The hybrid with other data terms, weights as in its schedule:
    ///
    /// | name | what |
    /// |---|---|
    /// | `default` | its schedule: point-to-plane, at the last level symmetric, and scan points towards the template |
    /// | `point_to_plane`, `symmetric`, `point_to_point` | this one instead of point-to-plane and symmetric, at their weight |
    /// | `without scan_to_template`, `without seam` | the default with that weight zero |
    /// | `without landmarks` | the same; the start still takes landmarks |
    /// | `without beyond` | the default with expressions free to lie outside 0 to 1 |
    /// | `without lambda_unseen` | the default with a graph as stiff where nothing is seen as where something is |
    /// | `with prediction` | the same, and unseen vertices held to where the blendshapes in one rigid pose predict them |
    ///
    /// # Errors
    /// As [`of_model`](Self::of_model).
    pub fn terms() -> Result<Vec<Self>, ScheduleError> {
        let changes: [(&str, Change); 10] = [
            ("default", |_| ()),
            ("point_to_plane", |s| each_level(s, |l| alone(l, "point_to_plane"))),
            ("symmetric", |s| each_level(s, |l| alone(l, "symmetric"))),
            ("point_to_point", |s| each_level(s, |l| alone(l, "point_to_point"))),
            ("without scan_to_template", |s| each_level(s, |l| l.set_term("scan_to_template", 0.0))),
            ("without beyond", |s| s.sigma.beyond = None),
            ("without landmarks", |s| each_level(s, |l| l.set_term("landmarks", 0.0))),
            ("without lambda_unseen", |s| s.model.set("lambda_unseen", 0.0)),
            ("with prediction", |s| {
                s.model.set("lambda_unseen", 0.0);
                each_level(s, |l| l.set_term("prediction", 0.01));
            }),
            ("without seam", |s| each_level(s, |l| l.set_term("seam", 0.0))),
        ];
        changes.into_iter().map(|(name, change)| Self::hybrid("term", name, change)).collect()
    }

    /// Name of its results' files: the model's, or what differs.
    pub(super) fn file_stem(&self) -> String {
        if self.group == "model" {
            self.name.clone()
        } else {
            format!("{} {}", self.group, self.name).replace(' ', "-")
        }
    }

    /// The hybrid with another schedule.
    ///
    /// # Errors
    /// As [`of_model`](Self::of_model).
    pub fn hybrid(group: &str, name: &str, change: impl FnOnce(&mut Schedule)) -> Result<Self, ScheduleError> {
        let mut variant = Self { group: group.to_owned(), name: name.to_owned(), ..Self::of_model(ModelKind::Hybrid)? };
        change(&mut variant.schedule);
        Ok(variant)
    }
}

/// The terms that pull vertices to their closest points.
const PULLS: [&str; 3] = ["point_to_plane", "symmetric", "point_to_point"];

/// Their weights at a level; point-to-plane's is 1 unless stated.
fn pulls(level: &Level) -> [f64; 3] {
    let unless_stated = [1.0, 0.0, 0.0];
    std::array::from_fn(|i| level.term(PULLS[i]).unwrap_or(unless_stated[i]))
}

/// Leaves one of them, at the weight of all.
fn alone(level: &mut Level, term: &str) {
    let weight = pulls(level).iter().sum();
    for other in PULLS {
        level.set_term(other, if other == term { weight } else { 0.0 });
    }
}

/// What makes another schedule of the default.
type Change = fn(&mut Schedule);

#[cfg(test)]
mod tests {
    use nonrigid::registration::TERMS;

    use super::*;

    #[test]
    fn a_kernel_is_in_place_at_every_level_at_its_scale() {
        let default = ModelKind::Hybrid.schedule().unwrap();
        let kernels = Variant::kernels().unwrap();
        assert_eq!(kernels.len(), 8);
        for v in &kernels {
            let mut kernels = Vec::new();
            each_level(&mut default.clone(), |l| kernels.push(l.kernel));
            let (mut back, mut kernels) = (v.schedule.clone(), kernels.into_iter());
            each_level(&mut back, |l| l.kernel = kernels.next().unwrap());
            assert_eq!(back, default, "{}: something else than the kernel differs", v.name);
            for (level, of) in v.schedule.levels.iter().zip(&default.levels) {
                let word = serde_json::to_value(level.kernel).unwrap();
                let word = word.as_str().or_else(|| word.as_object()?.keys().next().map(String::as_str)).unwrap();
                assert_eq!(word, v.name.split(' ').next().unwrap());
                assert_eq!(level.kernel.scale(), if v.name == "none" { None } else { of.kernel.scale() });
            }
            v.schedule.validate().unwrap();
        }
        assert_eq!(kernels.iter().find(|v| v.name == "huber").unwrap().schedule, default);
    }

    #[test]
    fn terms_change_what_they_name() {
        let default = ModelKind::Hybrid.schedule().unwrap();
        let terms = Variant::terms().unwrap();
        let levels = |name: &str| &terms.iter().find(|v| v.name == name).unwrap().schedule.levels;
        for (i, d) in default.levels.iter().enumerate() {
            let data = |name: &str| pulls(&levels(name)[i]);
            assert!(d.term("landmarks") > Some(0.0) && d.term("seam") > Some(0.0), "{d:?}");
            assert_eq!(data("default"), if i + 1 < default.levels.len() { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] });
            assert_eq!(data("point_to_plane"), [1.0, 0.0, 0.0]);
            assert_eq!(data("symmetric"), [0.0, 1.0, 0.0]);
            assert_eq!(data("point_to_point"), [0.0, 0.0, 1.0]);
            assert!(d.term("scan_to_template") > Some(0.0));
            assert_eq!(levels("without scan_to_template")[i], d.clone().with_term("scan_to_template", 0.0));
            assert_eq!(levels("without landmarks")[i], d.clone().with_term("landmarks", 0.0));
            assert_eq!(levels("without lambda_unseen")[i], *d);
            assert_eq!(levels("with prediction")[i], d.clone().with_term("prediction", 0.01));
            assert_eq!(levels("without seam")[i], d.clone().with_term("seam", 0.0));
        }
        for v in &terms {
            let stiffer = v.name != "without lambda_unseen" && v.name != "with prediction";
            assert_eq!(v.schedule.model.number("lambda_unseen") > Some(0.0), stiffer, "{}", v.name);
            assert_eq!(v.schedule.sigma.beyond.is_some(), v.name != "without beyond", "{}", v.name);
            v.schedule.resolved(&v.model, &TERMS).unwrap();
        }
    }
}
