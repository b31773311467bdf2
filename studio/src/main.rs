//! `nonrigid-studio`: the server's command line.

use std::io::Write as _;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use clap::Parser;
use nonrigid::console::{Failure, Stage, answer};
use studio::case::{Case, Edit, FileRef, Source, Unit};
use studio::demo;
use studio::server::Server;
use studio::session::Hub;
use studio::store::{guess_unit, points_of_mesh, points_of_rig};
use studio::vault::Vault;

/// Wrap templates onto scans, plan and measure changes of faces, and keep clients' files, in a browser.
///
/// Without files it opens the case that was changed last, or in a new vault a demo.
#[derive(Debug, Parser)]
#[command(name = "nonrigid-studio", version, max_term_width = 110)]
#[command(after_help = "Exit codes: 0 done, 1 arguments, 2 computation, 3 writing, 4 loading.")]
struct Arguments {
    /// Template of a new case (any mesh that `nonrigid register` reads)
    #[arg(long, value_name = "MESH")]
    template: Option<PathBuf>,
    /// Rig of a new case: a folder, .npz or .glb
    #[arg(long, value_name = "DIR")]
    rig: Option<PathBuf>,
    /// Scan of a new case; may be given several times
    #[arg(long, value_name = "MESH")]
    scan: Vec<PathBuf>,
    /// Recipe of a new case (.toml)
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Unit of these files [default: what the format states, or else by size]
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    unit: Option<Unit>,
    /// Where clients' files are kept [default: nonrigid-studio in the user's data folder]
    #[arg(long, value_name = "DIR")]
    vault: Option<PathBuf>,
    /// Port [default: a free one]
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Address to listen on, 0.0.0.0 for all of this machine's; any but 127.0.0.1 lets others on the network try, and nothing is
    /// encrypted
    #[arg(long, default_value = "127.0.0.1")]
    host: IpAddr,
    /// Do not open the browser
    #[arg(long)]
    no_open: bool,
}

