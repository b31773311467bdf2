//! `nonrigid animate`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use serde::Serialize;

use super::inputs::{Align, ShapeKindArgument, frames, read_rig, rig_files};
use super::units::{UnitArguments, Units};
use super::{
    Failure, Stage, check_output, check_plan, has_extension, same_place, say, warn, warn_of_format, warn_of_materials,
};
use crate::io::{
    Clip, FilePlan, MaterialFiles, MeshFile, Motion, write_animated_glb, write_json, write_pc2, write_usda,
};
use crate::mesh::{PolygonMesh, Pose, Vec3};
use crate::motion::{Lost, Track, flicker};
use crate::rig::{FittedFrame, ShapeSelection, WeightFitOptions, WeightFitter};

/// Arguments of `nonrigid animate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Frames are meshes of one topology, such as `nonrigid batch` leaves for a sequence, in the order of their names\n\
    (f2 before f10) or of --list. A frame that is missing, or jumps away from those round it, is lost: it is named, also in the .usda and .glb.\n\
    With --smooth what flickers from frame to frame goes, and lost frames are bridged by the motion of the others.\n\
    .usda: a mesh with points over time, millimetres, y up. .pc2: a point cache; load the first frame beside it.\n\
    .glb: morph targets. Without --rig one for each frame but the first; with it the rig's shapes and a pose, and one for each frame\n\
    that holds what they do not explain. Colours of vertices, which .pc2 has none of, are those of the first frame.\n\n\
    Examples:\n  nonrigid animate --meshes wrapped --out ann.usda\n  \
    nonrigid animate --meshes wrapped --fps 30 --smooth 4 --out ann.glb"
)]
pub struct Arguments {
    /// The frames: every .obj and .ply in this folder, or where there are none every .glb, by name
    #[arg(long, value_name = "DIR")]
    meshes: PathBuf,
    /// The frames' order: a line for each, the name of its file in that folder, or `-` and a name of one that is missing. Lines that start
    /// with `#` are skipped; a name that starts with either has `./` before it
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// The rig that explains the frames: a folder, .npz, .glb or .gltf
    #[arg(long, value_name = "DIR|FILE")]
    rig: Option<PathBuf>,
    /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
    #[arg(long, value_enum, requires = "rig")]
    shape_kind: Option<ShapeKindArgument>,
    /// How many of the first identity modes explain frames as well
    #[arg(long, value_name = "N", default_value_t = 0, requires = "rig")]
    identity_modes: usize,
    /// Frames a second, 1 to 1000, such as 23.976 [default: 60]
    #[arg(long, value_name = "N", value_parser = frame_rate)]
    fps: Option<f64>,
    /// Smooth the frames in time: what changes HZ times a second is halved, what changes slower stays, what changes faster goes;
    /// or none: the frames as they are
    #[arg(long, value_name = "HZ", default_value = "none")]
    smooth: Cutoff,
    #[command(flatten)]
    units: UnitArguments,
    /// The animation: .usda, .pc2 or .glb
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Report (.json): which frames are lost and why, how much they flicker
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// What is said of an animation.
#[derive(Debug, Serialize)]
struct Report<'a> {
    version: &'static str,
    frames_per_second: serde_json::Number,
    smooth_hz: Option<f64>,
    /// Root mean square of the vertices' second differences in time, millimetres, before and after smoothing; motion counts, too.
    second_difference_mm: [f64; 2],
    frames: Vec<FrameReport<'a>>,
    /// Frames at which the motion begins anew, and is not smoothed over.
    cuts: Vec<&'a str>,
}

#[derive(Debug, Serialize)]
struct FrameReport<'a> {
    name: &'a str,
    /// Why it is lost.
    lost: Option<String>,
}

/// Frames a second, where nothing else is asked for.
pub const FRAME_RATE: f64 = 60.0;

/// Frames a second from text.
pub fn frame_rate(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|rate| (1.0..=1000.0).contains(rate));
    found.ok_or_else(|| format!("'{text}' is no number from 1 to 1000"))
}

