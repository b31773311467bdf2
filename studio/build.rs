//! Bundles the page (`web/`) with vite when the bundle is absent or older than its sources, and embeds it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, exit};
use std::time::SystemTime;
use std::{env, fs};

const INPUTS: [&str; 6] = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts", "src"];

fn fail(why: &str) -> ! {
    // one sentence, not a backtrace
    eprintln!("{why}");
    println!("cargo::error={why}");
    exit(1)
}

fn files(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let mut inside: Vec<PathBuf> = fs::read_dir(path).into_iter().flatten().flatten().map(|e| e.path()).collect();
    inside.sort();
    inside.iter().flat_map(|p| files(p)).collect()
}

fn newest(paths: &[PathBuf]) -> SystemTime {
    let time = |p: &PathBuf| fs::metadata(p).and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    paths.iter().map(time).max().unwrap_or(SystemTime::UNIX_EPOCH)
}

fn npm(web: &Path, arguments: &[&str]) {
    let program = if cfg!(windows) { "npm.cmd" } else { "npm" };
    match Command::new(program).args(arguments).current_dir(web).output() {
        Err(_) => fail(
            "the studio's page is built by npm, which is not here: install Node 20 or newer (nodejs.org) and build again",
        ),
        Ok(out) if out.status.success() => {}
        Ok(out) => {
            let said = [out.stdout, out.stderr].map(|b| String::from_utf8_lossy(&b).into_owned()).concat();
            eprintln!("{said}");
            fail(&format!("npm {} failed in {}: see above", arguments.join(" "), web.display()));
        }
    }
}

fn main() {
    let web = Path::new(&env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default()).join("web");
    let sources: Vec<PathBuf> = INPUTS.iter().flat_map(|name| files(&web.join(name))).collect();
    INPUTS.iter().for_each(|name| println!("cargo::rerun-if-changed=web/{name}"));
    let bundle = web.join("dist");
    let made = |path: &Path| fs::metadata(path).and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    if made(&bundle.join("index.html")) < newest(&sources) {
        let lock = web.join("package-lock.json");
        if made(&web.join("node_modules/.package-lock.json")) < made(&lock) {
            npm(&web, &["ci", "--no-audit", "--no-fund"]);
        }
        npm(&web, &["run", "build"]);
    }
    let mut list = String::from("&[\n");
    for file in files(&bundle) {
        let name = file.strip_prefix(&bundle).unwrap_or(&file).to_string_lossy().replace('\\', "/");
        let _ = writeln!(list, "    ({name:?}, include_bytes!({:?})),", file.display().to_string());
    }
    list.push(']');
    let out = Path::new(&env::var_os("OUT_DIR").unwrap_or_default()).join("page.rs");
    if let Err(error) = fs::write(&out, list) {
        fail(&format!("{}: {error}", out.display()));
    }
}
