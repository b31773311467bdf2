//! The program by its command line: exit codes, and files of a new case.

use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use studio::case::FileRef;
use studio::vault::Vault;

use crate::client::{scaled_sheet, sheet};

fn program() -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_nonrigid-studio"));
    program.arg("--no-open");
    program
}

#[test]
fn each_failure_has_the_exit_code_of_its_stage() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    fs::write(at("sheet.obj"), sheet()).unwrap();
    fs::write(at("tiny.obj"), scaled_sheet(1e-9)).unwrap();
    fs::write(at("bad.ply"), "ply\nformat ascii 1.0\nelement vertex -3\n").unwrap();
    fs::write(at("bad.toml"), "step = 7").unwrap();
    fs::create_dir(at("broken")).unwrap();
    fs::write(at("broken/vault.sqlite"), "no database at all, and longer than the head of one").unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let [vault, sheet, absent, tiny, bad] = ["vault", "sheet.obj", "absent.obj", "tiny.obj", "bad.ply"].map(at);
    let [recipe, broken, inside] = ["bad.toml", "broken", "sheet.obj/vault"].map(at);
    for (code, said, arguments) in [
        (1, "--port", vec!["--vault", &vault, "--port", "x"]),
        (1, "mm, cm, m, um or in", vec!["--vault", &vault, "--unit", "foot"]),
        (1, "--recipe is for a new case", vec!["--vault", &vault, "--recipe", &recipe]),
        (1, "--unit is for a new case", vec!["--vault", &vault, "--unit", "mm"]),
        (1, "choose another one with --port", vec!["--vault", &vault, "--template", &sheet, "--port", &port]),
        (3, "cannot be a vault", vec!["--vault", &inside]),
        (
            4,
            "broken: cannot be a vault: the vault's database says: file is not a database; put",
            vec!["--vault", &broken],
        ),
        (4, "absent.obj", vec!["--vault", &vault, "--template", &absent]),
        (4, "bad.ply", vec!["--vault", &vault, "--scan", &bad]),
        (4, "Say --unit", vec!["--vault", &vault, "--scan", &tiny]),
        (4, "bad.toml: ", vec!["--vault", &vault, "--template", &sheet, "--recipe", &recipe]),
    ] {
        let out = program().args(&arguments).output().unwrap();
        let error = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(code), "{arguments:?}: {error}");
        assert!(error.starts_with("error: ") && error.contains(said), "{arguments:?}: {error}");
    }
    assert_eq!(program().arg("--help").output().unwrap().status.code(), Some(0));
}

/// Starts the program on a vault, and ends it when it has said its address.
fn started(vault: &Path, arguments: &[&OsStr]) {
    let mut child = program().arg("--vault").arg(vault).args(arguments).stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(line.starts_with("http://127.0.0.1:"), "{line}");
}

#[test]
fn only_a_new_vault_gets_a_demo() {
    let folder = tempfile::tempdir().unwrap();
    let clients = || Vault::open(folder.path()).unwrap().cases("").unwrap();
    started(folder.path(), &[]);
    let demo = clients();
    assert_eq!(demo.len(), 1);
    Vault::open(folder.path()).unwrap().delete_case(demo[0].id).unwrap();
    started(folder.path(), &[]);
    assert!(clients().is_empty());
}

#[test]
fn materials_come_along_with_a_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("face.obj"), format!("mtllib face.mtl\n{}", sheet())).unwrap();
    fs::write(at("face.mtl"), "newmtl skin\nmap_Kd skin.png\nmap_Bump absent.png\n").unwrap();
    fs::write(at("skin.png"), b"\x89PNG").unwrap();
    fs::write(at("other.png"), b"of another mesh").unwrap();
    let vault = at("vault");
    started(&vault, &["--template".as_ref(), at("face.obj").as_os_str()]);

    let vault = Vault::open(&vault).unwrap();
    let case = vault.case(vault.cases("").unwrap()[0].id).unwrap().case;
    let template = case.template.unwrap();
    assert_eq!((&*case.name, &*template.name, &*template.at.file), ("face", "face.obj", "face.obj"));
    let there = vault.path(&FileRef { file: String::new(), ..template.at.clone() }).unwrap();
    let mut names: Vec<String> =
        fs::read_dir(&there).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["face.mtl", "face.obj", "skin.png"]);
    assert_eq!(fs::read(there.join("skin.png")).unwrap(), b"\x89PNG");
}
