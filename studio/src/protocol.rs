//! What page and server say to each other: one enum each way, and frames of numbers. `web/src/protocol.ts` is generated from here; a
//! test fails when it is not.
//!
//! A binary frame is `u32` length of a JSON header ([`Numbers`]), the header, zeros up to a multiple of 4, and the arrays that it
//! names, little-endian, in its order.

use serde::{Deserialize, Serialize};
use ts_rs::TS;

use crate::case::{Case, Edit, FileRef, Unit, WrapSummary};
use crate::plan::{Preset, StepView};
use crate::vault::{Article, CaseSummary};

/// What added files become.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The template.
    Template,
    /// A scan.
    Scan,
    /// A rig; its template too, where there is none yet.
    Rig,
    /// Landmarks on the scan.
    ScanLandmarks,
    /// Landmarks on the template.
    TemplateLandmarks,
    /// A photo.
    Photo,
    /// A recipe: a new plan.
    Recipe,
    /// A schedule of the registration.
    Schedule,
    /// A case that was exported: a new case.
    Case,
}

/// A file that was uploaded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, TS)]
pub struct Upload {
    /// What the server has called it.
    pub id: String,
    /// Its own name.
    pub name: String,
}

/// On which side a landmark is placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum LandmarkSide {
    /// The template.
    Template,
    /// The scan.
    Scan,
}

/// What is written for the user.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case", tag = "export")]
pub enum Export {
    /// The wrapped template.
    Wrapped {
        /// `obj`, `ply` or `glb`.
        format: String,
    },
    /// The plan in work as a recipe.
    Recipe,
    /// The face after the plan in work.
    Face {
        /// `obj`, `ply` or `glb`.
        format: String,
    },
    /// The landmarks of the scan.
    Landmarks,
    /// The whole case, a zip file.
    Case,
}

/// From the page: a message, and the case that the page shows.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct FromPage {
    /// The case; what is meant for it is not done to another one that was opened meanwhile.
    #[serde(default)]
    pub case: Option<u32>,
    /// The message.
    #[serde(flatten)]
    pub message: ClientMessage,
}

/// What the page wants.
#[derive(Debug, Clone, PartialEq, Deserialize, TS)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum ClientMessage {
    /// Asks for the cases that contain a text.
    ListCases {
        /// The text.
        query: String,
    },
    /// A new case, which is opened.
    NewCase {
        /// The client.
        name: String,
    },
    /// Opens a case.
    OpenCase {
        /// Which.
        id: u32,
    },
    /// Deletes a case.
    DeleteCase {
        /// Which.
        id: u32,
    },
    /// Changes the open case. What was made on a plan or revision that is not there any more is refused.
    Edit {
        /// The plan in work.
        plan: u32,
        /// The revision that the page shows.
        revision: u32,
        /// How.
        edit: Edit,
    },
    /// Shows what a change of the plan would do, and keeps nothing.
    Preview {
        /// The change; none shows the plan as it is.
        edit: Option<Edit>,
    },
    /// One change back.
    Undo,
    /// One change forth.
    Redo,
    /// Uploaded files join the case.
    Add {
        /// As what.
        role: Role,
        /// The files.
        files: Vec<Upload>,
        /// Their unit, if it is known.
        unit: Option<Unit>,
    },
    /// Places a landmark at the nearest point of template or scan.
    Place {
        /// Its name; none for the next pair that lacks this side, or a new one.
        name: Option<String>,
        /// Where it is placed.
        side: LandmarkSide,
        /// The point, mm.
        point: [f64; 3],
    },
    /// Places the rig's landmarks on the scan by a registration without landmarks.
    Suggest,
    /// Wraps the template onto the scan.
    Run {
        /// Goes on from the last result.
        warm: bool,
    },
    /// Wraps with several models.
    Compare {
        /// Which.
        models: Vec<String>,
    },
    /// Ends what is running.
    Cancel,
    /// Painted weights of the scan's say at each template vertex; none for 1 everywhere.
    PaintMask {
        /// One per vertex, 0 to 1.
        weights: Option<Vec<f32>>,
    },
    /// Measures the face and these plans.
    Analyse {
        /// Plans by number.
        plans: Vec<u32>,
    },
    /// Shows a mixture of two plans: 0 the first, 1 the second; and how far they differ.
    Blend {
        /// The first; none for the face before.
        from: Option<u32>,
        /// The second.
        to: u32,
        /// Share of the second.
        share: f64,
        /// Sends the distances too.
        difference: bool,
    },
    /// Writes a file for the user.
    Export {
        /// Which.
        what: Export,
    },
    /// Asks for the articles that contain a text.
    ListArticles {
        /// The text.
        query: String,
    },
    /// Adds an article (number 0) or writes one anew.
    SaveArticle {
        /// The article.
        article: Article,
    },
    /// Deletes an article.
    DeleteArticle {
        /// Which.
        id: u32,
    },
}