/// What of the options of an animation of this format has no effect, if anything: `asked` frames a second, if any were, smoothing at `smooth`
/// Hz.
pub fn without_effect(format: &str, asked: Option<f64>, smooth: Option<f64>) -> Option<String> {
    let rate = asked.unwrap_or(FRAME_RATE);
    match smooth {
        Some(hz) if hz >= rate / 2.0 => {
            Some(format!("--smooth {hz}: nothing is smoothed, as that is half of --fps {rate} or more"))
        }
        None if format == "pc2" && asked.is_some() => {
            Some("--fps: has no effect on a .pc2 with --smooth none: frames are all it holds".to_owned())
        }
        _ => None,
    }
}

/// A frequency, Hz, or none.
#[derive(Debug, Clone, Copy)]
pub struct Cutoff(pub Option<f64>);

impl FromStr for Cutoff {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let above = |hz: &f64| hz.is_finite() && *hz > 0.0;
        match text.parse().ok().filter(above) {
            _ if text == "none" => Ok(Self(None)),
            None => Err(format!("'{text}' is neither a frequency above 0, such as 4, nor none")),
            hz => Ok(Self(hz)),
        }
    }
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    check_output(&a.out, &["usda", "pc2", "glb"])?;
    let extension = a.out.extension().unwrap_or_default().to_ascii_lowercase();
    if a.rig.is_some() && extension != "glb" {
        return Err(Failure::new(Stage::Arguments, "--rig: only .glb has weights; leave it out, or write .glb"));
    }
    let files = files(a)?;
    // in another folder, or beside frames of another format, it is none
    let folder = a.out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let of_frames = |(_, path): &(_, Option<PathBuf>)| path.as_ref().is_some_and(|path| has_extension(path, "glb"));
    if a.list.is_none() && extension == "glb" && same_place(&a.meshes, folder) && files.iter().any(of_frames) {
        let message = "--out is in the folder of --meshes: it would be one of the frames the next time";
        return Err(Failure::new(Stage::Arguments, format!("{message}; give another folder")));
    }
    let plan = FilePlan::new()
        .reads_all(files.iter().filter_map(|(_, path)| Some(("meshes", path.clone()?))))
        .reads_all(a.list.iter().map(|list| ("list", list.clone())))
        .reads_all(a.rig.iter().flat_map(|rig| rig_files(rig)))
        .writes("--out", &a.out)
        .writes_all(a.report.iter().map(|report| ("--report", report.clone())));
    check_plan(&plan)?;
    let mut units = a.units.of_given(&[("meshes", true), ("rig", a.rig.is_some())])?;
    let (path, mesh, colors, given) = read_frames(&files, &mut units)?;
    let colors = colors.as_deref();
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    let before = flicker(&given.iter().flatten().collect::<Vec<_>>());
    let smooth = a.smooth.0;
    let rate = a.fps.unwrap_or(FRAME_RATE);
    without_effect(extension.to_str().unwrap_or_default(), a.fps, smooth).iter().for_each(warn);
    let cutoff = smooth.map(|hz| hz / rate);
    let track = Track::follow(given, cutoff).map_err(|e| Failure::loading(format!("{}: {e}", a.meshes.display())))?;
    let clip = Clip { frames: &track.frames, frames_per_second: rate, lost: &track.lost_frames() };
    match extension.to_str() {
        Some("usda") => write_usda(&a.out, &mesh, colors, &clip, None).map_err(Failure::writing)?,
        Some("pc2") => write_pc2(&a.out, clip.frames).map_err(Failure::writing)?,
        _ => write_glb(a, &mut units, (&mesh, colors), &clip, &names)?,
    }
    units.say();
    if extension != "pc2" {
        warn_of_format(&a.out, &mesh);
        warn_of_materials(&a.out, path, &mesh, &MaterialFiles::default());
    }
    let lost = |k: usize| track.lost[k].map(|lost| why(lost, smooth.is_some()));
    for (k, why) in (0..names.len()).filter_map(|k| Some((k, lost(k)?))) {
        warn(format_args!("frame {:?} is lost: {why}", names[k]));
    }
    let cuts: Vec<&str> = track.cuts.iter().map(|&k| names[k]).collect();
    for cut in &cuts {
        warn(format_args!(
            "the motion begins anew at frame {cut:?}: what lies before it and after it is followed by itself"
        ));
    }
    if let Some(path) = &a.report {
        let frames = names.iter().enumerate().map(|(k, name)| FrameReport { name, lost: lost(k) }).collect();
        let second_difference_mm = [before, flicker(&track.frames)];
        let whole = (rate.fract() == 0.0).then(|| (rate as u64).into());
        let frames_per_second = whole.or_else(|| serde_json::Number::from_f64(rate)).unwrap_or_else(|| 0.into());
        let version = env!("CARGO_PKG_VERSION");
        write_json(path, &Report { version, frames_per_second, smooth_hz: smooth, second_difference_mm, frames, cuts })
            .map_err(Failure::writing)?;
    }
    say(format_args!("{} frames of {} vertices, {rate} a second", names.len(), mesh.positions.len()))?;
    say(format_args!("wrote {}", a.out.display()))
}

