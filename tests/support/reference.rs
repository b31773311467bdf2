//! Derivatives of deformation models by other means than those of the models: dense, one tangent coordinate at a time.
#![allow(dead_code)] // every test binary uses its own part of this

use std::cell::RefCell;

use nalgebra::{DMatrix, DVector, Matrix3};
use nonrigid::energy::DeformationModel;
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::normals::vertex_areas;
use nonrigid::mesh::{InnerLayer, TriangleMesh, Vec3};
use nonrigid::model::{
    ArapOptions, ArapSolver, Autodiff, Hybrid, MassSpring, NodeTransform, Point, PositionFunction, TissueOptions,
};
use nonrigid::nlls::{Manifold, PointArray, Scalar, so3};
use num_dual::Dual64;

/// What a model's derivatives are at some parameters.
pub struct Reference {
    /// `dv/dx`, a row for each coordinate of each vertex.
    pub positions: DMatrix<f64>,
    /// Gauss-Newton Hessian and gradient of half the regulariser.
    pub hessian: DMatrix<f64>,
    pub gradient: DVector<f64>,
}

/// Vertex positions and regulariser of a model, stated for any number.
pub trait Formula {
    fn tangent(&self) -> usize;

    /// Positions at `x` moved by a tangent step, and `(weight, residual)` of the regulariser.
    fn evaluate<D: Scalar>(&self, x: &[f64], step: &[D]) -> (Vec<[D; 3]>, Vec<(f64, D)>);
}

/// By dual numbers, one coordinate at a time.
pub fn formula(formula: impl Formula) -> impl Fn(&[f64]) -> Reference {
    move |x| {
        let n = formula.tangent();
        let mut step = vec![Dual64::from_re(0.0); n];
        let (vertices, residuals) = formula.evaluate(x, &step);
        let mut positions = DMatrix::zeros(3 * vertices.len(), n);
        let mut jacobian = DMatrix::zeros(residuals.len(), n);
        for k in 0..n {
            step[k] = step[k].derivative();
            let (vertices, residuals) = formula.evaluate(x, &step);
            step[k] = Dual64::from_re(0.0);
            for (row, v) in vertices.as_flattened().iter().enumerate() {
                positions[(row, k)] = v.eps;
            }
            for (row, (_, r)) in residuals.iter().enumerate() {
                jacobian[(row, k)] = r.eps;
            }
        }
        let (hessian, gradient) = normal(&jacobian, residuals.iter().map(|(w, r)| (*w, r.re)));
        Reference { positions, hessian, gradient }
    }
}

/// `J' W J` and `J' W r`.
pub fn normal(jacobian: &DMatrix<f64>, residuals: impl Iterator<Item = (f64, f64)>) -> (DMatrix<f64>, DVector<f64>) {
    let (mut weighted, mut right) = (jacobian.clone(), DVector::zeros(jacobian.nrows()));
    for (row, (weight, r)) in residuals.enumerate() {
        weighted.row_mut(row).scale_mut(weight);
        right[row] = weight * r;
    }
    (jacobian.tr_mul(&weighted), jacobian.tr_mul(&right))
}

/// Eqs. (4) to (8) of Klimov 2020 and `E_rot` of Sumner et al. 2007.
impl<T: NodeTransform<W>, const W: usize> Formula for Hybrid<T, W> {
    fn tangent(&self) -> usize {
        self.graph().free_nodes() * W + self.shapes().len()
    }