impl ClientMessage {
    /// Whether it is about the open case.
    #[must_use]
    pub const fn is_of_the_case(&self) -> bool {
        !matches!(
            self,
            Self::ListCases { .. }
                | Self::NewCase { .. }
                | Self::OpenCase { .. }
                | Self::DeleteCase { .. }
                | Self::Add { role: Role::Case, .. }
                | Self::Cancel
                | Self::ListArticles { .. }
                | Self::SaveArticle { .. }
                | Self::DeleteArticle { .. }
        )
    }

    /// Whether it changes nothing and only asks what something looks or would look like.
    #[must_use]
    pub const fn only_looks(&self) -> bool {
        matches!(self, Self::Preview { .. } | Self::Blend { .. } | Self::Analyse { .. })
    }
}

/// The frame of the face in which masks are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, TS)]
pub struct FrameView {
    /// Origin, mm.
    pub origin: [f64; 3],
    /// Unit vectors of x, y and z.
    pub axes: [[f64; 3]; 3],
    /// Millimetres of the mesh to one of the frame.
    pub unit: f64,
}

/// What a step did.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct StepResult {
    /// Vertices that could move.
    pub moving: u32,
    /// Longest displacement, mm.
    pub reached: f64,
    /// Triangles turned over.
    pub folded: u32,
    /// Smallest and largest length of an edge by that before.
    pub stretch: [f64; 2],
    /// Whether the surface folds or tears.
    pub tears: bool,
    /// Milliseconds are not kept; steps of the solver are.
    pub iterations: u32,
}

/// One measurement of several shapes.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct MeasureRow {
    /// What it belongs to.
    pub group: String,
    /// Its name.
    pub name: String,
    /// How it follows from landmarks.
    pub formula: String,
    /// Its unit.
    pub unit: String,
    /// Of the face before, then of each plan.
    pub values: Vec<Option<f64>>,
    /// A range from the literature.
    pub typical: Option<[f64; 2]>,
    /// Where that is written.
    pub source: String,
    /// Why there is no value.
    pub missing: String,
    /// Landmarks that it joins, on the face before, then on each plan, mm.
    pub lines: Vec<Vec<[f64; 3]>>,
}

/// A cut along the mid-sagittal plane.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct Profile {
    /// Whose.
    pub name: String,
    /// Ends of each piece: forwards and upwards, twice, mm.
    pub pieces: Vec<[f32; 4]>,
    /// Landmarks of the midline: name, forwards, upwards.
    pub points: Vec<(String, f32, f32)>,
}

/// Change of a region.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct RegionRow {
    /// The region.
    pub name: String,
    /// Area before, square mm.
    pub area: f64,
    /// Distance from the mirror image before, root mean square, mm.
    pub asymmetry: f64,
    /// Per plan: area, asymmetry, swept volume (cubic mm), largest displacement.
    pub plans: Vec<[f64; 4]>,
}

