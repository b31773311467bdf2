//! The page: one HTML file with everything in it.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use nonrigid::console::Failure;
use nonrigid::io::write_atomically;
use nonrigid::page::{self, escaped};

use super::claims::{Judged, PAPERS, Verdict};
use super::study::{Block, Section, Study};
use super::table::shown_cell;

/// Where a study stands.
pub enum State {
    /// Not yet begun.
    Waiting,
    /// At it.
    Running,
    /// Done.
    Done(Section),
    /// Ended with an error.
    Failed(String),
}

/// What the page is made of.
pub struct Page<'a> {
    /// What was run, in a sentence.
    pub about: &'a str,
    /// The verdicts so far.
    pub verdicts: &'a [Judged],
    /// Every study, in order.
    pub studies: &'a [(&'static Study, State)],
}

const STYLE: &str = "\
table.text td{min-width:90px}table.text td:first-child{min-width:260px}\
.holds{color:#006a4e;font-weight:600}.fails{color:#a8321e;font-weight:600}\
.waiting{color:#777}.failed{color:#a8321e;white-space:pre-wrap}nav a{margin-right:14px}";

/// Writes `index.html` into a folder, with the pictures that lie there inside.
///
/// # Errors
/// When a picture cannot be read or the page not be written.
pub fn write(folder: &Path, page: &Page<'_>) -> Result<()> {
    let html = html(folder, page)?;
    let path = folder.join("index.html");
    Ok(write_atomically(&path, |file| std::io::Write::write_all(file, html.as_bytes())).map_err(Failure::writing)?)
}

fn html(folder: &Path, page: &Page<'_>) -> Result<String> {
    let mut out = String::new();
    let count = |v: Verdict| page.verdicts.iter().filter(|j| j.verdict == v).count();
    let [holds, fails, undecided, open] = Verdict::ALL.map(count);
    let unfinished = page.studies.iter().any(|s| matches!(s.1, State::Waiting | State::Running));
    write!(
        out,
        "<h1>Two papers, measured</h1>\n\
         <p class=\"about\">K. V. Klimov, <i>A hybrid deformation model for the non-rigid registration of 3D scans</i>, 2020, and \
         J. Li et al., <i>Mesh morphing process for facial plastic surgery simulation</i>, 2018: their figures and their claims, on data \
         whose truth is known. {}</p>\n\
         <p>Of {} claims <span class=\"holds\">{holds} hold</span>, <span class=\"fails\">{fails} do not</span>, <span \
         class=\"waiting\">{undecided} are undecided</span>: a bound lies within what another choice of scans would do; {open} are not \
         measured{}.</p>\n<nav>",
        escaped(page.about),
        page.verdicts.len(),
        if unfinished { " yet" } else { "" },
    )?;
    for (study, _) in page.studies {
        write!(out, "<a href=\"#{0}\">{0}</a>", study.name)?;
    }
    out.push_str("<a href=\"#claims\">claims</a></nav>\n");
    for (study, state) in page.studies {
        let [title, about] = [study.title, study.about].map(escaped);
        write!(out, "<h2 id=\"{}\">{title}</h2>\n<p class=\"about\">{about}</p>\n", study.name)?;
        match state {
            State::Waiting => out.push_str("<p class=\"waiting\">Not yet run.</p>\n"),
            State::Running => out.push_str("<p class=\"waiting\">Running; reload this page.</p>\n"),
            State::Failed(message) => writeln!(out, "<p class=\"failed\">failed: {}</p>", escaped(message))?,
            State::Done(section) => {
                for block in &section.blocks {
                    write_block(&mut out, folder, block)?;
                }
            }
        }
    }
    out.push_str("<h2 id=\"claims\">What the papers claim</h2>\n");
    for paper in PAPERS {
        let of_paper: Vec<&Judged> = page.verdicts.iter().filter(|j| j.paper == paper.name).collect();
        writeln!(out, "<h3>{}</h3>", paper.name)?;
        write_claims(&mut out, &of_paper)?;
    }
    out.push_str(
        "<p class=\"about\">Every number is in a CSV and a JSON file beside this page; <code>manifest.json</code> has version, \
         command, configuration, seed and hashes of the inputs, <code>machine.json</code> processor, threads and times.</p>\n",
    );
    Ok(page::document("nonrigid: two papers, measured", STYLE, &out))
}

fn write_block(out: &mut String, folder: &Path, block: &Block) -> Result<()> {
    match block {
        Block::Figure { file, caption } => {
            let path = folder.join(file);
            let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
            if file.ends_with(".svg") {
                let drawing = String::from_utf8_lossy(&bytes);
                writeln!(out, "<figure>{drawing}<figcaption>{}</figcaption></figure>", escaped(caption))?;
            } else {
                out.push_str(&page::picture(&bytes, caption));
            }
        }
        Block::Table { table, caption, file } => {
            let caption = format!("{} All digits: <code>{}</code>.", escaped(caption), escaped(file));
            let header: Vec<String> = table.header.iter().map(|name| name.replace('_', " ")).collect();
            let rows = table.rows.iter().map(|row| row.iter().map(|cell| shown_cell(cell)).collect());
            out.push_str(&page::table(&caption, &header, rows));
        }
    }
    Ok(())
}

fn write_claims(out: &mut String, verdicts: &[&Judged]) -> Result<()> {
    out.push_str(
        "<div class=\"wide\"><table class=\"text\"><caption>One row for each sentence that claims something. A claim holds when \
         every number of its rule does. In brackets: the 95 % interval over the n scans, people or repetitions (jackknife); a \
         bound within it decides nothing. The same in <code>claims.csv</code>.</caption>\
         <tr><th>claim</th><th>section</th><th>verdict</th><th>rule</th><th>number, bound</th><th>rows</th><th>remark</th></tr>\n",
    );
    for j in verdicts {
        let class = match j.verdict {
            Verdict::Holds => "holds",
            Verdict::Fails => "fails",
            Verdict::Undecided | Verdict::NotMeasured => "waiting",
        };
        write!(out, "<tr><td>{}</td><td>{}</td>", escaped(j.claim.quote), escaped(j.claim.section))?;
        write!(out, "<td class=\"{class}\">{}</td><td>{}</td>", j.verdict.name(), escaped(j.claim.rule))?;
        for texts in [&j.numbers, &j.places] {
            write!(out, "<td>{}</td>", texts.iter().map(|t| escaped(t)).collect::<Vec<_>>().join("<br>"))?;
        }
        writeln!(out, "<td>{}</td></tr>", escaped(j.claim.remark))?;
    }
    out.push_str("</table></div>\n");
    Ok(())
}
