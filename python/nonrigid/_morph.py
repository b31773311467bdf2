"""Changing a face by masks, and measuring it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import _nonrigid
from ._mesh import Floats, Mesh, PathLike, bounds_of, count, count_or_none, indices, is_array, is_npy, is_path, load, names_of, warn, whole
from ._registration import _landmarks
from ._rig import Rig, _vertices, parts_of

MorphModel = Literal["direct", "hybrid", "blendshape", "gpmm", "graph", "sumner", "arap", "poisson", "laplacian", "mass_spring", "fem", "ffd", "free"]


class Preset(NamedTuple):
    """A recipe that comes with the package."""

    name: str
    amount: float
    """How many millimetres, unless said otherwise."""
    range: tuple[float, float] | None
    """What it is made for, millimetres."""
    about: str
    """What it does."""
    text: str
    """The recipe, TOML: to start one's own from."""


def presets() -> dict[str, Preset]:
    """The recipes that come with the package, by name.

    >>> presets()["nose-bridge"].range
    (-2.0, 4.0)
    """
    return {row[0]: Preset(row[0], row[1], None if row[2] is None else (row[2][0], row[2][1]), row[3], row[4]) for row in _nonrigid.presets()}


@dataclass(frozen=True, eq=False)
class MorphStep:
    """What one step of a recipe did."""

    report: dict[str, Any]
    """Model, vertices that could move, millimetres asked and reached, folds, stretch of edges; of an energy, its iterations."""
    masks: dict[str, Floats] = field(repr=False)
    """(V,) of each mask by its name, or number: the weights G, 0 to 1."""


@dataclass(frozen=True, eq=False)
class Morph:
    """A changed face."""

    mesh: Mesh
    """The result."""
    before: Mesh
    """What was changed."""
    steps: list[MorphStep]
    """Step by step."""

    @property
    def mask(self) -> Floats:
        """(V,): the largest weight of each vertex over all masks."""
        masks = [mask for step in self.steps for mask in step.masks.values()]
        return np.max(masks, axis=0) if masks else np.zeros(len(self.mesh.vertices))


def _recipes(recipe: Any, amount: float | None) -> list[tuple[str, Any, float | None]]:
    known = [row[0] for row in _nonrigid.presets()]
    if isinstance(recipe, Mapping) and "step" not in recipe:
        if amount is not None:
            raise ValueError("amount: each preset has its own here")
        jobs: list[tuple[str, Any, float | None]] = [("preset", name, mm) for name, mm in recipe.items()]
    elif isinstance(recipe, Mapping):
        jobs = [("keys", dict(recipe), amount)]
    elif isinstance(recipe, str) and recipe in known:
        jobs = [("preset", recipe, amount)]
    elif is_path(recipe):
        if not os.path.exists(recipe):
            raise FileNotFoundError(2, f"no such recipe, and no preset; presets are {', '.join(known)}", os.fspath(recipe))
        jobs = [("file", os.fspath(recipe), amount)]
    else:
        raise TypeError(f"recipe: expected a preset's name, {{preset: millimetres}}, a path or a recipe's keys, found {type(recipe).__qualname__}")
    for _, _, mm in jobs:
        if mm is not None and not isinstance(mm, (int, float, np.number)):
            raise TypeError(f"amount: expected millimetres, found {mm!r}")
    return [(kind, given, None if mm is None else float(mm)) for kind, given, mm in jobs]


def _marks(landmarks: Any, unit: str | None) -> list[_nonrigid.Landmarks]:
    """Landmarks of a mesh: one source or several, lengths of arrays in `unit`."""
    if landmarks is None:
        return []
    unit = None if unit == "auto" else unit
    numbers = isinstance(landmarks, list) and landmarks and all(isinstance(one, (int, np.integer)) for one in landmarks)
    if numbers or (is_array(landmarks) and not isinstance(landmarks, list)):
        landmarks = {str(k): int(v) for k, v in enumerate(indices("landmarks", landmarks).reshape(-1))}
    if isinstance(landmarks, list):
        return [_landmarks("landmarks", one, False, unit) for one in landmarks]
    return [_landmarks("landmarks", landmarks, False, unit)]


