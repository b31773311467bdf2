//! Studies on top of `nonrigid`.
use experiments::scan_bench::*;
use nonrigid::registration::*;
use std::path::Path;
fn main() -> anyhow::Result<()> {
    let a: Vec<String> = std::env::args().collect();
    let rig = RigData::read(Path::new(&a[2]))?;
    let model: ModelKind = a[3].parse().map_err(anyhow::Error::msg)?;
    let schedule =
        if a.len() > 4 { Schedule::from_toml(&std::fs::read_to_string(&a[4])?)? } else { model.schedule()? };
    let lm: LandmarkUse = a.get(5).map_or("all", |s| s).parse().map_err(anyhow::Error::msg)?;
    let mut dirs: Vec<_> =
        std::fs::read_dir(&a[1])?.map(|d| d.unwrap().path()).filter(|p| p.join("case.json").exists()).collect();
    dirs.sort();
    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let mut sum = (0.0, 0.0f64, 0.0, 0.0, 0.0f64, 0.0);
    for d in &dirs {
        let case = BenchCase::read(d, &rig)?;
        let (row, _) = run_case(&case, &model, &terms, &schedule, lm)?;
        let e = &row.errors;
        println!(
            "{:12} rmse {:.3} off {:.3} slide {:.3} un {:.3} p95 {:.3} max {:.2} flips {} it {} {:.2}s",
            row.case, e.rmse, e.off, e.slide, e.unobserved, e.p95, e.max, e.flipped, row.iterations, row.seconds
        );
        sum.0 += e.rmse;
        sum.1 = sum.1.max(e.rmse);
        sum.2 += e.off;
        sum.3 += e.slide;
        sum.4 = sum.4.max(e.unobserved);
        sum.5 += row.seconds;
    }
    let n = dirs.len() as f64;
    println!(
        "mean {:.4} worst {:.3} off {:.3} slide {:.3} un {:.3} sec {:.2}",
        sum.0 / n,
        sum.1,
        sum.2 / n,
        sum.3 / n,
        sum.4,
        sum.5 / n
    );
    Ok(())
}
