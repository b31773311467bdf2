//! Loops in parallel that allocate nothing and whose result does not depend on the number of threads.

/// Calls `work(i, &mut items[i])` for every item. Runs of up to `grain` items stay on one thread.
pub(super) fn for_each<T: Send>(items: &mut [T], grain: usize, work: &(impl Fn(usize, &mut T) + Sync)) {
    split(items, 0, grain.max(1), work);
}

fn split<T: Send>(items: &mut [T], first: usize, grain: usize, work: &(impl Fn(usize, &mut T) + Sync)) {
    if items.len() <= grain {
        for (k, item) in items.iter_mut().enumerate() {
            work(first + k, item);
        }
        return;
    }
    let middle = items.len() / 2;
    let (left, right) = items.split_at_mut(middle);
    rayon::join(|| split(left, first, grain, work), || split(right, first + middle, grain, work));
}
