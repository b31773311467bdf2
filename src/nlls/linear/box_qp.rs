//! Convex quadratic programs in a box, dense and small:
//!
//! ```text
//!     min 1/2 d' S d + s' d      subject to  l <= d <= u          S positive definite
//!
//!     d is the solution  <=>  with r = S d + s:    r_i = 0 where l_i < d_i < u_i,   r_i >= 0 where d_i = l_i,   r_i <= 0 where d_i = u_i
//! ```
//!
//! First the primal-dual active set method (K. Kunisch, F. Rendl, "An infeasible active set method for quadratic problems with
//! simple bounds", 2003): minimise over the free coordinates with the others held at their bounds, then hold every coordinate
//! that left the box and free every one with a multiplier of the wrong sign, all at once. From a good guess (the last active
//! set) it takes one or two rounds, from none about six; but it may cycle.
//!
//! So after [`BLOCK_ROUNDS`] rounds the primal active set method takes over (P. Stark, R. Parker, "Bounded-variable least
//! squares", 1995): steps inside the box towards the minimum of the face, up to the first bound in the way; at the minimum of a
//! face one coordinate of wrong sign is freed. The minima of the faces it rests on fall strictly: a freed coordinate moves
//! inwards whatever blocks (all other slopes on the face are zero), and as there are finitely many faces and none
//! comes twice, it ends. [`PRIMAL_ROUNDS`] is there for rounding alone; to reach it is an error.

use super::dense::DenseFactor;
use super::vector::dot;

/// Rounds of the primal-dual method before the primal one takes over.
const BLOCK_ROUNDS: usize = 20;

/// Rounds of the primal method, per coordinate; in exact arithmetic a few are enough.
const PRIMAL_ROUNDS: usize = 50;

/// A multiplier counts as negative beyond this share of the sum of sizes that it was computed from: its rounding error.
const MULTIPLIER_TOLERANCE: f64 = 1e-13;

/// Where a coordinate of the solution is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::nlls) enum Side {
    /// Not held.
    Free,
    /// At its lower bound.
    Lower,
    /// At its upper bound.
    Upper,
}

/// Why there is no solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unsolved {
    /// S is numerically not positive definite along this coordinate.
    Flat(usize),
    /// No active set was found in so many rounds of the primal method.
    Rounds(usize),
}

/// The solver: buffers, and the active set from which the next program starts.
#[derive(Debug)]
pub(super) struct BoxQp {
    sides: Vec<Side>,
    /// Coordinates that are not held, ascending.
    free: Vec<usize>,
    factor: DenseFactor,
    /// `S d + s` and its rounding error.
    slopes: Vec<f64>,
    errors: Vec<f64>,
    /// From `d` to the minimum of its face, over the free coordinates.
    direction: Vec<f64>,
}

/// A program: `S`, full, row-major; `s`; what pivots of S are measured against (its diagonal, or what that was before an
/// elimination); `l` and `u`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Program<'a> {
    pub matrix: &'a [f64],
    pub gradient: &'a [f64],
    pub pivots: &'a [f64],
    pub lower: &'a [f64],
    pub upper: &'a [f64],
}

impl BoxQp {
    pub(super) fn new(side: usize) -> Self {
        Self {
            sides: vec![Side::Free; side],
            free: Vec::with_capacity(side),
            factor: DenseFactor::new(side),
            slopes: vec![0.0; side],
            errors: vec![0.0; side],
            direction: vec![0.0; side],
        }
    }

    /// Where the coordinates of the last solution are.
    pub(super) fn sides(&self) -> &[Side] {
        &self.sides
    }

    /// Forgets the active set.
    pub(super) fn release(&mut self) {
        self.sides.fill(Side::Free);
    }

    /// Writes the solution to `d`; its held coordinates are bit for bit at their bounds. Starts from the last active set.
    ///
    /// Needs `l <= u`.
    pub(super) fn solve(&mut self, program: &Program<'_>, d: &mut [f64]) -> Result<(), Unsolved> {
        let Program { lower, upper, .. } = *program;
        for (i, side) in self.sides.iter_mut().enumerate() {
            *side = match *side {
                _ if lower[i] == upper[i] => Side::Lower,
                Side::Lower if lower[i] > f64::NEG_INFINITY => Side::Lower,
                Side::Upper if upper[i] < f64::INFINITY => Side::Upper,
                _ => Side::Free,
            };
        }
        for _ in 0..BLOCK_ROUNDS {
            for (i, side) in self.sides.iter().enumerate() {
                d[i] = match side {
                    Side::Free => 0.0,
                    Side::Lower => lower[i],
                    Side::Upper => upper[i],
                };
            }
            self.aim(program, d)?;
            for (&i, p) in self.free.iter().zip(&self.direction) {
                d[i] = *p;
            }
            if !self.exchange(program, d) {
                return Ok(());
            }
        }
        self.descend(program, d, PRIMAL_ROUNDS * d.len())
    }