/// Why a frame is lost, and what is in its place.
fn why(lost: Lost, smooth: bool) -> String {
    let bridged = "the motion of those round it stands in its place";
    match lost {
        Lost::Missing => format!("there is none; {bridged}"),
        Lost::Jump(by) if smooth => format!("it jumps {by:.1} mm away from those round it; {bridged}"),
        Lost::Jump(by) => format!("it jumps {by:.1} mm away from those round it, and is as it was"),
    }
}

/// Names and files of the frames in their order, no file for one that is missing.
fn files(a: &Arguments) -> Result<Vec<(String, Option<PathBuf>)>, Failure> {
    let Some(list) = &a.list else {
        return Ok(frames(&a.meshes)?.into_iter().map(|(name, path)| (name, Some(path))).collect());
    };
    let text = std::fs::read_to_string(list).map_err(|e| Failure::loading(format!("{}: {e}", list.display())))?;
    let frame = |line: &str| match line.strip_prefix('-') {
        Some(missing) => (missing.trim().to_owned(), None),
        None => {
            let stem = Path::new(line).file_stem().unwrap_or_default();
            (stem.to_string_lossy().into_owned(), Some(a.meshes.join(line)))
        }
    };
    let files: Vec<_> = text
        .trim_start_matches('\u{feff}')
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(frame)
        .collect();
    if files.iter().all(|(_, path)| path.is_none()) {
        return Err(Failure::loading(format!("{}: names no frame that is there", list.display())));
    }
    Ok(files)
}

/// Positions of the vertices of a frame; `None` where it is missing.
type Frame = Option<Vec<Vec3>>;

/// Red, green, blue of vertices.
type Colors = Vec<[u8; 3]>;

/// The first frame that is there, its file and its colours if it has any, and the positions of all.
type Frames<'a> = (&'a Path, PolygonMesh, Option<Colors>, Vec<Frame>);

fn read_frames<'a>(files: &'a [(String, Option<PathBuf>)], units: &mut Units<'_>) -> Result<Frames<'a>, Failure> {
    let mut first: Option<(&Path, PolygonMesh, Option<Colors>)> = None;
    let mut frames = Vec::with_capacity(files.len());
    for path in files.iter().map(|(_, path)| path) {
        let Some(path) = path else {
            frames.push(None);
            continue;
        };
        let MeshFile { mesh, colors, .. } = units.read_mesh_file("meshes", path)?;
        let (other, of, _) = first.get_or_insert_with(|| (path, mesh.clone(), colors));
        if (mesh.positions.len(), &mesh.starts, &mesh.corners) != (of.positions.len(), &of.starts, &of.corners) {
            let (path, other) = (path.display(), other.display());
            return Err(Failure::loading(format!("{path}: has other vertices or polygons than {other}")));
        }
        frames.push(Some(mesh.positions));
    }
    let (path, first, colors) = first.ok_or_else(|| Failure::loading("no frames"))?;
    Ok((path, first, colors, frames))
}

