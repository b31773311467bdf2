//! How far each vertex follows a mask: `W` of equation (5).

use std::path::Path;

use rayon::prelude::*;

use super::MorphError;
use crate::io::{Place, ReadError, WriteError, read_npy_vector, write_npy};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::{MirrorPlane, TriangleMesh, check_finite};

/// A weight from 0 to 1 for each vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights(Vec<f64>);

impl Weights {
    /// Weights of as many vertices as there are values.
    ///
    /// # Errors
    /// When a value is not from 0 to 1.
    pub fn new(values: Vec<f64>) -> Result<Self, MorphError> {
        match values.iter().position(|w| !(0.0..=1.0).contains(w)) {
            Some(vertex) => Err(MorphError::WeightValue { vertex, value: values[vertex] }),
            None => Ok(Self(values)),
        }
    }

    /// Values that are known to be from 0 to 1.
    pub(super) fn trusted(values: Vec<f64>) -> Self {
        debug_assert!(values.iter().all(|w| (0.0..=1.0).contains(w)));
        Self(values)
    }

    /// One weight per vertex.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// As [`Self::values`], to keep.
    #[must_use]
    pub fn into_values(self) -> Vec<f64> {
        self.0
    }

    /// The weights times one less what is `protected`, a number from 0 to 1 for each vertex.
    pub(super) fn without(&self, protected: &[f64]) -> Self {
        Self(self.0.iter().zip(protected).map(|(w, p)| w * (1.0 - p)).collect())
    }

    /// The largest weight of the vertices that are one point of the surface: of each the `first` such vertex is given, as by
    /// [`sewn`](crate::mesh::sewn).
    pub(super) fn together(mut self, first: &[u32]) -> Self {
        for (v, &f) in first.iter().enumerate() {
            self.0[f as usize] = self.0[f as usize].max(self.0[v]);
        }
        (0..first.len()).for_each(|v| self.0[v] = self.0[first[v] as usize]);
        self
    }

    /// The larger of two weights at each vertex.
    pub(super) fn or(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(a, b)| a.max(*b)).collect())
    }

    /// What is left of each of two where both pull alike: together as much as the larger of them.
    pub(super) fn shared([a, b]: [&Self; 2]) -> [Self; 2] {
        let share = |(a, b): (&f64, &f64)| if *a > 0.0 { a * a.max(*b) / (a + b) } else { 0.0 };
        [[a, b], [b, a]].map(|[own, other]| Self(own.0.iter().zip(&other.0).map(share).collect()))
    }

    /// Reads a one-dimensional NPY array of a weight for each of `vertices` vertices.
    ///
    /// # Errors
    /// When the file cannot be read, has another shape, or a value is not from 0 to 1.
    pub fn read_npy(path: &Path, vertices: usize) -> Result<Self, ReadError> {
        Self::new(read_npy_vector(path, Some(vertices))?)
            .map_err(|error| ReadError::malformed(path, Place::File, "weights from 0 to 1", error.to_string()))
    }

    /// Writes the weights as a one-dimensional NPY array of 64 bits a value.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_npy(&self, path: &Path) -> Result<(), WriteError> {
        write_npy(path, &[self.0.len()], &self.0)
    }

    /// The mirror image of weights that were painted on the mesh: each vertex takes the weight, linear on triangles, of the point of
    /// the surface that is closest to the vertex's mirror image. Exact where the mesh is its own mirror image.
    ///
    /// A mask that was projected is better mirrored before, with [`Projector::mirrored`](super::Projector::mirrored).
    ///
    /// # Errors
    /// When there is not one weight per vertex, the mesh has no triangles, or it is malformed.
    pub fn mirrored(&self, mesh: &TriangleMesh, plane: &MirrorPlane) -> Result<Self, MorphError> {
        if self.0.len() != mesh.positions.len() {
            return Err(MorphError::WeightCount { found: self.0.len(), vertices: mesh.positions.len() });
        }
        check_finite(&mesh.positions)?;
        let surface = ClosestPoint::new(mesh)?;
        let weight = |position| {
            let closest = surface.query(&plane.reflect(position)).ok_or(MorphError::NoSurface)?;
            let corners = mesh.triangles[closest.triangle as usize];
            let sum: f64 = corners.iter().zip(closest.barycentric).map(|(&v, b)| b * self.0[v as usize]).sum();
            Ok(sum.clamp(0.0, 1.0))
        };
        mesh.positions.par_iter().map(|p| weight(*p)).collect::<Result<_, _>>().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_that_share_pull_as_much_as_the_larger_of_them() {
        let [a, b] = [[0.0, 1.0, 1.0, 0.0, 0.5, 0.25], [0.0, 1.0, 0.0, 0.5, 0.5, 0.75]].map(|w| Weights(w.to_vec()));
        let [left_a, left_b] = Weights::shared([&a, &b]);
        let sums: Vec<f64> = left_a.values().iter().zip(left_b.values()).map(|(a, b)| a + b).collect();
        assert_eq!(sums, a.or(&b).values());
        assert_eq!((&left_a.values()[..3], left_b.values()[3]), (&[0.0, 0.5, 1.0][..], 0.5));
        assert_eq!(left_b.values()[5], 3.0 * left_a.values()[5]);
    }
}