    /// Holds what left the box and frees what a bound pulls at; false if there was nothing to change.
    fn exchange(&mut self, program: &Program<'_>, d: &[f64]) -> bool {
        let Program { lower, upper, .. } = *program;
        self.measure(program, d);
        let mut changed = false;
        for i in 0..d.len() {
            let side = match self.sides[i] {
                Side::Free if d[i] < lower[i] => Side::Lower,
                Side::Free if d[i] > upper[i] => Side::Upper,
                held if held != Side::Free && self.pull(program, i) > 0.0 => Side::Free,
                same => same,
            };
            changed |= side != self.sides[i];
            self.sides[i] = side;
        }
        changed
    }

    /// The primal active set method from `d`, moved into the box, in `rounds` at most.
    fn descend(&mut self, program: &Program<'_>, d: &mut [f64], rounds: usize) -> Result<(), Unsolved> {
        let Program { matrix, lower, upper, .. } = *program;
        let n = d.len();
        for i in 0..n {
            d[i] = d[i].clamp(lower[i], upper[i]);
            self.sides[i] = match d[i] {
                v if v == lower[i] => Side::Lower,
                v if v == upper[i] => Side::Upper,
                _ => Side::Free,
            };
        }
        for _ in 0..rounds {
            self.aim(program, d)?;
            let mut blocking = None;
            let mut length = 1.0;
            for (&i, &p) in self.free.iter().zip(&self.direction) {
                let (bound, side) = if p < 0.0 { (lower[i], Side::Lower) } else { (upper[i], Side::Upper) };
                let leaves = if p < 0.0 { d[i] + p < bound } else { d[i] + p > bound };
                if leaves && (bound - d[i]) / p < length {
                    length = (bound - d[i]) / p;
                    blocking = Some((i, bound, side));
                }
            }
            for (&i, p) in self.free.iter().zip(&self.direction) {
                d[i] = (d[i] + length * p).clamp(lower[i], upper[i]);
            }
            if let Some((i, bound, side)) = blocking {
                d[i] = bound;
                self.sides[i] = side;
                continue;
            }
            self.measure(program, d);
            // The coordinate whose freedom alone lowers the program most.
            let mut best = (0.0, None);
            for i in 0..n {
                let pull = self.pull(program, i);
                if pull > 0.0 && pull * pull > best.0 * matrix[i * n + i] {
                    best = (pull * pull / matrix[i * n + i], Some(i));
                }
            }
            let Some(i) = best.1 else { return Ok(()) };
            self.sides[i] = Side::Free;
        }
        Err(Unsolved::Rounds(rounds))
    }

    /// How hard, beyond rounding, coordinate `i` is drawn from its bound into the box; not positive if it is free or rightly held.
    fn pull(&self, program: &Program<'_>, i: usize) -> f64 {
        let inwards = match self.sides[i] {
            _ if program.lower[i] == program.upper[i] => return 0.0,
            Side::Free => return 0.0,
            Side::Lower => -self.slopes[i],
            Side::Upper => self.slopes[i],
        };
        inwards - self.errors[i]
    }

    /// `slopes = S d + s` and the rounding error of each.
    fn measure(&mut self, program: &Program<'_>, d: &[f64]) {
        let n = d.len();
        for i in 0..n {
            let row = &program.matrix[i * n..(i + 1) * n];
            self.slopes[i] = dot(row, d) + program.gradient[i];
            let sizes: f64 = row.iter().zip(d).map(|(h, d)| (h * d).abs()).sum();
            self.errors[i] = MULTIPLIER_TOLERANCE * (sizes + program.gradient[i].abs());
        }
    }

