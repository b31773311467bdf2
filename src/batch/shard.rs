//! Who does what, and in which order.

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::Row;

/// One of several parts of a batch, each for a machine or process of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// Everything.
    #[must_use]
    pub fn whole() -> Self {
        Self { index: 1, count: 1 }
    }

    /// Its part of a list: each goes to exactly one shard.
    pub fn of<T>(self, list: Vec<T>) -> Vec<T> {
        list.into_iter().enumerate().filter(|(k, _)| k % self.count == self.index - 1).map(|(_, item)| item).collect()
    }

    /// Whether both are different parts of one division.
    #[must_use]
    pub fn is_beside(self, other: Self) -> bool {
        self.count == other.count && self.index != other.index
    }

    /// Whether it is everything.
    #[must_use]
    pub fn is_whole(self) -> bool {
        self.count == 1
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-of-{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index, count }),
            Some((index, count)) => Err(format!("there is no part {index} of {count}; the first is 1/{count}")),
            None => Err("give part and number of parts, such as 2/8".to_owned()),
        }
    }
}

/// Rows that must follow each other: the frames of each sequence, in the manifest's order; any other row alone. Indices of rows,
/// ordered by the first of each.
#[must_use]
pub fn chains(rows: &[Row]) -> Vec<Vec<usize>> {
    let mut chains: Vec<Vec<usize>> = Vec::new();
    let mut of_sequence: HashMap<&str, usize> = HashMap::new();
    for (k, row) in rows.iter().enumerate() {
        let Some(sequence) = &row.sequence else {
            chains.push(vec![k]);
            continue;
        };
        let at = *of_sequence.entry(sequence).or_insert(chains.len());
        if at == chains.len() {
            chains.push(Vec::new());
        }
        chains[at].push(k);
    }
    chains
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_follow_each_other_and_shards_share_out_everything_once() {
        let row = |sequence: &str| Row {
            line: 0,
            name: String::new(),
            sequence: (!sequence.is_empty()).then(|| sequence.to_owned()),
            options: Vec::new(),
        };
        let rows = ["", "a", "b", "a", "", "b", "a"].map(row);
        let all = chains(&rows);
        assert_eq!(all, [vec![0], vec![1, 3, 6], vec![2, 5], vec![4]]);
        let mut parts: Vec<Vec<usize>> = (1..=3).flat_map(|i| Shard { index: i, count: 3 }.of(all.clone())).collect();
        parts.sort();
        assert_eq!(parts, [vec![0], vec![1, 3, 6], vec![2, 5], vec![4]]);
        assert_eq!(Shard::whole().of(all.clone()), all);
    }

    #[test]
    fn a_shard_is_a_part_of_several() {
        assert_eq!("2/8".parse(), Ok(Shard { index: 2, count: 8 }));
        assert_eq!(Shard { index: 2, count: 8 }.to_string(), "2-of-8");
        for (text, words) in
            [("0/3", "no part 0"), ("4/3", "no part 4"), ("2", "2/8"), ("a/b", "2/8"), ("1/0", "no part 1 of 0")]
        {
            assert!(text.parse::<Shard>().unwrap_err().contains(words), "{text}");
        }
    }
}