    fn evaluate<D: Scalar>(&self, x: &[f64], step: &[D]) -> (Vec<[D; 3]>, Vec<(f64, D)>) {
        let (graph, shapes, ambient) = (self.graph(), self.shapes(), T::Parameters::AMBIENT);
        let (nodes, free) = (graph.nodes(), graph.free_nodes());
        let mut maps: Vec<_> = (0..free)
            .map(|j| {
                let mut point = <T::Parameters as Manifold>::Point::<D>::filled(D::from(0.0));
                T::Parameters::plus(&x[j * ambient..(j + 1) * ambient], &step[j * W..(j + 1) * W], point.as_mut());
                T::map(point.as_ref())
            })
            .collect();
        let identity: Vec<D> = T::IDENTITY.iter().map(|e| D::from(*e)).collect();
        maps.resize(nodes.len(), T::map(&identity));
        let w: Vec<D> = (0..shapes.len()).map(|k| step[free * W + k] + x[free * ambient + k]).collect();
        let place = |(i, n): (usize, &Vec3)| {
            let mut b: [D; 3] = std::array::from_fn(|a| D::from(n[a]));
            for (k, w) in w.iter().enumerate() {
                let displacement = shapes.displacement(i, k);
                (0..3).for_each(|a| b[a] += *w * displacement[a]);
            }
            let mut v = [D::from(0.0); 3];
            for &(j, omega) in graph.influences(i) {
                let x_j = nodes[j as usize];
                let moved = maps[j as usize].apply(std::array::from_fn(|a| b[a] - x_j[a]));
                for a in 0..3 {
                    v[a] += (moved[a] + x_j[a]) * omega;
                }
            }
            v
        };
        let vertices = self.rest().iter().enumerate().map(place).collect();
        let lambda = self.stiffness;
        let mut residuals = Vec::new();
        for &(i, j) in graph.edges() {
            let [x_i, x_j] = [i, j].map(|k| nodes[k as usize]);
            let moved = maps[i as usize].apply(std::array::from_fn(|a| D::from(x_j[a] - x_i[a])));
            let target = &maps[j as usize].translation;
            residuals.extend((0..3).map(|a| (lambda.graph, moved[a] + x_i[a] - target[a] - x_j[a])));
        }
        let rotation = lambda.graph * lambda.rotation * graph.squared_reach(self.rest());
        for r in maps.iter().filter_map(T::rotation_residuals) {
            residuals.extend(r.map(|r| (rotation, r)));
        }
        residuals.extend(w.iter().zip(shapes.sigmas()).map(|(w, sigma)| (lambda.blend, *w / *sigma)));
        (vertices, residuals)
    }
}

impl<F: PositionFunction> Formula for Autodiff<F> {
    fn tangent(&self) -> usize {
        self.function().rest_blocks().len() * F::Block::TANGENT
    }

    fn evaluate<D: Scalar>(&self, x: &[f64], step: &[D]) -> (Vec<[D; 3]>, Vec<(f64, D)>) {
        let (ambient, tangent) = (F::Block::AMBIENT, F::Block::TANGENT);
        let gather = |blocks: &Vec<usize>| -> Vec<Point<F, D>> {
            let block = |&j: &usize| {
                let mut point = Point::<F, D>::filled(D::from(0.0));
                let delta = &step[j * tangent..(j + 1) * tangent];
                F::Block::plus(&x[j * ambient..(j + 1) * ambient], delta, point.as_mut());
                point
            };
            blocks.iter().map(block).collect()
        };
        let f = self.function();
        let vertices = f.vertex_blocks().iter().enumerate().map(|(i, b)| f.position(i, &gather(b))).collect();
        let smooth = f.smoothness_blocks();
        let residuals = smooth.iter().enumerate().flat_map(|(m, b)| f.smoothness(m, &gather(b)));
        (vertices, residuals.map(|r| (self.stiffness, r)).collect())
    }
}

/// Parameters that are positions, moved by a step.
fn moved<D: Scalar>(x: &[f64], step: &[D]) -> Vec<[D; 3]> {
    let node = |(x, d): (&[f64], &[D])| std::array::from_fn(|a| d[a] + x[a]);
    x.chunks_exact(3).zip(step.chunks_exact(3)).map(node).collect()
}

/// Each spring's `|x_i - x_j| - l`.
impl Formula for MassSpring {
    fn tangent(&self) -> usize {
        self.parameter_len()
    }

    fn evaluate<D: Scalar>(&self, x: &[f64], step: &[D]) -> (Vec<[D; 3]>, Vec<(f64, D)>) {
        let mut nodes = moved(x, step);
        let residual = |([a, b], stiffness, length): ([u32; 2], f64, f64)| {
            let d: [D; 3] = std::array::from_fn(|k| nodes[a as usize][k] - nodes[b as usize][k]);
            (self.lambda_smooth * stiffness, (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() - length)
        };
        let residuals = self.springs().map(residual).collect();
        nodes.truncate(self.vertex_count());
        (nodes, residuals)
    }
}

/// Corotational tetrahedra: entries and trace of `(R'F + F'R) / 2 - 1`, `R` by singular values.
pub struct Tissue {
    layer: InnerLayer,
    areas: Vec<f64>,
    options: TissueOptions,
    lambda: f64,
}

impl Tissue {
    pub fn new(mesh: &TriangleMesh, options: TissueOptions, lambda: f64) -> Self {
        let layer = InnerLayer::new(mesh, options.thickness).expect("a sound mesh");
        Self { layer, areas: vertex_areas(&mesh.positions, &mesh.triangles), options, lambda }
    }
}

impl Formula for Tissue {
    fn tangent(&self) -> usize {
        3 * self.layer.nodes.len()
    }

