//! Lost frames: those outside of the longest series of frames in which no step bends more sharply than the sequence's own: than a few
//! times the median of the three quarters of its frames that bend least. Of all its frames a few bad ones would spoil the median, as each
//! has a part in three bends.
//!
//! How sharply frames i < j < k bend is the root mean square over the vertices of their second divided difference,
//! `2 [(x_k - x_j) / (k - j) - (x_j - x_i) / (j - i)] / (k - i)`, millimetres a frame a frame. A frame that is off bends the motion
//! into it, at it and out of it; a head that moves fast bends it little. Up to [`REACH`] frames in a row are found; a longer run has no
//! fewer frames that agree with each other than the motion round it.
//!
//! Where the motion jumps for good, at a cut, the series leaves frames out as well, to get across: but those go on from the frames before
//! them or lead to those after them, which do not go on from each other. They are not lost; the motion begins anew there.

use rayon::prelude::*;

use crate::mesh::Vec3;

/// How many times the sequence's median a bend must be to be a jump.
pub const TIMES: f64 = 4.0;
/// The least that is a jump, millimetres a frame a frame: also of sequences that hardly move. A frame that is no farther off, in
/// millimetres, is not lost either.
pub const AT_LEAST: f64 = 3.0;
/// The share of the frames that the median is of.
const CALM: f64 = 0.75;
/// How many times the usual step of the motion one has to be, of a frame before the first or after the last of the series, to be a jump:
/// nothing tells where the motion leads there.
const STRIDE: f64 = 2.0;
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
    let bends = Bends::new(there.len(), bend);
    let most = AT_LEAST.max(TIMES * bends.median_of_the_calm());
    let goes_on = |i, j, k| bend(i, j, k) <= most;
    let series = bends.longest(most);
    // how far frame k lies from where frames i and j lead
    let beyond = |i: usize, j: usize, k: usize| {
        let [(at_i, x_i), (at_j, x_j), (at_k, x_k)] = [i, j, k].map(|f| there[f]);
        let share = (at_k as f64 - at_i as f64) / (at_j as f64 - at_i as f64);
        rms((0..x_j.len()).step_by(every).map(|v| x_k[v] - x_i[v].lerp(&x_j[v], share)))
    };
    let apart = |k: usize, from: &dyn Fn(usize) -> Vec3| {
        rms((0..there[k].1.len()).step_by(every).map(|v| there[k].1[v] - from(v)))
    };
    let moved = |a: usize, b: usize| apart(b, &|v| there[a].1[v]);
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
        let jumped = beyond(before, from, to).min(beyond(after, to, from)) > most;
        if jumped && last[1] + 1 >= first[0] {
            let cut = (first[0]..=last[1] + 1).max_by(|&a, &b| moved(a - 1, a).total_cmp(&moved(b - 1, b)));
            found.cuts.extend(cut.map(|cut| there[cut].0));
            kept.extend(from + 1..to);
        }
    }
    let mut steps: Vec<f64> =
        series.windows(2).map(|s| moved(s[0], s[1]) / (there[s[1]].0 - there[s[0]].0) as f64).collect();
    steps.sort_by(f64::total_cmp);
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    for f in (0..there.len()).filter(|f| !series.contains(f) && !kept.contains(f)) {
        let after = series.partition_point(|&s| s < f);
        let at = |k: usize| there[k].0 as f64;
        let (off, least) = match [after.checked_sub(1), Some(after)].map(|s| s.and_then(|s| series.get(s)).copied()) {
            [Some(a), Some(b)] => {
                let share = (at(f) - at(a)) / (at(b) - at(a));
                (apart(f, &|v| there[a].1[v].lerp(&there[b].1[v], share)), AT_LEAST)
            }
            [Some(one), None] | [None, Some(one)] => {
                (moved(one, f), AT_LEAST.max(STRIDE * usual * (at(one) - at(f)).abs()))
            }
            [None, None] => continue,
        };
        found.off[there[f].0] = Some(off).filter(|off| *off > least);
    }
    found
}

/// How sharply every three frames bend of which each step is at most [`REACH`]: of frame `k`, by the step to it and the one before.
struct Bends(Vec<[[f64; REACH]; REACH]>);

impl Bends {
    fn new(count: usize, bend: impl Fn(usize, usize, usize) -> f64 + Sync) -> Self {
        let of = |k: usize| {
            let to = |step: usize, before: usize| Some((k.checked_sub(step + before)?, k - step));
            std::array::from_fn(|s| {
                std::array::from_fn(|b| to(s + 1, b + 1).map_or(f64::INFINITY, |(i, j)| bend(i, j, k)))
            })
        };
        Self((0..count).into_par_iter().map(of).collect())
    }

