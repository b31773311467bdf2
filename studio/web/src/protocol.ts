// Generated from studio/src/protocol.rs by `STUDIO_WRITE=1 cargo test -p studio protocol`; not to be changed here.

export type Unit = "um" | "mm" | "cm" | "m" | "in";
export type FileRef = { 
/**
 * SHA-256 of names and contents, hexadecimal.
 */
asset: string, 
/**
 * The file; empty for all of them, as of a rig.
 */
file: string, };
export type Source = { 
/**
 * Where it is.
 */
at: FileRef, 
/**
 * What the page calls it.
 */
name: string, 
/**
 * Unit of its lengths.
 */
unit: Unit, };
export type Pair = { 
/**
 * Its name.
 */
name: string, 
/**
 * Vertex of the template.
 */
vertex: number | null, 
/**
 * Place on the scan, in the scan's file's unit brought to millimetres.
 */
target: [number, number, number] | null, 
/**
 * Why the place is doubtful, where it was suggested.
 */
doubt: string | null, 
/**
 * Whether the user has placed it on the scan: suggestions leave it there.
 */
by_hand: boolean, };
export type WrapSettings = { 
/**
 * Landmarks.
 */
pairs: Array<Pair>, 
/**
 * Deformation model, as the command line calls it; the usual one unless stated.
 */
model: string | null, 
/**
 * Identity modes of the rig, at most.
 */
identity_modes: number, 
/**
 * Regions outside of which the scan is not looked at; none for everywhere.
 */
regions: Array<string>, 
/**
 * Regions that follow smoothness alone.
 */
free_regions: Array<string>, 
/**
 * Bounds of expression weights.
 */
expression_bounds: [number, number] | null, 
/**
 * Bounds of identity weights.
 */
identity_bounds: [number, number] | null, 
/**
 * Painted weights of what the scan says at each template vertex (`.npy`).
 */
mask: FileRef | null, 
/**
 * A schedule (`.toml`) in place of the model's own.
 */
schedule: FileRef | null, };
export type Places = { 
/**
 * The scan.
 */
scan: Source, 
/**
 * Pairs that have a place on it.
 */
pairs: Array<Pair>, };
export type Wrapped = { 
/**
 * The mesh, millimetres.
 */
mesh: FileRef, 
/**
 * Where the registration ended, for the next one.
 */
state: FileRef, 
/**
 * The report, JSON.
 */
report: FileRef, 
/**
 * Arguments of `nonrigid` that make the same bytes; files as `asset:HASH/NAME`.
 */
command: Array<string>, 
/**
 * The model.
 */
model: string, 
/**
 * The scan's name.
 */
scan: string, 
/**
 * Its numbers.
 */
summary: WrapSummary, };
export type WrapSummary = { 
/**
 * Share of the vertices within 3 mm of the scan.
 */
within: number, 
/**
 * Median distance of those, mm.
 */
median: number, 
/**
 * 95th percentile of all distances, mm.
 */
p95: number, 
/**
 * Triangles turned over.
 */
flipped: number, 
/**
 * Probability that the error exceeds 3 mm on a face, the same share of the size on other subjects.
 */
probability: number, 
/**
 * Steps.
 */
steps: number, 
/**
 * Why the result is doubtful.
 */
doubts: Array<string>, };
export type Plan = { 
/**
 * Number within the case.
 */
id: number, 
/**
 * Its name.
 */
name: string, 
/**
 * TOML.
 */
recipe: string, };
export type Photo = { 
/**
 * The file.
 */
at: FileRef, 
/**
 * What it shows.
 */
name: string, };
export type Case = { 
/**
 * The client's name.
 */
name: string, 
/**
 * Date of the case, as the user writes it.
 */
date: string, 
/**
 * Notes.
 */
notes: string, 
/**
 * The template.
 */
template: Source | null, 
/**
 * Its rig.
 */
rig: Source | null, 
/**
 * Scans of the client.
 */
scans: Array<Source>, 
/**
 * The one in work.
 */
scan: number | null, 
/**
 * Landmarks on the other ones.
 */
places: Array<Places>, 
/**
 * How it is wrapped.
 */
wrap: WrapSettings, 
/**
 * The last result.
 */
wrapped: Wrapped | null, 
/**
 * Plans.
 */
plans: Array<Plan>, 
/**
 * The one in work.
 */
plan: number, 
/**
 * Photos.
 */
photos: Array<Photo>, };
export type Side = "both" | "left" | "right";
export type Which = "template" | "rig" | "scan";
export type Edit = { "edit": "describe", 
/**
 * Name.
 */
name: string, 
/**
 * Date.
 */
date: string, 
/**
 * Notes.
 */
notes: string, } | { "edit": "set_unit", 
/**
 * Which.
 */
which: Which, 
/**
 * Its unit.
 */
unit: Unit, } | { "edit": "use_scan", 
/**
 * Its number in the list.
 */
index: number, } | { "edit": "remove_scan", 
/**
 * Its number in the list.
 */
index: number, } | { "edit": "remove_photo", 
/**
 * Its number in the list.
 */
index: number, } | { "edit": "set_pair", 
/**
 * The pair.
 */
pair: Pair, } | { "edit": "rename_pair", 
/**
 * Its name.
 */
name: string, 
/**
 * Its new one.
 */
to: string, } | { "edit": "remove_pair", 
/**
 * Its name.
 */
name: string, } | { "edit": "set_pairs", 
/**
 * In place of all that are there.
 */
pairs: Array<Pair>, } | { "edit": "set_wrap", 
/**
 * Pairs and mask in it are ignored; without a schedule, the case's is taken away.
 */
settings: WrapSettings, } | { "edit": "new_plan", 
/**
 * Its name.
 */
name: string, 
/**
 * The plan it begins as a copy of.
 */
copy_of: number | null, 
/**
 * Or else its recipe, TOML; without either it is empty.
 */
recipe: string | null, } | { "edit": "use_plan", 
/**
 * Its number.
 */
id: number, } | { "edit": "rename_plan", 
/**
 * The name.
 */
name: string, } | { "edit": "remove_plan", 
/**
 * Its number.
 */
id: number, } | { "edit": "set_recipe", 
/**
 * TOML.
 */
recipe: string, } | { "edit": "set_preset", 
/**
 * Its name.
 */
preset: string, 
/**
 * Millimetres.
 */
amount: number, 
/**
 * Which side.
 */
side: Side, } | { "edit": "add_step", 
/**
 * The step.
 */
step: DrawnStep, } | { "edit": "change_step", 
/**
 * Its number, from 0.
 */
index: number, 
/**
 * What becomes of it.
 */
change: StepChange, } | { "edit": "move_step", 
/**
 * From.
 */
from: number, 
/**
 * To.
 */
to: number, } | { "edit": "remove_step", 
/**
 * Its number, from 0.
 */
index: number, };
export type Drawing = { "circle": { 
/**
 * Middle.
 */
centre: [number, number], 
/**
 * Radius.
 */
radius: number, } } | { "ellipse": { 
/**
 * Middle.
 */
centre: [number, number], 
/**
 * Half axes.
 */
radii: [number, number], 
/**
 * Turn of the first, degrees.
 */
angle: number, } } | { "sector": { 
/**
 * Tip.
 */
centre: [number, number], 
/**
 * Inner radius.
 */
inner: number, 
/**
 * Outer radius.
 */
outer: number, 
/**
 * First side, degrees.
 */
start: number, 
/**
 * Turn to the second, degrees.
 */
sweep: number, } } | { "polygon": { 
/**
 * Points of each.
 */
rings: Array<Array<[number, number]>>, } } | { "union": Array<Drawing> } | { "subtract": Array<Drawing> } | { "intersect": Array<Drawing> };
export type DrawnFrom = { "frame": { 
/**
 * Turn about y, degrees.
 */
yaw: number, 
/**
 * Then about x, degrees.
 */
pitch: number, } } | { "camera": { 
/**
 * Where it is.
 */
eye: [number, number, number], 
/**
 * What it looks at.
 */
target: [number, number, number], 
/**
 * Upwards.
 */
up: [number, number, number], 
/**
 * Height of the picture, mm.
 */
height: number, 
/**
 * Width and height of the drawing, pixels.
 */
size: [number, number], } };
export type Mask = { "drawn": { 
/**
 * From where.
 */
from: DrawnFrom, 
/**
 * What.
 */
drawing: Drawing, } } | { "parts": { 
/**
 * Their names.
 */
names: Array<string>, } };
export type DrawnStep = { 
/**
 * Its name.
 */
name: string, 
/**
 * Deformation model.
 */
model: string, 
/**
 * What moves.
 */
mask: Mask, 
/**
 * Width of the soft rim: standard deviation of the blur, mm.
 */
soft: number, 
/**
 * Displacement along the frame's axes, mm.
 */
displacement: [number, number, number], 
/**
 * Also the mirror image.
 */
mirror: boolean, 
/**
 * Also what the surface hides.
 */
through: boolean, 
/**
 * What is protected.
 */
protect: Array<Mask>, 
/**
 * Vertices that stay.
 */
pins: Array<number>, };
export type StepChange = { 
/**
 * Its name.
 */
name: string | null, 
/**
 * What its displacements are multiplied by.
 */
amount: number | null, 
/**
 * Deformation model.
 */
model: string | null, 
/**
 * Displacement of its first mask.
 */
displacement: [number, number, number] | null, 
/**
 * Soft rim of its masks, mm.
 */
soft: number | null, 
/**
 * Mirror image of its masks.
 */
mirror: boolean | null, 
/**
 * Which side of the face.
 */
side: Side | null, 
/**
 * What is protected, in place of what was.
 */
protect: Array<Mask> | null, };
export type StepView = { 
/**
 * Its name.
 */
name: string, 
/**
 * The ready operation that it is, whose slider moves it; of a second one like it, none.
 */
preset: string | null, 
/**
 * What its displacements are multiplied by; of a ready operation, millimetres.
 */
amount: number, 
/**
 * Which side of the face.
 */
side: Side, 
/**
 * Deformation model.
 */
model: string, 
/**
 * Displacement of its first mask.
 */
displacement: [number, number, number] | null, 
/**
 * Soft rim of its first mask, mm.
 */
soft: number, 
/**
 * Mirror image of its first mask.
 */
mirror: boolean, 
/**
 * How many masks protect.
 */
protects: number, 
/**
 * How many points are pinned.
 */
pins: number, };
export type Preset = { 
/**
 * Its name.
 */
name: string, 
/**
 * What it does.
 */
about: string, 
/**
 * Usual millimetres.
 */
amount: number, 
/**
 * From where to where it is made for.
 */
range: [number, number], };
export type CaseSummary = { 
/**
 * Its number.
 */
id: number, 
/**
 * The client.
 */
name: string, 
/**
 * Date, as the user has written it.
 */
date: string, 
/**
 * Beginning of the notes.
 */
notes: string, 
/**
 * When it was changed last, seconds since 1970.
 */
touched: number, 
/**
 * Scans.
 */
scans: number, 
/**
 * Whether a template is wrapped.
 */
wrapped: boolean, 
/**
 * Plans that have steps.
 */
plans: number, 
/**
 * Why it cannot be read, where it cannot: nothing else is known of it then.
 */
trouble: string | null, };
export type Article = { 
/**
 * Its number; 0 for a new one.
 */
id: number, 
/**
 * Title.
 */
title: string, 
/**
 * Tags, separated by blanks.
 */
tags: string, 
/**
 * Markdown.
 */
body: string, 
/**
 * A recipe (TOML), or nothing.
 */
recipe: string, };
export type Role = "template" | "scan" | "rig" | "scan_landmarks" | "template_landmarks" | "photo" | "recipe" | "schedule" | "case";
export type Upload = { 
/**
 * What the server has called it.
 */
id: string, 
/**
 * Its own name.
 */
name: string, };
export type LandmarkSide = "template" | "scan";
export type Export = { "export": "wrapped", 
/**
 * `obj`, `ply` or `glb`.
 */
format: string, } | { "export": "recipe" } | { "export": "face", 
/**
 * `obj`, `ply` or `glb`.
 */
format: string, } | { "export": "landmarks" } | { "export": "case" };
export type ClientMessage = { "type": "list_cases", 
/**
 * The text.
 */
query: string, } | { "type": "new_case", 
/**
 * The client.
 */
name: string, } | { "type": "open_case", 
/**
 * Which.
 */
id: number, } | { "type": "delete_case", 
/**
 * Which.
 */
id: number, } | { "type": "edit", 
/**
 * The plan in work.
 */
plan: number, 
/**
 * The revision that the page shows.
 */
revision: number, 
/**
 * How.
 */
edit: Edit, } | { "type": "preview", 
/**
 * The change; none shows the plan as it is.
 */
edit: Edit | null, } | { "type": "undo" } | { "type": "redo" } | { "type": "add", 
/**
 * As what.
 */
role: Role, 
/**
 * The files.
 */
files: Array<Upload>, 
/**
 * Their unit, if it is known.
 */
unit: Unit | null, } | { "type": "place", 
/**
 * Its name; none for the next pair that lacks this side, or a new one.
 */
name: string | null, 
/**
 * Where it is placed.
 */
side: LandmarkSide, 
/**
 * The point, mm.
 */
point: [number, number, number], } | { "type": "suggest" } | { "type": "run", 
/**
 * Goes on from the last result.
 */
warm: boolean, } | { "type": "compare", 
/**
 * Which.
 */
models: Array<string>, } | { "type": "cancel" } | { "type": "paint_mask", 
/**
 * One per vertex, 0 to 1.
 */
weights: Array<number> | null, } | { "type": "analyse", 
/**
 * Plans by number.
 */
plans: Array<number>, } | { "type": "blend", 
/**
 * The first; none for the face before.
 */
from: number | null, 
/**
 * The second.
 */
to: number, 
/**
 * Share of the second.
 */
share: number, 
/**
 * Sends the distances too.
 */
difference: boolean, } | { "type": "export", 
/**
 * Which.
 */
what: Export, } | { "type": "list_articles", 
/**
 * The text.
 */
query: string, } | { "type": "save_article", 
/**
 * The article.
 */
article: Article, } | { "type": "delete_article", 
/**
 * Which.
 */
id: number, };
export type FrameView = { 
/**
 * Origin, mm.
 */
origin: [number, number, number], 
/**
 * Unit vectors of x, y and z.
 */
axes: [[number, number, number], [number, number, number], [number, number, number]], 
/**
 * Millimetres of the mesh to one of the frame.
 */
unit: number, };
export type StepResult = { 
/**
 * Vertices that could move.
 */
moving: number, 
/**
 * Longest displacement, mm.
 */
reached: number, 
/**
 * Triangles turned over.
 */
folded: number, 
/**
 * Smallest and largest length of an edge by that before.
 */
stretch: [number, number], 
/**
 * Whether the surface folds or tears.
 */
tears: boolean, 
/**
 * Milliseconds are not kept; steps of the solver are.
 */
iterations: number, };
export type MeasureRow = { 
/**
 * What it belongs to.
 */
group: string, 
/**
 * Its name.
 */
name: string, 
/**
 * How it follows from landmarks.
 */
formula: string, 
/**
 * Its unit.
 */
unit: string, 
/**
 * Of the face before, then of each plan.
 */
values: Array<number | null>, 
/**
 * A range from the literature.
 */
typical: [number, number] | null, 
/**
 * Where that is written.
 */
source: string, 
/**
 * Why there is no value.
 */
missing: string, 
/**
 * Landmarks that it joins, on the face before, then on each plan, mm.
 */
lines: Array<Array<[number, number, number]>>, };
export type Profile = { 
/**
 * Whose.
 */
name: string, 
/**
 * Ends of each piece: forwards and upwards, twice, mm.
 */
pieces: Array<[number, number, number, number]>, 
/**
 * Landmarks of the midline: name, forwards, upwards.
 */
points: Array<[string, number, number]>, };
export type RegionRow = { 
/**
 * The region.
 */
name: string, 
/**
 * Area before, square mm.
 */
area: number, 
/**
 * Distance from the mirror image before, root mean square, mm.
 */
asymmetry: number, 
/**
 * Per plan: area, asymmetry, swept volume (cubic mm), largest displacement.
 */
plans: Array<[number, number, number, number]>, };
export type Analysis = { 
/**
 * Plans by number.
 */
plans: Array<number>, 
/**
 * "before", then the plans' names.
 */
columns: Array<string>, 
/**
 * Measurements.
 */
rows: Array<MeasureRow>, 
/**
 * Regions.
 */
regions: Array<RegionRow>, 
/**
 * Outlines, as the columns.
 */
profiles: Array<Profile>, };
export type CompareRow = { 
/**
 * The model.
 */
model: string, 
/**
 * Its numbers, if it came to an end.
 */
summary: WrapSummary | null, 
/**
 * Seconds.
 */
seconds: number, 
/**
 * What went wrong.
 */
error: string, };
export type ServerMessage = { "type": "welcome", 
/**
 * Version of the server.
 */
version: string, 
/**
 * Deformation models of registration.
 */
models: Array<string>, 
/**
 * Deformation models of plans.
 */
morph_models: Array<string>, 
/**
 * Ready operations.
 */
presets: Array<Preset>, 
/**
 * Folder of the vault.
 */
vault: string, } | { "type": "cases", 
/**
 * The cases.
 */
cases: Array<CaseSummary>, } | { "type": "case", 
/**
 * Its number.
 */
id: number, 
/**
 * Revision.
 */
revision: number, 
/**
 * The document.
 */
case: Case, 
/**
 * What undo would take back.
 */
undo: string | null, 
/**
 * What redo would do again.
 */
redo: string | null, 
/**
 * Regions of the rig or groups of the template.
 */
regions: Array<string>, 
/**
 * The `nonrigid register` line of the last result.
 */
command: string | null, 
/**
 * Whether that result is of the scan in work and the template, in their units.
 */
current: boolean, } | { "type": "no_case" } | { "type": "error", 
/**
 * In words.
 */
text: string, } | { "type": "note", 
/**
 * In words.
 */
text: string, } | { "type": "progress", 
/**
 * What.
 */
what: string, 
/**
 * How far, 0 to 1, if that is known.
 */
share: number | null, } | { "type": "idle" } | { "type": "step", 
/**
 * Level, from 1.
 */
level: number, 
/**
 * Step since the start.
 */
step: number, 
/**
 * All levels.
 */
levels: number, 
/**
 * Energy after it.
 */
energy: number, 
/**
 * By term and regulariser.
 */
energies: Array<[string, number]>, 
/**
 * Share of the vertices with a correspondence.
 */
inliers: number, 
/**
 * Largest motion, mm.
 */
motion: number, } | { "type": "plan", 
/**
 * Whether it is a preview.
 */
preview: boolean, 
/**
 * Its steps.
 */
steps: Array<StepView>, 
/**
 * What each did.
 */
results: Array<StepResult>, 
/**
 * Where masks are drawn, after the last step.
 */
frame: FrameView | null, 
/**
 * The command line that makes the same bytes.
 */
command: string, 
/**
 * Milliseconds that it took.
 */
milliseconds: number, 
/**
 * Why it could not be replayed.
 */
error: string | null, } | { "type": "analysis", 
/**
 * Everything.
 */
analysis: Analysis, } | { "type": "compared", 
/**
 * Its row.
 */
row: CompareRow, } | { "type": "exported", 
/**
 * Where it is.
 */
at: FileRef, } | { "type": "articles", 
/**
 * The articles.
 */
articles: Array<Article>, } | { "type": "unit_wanted", 
/**
 * As what the file was added, if it waits for its unit.
 */
role: Role, 
/**
 * The uploads that wait.
 */
files: Array<Upload>, 
/**
 * What is known.
 */
text: string, 
/**
 * Units that are possible.
 */
units: Array<Unit>, };
export type Numbers = { "numbers": "mesh", 
/**
 * Slot.
 */
slot: string, 
/**
 * Vertices.
 */
vertices: number, 
/**
 * Triangles.
 */
triangles: number, 
/**
 * Edges of polygons.
 */
lines: number, 
/**
 * Whether there are colours.
 */
colors: boolean, 
/**
 * Triangles that the file has, where fewer are shown.
 */
of: number, } | { "numbers": "positions", 
/**
 * Slot.
 */
slot: string, 
/**
 * Vertices.
 */
vertices: number, } | { "numbers": "values", 
/**
 * Slot.
 */
slot: string, 
/**
 * What they are.
 */
title: string, 
/**
 * Vertices.
 */
vertices: number, 
/**
 * Lower end of the colours.
 */
low: number, 
/**
 * Upper end.
 */
high: number, } | { "numbers": "clear", 
/**
 * Slot.
 */
slot: string, };
export type FromPage = { case: number | null } & ClientMessage;
