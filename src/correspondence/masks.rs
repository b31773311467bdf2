//! How much each vertex of the template takes part in a registration: what its masks and its rim leave of it.

/// Weights per template vertex, from a mask, a mask of what is free, and the template's rim.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexMasks {
    /// Weight of what the scan says of a vertex: the mask times what is not free.
    pub data: Vec<f64>,
    /// Weight of what binds a vertex at all, the scan or the prediction: what is not free.
    pub bound: Vec<f64>,
    /// Vertices of the rim where it is rejected; they take no correspondence whatever the masks say.
    pub rim: Vec<bool>,
}

impl VertexMasks {
    /// Every one of `count` vertices takes part fully.
    #[must_use]
    pub fn all(count: usize) -> Self {
        Self::new(None, None, vec![false; count])
    }

    /// Masks of 0 to 1 per vertex; one that is missing changes nothing.
    ///
    /// # Panics
    /// When the lengths differ.
    #[must_use]
    pub fn new(mask: Option<&[f64]>, free_mask: Option<&[f64]>, rim: Vec<bool>) -> Self {
        let bound: Vec<f64> = free_mask.map_or_else(|| vec![1.0; rim.len()], |f| f.iter().map(|f| 1.0 - f).collect());
        assert_eq!(bound.len(), rim.len(), "one value of the free mask per vertex");
        let data = match mask {
            None => bound.clone(),
            Some(mask) => {
                assert_eq!(mask.len(), rim.len(), "one value of the mask per vertex");
                mask.iter().zip(&bound).map(|(m, b)| m * b).collect()
            }
        };
        Self { data, bound, rim }
    }

    /// The same, but the scan has no say in vertices that no polygon uses.
    #[must_use]
    pub fn of_surface(mut self, referenced: &[bool]) -> Self {
        self.data.iter_mut().zip(referenced).filter(|(_, r)| !**r).for_each(|(data, _)| *data = 0.0);
        self
    }

    /// Vertices that the scan has no say in.
    #[must_use]
    pub fn unseen(&self) -> Vec<bool> {
        self.rim.iter().zip(&self.data).map(|(rim, data)| *rim || *data == 0.0).collect()
    }

    /// Number of vertices that the scan may have a say in, on the rim or not: what shares of vertices are taken of.
    #[must_use]
    pub fn counted(&self) -> usize {
        self.data.iter().filter(|d| **d > 0.0).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_multiply_and_the_rim_stays_apart() {
        let rim = vec![false, true, false];
        let masks = VertexMasks::new(Some(&[1.0, 0.5, 0.0]), Some(&[0.25, 0.0, 0.0]), rim.clone());
        assert_eq!(masks, VertexMasks { data: vec![0.75, 0.5, 0.0], bound: vec![0.75, 1.0, 1.0], rim: rim.clone() });
        assert_eq!(masks.counted(), 2);
        assert_eq!(VertexMasks::new(None, Some(&[1.0, 0.0, 0.5]), rim).counted(), 2);
        assert_eq!(VertexMasks::all(4).counted(), 4);
    }
}
