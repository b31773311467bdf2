//! The page: one HTML file with everything in it.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use nonrigid::{page, text};

use super::claims::{Judged, PAPERS, Verdict};
use super::study::{Block, Section, Study};
use super::table::{Table, shown_cell};
use super::view3d;
use crate::output::write_file;

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

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Writes `index.html` into a folder, with the pictures that lie there inside, and every table of the page as LaTeX; the page's bytes.
///
/// # Errors
/// When a picture cannot be read or a file not be written.
pub fn write(folder: &Path, page: &Page<'_>) -> Result<usize> {
    let html = html(folder, page)?;
    for (study, state) in page.studies {
        let State::Done(section) = state else { continue };
        for (name, table) in tables_of(study.name, section) {
            write_file(&folder.join(name), table.latex())?;
        }
    }
    write_file(&folder.join("index.html"), &html)?;
    Ok(html.len())
}

/// The tables of a section, each with the name of its LaTeX file.
fn tables_of<'a>(study: &str, section: &'a Section) -> Vec<(String, &'a Table)> {
    let tables = section
        .blocks
        .iter()
        .filter_map(|block| if let Block::Table { table, .. } = block { Some(table) } else { None });
    tables.enumerate().map(|(k, table)| (format!("{study}-table{}.tex", k + 1), table)).collect()
}

fn html(folder: &Path, page: &Page<'_>) -> Result<String> {
    let mut out = String::new();
    let count = |v: Verdict| page.verdicts.iter().filter(|j| j.verdict == v).count();
    let [holds, fails, undecided, open] = Verdict::ALL.map(count);
    let unfinished = page.studies.iter().any(|s| matches!(s.1, State::Waiting | State::Running));
    write!(out, "<nav id=\"contents\"><details open><summary>Contents</summary><ol>")?;
    for (study, _) in page.studies {
        write!(out, "<li><a href=\"#{}\">{}</a></li>", study.name, text::html(study.title))?;
    }
    out.push_str("<li><a href=\"#claims\">What the papers claim</a></li></ol></details></nav>\n<main>\n");
    write!(
        out,
        "<h1>Two papers, measured</h1>\n\
         <p class=\"about\">K. V. Klimov, <i>A hybrid deformation model for the non-rigid registration of 3D scans</i>, 2020, and \
         J. Li et al., <i>Mesh morphing process for facial plastic surgery simulation</i>, 2018: their figures and their claims, on data \
         whose truth is known. {}</p>\n\
         <p>Of {} claims: <span class=\"holds\">{holds} hold</span>, <span class=\"fails\">{fails} do not</span>, <span \
         class=\"waiting\">{undecided} undecided</span>: a bound lies within what another choice of scans would do; {open} not measured{}.</p>\n",
        text::html(page.about),
        page.verdicts.len(),
        if unfinished { " yet" } else { "" },
    )?;
    for (study, state) in page.studies {
        let [title, about] = [study.title, study.about].map(text::html);
        writeln!(out, "<details class=\"study\" open><summary><h2 id=\"{}\">{title}</h2></summary>", study.name)?;
        if let State::Done(section) = state {
            writeln!(out, "<p class=\"finding\">{}</p>", text::html(&section.finding))?;
        }
        writeln!(out, "<p class=\"about\">{about}</p>")?;
        match state {
            State::Waiting => out.push_str("<p class=\"waiting\">Not yet run.</p>\n"),
            State::Running => out.push_str("<p class=\"waiting\">Running; reload this page.</p>\n"),
            State::Failed(message) => writeln!(out, "<p class=\"failed\">failed: {}</p>", text::html(message))?,
            State::Done(section) => {
                let mut tables = tables_of(study.name, section).into_iter().map(|t| t.0);
                for block in &section.blocks {
                    write_block(&mut out, folder, block, &mut tables)?;
                }
            }
        }
        out.push_str("</details>\n");
    }
    out.push_str("<details class=\"study\" open><summary><h2 id=\"claims\">What the papers claim</h2></summary>\n");
    for paper in PAPERS {
        let of_paper: Vec<&Judged> = page.verdicts.iter().filter(|j| j.paper == paper.name).collect();
        writeln!(out, "<h3>{}</h3>", paper.name)?;
        write_claims(&mut out, &of_paper)?;
    }
    out.push_str(
        "</details>\n<p class=\"about\">Every number is in a CSV and a JSON file beside this page, every plot in an SVG file; \
         <code>manifest.json</code> has version, command, configuration, seed and hashes of the inputs, <code>machine.json</code> \
         processor, threads and times.</p>\n</main>\n",
    );
    write!(out, "<script>{SCRIPT}</script>")?;
    if page
        .studies
        .iter()
        .any(|(_, state)| matches!(state, State::Done(s) if s.blocks.iter().any(|b| matches!(b, Block::View(_)))))
    {
        write!(out, "<script>{}</script>", view3d::SCRIPT)?;
    }
    Ok(page::document("nonrigid: two papers, measured", STYLE, &out))
}

fn write_block(
    out: &mut String,
    folder: &Path,
    block: &Block,
    tables: &mut impl Iterator<Item = String>,
) -> Result<()> {
    match block {
        Block::Figure { file, caption } => {
            let path = folder.join(file);
            let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
            if file.ends_with(".svg") {
                let drawing = String::from_utf8_lossy(&bytes);
                writeln!(
                    out,
                    "<figure><div class=\"drawing\">{drawing}</div><figcaption>{}</figcaption></figure>",
                    text::html(caption)
                )?;
            } else {
                out.push_str(&page::picture(&bytes, caption));
            }
        }
        Block::Table { table, caption, file } => {
            let latex = tables.next().unwrap_or_default();
            let caption = format!(
                "{} All digits: <code>{}</code>; for LaTeX: <code>{latex}</code>.",
                text::html(caption),
                text::html(file)
            );
            let header: Vec<String> = table.header.iter().map(|name| name.replace('_', " ")).collect();
            let rows = table.rows.iter().map(|row| row.iter().map(|cell| shown_cell(cell)).collect());
            out.push_str(&page::table(&caption, &header, rows));
        }
        Block::View(view) => out.push_str(&view.html()?),
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
        write!(out, "<tr><td>{}</td><td>{}</td>", text::html(j.claim.quote), text::html(j.claim.section))?;
        write!(out, "<td class=\"{class}\">{}</td><td>{}</td>", j.verdict.name(), text::html(j.claim.rule))?;
        for texts in [&j.numbers, &j.places] {
            write!(out, "<td>{}</td>", texts.iter().map(|t| text::html(t)).collect::<Vec<_>>().join("<br>"))?;
        }
        writeln!(out, "<td>{}</td></tr>", text::html(j.claim.remark))?;
    }
    out.push_str("</table></div>\n");
    Ok(())
}
