//! Lost frames: those outside of the longest series of frames in which no step bends more sharply than the sequence's own.
//!
//! How sharply frames i < j < k bend is the root mean square over the vertices of their second divided difference,
//! `2 [(x_k - x_j) / (k - j) - (x_j - x_i) / (j - i)] / (k - i)`, millimetres a frame a frame. A frame that is off bends the motion
//! into it, at it and out of it; a head that moves fast bends it little. Up to [`REACH`] frames in a row are found; a longer run has no
//! fewer frames that agree with each other than the motion round it.
//!
//! Where the motion jumps for good, at a cut, the series leaves frames out as well, to get across: but those go on from the frames before
//! them or lead to those after them, which do not go on from each other. They are not lost; the motion begins anew there.

use crate::mesh::Vec3;

/// How many times the sequence's median a bend must be to be a jump.
pub const TIMES: f64 = 4.0;
/// The least that is a jump, millimetres a frame a frame: also of sequences that hardly move.
pub const AT_LEAST: f64 = 3.0;
/// How many frames a series may leave out at once, and one more.
pub const REACH: usize = 8;
/// About so many vertices are looked at.
const VERTICES: usize = 512;

/// Where frames do not go on from each other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Jumps {
    /// Of every frame, by how many millimetres it is off the line between its neighbours in the series, if it is lost.
    pub off: Vec<Option<f64>>,
    /// Frames at which the motion begins anew.
    pub cuts: Vec<usize>,
}

/// The jumps of a sequence. Missing frames and sequences of fewer than five frames are not judged.
#[must_use]
pub fn jumps(frames: &[Option<Vec<Vec3>>]) -> Jumps {
    let mut found = Jumps { off: vec![None; frames.len()], cuts: Vec::new() };
    let there: Vec<(usize, &Vec<Vec3>)> =
        frames.iter().enumerate().filter_map(|(k, f)| Some((k, f.as_ref()?))).collect();
    if there.len() < 5 {
        return found;
    }
    let every = there[0].1.len().div_ceil(VERTICES).max(1);
    let bend = |i: usize, j: usize, k: usize| {
        let [(at_i, x_i), (at_j, x_j), (at_k, x_k)] = [i, j, k].map(|f| there[f]);
        let [before, after] = [at_j - at_i, at_k - at_j].map(|steps| steps as f64);
        let at = |v: usize| ((x_k[v] - x_j[v]) / after - (x_j[v] - x_i[v]) / before) * (2.0 / (before + after));
        rms((0..x_j.len()).step_by(every).map(at))
    };
    let mut bends: Vec<f64> = (2..there.len()).map(|k| bend(k - 2, k - 1, k)).collect();
    bends.sort_by(f64::total_cmp);
    let most = AT_LEAST.max(TIMES * bends[bends.len() / 2]);
    let goes_on = |i, j, k| bend(i, j, k) <= most;
    let series = longest(there.len(), |i, j, k| Some(bend(i, j, k)).filter(|bend| *bend <= most));
    // how far frame k lies from where frames i and j lead
    let beyond = |i: usize, j: usize, k: usize| {
        let [(at_i, x_i), (at_j, x_j), (at_k, x_k)] = [i, j, k].map(|f| there[f]);
        let share = (at_k as f64 - at_i as f64) / (at_j as f64 - at_i as f64);
        rms((0..x_j.len()).step_by(every).map(|v| x_k[v] - x_i[v].lerp(&x_j[v], share)))
    };
    let step = |k: usize| rms((0..there[k].1.len()).step_by(every).map(|v| there[k].1[v] - there[k - 1].1[v]));
    let mut kept = Vec::new();
    for around in series.windows(4).filter(|around| around[2] - around[1] > 1) {
        let &[before, from, to, after] = around else { continue };
        let (mut last, mut first) = ([before, from], [to, after]);
        while last[1] + 1 < to && goes_on(last[0], last[1], last[1] + 1) {
            last = [last[1], last[1] + 1];
        }
        while first[0] - 1 > from && goes_on(first[0] - 1, first[0], first[1]) {
            first = [first[0] - 1, first[0]];
        }
        let apart = beyond(before, from, to).min(beyond(after, to, from)) > most;
        if apart && last[1] + 1 >= first[0] {
            let cut = (first[0]..=last[1] + 1).max_by(|&a, &b| step(a).total_cmp(&step(b)));
            found.cuts.extend(cut.map(|cut| there[cut].0));
            kept.extend(from + 1..to);
        }
    }
    for f in (0..there.len()).filter(|f| !series.contains(f) && !kept.contains(f)) {
        let after = series.partition_point(|&s| s < f);
        let neighbours = [after.checked_sub(1), Some(after)].map(|s| s.and_then(|s| series.get(s)).map(|&s| there[s]));
        let (at, x) = there[f];
        let off = |v: usize| match neighbours {
            [Some((a, x_a)), Some((b, x_b))] => x[v] - x_a[v].lerp(&x_b[v], (at - a) as f64 / (b - a) as f64),
            [Some((_, one)), None] | [None, Some((_, one))] => x[v] - one[v],
            [None, None] => Vec3::zeros(),
        };
        found.off[at] = Some(rms((0..x.len()).step_by(every).map(off)));
    }
    found
}