/// Measurements of the face and of plans.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct Analysis {
    /// Plans by number.
    pub plans: Vec<u32>,
    /// "before", then the plans' names.
    pub columns: Vec<String>,
    /// Measurements.
    pub rows: Vec<MeasureRow>,
    /// Regions.
    pub regions: Vec<RegionRow>,
    /// Outlines, as the columns.
    pub profiles: Vec<Profile>,
}

/// A row of the comparison of models.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct CompareRow {
    /// The model.
    pub model: String,
    /// Its numbers, if it came to an end.
    pub summary: Option<WrapSummary>,
    /// Seconds.
    pub seconds: f64,
    /// What went wrong.
    pub error: String,
}

/// To the page.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum ServerMessage {
    /// The first message.
    Welcome {
        /// Version of the server.
        version: String,
        /// Deformation models of registration.
        models: Vec<String>,
        /// Deformation models of plans.
        morph_models: Vec<String>,
        /// Ready operations.
        presets: Vec<Preset>,
        /// Folder of the vault.
        vault: String,
    },
    /// The cases that were asked for.
    Cases {
        /// The cases.
        cases: Vec<CaseSummary>,
    },
    /// The open case, after every change.
    Case {
        /// Its number.
        id: u32,
        /// Revision.
        revision: u32,
        /// The document.
        case: Box<Case>,
        /// What undo would take back.
        undo: Option<String>,
        /// What redo would do again.
        redo: Option<String>,
        /// Regions of the rig or groups of the template.
        regions: Vec<String>,
        /// The `nonrigid register` line of the last result.
        command: Option<String>,
        /// Whether that result is of the scan in work and the template, in their units.
        current: bool,
    },
    /// No case is open any more.
    NoCase,
    /// What went wrong and what to do.
    Error {
        /// In words.
        text: String,
    },
    /// What was done.
    Note {
        /// In words.
        text: String,
    },
    /// Something is running.
    Progress {
        /// What.
        what: String,
        /// How far, 0 to 1, if that is known.
        share: Option<f64>,
    },
    /// Nothing is running any more.
    Idle,
    /// A step of a registration.
    Step {
        /// Level, from 1.
        level: u32,
        /// Step since the start.
        step: u32,
        /// All levels.
        levels: u32,
        /// Energy after it.
        energy: f64,
        /// By term and regulariser.
        energies: Vec<(String, f64)>,
        /// Share of the vertices with a correspondence.
        inliers: f64,
        /// Largest motion, mm.
        motion: f64,
    },
    /// The plan in work, as it is replayed or previewed.
    Plan {
        /// Whether it is a preview.
        preview: bool,
        /// Its steps.
        steps: Vec<StepView>,
        /// What each did.
        results: Vec<StepResult>,
        /// Where masks are drawn, after the last step.
        frame: Option<FrameView>,
        /// The command line that makes the same bytes.
        command: String,
        /// Milliseconds that it took.
        milliseconds: f64,
        /// Why it could not be replayed.
        error: Option<String>,
    },
    /// Measurements.
    Analysis {
        /// Everything.
        analysis: Box<Analysis>,
    },
    /// One more model was compared.
    Compared {
        /// Its row.
        row: CompareRow,
    },
    /// A file to take.
    Exported {
        /// Where it is.
        at: FileRef,
    },
    /// The articles that were asked for.
    Articles {
        /// The articles.
        articles: Vec<Article>,
    },
    /// The unit of a file is unclear.
    UnitWanted {
        /// As what the file was added, if it waits for its unit.
        role: Role,
        /// The uploads that wait.
        files: Vec<Upload>,
        /// What is known.
        text: String,
        /// Units that are possible.
        units: Vec<Unit>,
    },
}