    fn evaluate<D: Scalar>(&self, x: &[f64], step: &[D]) -> (Vec<[D; 3]>, Vec<(f64, D)>) {
        let Self { layer, areas, options, lambda } = self;
        let mut nodes = moved(x, step);
        let sides =
            |t: &[u32; 4], p: &dyn Fn(u32) -> Vec3| Matrix3::from_columns(&[1, 2, 3].map(|k| p(t[k]) - p(t[0])));
        let at_rest = |t: &[u32; 4]| sides(t, &|k| layer.nodes[k as usize]);
        let volume = |t: &[u32; 4]| at_rest(t).determinant() / 6.0;
        let tie = 1e-3 * layer.tetrahedra.iter().map(volume).sum::<f64>() / layer.tetrahedra.len() as f64;
        let own = layer.tetrahedra.iter().map(|t| (t, volume(t)));
        let nu = options.poisson;
        let (mu, kappa) = (0.5 / (1.0 + nu), nu / (1.0 + nu) / (1.0 - 2.0 * nu));
        let mut residuals = Vec::new();
        for (t, volume) in own.chain(layer.ties.iter().map(|t| (t, volume(t).min(tie)))) {
            let inverse = at_rest(t).try_inverse().expect("a volume");
            let f = sides(t, &|k| Vec3::from_column_slice(&x[3 * k as usize..3 * k as usize + 3])) * inverse;
            let r = closest_by_singular_values(f);
            let side = |a: usize, k: usize| nodes[t[k + 1] as usize][a] - nodes[t[0] as usize][a];
            let f = |a: usize, b: usize| (0..3).fold(D::from(0.0), |sum, k| sum + side(a, k) * inverse[(k, b)]);
            let turned = |a: usize, b: usize| (0..3).fold(D::from(0.0), |sum, k| sum + f(k, b) * r[(k, a)]);
            let weight = lambda * volume / options.thickness;
            for (a, b) in (0..9).map(|k| (k / 3, k % 3)) {
                let one = f64::from(u8::from(a == b));
                residuals.push((weight * mu, (turned(a, b) + turned(b, a)) * 0.5 - one));
            }
            residuals.push((weight * kappa / 2.0, turned(0, 0) + turned(1, 1) + turned(2, 2) - 3.0));
        }
        for (below, area) in layer.below.iter().zip(areas).filter_map(|(b, a)| Some(((*b)? as usize, a))) {
            let weight = lambda * options.anchor * area / options.thickness.powi(2);
            residuals.extend((0..3).map(|a| (weight, nodes[below][a] - layer.nodes[below][a])));
        }
        nodes.truncate(areas.len());
        (nodes, residuals)
    }
}

/// The rotation closest to a matrix (Kabsch 1976).
fn closest_by_singular_values(a: Matrix3<f64>) -> Matrix3<f64> {
    let svd = a.svd(true, true);
    let (u, v) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    u * Matrix3::from_diagonal(&Vec3::new(1.0, 1.0, (u * v).determinant().signum())) * v
}

/// For models whose positions are affine and whose regulariser is quadratic in parameters to which steps add. Differences of any
/// step are then exact but for rounding:
///
/// ```text
///     dv/dx_k = v(x + e_k) - v(x)                           g_k = (E(x + e_k) - E(x - e_k)) / 4
///     H_kl = (E(e_k + e_l) - E(e_k) - E(e_l) + E(0)) / 2
/// ```
pub fn quadratic(model: impl DeformationModel) -> impl Fn(&[f64]) -> Reference {
    let model = RefCell::new(model);
    move |x| {
        let mut model = model.borrow_mut();
        let n = x.len();
        let mut place = |x: &[f64]| {
            let mut out = Vec::new();
            model.positions(x, &mut out);
            out
        };
        let at_x = place(x);
        let mut positions = DMatrix::zeros(3 * at_x.len(), n);
        for k in 0..n {
            let mut y = x.to_vec();
            y[k] += 1.0;
            for (i, (a, b)) in place(&y).iter().zip(&at_x).enumerate() {
                positions.view_mut((3 * i, k), (3, 1)).copy_from(&(a - b));
            }
        }
        let mut energy = |x: &[f64]| {
            let mut energies = Vec::new();
            model.regulariser_energy(x, &mut energies);
            energies.iter().map(|e| e.1).sum::<f64>()
        };
        let mut y = vec![0.0; n];
        let at_zero = energy(&y);
        let mut at = |ones: &[usize]| {
            ones.iter().for_each(|&k| y[k] += 1.0);
            let energy = energy(&y);
            ones.iter().for_each(|&k| y[k] = 0.0);
            energy
        };
        let single: Vec<f64> = (0..n).map(|k| at(&[k])).collect();
        let mut hessian = DMatrix::zeros(n, n);
        for k in 0..n {
            for l in 0..=k {
                let h = (at(&[k, l]) - single[k] - single[l] + at_zero) / 2.0;
                (hessian[(k, l)], hessian[(l, k)]) = (h, h);
            }
        }
        let mut gradient = DVector::zeros(n);
        for k in 0..n {
            let [up, down] = [1.0, -1.0].map(|step| {
                let mut y = x.to_vec();
                y[k] += step;
                energy(&y)
            });
            gradient[k] = (up - down) / 4.0;
        }
        Reference { positions, hessian, gradient }
    }
}

/// Cells of edges: residuals `(v_a - v_b) - exp(omega_c^) R_c (n_a - n_b)` at the best `R_c`, by dual numbers in `v` and `omega`.
/// Local/global holds `omega`, joint eliminates it.
pub struct Rigidity {
    rest: Vec<Vec3>,
    cells: usize,
    /// `(c, a, b, w_ab)`.
    edges: Vec<(usize, usize, usize, f64)>,
    solver: ArapSolver,
    lambda: f64,
    places: Vec<Option<Vec3>>,
}

/// Share of the trace of `omega_i`'s block on its diagonal: a star on a line is free to turn round it.
const TURN_FLOOR: f64 = 1e-9;

impl Rigidity {
    /// Stars: each edge in both directions, each in the cell of its first vertex.
    pub fn stars(mesh: &TriangleMesh, options: ArapOptions, lambda: f64, held: &[bool], places: &[Vec3]) -> Self {
        let rest = mesh.positions.clone();
        let graph = EdgeGraph::of(mesh);
        let mut edges: Vec<(usize, usize, f64)> = Vec::new();
        for &[a, b] in graph.edges() {
            let opposite = mesh.triangles.iter().filter(|t| t.contains(&a) && t.contains(&b)).map(|t| {
                let c = t.iter().copied().find(|&c| c != a && c != b).expect("three corners");
                let [u, v] = [a, b].map(|k| rest[k as usize] - rest[c as usize]);
                u.dot(&v) / u.cross(&v).norm()
            });
            let weight = opposite.sum::<f64>() / 2.0;
            edges.push((a as usize, b as usize, if options.clamp { weight.max(0.0) } else { weight }));
        }
        edges.extend(Self::ties(&rest, &graph));
        let edges =
            edges.into_iter().filter(|e| e.2 != 0.0).flat_map(|(a, b, w)| [(a, a, b, w), (b, b, a, w)]).collect();
        let places = held.iter().zip(places).map(|(held, p)| held.then_some(*p)).collect();
        Self { cells: rest.len(), rest, edges, solver: options.solver, lambda, places }
    }

