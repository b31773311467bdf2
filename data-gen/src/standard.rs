//! The six standard cases, as extreme as those that registration programs are compared on.

use crate::{FaceRig, PRESETS, ScanError, Subject, resolve_shapes};

/// A case that is made the same everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StandardCase {
    /// Its folder's name.
    pub name: &'static str,
    /// Which of the [`PRESETS`] it shows.
    pub preset: &'static str,
    /// Expressions that no fit may use; `None`: the person is unknown.
    pub withheld: Option<[&'static str; 3]>,
}

/// All of them. The k-th is simulated from the seed plus k.
pub const STANDARD_CASES: [StandardCase; 6] = [
    known("same_open", "open", ["mouthStretch", "eyeWide", "jawForward"]),
    known("same_smile", "smile", ["cheekSquint", "mouthDimple", "mouthStretch"]),
    known("same_blink", "blink", ["browDown", "mouthFunnel", "noseSneer"]),
    StandardCase { name: "new_neutral", preset: "neutral", withheld: None },
    StandardCase { name: "new_open", preset: "shout", withheld: None },
    StandardCase { name: "new_asym", preset: "asym", withheld: None },
];

const fn known(name: &'static str, preset: &'static str, withheld: [&'static str; 3]) -> StandardCase {
    StandardCase { name, preset, withheld: Some(withheld) }
}

impl StandardCase {
    /// Names and weights of the expression.
    #[must_use]
    pub fn expressions(&self) -> Vec<(String, f64)> {
        preset_weights(self.preset)
    }

    /// What a fit knows of the person.
    ///
    /// # Errors
    /// When the rig does not have what is withheld.
    pub fn subject(&self, rig: &FaceRig) -> Result<Subject, ScanError> {
        let Some(withheld) = self.withheld else { return Ok(Subject::new(rig)) };
        let names: Vec<&str> = rig.expressions.iter().map(|e| &*e.0).collect();
        let full: Result<Vec<Vec<&str>>, ScanError> =
            withheld.iter().map(|name| resolve_shapes(&names, name)).collect();
        Ok(Subject::Same { withheld: full?.concat().into_iter().map(str::to_owned).collect() })
    }
}

/// Names and weights of one of the [`PRESETS`]; of an unknown name none.
#[must_use]
pub fn preset_weights(preset: &str) -> Vec<(String, f64)> {
    let found = PRESETS.iter().find(|p| p.0 == preset);
    found.map_or(&[][..], |p| p.1).iter().map(|(name, weight)| ((*name).to_owned(), *weight)).collect()
}
