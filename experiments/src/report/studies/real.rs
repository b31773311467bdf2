//! Real scans, every model: nobody knows the truth, so what counts is distance, coverage and the state of the mesh.

use anyhow::{Result, bail};

use crate::real_scans::{COLUMNS, numbers, register_all};
use crate::report::study::{Block, Section, Setting, Study, least_and_most, ranked};
use crate::report::table::Table;

pub const STUDY: Study = Study {
    name: "real",
    title: "Real scans, every model",
    about: "Varied: the model. Held: the rig with its expressions and 60 identity modes, or as many as it has, landmarks where a scan has some, \
            the default schedules. Measured, as nobody knows the truth: the share of vertices with an accepted correspondence, the median \
            distance to the scan, self-intersections, the stretch of edges.",
    tables: &["real"],
    seconds: |effort| 6.0 * effort.models.len() as f64,
    run,
};

fn run(setting: &Setting<'_>) -> Result<Section> {
    let Some(real) = &setting.data.real else {
        bail!("--scans holds no scan but cases with truth");
    };
    let arguments = real.arguments(setting.effort.models.clone(), setting.out.join("real"));
    let (rows, picture) = register_all(&arguments, &real.scans)?;
    let mut table = Table::new(&[&["scan", "model"][..], &COLUMNS, &["error"]].concat());
    for row in &rows {
        let mut cells = vec![row.scan.clone(), row.model.clone()];
        cells.extend(row.fit.as_ref().map_or_else(|| vec![String::new(); COLUMNS.len()], |fit| numbers(fit, 6)));
        cells.push(row.error.clone().unwrap_or_default());
        table.push(cells);
    }
    table.write(setting.out, "real")?;
    let caption = "Each scan and what every model makes of it. The results are in the folder real, as OBJ.";
    let picture = setting.picture("real", &picture, caption)?;
    let caption = "The same in numbers, millimetres; median and share over vertices within 3 mm as well.";
    let finding = least_and_most("median distance to the scan", &ranked(&table, &[], "model", "median")?, " mm");
    Ok(Section {
        finding,
        blocks: vec![picture, Block::Table { table, caption: caption.into(), file: "real.csv".into() }],
    })
}