fn unit(text: &str) -> Result<Unit, String> {
    let all = [Unit::Mm, Unit::Cm, Unit::M, Unit::Um, Unit::In];
    all.into_iter().find(|u| u.length().to_string() == text).ok_or_else(|| "mm, cm, m, um or in".to_owned())
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return answer(&error),
    };
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn run(arguments: &Arguments) -> Result<(), Failure> {
    let with_files = arguments.template.is_some() || arguments.rig.is_some() || !arguments.scan.is_empty();
    for (option, given) in [("--recipe", arguments.recipe.is_some()), ("--unit", arguments.unit.is_some())] {
        if given && !with_files {
            let text = format!("{option} is for a new case: say --template, --rig or --scan too");
            return Err(Failure::new(Stage::Arguments, text));
        }
    }
    let folder = arguments.vault.clone().map_or_else(data_folder, Ok)?;
    let known = folder.join("vault.sqlite").exists();
    let vault = Vault::open(&folder).map_err(|e| if known { Failure::loading(e) } else { Failure::writing(e) })?;
    let first = if with_files {
        Some(new_case(&vault, arguments)?)
    } else if !known {
        eprintln!("a new vault, {}: making the demo", folder.display());
        Some(demo::add(&vault).map_err(Failure::writing)?)
    } else {
        None
    };
    let hub = Arc::new(Hub::new(vault));
    if let (Some(id), Ok(mut case)) = (first, hub.first_case.lock()) {
        *case = Some(id);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(Failure::computation)?;
    runtime.block_on(async {
        let bound = Server::bind(hub, arguments.host, arguments.port).await;
        let server = bound.map_err(|e| Failure::new(Stage::Arguments, e.0))?;
        let address = server.address();
        let mut out = std::io::stdout();
        let said = writeln!(out, "{address}").and_then(|()| out.flush());
        said.map_err(|e| Failure::writing(format!("standard output: {e}")))?;
        if let Some(names) = server.names() {
            let names: String = names.iter().map(|name| format!(", or {name}")).collect();
            eprintln!("on other machines, put an address of this one{names} in place of the one above");
        }
        if !arguments.no_open {
            open_browser(&address);
        }
        tokio::select! {
            outcome = server.run() => outcome.map_err(Failure::computation),
            _ = tokio::signal::ctrl_c() => Ok(()),
        }
    })?;
    // jobs that still run have written nothing yet
    runtime.shutdown_background();
    Ok(())
}

/// `$XDG_DATA_HOME`, or where the system keeps such things.
fn data_folder() -> Result<PathBuf, Failure> {
    let of = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let home = || {
        of("HOME").map(|home| {
            if cfg!(target_os = "macos") { home.join("Library/Application Support") } else { home.join(".local/share") }
        })
    };
    let folder = of("XDG_DATA_HOME").or_else(|| of("APPDATA")).or_else(home);
    let unknown = || Failure::new(Stage::Arguments, "no home folder is known: say --vault DIR");
    folder.map(|f| f.join("nonrigid-studio")).ok_or_else(unknown)
}

/// A file or folder, copied into the vault.
fn taken(vault: &Vault, path: &Path, rig: bool, unit: Option<Unit>) -> Result<Source, Failure> {
    let unreadable = |e: std::io::Error| Failure::loading(format!("{}: {e}", path.display()));
    let points = if rig { points_of_rig(path) } else { points_of_mesh(path) }.map_err(Failure::loading)?;
    let unit = unit
        .map_or_else(|| guess_unit(path, &points), Ok)
        .map_err(|(text, _)| Failure::loading(format!("{text} Say --unit")))?;
    let incoming = vault.incoming().map_err(Failure::writing)?;
    let files: Vec<PathBuf> = if path.is_dir() {
        let entries = std::fs::read_dir(path).map_err(unreadable)?;
        let all = entries.map(|e| e.map(|e| e.path())).collect::<Result<Vec<_>, _>>().map_err(unreadable)?;
        all.into_iter().filter(|p| p.is_file()).collect()
    } else {
        let named = nonrigid::io::files_of_painted_mesh(path);
        named.into_iter().filter(|file| file == path || file.is_file()).collect()
    };
    for file in files {
        let name = file.file_name().unwrap_or_default();
        if !name.to_string_lossy().starts_with('.') {
            std::fs::copy(&file, incoming.folder.join(name)).map_err(unreadable)?;
        }
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let file = if path.is_dir() { String::new() } else { name.clone() };
    Ok(Source { at: FileRef { asset: vault.take(&incoming).map_err(Failure::writing)?, file }, name, unit })
}

fn new_case(vault: &Vault, arguments: &Arguments) -> Result<u32, Failure> {
    let Arguments { template, rig, scan, recipe, unit, .. } = arguments;
    let take = |path: &PathBuf, is_rig| taken(vault, path, is_rig, *unit);
    let mut case = Case {
        template: template.as_ref().map(|p| take(p, false)).transpose()?,
        rig: rig.as_ref().map(|p| take(p, true)).transpose()?,
        scans: scan.iter().map(|p| take(p, false)).collect::<Result<_, _>>()?,
        ..Case::default()
    };
    if let (None, Some(rig), Some(path)) = (&case.template, &case.rig, rig)
        && path.join("template.obj").exists()
    {
        let at = FileRef { file: "template.obj".to_owned(), ..rig.at.clone() };
        case.template = Some(Source { at, name: "template.obj".to_owned(), unit: rig.unit });
    }
    if let Some(path) = recipe {
        let recipe = nonrigid::io::read_text(path).map_err(Failure::loading)?;
        let unusable = |e| Failure::loading(format!("{}: {e}", path.display()));
        case.apply(&Edit::SetRecipe { recipe }).map_err(unusable)?;
    }
    case.scan = (!case.scans.is_empty()).then_some(0);
    let named = scan.first().or(template.as_ref()).or(rig.as_ref());
    if let Some(name) = named.and_then(|p| p.file_stem()) {
        case.name = name.to_string_lossy().into_owned();
    }
    vault.add_case(&case).map_err(Failure::writing)
}

/// Asks the desktop to show an address. Where there is none, the address is printed all the same.
fn open_browser(address: &str) {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let quiet = std::process::Stdio::null;
    let started = std::process::Command::new(program).arg(address).stdout(quiet()).stderr(quiet()).spawn();
    if started.is_err() {
        eprintln!("open this address in a browser");
    }
}
