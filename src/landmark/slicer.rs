//! 3D Slicer's markups: `.mrk.json` (schema 1.0.0 to 1.0.3) and `.fcsv`, both of
//! <https://slicer.readthedocs.io/en/latest/developer_guide/modules/markups.html>.
//!
//! Slicer keeps points in the patient's LPS or RAS space (towards left, posterior, superior; right, anterior, superior),
//! which differ in the signs of x and y, and the file says which. Meshes that Slicer writes are in LPS, and so are the
//! positions here, whatever the file has. Units are millimetres unless a `.mrk.json` says micrometres. Points whose
//! position is not defined are missing.

use std::fmt::Write as _;
use std::path::Path;

use super::json::Json;
use super::lines::{Lines, split_quoted};
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, LengthUnit, PatientSpace, Place, PlacedLandmark, ReadError};
use crate::text::{csv_field, from_csv_field};

const SCHEMA: &str = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#";
const COLUMNS: &str = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID";
/// Fields that newer versions add without naming them: the status of the position, and another.
const UNNAMED: usize = 2;
/// Codes of the first of them: not defined, and missing (`vtkMRMLMarkupsNode::PositionStatus`).
const NOT_PLACED: [&str; 2] = ["0", "3"];

pub(super) fn is(json: &Json) -> bool {
    json.get("markups").is_some_and(|m| m.array().is_some_and(|m| m.iter().all(|m| matches!(m, Json::Object(_)))))
}

pub(super) fn parse_json(json: &Json, path: &Path) -> Result<LandmarkSet, ReadError> {
    let wrong = |expected: &str, found: &Json| {
        let found = found.text().map_or_else(|| found.kind(), |t| format!("{t:?}"));
        ReadError::malformed(path, Place::File, expected, found)
    };
    let mut set = LandmarkSet { format: LandmarkFormat::SlicerJson, named: true, ..LandmarkSet::default() };
    for markup in json.get("markups").and_then(Json::array).unwrap_or_default() {
        let space = match markup.get("coordinateSystem") {
            None => PatientSpace::Lps,
            Some(stated) => match stated.text() {
                Some("LPS") => PatientSpace::Lps,
                Some("RAS") => PatientSpace::Ras,
                _ => return Err(wrong("\"coordinateSystem\" LPS or RAS", stated)),
            },
        };
        let unit = match markup.get("coordinateUnits") {
            None => LengthUnit::Millimetre,
            Some(stated) => match stated.array().and_then(<[Json]>::first).unwrap_or(stated).text() {
                Some("mm") => LengthUnit::Millimetre,
                Some("um") => LengthUnit::Micrometre,
                _ => return Err(wrong("\"coordinateUnits\" mm or um", stated)),
            },
        };
        (set.space, set.unit) = (Some(space), Some(unit));
        for point in markup.get("controlPoints").and_then(Json::array).unwrap_or_default() {
            let text = |key: &str| point.get(key).and_then(Json::text).filter(|t| !t.is_empty());
            let number = || (set.landmarks.len() + set.missing.len()).to_string();
            let name = text("label").or(text("id")).map_or_else(number, str::to_owned);
            if text("positionStatus").is_some_and(|s| s == "undefined" || s == "missing") {
                set.missing.push(name);
                continue;
            }
            let position = point.get("position").unwrap_or(&Json::Null).point(path, &name, "a position [x, y, z]")?;
            let place = LandmarkPlace::Position(space.to_lps(position) * unit.millimetres());
            set.landmarks.push(PlacedLandmark { name, place, sigma: None });
        }
    }
    if set.space.is_none() {
        return Err(ReadError::malformed(path, Place::File, "a markup", "none"));
    }
    Ok(set)
}

/// The columns of a file, and where those are that a point needs: x, y, z, label and id.
struct Columns {
    names: String,
    count: usize,
    at: [Option<usize>; 5],
}

impl Columns {
    fn new(names: &str) -> Self {
        let columns = split_quoted(names);
        let at = ["x", "y", "z", "label", "id"].map(|name| columns.iter().position(|c| c == name));
        Self { names: names.to_owned(), count: columns.len(), at }
    }
}

pub(super) fn parse_fcsv(text: &str, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut set = LandmarkSet {
        format: LandmarkFormat::SlicerFcsv,
        named: true,
        unit: Some(LengthUnit::Millimetre),
        ..LandmarkSet::default()
    };
    let mut columns = Columns::new(COLUMNS);
    for line in Lines::new(text, path) {
        if let Some(comment) = line.text.strip_prefix('#') {
            match comment.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
                Some(("CoordinateSystem", "LPS" | "1")) => set.space = Some(PatientSpace::Lps),
                Some(("CoordinateSystem", "RAS" | "0")) => set.space = Some(PatientSpace::Ras),
                Some(("CoordinateSystem", _)) => return Err(line.wrong("`# CoordinateSystem = ` LPS, RAS, 1 or 0")),
                Some(("columns", names)) => columns = Columns::new(names),
                _ => {}
            }
            continue;
        }
        let Some(space) = set.space else {
            return Err(line.error("a line `# CoordinateSystem = LPS` or RAS first", "a point"));
        };
        let fields = split_quoted(line.text);
        let [x, y, z, label, id] = columns.at.map(|i| fields.get(i?));
        let (Some(x), Some(y), Some(z)) = (x, y, z) else {
            return Err(line.error(format!("columns {}", columns.names), format!("{} fields", fields.len())));
        };
        line.check_width(&fields, columns.count + UNNAMED)?;
        let named = label.or(id).filter(|n| !n.is_empty()).map(|n| from_csv_field(n).to_owned());
        let name = named.unwrap_or_else(|| (set.landmarks.len() + set.missing.len()).to_string());
        let status = fields.get(columns.count);
        if status.is_some_and(|s| NOT_PLACED.contains(&s.as_str())) {
            set.missing.push(name);
            continue;
        }
        let place = LandmarkPlace::Position(space.to_lps(line.point(&[x, y, z])?));
        set.landmarks.push(PlacedLandmark { name, place, sigma: None });
    }
    Ok(set)
}

pub(super) fn render_json(set: &LandmarkSet) -> String {
    let space = set.space.unwrap_or(PatientSpace::Lps);
    let mut out = format!(
        "{{\n  \"@schema\": \"{SCHEMA}\",\n  \"markups\": [{{\n    \"type\": \"Fiducial\",\n    \
         \"coordinateSystem\": \"{space}\",\n    \"coordinateUnits\": \"mm\",\n    \"controlPoints\": ["
    );
    for (i, (landmark, p)) in set.positions().enumerate() {
        let name = super::quoted(&landmark.name);
        let position = space.to_lps(p);
        let comma = if i == 0 { "" } else { "," };
        let _ = write!(
            out,
            "{comma}\n      {{\"id\": \"{}\", \"label\": {name}, \"position\": {:?}, \"positionStatus\": \"defined\"}}",
            i + 1,
            position.as_slice()
        );
    }
    out.push_str("\n    ]\n  }]\n}\n");
    out
}

pub(super) fn render_fcsv(set: &LandmarkSet) -> String {
    let space = set.space.unwrap_or(PatientSpace::Lps);
    let mut out =
        format!("# Markups fiducial file version = 4.13\n# CoordinateSystem = {space}\n# columns = {COLUMNS}\n");
    for (i, (landmark, p)) in set.positions().enumerate() {
        let p = space.to_lps(p);
        let name = csv_field(&landmark.name);
        let _ = writeln!(out, "{},{},{},{},0,0,0,1,1,1,0,{name},,", i + 1, p.x, p.y, p.z);
    }
    out
}
