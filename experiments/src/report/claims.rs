//! What the papers claim, sentence by sentence, and whether the tables bear it out.
//!
//! Each claim has rules: a number taken from a table that a study wrote, alone or over another, and a bound. A claim holds
//! when all of its rules do. The numbers are read from the CSV files, so whoever doubts a verdict can look at the rows.

use std::path::Path;

use anyhow::{Context, Result, bail};

use super::table::{Table, number};

mod klimov;
mod li;

/// A paper, and every claim of it that can be measured.
#[derive(Debug, Clone, Copy)]
pub struct Paper {
    /// Author and year.
    pub name: &'static str,
    /// The claims, in its order.
    pub claims: &'static [Claim],
}

/// Both papers.
pub const PAPERS: [Paper; 2] =
    [Paper { name: "Klimov 2020", claims: klimov::KLIMOV }, Paper { name: "Li 2018", claims: li::LI }];

/// A sentence of a paper.
#[derive(Debug, Clone, Copy)]
pub struct Claim {
    /// The sentence, in English.
    pub quote: &'static str,
    /// Where it stands.
    pub section: &'static str,
    /// What must be so for it to hold, in words.
    pub rule: &'static str,
    /// The same in numbers.
    pub rules: &'static [Rule],
    /// What explains the verdict, or limits it.
    pub remark: &'static str,
}

/// A bound on a number, or on the ratio of two.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// The number.
    pub value: Pick,
    /// What it is divided by.
    pub over: Option<Pick>,
    /// The bound.
    pub is: Bound,
}

/// Where a number must lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// There or above.
    AtLeast(f64),
    /// There or below.
    AtMost(f64),
}

/// A number of a table: the rows that hold some texts, one column, and what becomes of several.
#[derive(Debug, Clone, Copy)]
pub struct Pick {
    /// The file's name without `.csv`.
    pub csv: &'static str,
    /// (column, text) pairs that a row must hold.
    pub rows: &'static [(&'static str, &'static str)],
    /// The column with the numbers.
    pub column: &'static str,
    /// What becomes of several.
    pub take: Take,
}

/// What becomes of several numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Take {
    /// Their mean.
    Mean,
    /// Standard deviation over mean.
    Variation,
    /// The first, in the order of the rows.
    First,
    /// The last.
    Last,
}

/// How a claim came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// All of its rules hold.
    Holds,
    /// One does not.
    Fails,
    /// Its tables are not there, or not yet.
    NotMeasured,
}

impl Verdict {
    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Fails => "does not hold",
            Self::NotMeasured => "not measured",
        }
    }
}

/// A claim with its numbers.
#[derive(Debug, Clone)]
pub struct Judged {
    /// Name of the paper.
    pub paper: &'static str,
    /// The claim.
    pub claim: &'static Claim,
    /// How it came out.
    pub verdict: Verdict,
    /// The number of each rule, with its bound: `2.31 >= 1.5`.
    pub numbers: Vec<String>,
    /// Where each number stands: `sweeps.csv: 12, 17`.
    pub places: Vec<String>,
}

/// What verdicts rest on: tables of a folder, which holds others too, from other runs.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// The folder.
    pub folder: &'a Path,
    /// Names of the files that count, without `.csv`; whether they are there yet or not.
    pub tables: &'a [&'a str],
}

/// Judges every claim.
///
/// # Errors
/// When a table is there but is not one, or lacks a column.
pub fn judge_all(by: Measured<'_>) -> Result<Vec<Judged>> {
    let claims = PAPERS.iter().flat_map(|paper| paper.claims.iter().map(|claim| (paper.name, claim)));
    claims.map(|(paper, claim)| judge(paper, claim, by).with_context(|| format!("claim {:?}", claim.quote))).collect()
}

