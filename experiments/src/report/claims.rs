//! What the papers claim, sentence by sentence, and whether the tables bear it out.
//!
//! Each claim has rules: a number taken from a table that a study wrote, alone or over another, and a bound. A table with a column
//! of [`UNITS`] holds a sample of scans, people or repetitions; its numbers have a 95 % interval over them, by the
//! [`jackknife`], which takes the same unit out of both sides of a ratio. A bound within the interval, or a sample of one, decides
//! nothing. A table without such a column is exact. The numbers are read from the CSV files, so whoever doubts a verdict can look
//! at the rows.

use std::path::Path;

use anyhow::{Context, Result, bail};

use super::table::{Table, shown};
use crate::statistics::jackknife;

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
    /// The mean of each unit's first, in the order of the rows.
    First,
    /// The mean of each unit's last.
    Last,
}

/// Columns that name what a row was measured on: what could have been another.
pub const UNITS: [&str; 4] = ["case", "scan", "face", "repetition"];

/// How a claim came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// All of its rules hold.
    Holds,
    /// One does not.
    Fails,
    /// None fails, but a bound lies within what chance may do.
    Undecided,
    /// Its tables are not there, or not yet.
    NotMeasured,
}

impl Verdict {
    /// All, in the order in which they are counted.
    pub const ALL: [Self; 4] = [Self::Holds, Self::Fails, Self::Undecided, Self::NotMeasured];

    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Fails => "does not hold",
            Self::Undecided => "undecided",
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
    /// How each rule came out, if it was measured.
    pub rules: Vec<Verdict>,
    /// The number of each rule, with its bound, interval and sample: `2.31 >= 1.5 (1.90 to 2.72, n = 4)`.
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
    let (mut rules, mut numbers, mut places) = (Vec::new(), Vec::new(), Vec::new());
    for rule in claim.rules {
        let Some(measured) = rule.measure(by)? else {
            let (rules, numbers, places) = (Vec::new(), Vec::new(), Vec::new());
            return Ok(Judged { paper, claim, verdict: Verdict::NotMeasured, rules, numbers, places });
        };
        let verdict = measured.against(rule.is);
        let (sign, bound) = match rule.is {
            Bound::AtLeast(b) => (">=", b),
            Bound::AtMost(b) => ("<=", b),
        };
        let said = match verdict {
            Verdict::Fails => ", missed",
            Verdict::Undecided => ", undecided",
            _ => "",
        };
        numbers.push(format!("{} {sign} {bound}{}{said}", shown(measured.number), measured.sample()));
        places.push(measured.place);
        rules.push(verdict);
    }
    let any = |v: Verdict| rules.contains(&v);
    let verdict = [Verdict::Fails, Verdict::Undecided].into_iter().find(|v| any(*v)).unwrap_or(Verdict::Holds);
    Ok(Judged { paper, claim, verdict, rules, numbers, places })
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

/// A number with what chance may make of it.
struct Value {
    number: f64,
    /// How many scans, people or repetitions it is of; none of an exact one.
    units: Option<usize>,
    interval: Option<[f64; 2]>,
    place: String,
}

impl Value {
    /// A number that is infinite, as failed registrations make it, is what it is; not a number decides nothing.
    fn against(&self, bound: Bound) -> Verdict {
        let ends = match (self.interval, self.units) {
            (Some(ends), _) => ends,
            (None, Some(_)) if self.number.is_finite() => return Verdict::Undecided,
            (None, _) => [self.number; 2],
        };
        match ends.map(|end| bound.admits(end)) {
            _ if self.number.is_nan() => Verdict::Undecided,
            [true, true] => Verdict::Holds,
            [false, false] => Verdict::Fails,
            _ => Verdict::Undecided,
        }
    }

    fn sample(&self) -> String {
        match (self.units, self.interval) {
            (Some(n), Some([low, high])) => format!(" ({} to {}, n = {n})", shown(low), shown(high)),
            (Some(n), None) => format!(" (n = {n})"),
            (None, _) => String::new(),
        }
    }
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
        let Some(top) = self.value.read(by)? else { return Ok(None) };
        let bottom = match self.over {
            None => None,
            Some(over) => match over.read(by)? {
                None => return Ok(None),
                bottom => bottom,
            },
        };
        let number = |without: Option<&str>| {
            let bottom = bottom.as_ref().map_or(1.0, |b| b.number(without));
            top.number(without) / bottom
        };
        let mut units: Vec<&str> = Vec::new();
        for (unit, _) in bottom.iter().chain([&top]).flat_map(|numbers| &numbers.values) {
            if let Some(unit) = unit.as_deref().filter(|u| !units.contains(u)) {
                units.push(unit);
            }
        }
        let without: Vec<f64> = units.iter().map(|unit| number(Some(unit))).collect();
        let place = bottom.iter().fold(top.place.clone(), |place, bottom| format!("{place} over {}", bottom.place));
        let (number, units) = (number(None), (!units.is_empty()).then_some(units.len()));
        Ok(Some(Value { number, units, interval: jackknife(number, &without), place }))
    }
}

/// The numbers of a pick, each with its unit if the table has any.
struct Numbers {
    values: Vec<(Option<String>, f64)>,
    take: Take,
    place: String,
}