    /// Triangles with their neighbours across edges: each triangle shared evenly among the cells that it is in, its edges weighing half
    /// their cotangents.
    pub fn patches(mesh: &TriangleMesh, solver: ArapSolver, lambda: f64, held: &[bool], places: &[Vec3]) -> Self {
        let (rest, triangles) = (mesh.positions.clone(), &mesh.triangles);
        let adjacent = |s: usize, t: usize| triangles[s].iter().filter(|v| triangles[t].contains(v)).count() >= 2;
        let patch = |t: usize| (0..triangles.len()).filter(move |&s| adjacent(s, t));
        let mut edges = Vec::new();
        for t in 0..triangles.len() {
            for s in patch(t) {
                let share = 1.0 / patch(s).count() as f64;
                for k in 0..3 {
                    let [a, b, c] = [0, 1, 2].map(|m| triangles[s][(k + m) % 3] as usize);
                    let (u, v) = (rest[a] - rest[c], rest[b] - rest[c]);
                    edges.push((t, a, b, share * u.dot(&v) / u.cross(&v).norm() / 2.0));
                }
            }
        }
        for (loose, anchor, weight) in Self::ties(&rest, &EdgeGraph::of(mesh)) {
            let cell = triangles.iter().position(|t| t.contains(&(anchor as u32))).expect("an anchor in a triangle");
            edges.push((cell, loose, anchor, weight));
        }
        let places = held.iter().zip(places).map(|(held, p)| held.then_some(*p)).collect();
        Self { rest, cells: triangles.len(), edges, solver, lambda, places }
    }