/// Header of a frame of numbers. Slots: `template`, `scan` and `face` are meshes; `wrapped` and `compare/MODEL` have the template's
/// triangles, `plan` and `other`, from which a blend begins, the face's.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
#[serde(rename_all = "snake_case", tag = "numbers")]
pub enum Numbers {
    /// Arrays: positions (f32, 3 per vertex), triangles (u32, 3), lines (u32, 2), colours (u8, 3 per vertex, padded to 4 bytes).
    Mesh {
        /// Slot.
        slot: String,
        /// Vertices.
        vertices: u32,
        /// Triangles.
        triangles: u32,
        /// Edges of polygons.
        lines: u32,
        /// Whether there are colours.
        colors: bool,
        /// Triangles that the file has, where fewer are shown.
        of: u32,
    },
    /// Array: positions (f32, 3 per vertex).
    Positions {
        /// Slot.
        slot: String,
        /// Vertices.
        vertices: u32,
    },
    /// Array: values (f32, one per vertex).
    Values {
        /// Slot.
        slot: String,
        /// What they are.
        title: String,
        /// Vertices.
        vertices: u32,
        /// Lower end of the colours.
        low: f32,
        /// Upper end.
        high: f32,
    },
    /// A slot is empty.
    Clear {
        /// Slot.
        slot: String,
    },
}

/// A binary frame.
#[must_use]
pub fn frame(header: &Numbers, arrays: &[&[u8]]) -> Vec<u8> {
    let header = serde_json::to_vec(header).unwrap_or_default();
    let mut out = Vec::with_capacity(header.len() + 8 + arrays.iter().map(|a| a.len() + 4).sum::<usize>());
    out.extend(u32::try_from(header.len()).unwrap_or(0).to_le_bytes());
    out.extend(&header);
    for array in arrays {
        out.resize(out.len().next_multiple_of(4), 0);
        out.extend(*array);
    }
    out
}

/// `web/src/protocol.ts`.
#[must_use]
pub fn typescript() -> String {
    use crate::{case, plan, vault};
    macro_rules! declare {
        ($($t:ty),* $(,)?) => { [$(format!("export {}\n", <$t>::decl())),*].concat() };
    }
    let types = declare!(
        case::Unit,
        case::FileRef,
        case::Source,
        case::Pair,
        case::WrapSettings,
        case::Places,
        case::Wrapped,
        case::WrapSummary,
        case::Plan,
        case::Photo,
        case::Case,
        case::Side,
        case::Which,
        case::Edit,
        plan::Drawing,
        plan::DrawnFrom,
        plan::Mask,
        plan::DrawnStep,
        plan::StepChange,
        plan::StepView,
        plan::Preset,
        vault::CaseSummary,
        vault::Article,
        Role,
        Upload,
        LandmarkSide,
        Export,
        ClientMessage,
        FrameView,
        StepResult,
        MeasureRow,
        Profile,
        RegionRow,
        Analysis,
        CompareRow,
        ServerMessage,
        Numbers,
    );
    format!(
        "// Generated from studio/src/protocol.rs by `STUDIO_WRITE=1 cargo test -p studio protocol`; not to be changed here.\n\n{types}\
         export type FromPage = {{ case: number | null }} & ClientMessage;\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_speaks_the_servers_protocol() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/web/src/protocol.ts");
        if std::env::var_os("STUDIO_WRITE").is_some() {
            std::fs::write(path, typescript()).unwrap();
        }
        let there = std::fs::read_to_string(path).unwrap_or_default();
        assert!(there == typescript(), "{path} is old: STUDIO_WRITE=1 cargo test -p studio protocol");
    }

    #[test]
    fn arrays_of_a_frame_are_aligned() {
        let bytes = frame(&Numbers::Clear { slot: "x".to_owned() }, &[&[1, 2, 3], &[4; 4]]);
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let start = (4 + length).next_multiple_of(4);
        assert_eq!(bytes[start..], [1, 2, 3, 0, 4, 4, 4, 4]);
    }
}