impl Numbers {
    /// Of all units but one; not a number if that leaves none.
    fn number(&self, without: Option<&str>) -> f64 {
        let kept = || self.values.iter().filter(|(unit, _)| without.is_none() || unit.as_deref() != without);
        let mut values: Vec<f64> = Vec::new();
        match self.take {
            Take::Mean | Take::Variation => values.extend(kept().map(|v| v.1)),
            Take::First | Take::Last => {
                let mut ends: Vec<(&Option<String>, f64)> = Vec::new();
                for (unit, value) in kept() {
                    match ends.iter_mut().find(|end| end.0 == unit) {
                        Some(end) if self.take == Take::Last => end.1 = *value,
                        Some(_) => {}
                        None => ends.push((unit, *value)),
                    }
                }
                values.extend(ends.iter().map(|end| end.1));
            }
        }
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        if self.take != Take::Variation {
            return mean;
        }
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        (square / (values.len() as f64 - 1.0)).sqrt() / mean
    }
}

impl Pick {
    fn read(&self, by: Measured<'_>) -> Result<Option<Numbers>> {
        let path = by.folder.join(format!("{}.csv", self.csv));
        if !by.tables.contains(&self.csv) || !path.exists() {
            return Ok(None);
        }
        let table = Table::read(&path)?;
        let column = table.column(self.column)?;
        let unit = UNITS.iter().find_map(|unit| table.column(unit).ok());
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
            values.push((unit.map(|k| row[k].clone()), value));
        }
        let lines: Vec<String> = rows.iter().map(|r| r.0.to_string()).collect();
        let lines = match &lines[..] {
            [first, .., last] if lines.len() > 3 => format!("{first}...{last}"),
            few => few.join(", "),
        };
        Ok(Some(Numbers { values, take: self.take, place: format!("{}.csv: {lines}", self.csv) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn of(name: &'static [(&'static str, &'static str)], column: &'static str, take: Take) -> Pick {
        Pick { csv: "t", rows: name, column, take }
    }

    fn measured(rule: Rule, header: &[&str], rows: &[&[&str]]) -> Value {
        let folder = tempfile::tempdir().unwrap();
        let mut table = Table::new(header);
        rows.iter().for_each(|row| table.push(row.iter().map(ToString::to_string).collect()));
        table.write(folder.path(), "t").unwrap();
        rule.measure(Measured { folder: folder.path(), tables: &["t"] }).unwrap().unwrap()
    }

    const RATIO: Rule = Rule {
        value: of(&[("name", "a")], "rmse", Take::Mean),
        over: Some(of(&[("name", "b")], "rmse", Take::Mean)),
        is: Bound::AtMost(0.5),
    };

    /// Scans that differ tenfold, with ratios that agree: pairs decide what means alone could not.
    #[test]
    fn a_ratio_is_taken_scan_by_scan() {
        let header = ["name", "case", "rmse"];
        let rows =
            [["a", "x", "1"], ["a", "y", "10"], ["a", "z", "2"], ["b", "x", "3"], ["b", "y", "31"], ["b", "z", "6"]];
        let rows: Vec<&[&str]> = rows.iter().map(|r| &r[..]).collect();
        let value = measured(RATIO, &header, &rows);
        assert!((value.number - 13.0 / 40.0).abs() < 1e-15 && value.units == Some(3), "{}", value.number);
        let [low, high] = value.interval.unwrap();
        assert!(0.25 < low && low < 13.0 / 40.0 && high < 0.4, "{low} {high}");
        assert_eq!(value.against(Bound::AtMost(0.5)), Verdict::Holds);
        assert_eq!(value.against(Bound::AtLeast(0.5)), Verdict::Fails);
        assert_eq!(value.against(Bound::AtMost(13.1 / 40.0)), Verdict::Undecided);
        assert!(value.sample().ends_with("n = 3)"), "{}", value.sample());
    }

    #[test]
    fn one_scan_decides_nothing_and_exact_numbers_do() {
        let one = measured(RATIO, &["name", "case", "rmse"], &[&["a", "x", "1"], &["b", "x", "100"]]);
        assert_eq!((one.against(Bound::AtMost(0.5)), one.sample()), (Verdict::Undecided, " (n = 1)".into()));
        let exact = measured(RATIO, &["name", "rmse"], &[&["a", "1"], &["b", "100"]]);
        assert_eq!((exact.against(Bound::AtMost(0.5)), exact.sample()), (Verdict::Holds, String::new()));
    }

    #[test]
    fn a_failed_registration_is_worse_than_any_bound() {
        let header = ["name", "case", "rmse", "error"];
        let rows: [&[&str]; 4] =
            [&["a", "x", "", "lost"], &["a", "y", "1", ""], &["b", "x", "1", ""], &["b", "y", "1", ""]];
        let value = measured(RATIO, &header, &rows);
        assert_eq!(value.against(Bound::AtMost(0.5)), Verdict::Fails);
        assert_eq!(value.against(Bound::AtLeast(0.5)), Verdict::Holds);
    }

    #[test]
    fn first_and_last_are_those_of_each_scan() {
        let header = ["name", "case", "rmse"];
        let rows: [&[&str]; 4] = [&["a", "x", "1"], &["a", "y", "2"], &["a", "x", "10"], &["a", "y", "30"]];
        for (take, mean) in [(Take::First, 1.5), (Take::Last, 20.0)] {
            let rule = Rule { value: of(&[("name", "a")], "rmse", take), over: None, is: Bound::AtMost(0.5) };
            let value = measured(rule, &header, &rows);
            assert_eq!((value.number, value.units), (mean, Some(2)));
        }
    }
}