    /// Vertices of no triangle are tied to the nearest other.
    fn ties(rest: &[Vec3], graph: &EdgeGraph) -> Vec<(usize, usize, f64)> {
        let squared = |a: usize, b: usize| (rest[a] - rest[b]).norm_squared();
        let lengths = graph.edges().iter().map(|e| squared(e[0] as usize, e[1] as usize));
        let mean = lengths.sum::<f64>() / graph.edges().len() as f64;
        let loose = |i: &usize| graph.neighbours(*i).is_empty();
        let tie = |i: usize| {
            let others = (0..rest.len()).filter(|j| !loose(j));
            let anchor = others.min_by(|&a, &b| squared(i, a).total_cmp(&squared(i, b))).expect("a triangle");
            (i, anchor, (mean / squared(i, anchor)).min(1.0) / 3f64.sqrt())
        };
        (0..rest.len()).filter(loose).map(tie).collect()
    }

    /// Positions for the parameters of free vertices.
    fn place<D: Scalar>(&self, x: &[D]) -> Vec<[D; 3]> {
        let mut free = x.chunks_exact(3);
        let fixed = |p: &Vec3| std::array::from_fn(|a| D::from(p[a]));
        self.places
            .iter()
            .map(|held| held.as_ref().map_or_else(|| free.next().expect("its own").try_into().unwrap(), fixed))
            .collect()
    }

    fn rotations(&self, v: &[[f64; 3]]) -> Vec<Matrix3<f64>> {
        let mut a = vec![Matrix3::zeros(); self.cells];
        for &(c, i, j, w) in &self.edges {
            a[c] += (Vec3::from(v[i]) - Vec3::from(v[j])) * (self.rest[i] - self.rest[j]).transpose() * w;
        }
        a.into_iter().map(closest_by_singular_values).collect()
    }

    pub fn reference(&self, x: &[f64]) -> Reference {
        let rotations = self.rotations(&self.place(x));
        let (n, turns) = (x.len(), 3 * self.cells);
        let evaluate = |step: &[Dual64]| {
            let moved: Vec<Dual64> = step[..n].iter().zip(x).map(|(d, x)| *d + *x).collect();
            let v = self.place(&moved);
            let residual = |&(c, i, j, _): &(usize, usize, usize, f64)| -> [Dual64; 3] {
                let p = rotations[c] * (self.rest[i] - self.rest[j]);
                let turn = so3::exp([0, 1, 2].map(|a| step[n + 3 * c + a]));
                std::array::from_fn(|a| v[i][a] - v[j][a] - (turn[a][0] * p[0] + turn[a][1] * p[1] + turn[a][2] * p[2]))
            };
            let residuals: Vec<Dual64> = self.edges.iter().flat_map(residual).collect();
            (v, residuals)
        };
        let mut step = vec![Dual64::from_re(0.0); n + turns];
        let (_, residuals) = evaluate(&step);
        let mut positions = DMatrix::zeros(3 * self.rest.len(), n);
        let mut jacobian = DMatrix::zeros(residuals.len(), n + turns);
        for k in 0..n + turns {
            step[k] = step[k].derivative();
            let (v, r) = evaluate(&step);
            step[k] = Dual64::from_re(0.0);
            jacobian.column_mut(k).iter_mut().zip(&r).for_each(|(e, r)| *e = r.eps);
            if k < n {
                positions.column_mut(k).iter_mut().zip(v.as_flattened()).for_each(|(e, v)| *e = v.eps);
            }
        }
        let weights = self.edges.iter().flat_map(|e| [self.lambda * e.3; 3]);
        let (all, gradient) = normal(&jacobian, weights.zip(residuals.iter().map(|r| r.re)));
        let mut hessian = all.view((0, 0), (n, n)).into_owned();
        if self.solver == ArapSolver::Joint {
            for i in 0..self.cells {
                let at = n + 3 * i;
                let mut own: Matrix3<f64> = all.fixed_view::<3, 3>(at, at).into_owned();
                own += Matrix3::from_diagonal_element(TURN_FLOOR * own.trace());
                // Negative weights can make it indefinite; the rotation then stays.
                let Some(factor) = own.cholesky() else { continue };
                let cross = all.view((at, 0), (3, n));
                hessian -= cross.transpose() * factor.solve(&cross.into_owned());
            }
        }
        Reference { positions, hessian, gradient: gradient.rows(0, n).into_owned() }
    }
}