/// The longest series of 0 to `count` - 1 in which every three that follow each other have a `bend`, of which each step is at most
/// [`REACH`]. Of equally long ones, the one that bends least in all: a frame that is off bends the motion at its neighbours, too.
fn longest(count: usize, bend: impl Fn(usize, usize, usize) -> Option<f64>) -> Vec<usize> {
    // length of the longest series that ends with a step of so much to this frame, its bends, and the step before
    let mut best = vec![[(2usize, 0.0, 0usize); REACH + 1]; count];
    let better = |a: (usize, f64), b: (usize, f64)| a.0 > b.0 || (a.0 == b.0 && a.1 < b.1);
    for k in 0..count {
        for step in 1..=REACH.min(k) {
            let j = k - step;
            for before in 1..=REACH.min(j) {
                let (length, bends, _) = best[j][before];
                // as long at best as what is known: need not be looked at
                if length + 1 < best[k][step].0 {
                    continue;
                }
                let Some(bend) = bend(j - before, j, k) else { continue };
                let (known, known_bends, _) = best[k][step];
                if better((length + 1, bends + bend), (known, known_bends)) {
                    best[k][step] = (length + 1, bends + bend, before);
                }
            }
        }
    }
    let ends = (1..count).flat_map(|k| (1..=REACH.min(k)).map(move |step| (k, step)));
    // the first of those that are equal
    let of = |(k, step): (usize, usize)| (best[k][step].0, best[k][step].1);
    let Some((mut k, mut step)) = ends.reduce(|a, b| if better(of(b), of(a)) { b } else { a }) else {
        return (0..count).collect();
    };
    let mut series = vec![k];
    while step > 0 {
        let before = best[k][step].2;
        k -= step;
        series.push(k);
        step = before;
    }
    series.reverse();
    series
}

fn rms(of: impl Iterator<Item = Vec3>) -> f64 {
    let (sum, count) = of.fold((0.0, 0usize), |(sum, count), x| (sum + x.norm_squared(), count + 1));
    (sum / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_series_leaves_out_what_may_not_follow() {
        let all = longest(20, |_, _, _| Some(0.0));
        assert_eq!(all, (0..20).collect::<Vec<_>>());
        let odd = longest(9, |i, j, k| (![i, j, k].contains(&4)).then_some(0.0));
        assert_eq!(odd, [0, 1, 2, 3, 5, 6, 7, 8]);
        // frame 4 bends the motion into it and out of it as well, but not so much that either could not be left out in its place
        let at = |k: usize| if k == 4 { 2.0 } else { 0.0 };
        let bend = |i: usize, j: usize, k: usize| {
            let [before, after] = [(j - i) as f64, (k - j) as f64];
            2.0 / (before + after) * f64::abs((at(k) - at(j)) / after - (at(j) - at(i)) / before)
        };
        let off = longest(9, |i, j, k| Some(bend(i, j, k)).filter(|bend| *bend <= 3.0));
        assert_eq!(off, [0, 1, 2, 3, 5, 6, 7, 8]);
    }

    #[test]
    fn a_fast_turn_is_no_jump_and_one_step_aside_is() {
        // a head of 100 mm that turns back and forth by 40 degrees, twice a second, at 15 frames a second
        let at = |k: usize, r: f64| {
            let angle = 0.7 * (std::f64::consts::TAU * 2.0 * k as f64 / 15.0).sin();
            Vec3::new(r * angle.sin(), 0.0, r * angle.cos())
        };
        let mut frames: Vec<Option<Vec<Vec3>>> =
            (0..30).map(|k| Some((0..50).map(|v| at(k, f64::from(v) + 50.0)).collect())).collect();
        assert!(jumps(&frames).off.iter().all(Option::is_none), "{:?}", jumps(&frames));
        // four times what it bends by, about 43 mm, and more
        frames[12].as_mut().unwrap().iter_mut().for_each(|p| p.y += 150.0);
        let Jumps { off, cuts } = jumps(&frames);
        let found: Vec<usize> = off.iter().enumerate().filter_map(|(k, j)| j.map(|_| k)).collect();
        assert_eq!((found, cuts), (vec![12], vec![]));
    }
}
