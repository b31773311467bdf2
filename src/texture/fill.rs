//! Filling in what is not known: coarse to fine, and over seams.

use rayon::prelude::*;

/// Texels that colours go on for beyond a seam, at a side of 1024.
const GUTTER: usize = 8;

/// Fills every texel that is not `known`: each level halves the size, a texel being the mean of those of its four that are known, until
/// all are; then back, where what is not known is interpolated from the level above (pull and push). What is `covered` goes on over
/// its borders for some texels first.
pub(super) fn fill<const N: usize>(side: usize, values: &mut [[f32; N]], known: &[bool], covered: &[bool]) {
    if values.is_empty() || !known.contains(&true) {
        return;
    }
    pull_and_push([side, side], values, known.to_vec());
    // the nearest colour of the same piece is better there than a mean of all around
    let mut done = covered.to_vec();
    let neighbours = |at: usize| {
        let (x, y) = ((at % side) as i64, (at / side) as i64);
        let inside = move |(dx, dy): (i64, i64)| {
            let (x, y) = (x + dx, y + dy);
            let fits = (0..side as i64).contains(&x) && (0..side as i64).contains(&y);
            fits.then(|| y as usize * side + x as usize)
        };
        [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)].into_iter().filter_map(inside)
    };
    let beside = |at: &usize, done: &[bool]| !done[*at] && neighbours(*at).any(|n| done[n]);
    let mut ring: Vec<usize> = (0..side * side).into_par_iter().filter(|at| beside(at, &done)).collect();
    for _ in 0..(GUTTER * side).div_ceil(1024).max(4) {
        let mean = |at: &usize| {
            let (mut sum, mut count) = ([0.0; N], 0.0);
            for n in neighbours(*at).filter(|n| done[*n]) {
                (0..N).for_each(|k| sum[k] += values[n][k]);
                count += 1.0;
            }
            sum.map(|s| s / count)
        };
        let means: Vec<[f32; N]> = ring.iter().map(mean).collect();
        for (at, mean) in ring.iter().zip(means) {
            values[*at] = mean;
            done[*at] = true;
        }
        let mut next: Vec<usize> = ring.iter().flat_map(|at| neighbours(*at)).filter(|n| !done[*n]).collect();
        next.sort_unstable();
        next.dedup();
        ring = next;
    }
}

fn pull_and_push<const N: usize>(size: [usize; 2], values: &mut [[f32; N]], known: Vec<bool>) {
    if !known.contains(&false) {
        return;
    }
    let half = size.map(|n| n.div_ceil(2));
    let mut coarse = vec![([0.0; N], false); half[0] * half[1]];
    coarse.par_chunks_mut(half[0]).enumerate().for_each(|(y, row)| {
        for (x, (mean, some)) in row.iter_mut().enumerate() {
            let mut count = 0.0f32;
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let (x, y) = (2 * x + dx, 2 * y + dy);
                let at = y * size[0] + x;
                if x < size[0] && y < size[1] && known[at] {
                    (0..N).for_each(|k| mean[k] += values[at][k]);
                    count += 1.0;
                }
            }
            if count > 0.0 {
                *some = true;
                mean.iter_mut().for_each(|m| *m /= count);
            }
        }
    });
    let (mut means, some): (Vec<[f32; N]>, Vec<bool>) = coarse.into_iter().unzip();
    pull_and_push(half, &mut means, some);
    values.par_chunks_mut(size[0]).enumerate().for_each(|(y, row)| {
        for (x, value) in row.iter_mut().enumerate().filter(|(x, _)| !known[y * size[0] + x]) {
            // linear between the centres of the coarse texels
            let near = |at: usize, n: usize| {
                let other = if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { (at / 2 + 1).min(n - 1) };
                [(at / 2, 0.75), (other, 0.25)]
            };
            *value = [0.0; N];
            for (row, of_row) in near(y, half[1]) {
                for (column, of_column) in near(x, half[0]) {
                    let mean = means[row * half[0] + column];
                    (0..N).for_each(|k| value[k] += of_row * of_column * mean[k]);
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_known_stays_and_the_rest_lies_between() {
        for side in [1, 2, 7, 64] {
            let known: Vec<bool> = (0..side * side).map(|i| i % 5 == 0).collect();
            let before: Vec<[f32; 1]> =
                (0..side * side).map(|i| if known[i] { [1.0 + (i % 3) as f32] } else { [-50.0] }).collect();
            let mut values = before.clone();
            fill(side, &mut values, &known, &known);
            for i in 0..side * side {
                let fits = if known[i] { values[i] == before[i] } else { (1.0..=3.0).contains(&values[i][0]) };
                assert!(fits, "{side}: {} at {i}", values[i][0]);
            }
        }
        let mut nothing = vec![[7.0]; 4];
        fill(2, &mut nothing, &[false; 4], &[false; 4]);
        assert_eq!(nothing, [[7.0]; 4]);
    }

    #[test]
    fn a_piece_goes_on_beyond_its_border_with_its_own_colour() {
        let side = 64;
        // two pieces side by side, with a gap of six
        let covered: Vec<bool> = (0..side * side).map(|i| i % side < 20 || i % side >= 26).collect();
        let mut values: Vec<[f32; 1]> = (0..side * side).map(|i| [if i % side < 20 { 0.0 } else { 1.0 }]).collect();
        fill(side, &mut values, &covered, &covered);
        for y in 0..side {
            let row: Vec<f32> = values[y * side + 20..y * side + 26].iter().map(|v| v[0]).collect();
            assert!(row[..3].iter().all(|v| *v == 0.0) && row[3..].iter().all(|v| *v == 1.0), "{row:?}");
        }
    }
}