def morph(
    mesh: Any,
    recipe: str | PathLike | Mapping[str, Any],
    *,
    landmarks: Any = None,
    rig: Rig | PathLike | None = None,
    shapes: Iterable[str] | None = None,
    identity_modes: int = 0,
    weight_bounds: tuple[float, float] | None = None,
    amount: float | None = None,
    until: int | None = None,
    model: MorphModel | None = None,
    unit: str | None = None,
    threads: int | None = None,
) -> Morph:
    """Changes a face by masks (Li et al. 2018): each vertex under a mask moves by its grey value times a displacement.

    mesh: a path, arrays (vertices, faces), a `Mesh`, or one of trimesh, meshio, Open3D or PyVista. recipe: the name of a preset
    (`presets`), {preset: millimetres, ...} in order, a TOML file, or its keys as a dict.

    landmarks: of the mesh, which masks are drawn by: a file, {name: vertex or point}, or the 68 vertex indices of Multi-PIE; those of the rig
    unless stated. rig: blendshapes and regions on the mesh's vertices. weight_bounds: of blendshape weights.

    amount: what the displacements are multiplied by, for a preset millimetres. until: only so many steps. model: in place of every step's,
    "direct", or an energy that follows the masks: "free", "arap", "graph", "blendshape", "hybrid". unit: of the mesh, of a rig's
    files and of points of landmarks; a `Mesh` and a `Rig` are in millimetres already.

    Raises ValueError for what is not there or not understood, ComputationError for a step that is impossible on this mesh, OSError.
    """
    before = Mesh.of(mesh, unit=unit)
    identity_modes, until = count("identity_modes", identity_modes), count_or_none("until", until, 1)
    if rig is None and (shapes is not None or identity_modes or weight_bounds is not None):
        raise ValueError("shapes, identity_modes and weight_bounds are of a rig; give rig")
    of_rig = None if rig is None else Rig.of(rig, unit=unit or "auto")
    notes, steps = _nonrigid.morph_mesh(
        before._native,
        _recipes(recipe, amount),
        _marks(landmarks, unit),
        None if unit == "auto" else unit,
        None if of_rig is None else of_rig._native,
        None if shapes is None else names_of(shapes),
        identity_modes,
        bounds_of("weight_bounds", weight_bounds),
        until,
        model,
        count_or_none("threads", threads),
    )
    for note in notes:
        warn(note)
    after = before.with_vertices(steps[-1][0], colors=before.colors) if steps else before
    told = [
        MorphStep(json.loads(report), {name or str(k): weights for k, (name, weights) in enumerate(masks)}) for _, report, masks in steps
    ]
    return Morph(after, before, told)


class Measurements(dict[str, Any]):
    """Everything that was measured, as the JSON of `nonrigid measure`; `value` gives one number by name."""

    csv: str
    """As the table of `nonrigid measure --csv`."""
    text: str
    """In words."""

    def value(self, name: str, *, after: bool = False) -> float | None:
        """A measurement, before or after; None where its landmarks are not given. Raises KeyError for a name that there is not."""
        for row in self["measurements"]:
            if row["name"] == name:
                number: float | None = row["after" if after else "before"]
                return number
        raise KeyError(name)

    def __str__(self) -> str:
        return self.text

    def __reduce__(self) -> tuple[Any, ...]:
        return _measured, (dict(self), self.csv, self.text)


def _measured(values: dict[str, Any], csv: str, text: str) -> Measurements:
    measured = Measurements(values)
    measured.csv, measured.text = csv, text
    return measured


