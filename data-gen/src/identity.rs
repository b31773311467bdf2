//! Identity modes: the principal components of how faces differ.

use nonrigid::mesh::Vec3;

use crate::face::Site;

/// Modes of falling variance, each scaled by its standard deviation.
pub(crate) struct IdentityModes {
    count: usize,
}

/// A sum of modes.
pub(crate) struct Person {
    weights: Vec<f64>,
}

impl IdentityModes {
    pub fn new(count: usize) -> Self {
        Self { count }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    /// The person of these weights; missing ones are 0, superfluous ones are ignored.
    pub fn mix(&self, weights: &[f64]) -> Person {
        Person { weights: weights.iter().copied().take(self.count).collect() }
    }

    /// Each mode's displacement at weight 1, vertex by vertex.
    pub fn deltas(&self, sites: &[Site]) -> Vec<Vec<Vec3>> {
        (0..self.count)
            .map(|k| {
                let mut weights = vec![0.0; self.count];
                weights[k] = 1.0;
                let person = self.mix(&weights);
                sites.iter().map(|s| person.displacement(s)).collect()
            })
            .collect()
    }
}

impl Person {
    /// Millimetres.
    pub fn displacement(&self, site: &Site) -> Vec3 {
        self.weights
            .iter()
            .enumerate()
            .map(|(k, w)| Vec3::new(site.neutral.x, 0.0, 0.0) * (0.04 * w / (k + 1) as f64))
            .sum()
    }
}
