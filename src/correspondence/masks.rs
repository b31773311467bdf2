//! How much each vertex of the template takes part in a registration: what its masks and its rim leave of it, and which vertices
//! speak for their neighbours.

use crate::mesh::adjacency::EdgeGraph;

/// Weights per template vertex, from a mask, a mask of what is free, and the template's rim.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexMasks {
    /// Weight of what the scan says of a vertex: the mask times what is not free.
    pub data: Vec<f64>,
    /// Weight of what binds a vertex at all, the scan or the prediction: what is not free.
    pub bound: Vec<f64>,
    /// What share of its say the scan's samples leave each vertex; empty where all have their full say.
    samples: Vec<f64>,
    /// Vertices of the rim where it is rejected; they take no correspondence whatever the masks say.
    pub rim: Vec<bool>,
    /// The vertex that takes a correspondence in each one's place; empty where all take their own.
    speakers: Vec<u32>,
    /// Sum over the vertices that each speaks for.
    spoken_for: Vec<f64>,
}

/// Least share of a sample: a vertex of triangles without area is a vertex.
const LEAST_SHARE: f64 = 1e-4;

/// Least number of vertices that speak for others: shapes and coarse nodes have nearly as many parameters.
const LEAST_SPEAKERS: usize = 1000;

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
        Self { data, bound, samples: Vec::new(), rim, speakers: Vec::new(), spoken_for: Vec::new() }
    }

    /// The same, but the scan has no say in vertices that `left_out` names.
    #[must_use]
    pub fn without(mut self, left_out: impl Fn(usize) -> bool) -> Self {
        self.data.iter_mut().enumerate().filter(|(v, _)| left_out(*v)).for_each(|(_, data)| *data = 0.0);
        self
    }

    /// Has vertices that crowd about one sample of the scan share what it says: one whose `areas` is less than a sample's area counts
    /// the root of their ratio. Not the ratio, as neighbours do see different places of one triangle. The rest of its say is unseen.
    pub fn share_samples(&mut self, areas: &[f64], sample: f64) {
        self.samples.clear();
        if sample > 0.0 {
            self.samples.extend(areas.iter().map(|area| (area / sample).clamp(LEAST_SHARE, 1.0).sqrt()));
        }
    }

    /// Has few vertices take correspondences, no two of them neighbours, each for itself and for neighbours that take none: in the order of
    /// the vertices, every one that takes part at all and has no such neighbour before it. About a quarter of a surface; all of one where a
    /// quarter would be under a thousand.
    pub fn thin(&mut self, edges: &EdgeGraph) {
        self.let_all_speak();
        let takes_part = |i: usize| !self.rim[i] && self.data[i] > 0.0;
        let mut speakers: Vec<u32> = (0..self.data.len() as u32).collect();
        for i in (0..self.data.len()).filter(|&i| takes_part(i)) {
            let earlier = edges.neighbours(i).iter().copied().filter(|&j| (j as usize) < i && takes_part(j as usize));
            if let Some(speaker) = earlier.filter(|&j| speakers[j as usize] == j).min() {
                speakers[i] = speaker;
            }
        }
        let speaks = |i: &usize| takes_part(*i) && speakers[*i] as usize == *i;
        if (0..speakers.len()).filter(speaks).count() < LEAST_SPEAKERS {
            return;
        }
        self.spoken_for.resize(self.data.len(), 0.0);
        for (i, &speaker) in speakers.iter().enumerate() {
            self.spoken_for[speaker as usize] += self.own_weight(i);
        }
        self.speakers = speakers;
    }

    /// Has every vertex take its own correspondence again.
    pub fn let_all_speak(&mut self) {
        self.speakers.clear();
        self.spoken_for.clear();
    }

    /// The vertex that takes a correspondence in place of vertex `i`: itself, unless [thinned](Self::thin).
    #[must_use]
    pub fn speaker(&self, i: usize) -> usize {
        self.speakers.get(i).map_or(i, |&s| s as usize)
    }

    /// What the scan says of all vertices that `i` speaks for weighs so much; zero where another speaks for it.
    #[must_use]
    pub fn weight(&self, i: usize) -> f64 {
        self.spoken_for.get(i).copied().unwrap_or_else(|| self.own_weight(i))
    }

    /// What the scan says of vertex `i` alone weighs so much.
    #[must_use]
    pub fn own_weight(&self, i: usize) -> f64 {
        self.data[i] * self.samples.get(i).copied().unwrap_or(1.0)
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
        assert_eq!((&masks.data[..], &masks.bound[..]), (&[0.75, 0.5, 0.0][..], &[0.75, 1.0, 1.0][..]));
        assert_eq!(masks.counted(), 2);
        assert_eq!(VertexMasks::new(None, Some(&[1.0, 0.0, 0.5]), rim).counted(), 2);
        assert_eq!(VertexMasks::all(4).counted(), 4);
    }

    #[test]
    fn vertices_that_crowd_share_what_the_scan_says() {
        let mut masks = VertexMasks::new(Some(&[1.0, 1.0, 0.5, 1.0, 0.0]), None, vec![false; 5]);
        masks.share_samples(&[8.0, 2.0, 0.5, 0.0, 1.0], 2.0);
        assert_eq!([0, 1, 2, 3, 4].map(|i| masks.weight(i)), [1.0, 1.0, 0.25, 0.01, 0.0]);
        assert_eq!(masks.counted(), 4);
    }

    #[test]
    fn few_speak_for_all_and_weigh_as_much() {
        const COLUMNS: usize = 80;
        const COUNT: usize = COLUMNS * COLUMNS;
        use crate::mesh::Vec3;
        use crate::mesh::testing::sheet;
        let edges = EdgeGraph::of(&sheet(COLUMNS, COLUMNS, |c, r| Vec3::new(c, r, 0.0)));
        let data: Vec<f64> = (0..COUNT).map(|i| (i % 5) as f64 * 0.25).collect();
        let rim = (0..COUNT).map(|i| i < COLUMNS).collect();
        let mut masks = VertexMasks::new(Some(&data), None, rim);
        let all = masks.clone();
        masks.thin(&edges);
        let takes_part = |i: usize| i >= COLUMNS && data[i] > 0.0;
        for i in (0..COUNT).filter(|&i| takes_part(i)) {
            let speaker = masks.speaker(i);
            assert!(takes_part(speaker) && masks.speaker(speaker) == speaker);
            assert!(speaker == i || edges.neighbours(i).contains(&(speaker as u32)));
            assert!(
                speaker != i
                    || edges
                        .neighbours(i)
                        .iter()
                        .all(|&j| masks.speaker(j as usize) != j as usize || !takes_part(j as usize))
            );
        }
        let speaking = (0..COUNT).filter(|&i| takes_part(i) && masks.speaker(i) == i).count();
        assert!((COUNT / 6..COUNT / 3).contains(&speaking), "{speaking}");
        let sum = |masks: &VertexMasks| (0..COUNT).map(|i| masks.weight(i)).sum::<f64>();
        assert!((sum(&masks) - sum(&all)).abs() < 1e-9);
        masks.let_all_speak();
        assert_eq!(masks, all);
        // A quarter of so few is too little.
        let mut few = VertexMasks::all(40 * 30);
        few.thin(&EdgeGraph::of(&sheet(40, 30, |c, r| Vec3::new(c, r, 0.0))));
        assert_eq!(few, VertexMasks::all(40 * 30));
    }
}