def measure(
    mesh: Any,
    after: Any = None,
    *,
    landmarks: Any = None,
    rig: Rig | PathLike | None = None,
    regions: Mapping[str, ArrayLike] | None = None,
    align: bool = False,
    unit: str | None = None,
) -> Measurements:
    """Measures a face, or what a change did to it: distances, angles, ratios, symmetry, areas and volumes by region. `glossary` has every
    measurement with its formula and landmarks.

    mesh: as of `morph`. after: the same vertices after, a mesh, (V, 3) or a path, measured along the axes of the face before, however the
    head is held. landmarks: {name: vertex or point}, the 68 vertex indices of Multi-PIE, files, or a list of these; unless stated those of
    the rig, with the landmarks by name beside it. rig, regions: parts of the face; the groups of the mesh unless stated. align: take the
    motion of the head out of the face after, on which displacements and volumes alone depend. unit: of mesh, after and points of
    landmarks; a `Mesh` is in millimetres already.

    Warns of points off the mesh, and of a head that has moved, unless align. Raises ValueError where nothing can be measured, or vertices
    do not correspond; OSError.
    """
    before = Mesh.of(mesh, unit=unit)
    moved = None if after is None else _vertices("after", after, unit)
    of_rig = None if rig is None else Rig.of(rig)
    parts = parts_of(regions)
    marks, of_unit = _marks(landmarks, unit), None if unit == "auto" else unit
    found = _nonrigid.measure_mesh(before._native, moved, marks, of_unit, None if of_rig is None else of_rig._native, parts, align)
    for note in found[3]:
        warn(note)
    return _measured(json.loads(found[0]), found[1], found[2])


def glossary() -> str:
    """Every measurement with its formula, and every landmark with its place."""
    return _nonrigid.glossary()


class Evaluation(dict[str, Any]):
    """What `nonrigid eval --json` prints: errors in millimetres, flipped triangles, self-intersections, stretch of edges."""

    distances: Floats
    """(V,): distance of each vertex to the truth, nan where it is not observed, or to the scan, millimetres."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _evaluated, (dict(self), self.distances)


def _evaluated(values: dict[str, Any], distances: Floats) -> Evaluation:
    evaluation = Evaluation(values)
    evaluation.distances = distances
    return evaluation


def evaluate(
    result: Any, template: Any, *, truth: Any = None, observed: ArrayLike | PathLike | None = None, scan: Any = None, unit: str | None = None
) -> Evaluation:
    """Measures a result against the truth (rmse, median, p95, max, split into off the surface and along it), or where there is none
    against the scan (distances both ways), and what became of the mesh.

    result: (V, 3), a mesh, or a path, in the template's vertex order. template: the mesh that was registered. truth: (V, 3) or a path.
    observed: (V,) which vertices the scan shows, all unless stated. scan: a mesh or a point cloud with normals. unit: of all that are
    given; a `Mesh` is in millimetres already.

    Raises ValueError where they do not correspond, or neither or both of truth and scan are given; OSError.
    """
    if (truth is None) == (scan is None):
        raise ValueError("give truth or scan, one of them")
    start = Mesh.of(template, unit=unit)
    positions = _vertices("result", result, unit)
    if scan is not None:
        if observed is not None:
            raise ValueError("observed: goes with truth, not with scan")
        text, distances = _nonrigid.evaluate_scan(positions, start._native, Mesh.of(scan, unit=unit)._native)
        return _evaluated(json.loads(text), distances)
    seen = None
    if observed is not None:
        flags = load(observed) if is_path(observed) and is_npy(observed) else whole("observed", observed)  # type: ignore[arg-type]
        if flags.dtype != np.bool_ or flags.shape != (len(positions),):
            raise ValueError(f"observed: expected {len(positions)} truth values, found {flags.dtype} of {flags.shape}")
        seen = np.ascontiguousarray(flags)
    text, distances = _nonrigid.evaluate_truth(positions, start._native, _vertices("truth", truth, unit), seen)
    return _evaluated(json.loads(text), distances)


__all__: Sequence[str] = ("Evaluation", "Measurements", "Morph", "MorphStep", "Preset", "evaluate", "glossary", "measure", "morph", "presets")