/// Judges one claim.
///
/// # Errors
/// When a table is there but is not one, or lacks a column.
pub fn judge(paper: &'static str, claim: &'static Claim, by: Measured<'_>) -> Result<Judged> {
    let (mut numbers, mut places, mut verdict) = (Vec::new(), Vec::new(), Verdict::Holds);
    for rule in claim.rules {
        let Some(measured) = rule.measure(by)? else {
            let (verdict, numbers, places) = (Verdict::NotMeasured, Vec::new(), Vec::new());
            return Ok(Judged { paper, claim, verdict, numbers, places });
        };
        if !rule.is.admits(measured.number) {
            verdict = Verdict::Fails;
        }
        let (sign, bound) = match rule.is {
            Bound::AtLeast(b) => (">=", b),
            Bound::AtMost(b) => ("<=", b),
        };
        let missed = if rule.is.admits(measured.number) { "" } else { " (missed)" };
        numbers.push(format!("{} {sign} {bound}{missed}", three_digits(measured.number)));
        places.push(measured.place);
    }
    Ok(Judged { paper, claim, verdict, numbers, places })
}

/// The verdicts as a table.
#[must_use]
pub fn table(judged: &[Judged]) -> Table {
    let mut table = Table::new(&["paper", "claim", "section", "rule", "verdict", "numbers", "rows", "remark"]);
    for j in judged {
        let Claim { quote, section, rule, remark, .. } = j.claim;
        let texts = [j.paper, quote, section, rule, j.verdict.name()].map(str::to_owned);
        let mut row = texts.to_vec();
        row.extend([j.numbers.join("; "), j.places.join("; "), (*remark).to_owned()]);
        table.push(row);
    }
    table
}

fn three_digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return number(value);
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 8) as usize;
    format!("{value:.digits$}")
}

struct Value {
    number: f64,
    place: String,
}

impl Bound {
    /// Not a number lies nowhere.
    fn admits(self, value: f64) -> bool {
        match self {
            Self::AtLeast(bound) => value >= bound,
            Self::AtMost(bound) => value <= bound,
        }
    }
}

impl Rule {
    fn measure(&self, by: Measured<'_>) -> Result<Option<Value>> {
        let Some(top) = self.value.measure(by)? else { return Ok(None) };
        let Some(over) = self.over else { return Ok(Some(top)) };
        let Some(bottom) = over.measure(by)? else { return Ok(None) };
        let place = format!("{} over {}", top.place, bottom.place);
        Ok(Some(Value { number: top.number / bottom.number, place }))
    }
}

impl Pick {
    fn measure(&self, by: Measured<'_>) -> Result<Option<Value>> {
        let path = by.folder.join(format!("{}.csv", self.csv));
        if !by.tables.contains(&self.csv) || !path.exists() {
            return Ok(None);
        }
        let table = Table::read(&path)?;
        let column = table.column(self.column)?;
        let rows = table.find(self.rows)?;
        if rows.is_empty() {
            return Ok(None);
        }
        let failure = table.column("error").ok();
        let mut values = Vec::new();
        for (line, row) in &rows {
            // A registration that failed counts as worse than any; what is empty without one was not measured.
            let failed = failure.is_some_and(|k| !row[k].is_empty());
            if row[column].is_empty() && !failed {
                return Ok(None);
            }
            let value = if failed { f64::INFINITY } else { row[column].parse().unwrap_or(f64::NAN) };
            if value.is_nan() {
                bail!("{}, line {line}: {:?} is not a number", path.display(), row[column]);
            }
            values.push(value);
        }
        let lines: Vec<String> = match self.take {
            Take::First => vec![rows[0].0.to_string()],
            Take::Last => vec![rows[rows.len() - 1].0.to_string()],
            _ => rows.iter().map(|r| r.0.to_string()).collect(),
        };
        let lines = match &lines[..] {
            [first, .., last] if lines.len() > 3 => format!("{first}...{last}"),
            few => few.join(", "),
        };
        Ok(Some(Value { number: self.take.of(&values), place: format!("{}.csv: {lines}", self.csv) }))
    }
}

impl Take {
    /// Of at least one value.
    fn of(self, values: &[f64]) -> f64 {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        match self {
            Self::Mean => mean,
            Self::Variation => {
                let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
                (square / (values.len() - 1).max(1) as f64).sqrt() / mean
            }
            Self::First => values[0],
            Self::Last => values[values.len() - 1],
        }
    }
}