    /// The median along the longest series without its sharpest bends: that with the lowest limit which still has [`CALM`] of the frames.
    fn median_of_the_calm(&self) -> f64 {
        let mut limits: Vec<f64> = self.0.iter().flatten().flatten().copied().filter(|b| b.is_finite()).collect();
        limits.sort_by(f64::total_cmp);
        let enough = (CALM * self.0.len() as f64).ceil() as usize;
        let lowest = limits.partition_point(|limit| self.longest(*limit).len() < enough);
        let calm = self.longest(limits.get(lowest).copied().unwrap_or(f64::MAX));
        let mut bends: Vec<f64> = calm.windows(3).map(|f| self.0[f[2]][f[2] - f[1] - 1][f[1] - f[0] - 1]).collect();
        bends.sort_by(f64::total_cmp);
        bends.get(bends.len() / 2).copied().unwrap_or(0.0)
    }

    /// The longest series of frames in which no three that follow each other bend more than `most`. Of equally long ones, the one that
    /// bends least in all: a frame that is off bends the motion at its neighbours, too.
    fn longest(&self, most: f64) -> Vec<usize> {
        let count = self.0.len();
        // length of the longest series that ends with a step of so much to this frame, its bends, and the step before
        let mut best = vec![[(2usize, 0.0, 0usize); REACH + 1]; count];
        let better = |a: (usize, f64), b: (usize, f64)| a.0 > b.0 || (a.0 == b.0 && a.1 < b.1);
        for k in 0..count {
            for step in 1..=REACH.min(k) {
                let j = k - step;
                for before in 1..=REACH.min(j) {
                    let bend = self.0[k][step - 1][before - 1];
                    let (length, bends, _) = best[j][before];
                    let (known, known_bends, _) = best[k][step];
                    if bend <= most && better((length + 1, bends + bend), (known, known_bends)) {
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
        let all = Bends::new(20, |_, _, _| 0.0).longest(0.0);
        assert_eq!(all, (0..20).collect::<Vec<_>>());
        let odd = Bends::new(9, |i, j, k| f64::from(u8::from([i, j, k].contains(&4)))).longest(0.5);
        assert_eq!(odd, [0, 1, 2, 3, 5, 6, 7, 8]);
        // frame 4 bends the motion into it and out of it as well, but not so much that either could not be left out in its place
        let at = |k: usize| if k == 4 { 2.0 } else { 0.0 };
        let bend = |i: usize, j: usize, k: usize| {
            let [before, after] = [(j - i) as f64, (k - j) as f64];
            2.0 / (before + after) * f64::abs((at(k) - at(j)) / after - (at(j) - at(i)) / before)
        };
        let off = Bends::new(9, bend).longest(3.0);
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
    fn lost_of(places: &[f64]) -> Vec<usize> {
        let frame = |x: &f64| Some((0..20).map(|v| Vec3::new(*x, f64::from(v), 0.0)).collect());
        let Jumps { off, cuts } = jumps(&places.iter().map(frame).collect::<Vec<_>>());
        assert!(cuts.is_empty(), "{cuts:?}");
        (0..off.len()).filter(|&k| off[k].is_some()).collect()
    }

    #[test]
    fn a_few_that_are_off_do_not_hide_each_other() {
        let moving = |count: usize, bad: &[usize], by: f64| -> Vec<f64> {
            (0..count).map(|k| 0.3 * k as f64 + if bad.contains(&k) { by } else { 0.0 }).collect()
        };
        for (count, bad) in
            [(8, &[4][..]), (5, &[2]), (20, &[3, 10, 16]), (20, &[3, 4, 10, 16, 17]), (12, &[0, 6]), (9, &[8])]
        {
            assert_eq!(lost_of(&moving(count, bad, 20.0)), bad, "of {count}");
            assert!(lost_of(&moving(count, bad, 2.5)).is_empty(), "of {count}");
        }
    }

    #[test]
    fn a_motion_that_begins_or_turns_at_an_end_loses_no_frame() {
        let begins: Vec<f64> = (0..12).map(|k| 6.0 * f64::from((k - 1).max(0))).collect();
        let turns: Vec<f64> = (0..12).map(|k| 6.0 * f64::from((k - 1_i32).abs())).collect();
        for places in [begins, turns] {
            assert_eq!(lost_of(&places), [] as [usize; 0], "{places:?}");
            let backwards: Vec<f64> = places.iter().rev().copied().collect();
            assert_eq!(lost_of(&backwards), [] as [usize; 0], "{backwards:?}");
        }
    }
}