fn write_glb(
    a: &Arguments,
    units: &mut Units<'_>,
    (mesh, colors): (&PolygonMesh, Option<&[[u8; 3]]>),
    clip: &Clip<'_>,
    frame_names: &[&str],
) -> Result<(), Failure> {
    let frames = clip.frames;
    let (rest, mut targets, mut deltas, fitted) = match &a.rig {
        None => (frames[0].clone(), Vec::new(), Vec::new(), Vec::new()),
        Some(path) => explained(a, path, units, frames, frame_names)?,
    };
    let shapes = targets.len();
    let vertices = rest.len();
    // What shapes explain of a frame, in the rest's frame.
    let residual = |k: usize| -> Vec<f32> {
        let Some(FittedFrame { weights, pose, .. }) = fitted.get(k) else {
            return frames[k].iter().zip(&rest).flat_map(|(p, r)| <[f64; 3]>::from(p - r)).map(|x| x as f32).collect();
        };
        let mut left: Vec<f64> =
            frames[k].iter().zip(&rest).flat_map(|(p, r)| <[f64; 3]>::from(pose.apply_inverse(*p) - r)).collect();
        for (w, shape) in weights.iter().zip(deltas.chunks_exact(3 * vertices)) {
            left.iter_mut().zip(shape).for_each(|(x, d): (&mut f64, &f32)| *x -= w * f64::from(*d));
        }
        left.into_iter().map(|x| x as f32).collect()
    };
    // The first frame of an animation without a rig is its rest.
    let first = usize::from(fitted.is_empty());
    let residuals: Vec<f32> = (first..frames.len()).flat_map(residual).collect();
    let mut weights = Vec::with_capacity(frames.len());
    for k in 0..frames.len() {
        let mut of_frame = fitted.get(k).map_or_else(Vec::new, |f| f.weights.clone());
        of_frame.extend((first..frames.len()).map(|other| f64::from(u8::from(other == k))));
        weights.push(of_frame);
    }
    // a frame may be held, and two files be called alike
    let mut taken: BTreeSet<String> = targets.iter().cloned().collect();
    for (k, name) in frame_names.iter().enumerate().skip(first) {
        let plain = format!("frame {name}");
        let mut all = std::iter::successors(Some(plain.clone()), |last| Some(format!("{last} at {k}")));
        targets.push(all.find(|own| taken.insert(own.clone())).unwrap_or(plain));
    }
    deltas.extend(residuals);
    let poses: Vec<Pose> = (0..frames.len()).map(|k| fitted.get(k).map_or_else(Pose::identity, |f| f.pose)).collect();
    let (frames_per_second, lost) = (clip.frames_per_second, clip.lost);
    let motion = Motion { frames_per_second, poses: &poses, weights: &weights, lost };
    let names: Vec<&str> = targets.iter().map(String::as_str).collect();
    write_animated_glb(&a.out, &mesh.with_positions(rest), colors, &names, &deltas, &motion)
        .map_err(Failure::writing)?;
    if shapes > 0 {
        let squares = fitted.iter().map(|f| f.rms * f.rms).sum::<f64>() / fitted.len() as f64;
        say(format_args!(
            "{shapes} shapes explain the frames to {:.3} mm rms; the rest is in targets of their own",
            squares.sqrt()
        ))?;
    }
    Ok(())
}

/// The rig's neutral, its shapes' names and displacements, and how it explains the frames.
type Explained = (Vec<Vec3>, Vec<String>, Vec<f32>, Vec<FittedFrame>);

fn explained(
    a: &Arguments,
    path: &Path,
    units: &mut Units<'_>,
    frames: &[Vec<Vec3>],
    frame_names: &[&str],
) -> Result<Explained, Failure> {
    let at_rig = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
    let rig = read_rig(path, usize::MAX, a.shape_kind, units)?;
    let selection = ShapeSelection { names: None, identity_modes: a.identity_modes };
    let basis = rig.select(selection).map_err(|e| at_rig(&e))?;
    let names: Vec<String> = basis.shapes().iter().map(|s| s.name.clone()).collect();
    let index = |name: &String| rig.find(name).map(|k| rig.deltas(k));
    let deltas = names.iter().map(index).collect::<Result<Vec<_>, _>>().map_err(|e| at_rig(&e))?.concat();
    // modes of how faces differ go below zero
    let bounds = if a.identity_modes > 0 { [-5.0, 5.0] } else { [0.0, 1.0] };
    let options = WeightFitOptions { bounds, pose: Align::Rigid.pose(), ..WeightFitOptions::default() };
    let mut fitter = WeightFitter::new(rig.neutral(), rig.mesh(), basis, &options).map_err(|e| at_rig(&e))?;
    let mut fitted = Vec::with_capacity(frames.len());
    for (frame, name) in frames.iter().zip(frame_names) {
        let found = fitter.fit(frame).map_err(|e| Failure::loading(format!("frame {name:?}: {e}")))?;
        found.doubts.iter().for_each(|doubt| warn(format_args!("frame {name:?}: {doubt}")));
        fitted.push(found);
    }
    Ok((rig.neutral().to_vec(), names, deltas, fitted))
}