    /// `direction = -S_FF^-1 (S d + s)_F` over the free coordinates F.
    fn aim(&mut self, program: &Program<'_>, d: &[f64]) -> Result<(), Unsolved> {
        let n = d.len();
        let Self { sides, free, factor, direction, .. } = self;
        free.clear();
        free.extend((0..n).filter(|&i| sides[i] == Side::Free));
        factor.set_side(free.len());
        let l = factor.matrix_mut();
        direction.clear();
        for (c, &i) in free.iter().enumerate() {
            let row = &program.matrix[i * n..(i + 1) * n];
            direction.push(-(dot(row, d) + program.gradient[i]));
            for (r, &j) in free.iter().enumerate().skip(c) {
                l[c * free.len() + r] = row[j];
            }
        }
        factor.factorize(|k| program.pivots[free[k]], |_| 0.0).map_err(|k| Unsolved::Flat(free[k]))?;
        factor.solve(direction);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    /// A program with `S = Q' diag(1 .. condition) Q` and coordinates of different sizes.
    struct Case {
        matrix: Vec<f64>,
        gradient: Vec<f64>,
        lower: Vec<f64>,
        upper: Vec<f64>,
    }

    impl Case {
        fn random(random: &mut Random, n: usize, condition: f64) -> Self {
            let a = nalgebra::DMatrix::from_fn(n, n, |_, _| random.next());
            let q = a.qr().q();
            let spread = nalgebra::DMatrix::from_diagonal(&nalgebra::DVector::from_fn(n, |i, _| {
                condition.powf(i as f64 / (n.max(2) - 1) as f64)
            }));
            let s = q.transpose() * spread * &q;
            let matrix = (0..n * n).map(|k| 0.5 * (s[(k / n, k % n)] + s[(k % n, k / n)])).collect();
            let mut case = Self { matrix, gradient: vec![0.0; n], lower: vec![0.0; n], upper: vec![0.0; n] };
            // Around a target that the box holds in part, with every kind of bound.
            let target: Vec<f64> = (0..n).map(|_| 2.0 * random.next()).collect();
            for i in 0..n {
                case.gradient[i] = -dot(&case.matrix[i * n..(i + 1) * n], &target);
                (case.lower[i], case.upper[i]) = match random.index(8) {
                    0 => (f64::NEG_INFINITY, f64::INFINITY),
                    1 => (f64::NEG_INFINITY, 0.0),
                    2 => (0.0, f64::INFINITY),
                    3 => (0.0, 0.0),
                    // Degenerate: the minimum lies on the bound.
                    4 => (target[i], target[i] + 1.0),
                    _ => (-random.next().abs(), random.next().abs()),
                };
            }
            case
        }

        fn program<'a>(&'a self, pivots: &'a [f64]) -> Program<'a> {
            Program { matrix: &self.matrix, gradient: &self.gradient, pivots, lower: &self.lower, upper: &self.upper }
        }

        fn diagonal(&self) -> Vec<f64> {
            let n = self.gradient.len();
            (0..n).map(|i| self.matrix[i * n + i]).collect()
        }

        /// Largest violation of the optimality conditions, relative to the sizes that slopes are computed from.
        fn violation(&self, d: &[f64]) -> f64 {
            let n = d.len();
            let mut worst: f64 = 0.0;
            for i in 0..n {
                assert!(
                    self.lower[i] <= d[i] && d[i] <= self.upper[i],
                    "{i}: {} {} {}",
                    self.lower[i],
                    d[i],
                    self.upper[i]
                );
                let row = &self.matrix[i * n..(i + 1) * n];
                let slope = row.iter().zip(d).map(|(h, d)| h * d).sum::<f64>() + self.gradient[i];
                let size = row.iter().zip(d).map(|(h, d)| (h * d).abs()).sum::<f64>() + self.gradient[i].abs();
                let violation = match (d[i] == self.lower[i], d[i] == self.upper[i]) {
                    (true, true) => 0.0,
                    (true, false) => (-slope).max(0.0),
                    (false, true) => slope.max(0.0),
                    (false, false) => slope.abs(),
                };
                worst = worst.max(violation / size.max(1.0));
            }
            worst
        }
    }

    /// Both methods, the primal one from wherever `start` puts it.
    fn solve_both(case: &Case, start: &[f64]) -> [Vec<f64>; 2] {
        let n = case.gradient.len();
        let pivots = case.diagonal();
        let (mut d, mut primal) = (vec![f64::NAN; n], start.to_vec());
        BoxQp::new(n).solve(&case.program(&pivots), &mut d).unwrap();
        BoxQp::new(n).descend(&case.program(&pivots), &mut primal, PRIMAL_ROUNDS * n).unwrap();
        [d, primal]
    }

    #[test]
    fn random_programs_meet_the_optimality_conditions() {
        let mut random = Random(5);
        for n in [1, 2, 3, 5, 10, 20, 50, 150] {
            for condition in [1.0, 1e3, 1e6, 1e10] {
                for _ in 0..if n < 50 { 60 } else { 3 } {
                    let case = Case::random(&mut random, n, condition);
                    let start: Vec<f64> = (0..n).map(|_| 3.0 * random.next()).collect();
                    for d in solve_both(&case, &start) {
                        let violation = case.violation(&d);
                        assert!(violation < 1e-10, "n {n}, condition {condition:e}: {violation:e}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_active_set_carries_over_to_the_next_program() {
        let mut random = Random(9);
        for n in [4, 30, 90] {
            let mut case = Case::random(&mut random, n, 1e4);
            let mut qp = BoxQp::new(n);
            let pivots = case.diagonal();
            for _ in 0..20 {
                let mut d = vec![0.0; n];
                qp.solve(&case.program(&pivots), &mut d).unwrap();
                assert!(case.violation(&d) < 1e-10);
                for (i, side) in qp.sides().iter().enumerate() {
                    match side {
                        Side::Free => {}
                        Side::Lower => assert_eq!(d[i], case.lower[i]),
                        Side::Upper => assert_eq!(d[i], case.upper[i]),
                    }
                }
                case.gradient.iter_mut().for_each(|g| *g += random.next());
            }
        }
    }

    #[test]
    fn programs_on_which_all_at_once_cycles_are_solved() {
        // All-at-once exchanges cycle on some positive definite matrices that are far from M-matrices; small ones are
        // searched for one. The safeguard must be what ends it.
        let mut random = Random(1);
        let mut cycled = 0;
        for _ in 0..20_000 {
            let n = 3 + random.index(4);
            let mut case = Case::random(&mut random, n, 1e4);
            case.lower.fill(0.0);
            case.upper.fill(f64::INFINITY);
            let pivots = case.diagonal();
            let mut qp = BoxQp::new(n);
            let mut d = vec![0.0; n];
            let program = case.program(&pivots);
            let mut ended = false;
            for _ in 0..BLOCK_ROUNDS {
                d.fill(0.0);
                qp.aim(&program, &d).unwrap();
                for (&i, p) in qp.free.iter().zip(&qp.direction) {
                    d[i] = *p;
                }
                if !qp.exchange(&program, &d) {
                    ended = true;
                    break;
                }
            }
            if !ended {
                cycled += 1;
                qp.release();
                qp.solve(&program, &mut d).unwrap();
                assert!(case.violation(&d) < 1e-10);
            }
        }
        assert!(cycled > 0, "no program cycled: the test shows nothing");
    }

    #[test]
    fn a_flat_direction_is_named_unless_it_is_held() {
        let (matrix, gradient) = ([4.0, 0.0, 0.0, 0.0], [-2.0, 1.0]);
        let (lower, upper) = ([-1.0; 2], [1.0; 2]);
        let pivots = [4.0, 1.0];
        let program = Program { matrix: &matrix, gradient: &gradient, pivots: &pivots, lower: &lower, upper: &upper };
        let mut d = [0.0; 2];
        assert_eq!(BoxQp::new(2).solve(&program, &mut d), Err(Unsolved::Flat(1)));
        let held = Program { lower: &[-1.0, 0.25], upper: &[1.0, 0.25], ..program };
        assert_eq!(BoxQp::new(2).solve(&held, &mut d), Ok(()));
        assert_eq!(d, [0.5, 0.25]);
    }

    #[test]
    fn rounds_that_run_out_are_an_error() {
        let case = Case::random(&mut Random(2), 20, 1e4);
        let pivots = case.diagonal();
        let ended = |rounds: usize| BoxQp::new(20).descend(&case.program(&pivots), &mut [9.0; 20], rounds);
        assert_eq!(ended(1), Err(Unsolved::Rounds(1)));
        assert_eq!(ended(PRIMAL_ROUNDS * 20), Ok(()));
    }
}
