"""Registration of a template to a scan."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _nonrigid
from ._mesh import Floats, Mesh, PathLike, bounds_of, count, count_or_none, ending, indices, is_npy, is_path, names_of, points, warn, whole
from ._nonrigid import Step
from ._rig import Rig, Weight
from ._schedule import Schedule

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

Model = Literal[
    "hybrid",
    "klimov2020",
    "sequential",
    "blendshape",
    "flame",
    "gpmm",
    "gpmm_rig",
    "graph",
    "sumner",
    "arap",
    "poisson",
    "laplacian",
    "affine",
    "mass_spring",
    "fem",
    "ffd",
    "free",
    "rigid",
    "similarity",
]


class Registration:
    """A template that was registered to a scan. It can be pickled; the normal equations and the scan stay behind then."""

    mesh: Mesh
    """The template's polygons on the scan's shape, with the scan's colours if it has any."""
    template: Mesh
    """What was registered."""
    model: str
    """The deformation model."""
    weights: dict[str, Weight]
    """Blendshape weights by name, with their standard deviations."""
    accepted: NDArray[np.bool_]
    """(V,): which vertices had an accepted correspondence at the end."""
    report_json: str
    """The report, byte for byte as `nonrigid register --report` writes it."""
    state_json: str
    """Where it has ended, byte for byte as `nonrigid register --state` writes it."""
    error_probability: float
    """Probability that the result is wrong by more than 3 mm (on a face; on other subjects the same share of their size)."""
    doubts: list[str]
    """What speaks for that, most telling first; empty unless the probability is high."""
    finished: bool
    """Whether the schedule was run to its end; False if a callback has stopped it."""

    finer: Mesh | None
    """The result divided by Catmull and Clark's rules and gone on to the scan, if `subdivide` has asked for it; with the scan's colours."""

    _reads: list[str]
    _facing: tuple[int, int, bool]
    _title: str
    _wrong_length: str
    _scan: Mesh | None
    _equations: Any

    @property
    def positions(self) -> Floats:
        """(V, 3) float64: one position for each template vertex, in the scan's frame, millimetres."""
        return self.mesh.vertices

    @property
    def report(self) -> dict[str, Any]:
        """The report: schedule, start, quality, evidence, doubts, weights, history, hashes of the files that were read."""
        report: dict[str, Any] = json.loads(self.report_json)
        return report

    @property
    def history(self) -> list[dict[str, Any]]:
        """Every step: level, step, energies, inliers, motion."""
        history: list[dict[str, Any]] = self.report["history"]
        return history

    def normal_equations(self) -> tuple[csc_matrix, Floats]:
        """H and g of H d = -g at the result, of half the energy and without damping: (n, n) `scipy.sparse.csc_matrix`, symmetric, both
        triangles, and (n,). Coordinates are the model's tangents, sparse ones (nodes or vertices) first, then the blendshape weights and
        those of shapes that the schedule adds (`proportions`); in the template's centred frame, at the correspondences of the last step. Needs SciPy.

        Raises ValueError unless `register(..., equations=True)` has kept them.
        """
        if self._equations is None:
            raise ValueError("the normal equations were not kept; register with equations=True (a pickle does not hold them)")
        from scipy.sparse import csc_matrix

        pointers, rows, values, gradient = self._equations
        return csc_matrix((values, rows, pointers), shape=(len(gradient), len(gradient)), copy=True), gradient.copy()

    def save(self, path: PathLike, *, report: PathLike | None = None, state: PathLike | None = None) -> None:
        """Writes what `nonrigid register` writes, the same bytes: the mesh (.obj, .ply, .glb), `finer` if there is one, and, where asked
        for, report and state (.json). Each file is whole or not there; none that was read is overwritten.

        Raises OSError if a file cannot be written, ValueError if it must not be.
        """
        given = (("report", report, self.report_json), ("state", state, self.state_json))
        texts = [(ending(what, file, ".json"), text) for what, file, text in given if file is not None]
        _nonrigid.check_plan(self._reads, [os.fspath(path), *(file for file, _ in texts)])
        written = self.mesh if self.finer is None else self.finer
        for note in written._native.write(os.fspath(path), self._reads):
            warn(note)
        for file, text in texts:
            _nonrigid.write_text(file, text, self._reads)

    def picture(self, path: PathLike, *, scan: Any = None) -> None:
        """Writes a picture (.png) of template, scan, result, and result over scan. scan: needed after a pickle only.

        Raises OSError if it cannot be written, ValueError without a scan.
        """
        shown = self._scan if scan is None else Mesh.of(scan)
        if shown is None:
            raise ValueError("a pickle does not hold the scan; give it: picture(path, scan=...)")
        parts = (self.template._native, shown._native, self.mesh._native)
        _nonrigid.picture(ending("picture", path, ".png"), self._title, *parts, self._facing, self._reads)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_scan": None, "_equations": None}

    def __repr__(self) -> str:
        unfinished = "" if self.finished else ", stopped before its end"
        return f"Registration({self.model}, {self.error_probability:.0%} probably wrong by over {self._wrong_length}{unfinished})"


def _landmarks(what: str, given: Any, scan: bool, unit: str | None) -> _nonrigid.Landmarks:
    """Landmarks of a file, a mapping, or two arrays; of these, lengths are in `unit`."""
    if is_path(given):
        return _nonrigid.Landmarks.read(os.fspath(given), scan)
    if isinstance(given, tuple) and len(given) == 2:
        vertices, places = indices(what, given[0]), points(what, given[1])
        if vertices.shape != (len(places),):
            raise ValueError(f"{what}: expected vertex indices (L,) and points (L, 3), found {vertices.shape} and {places.shape}")
        given = dict(zip(vertices.tolist(), places))
        if len(given) < len(vertices):
            twice = next(v for v, uses in Counter(vertices.tolist()).items() if uses > 1)
            raise ValueError(f"{what}: expected every vertex once, found {twice} more often")
    if not isinstance(given, Mapping):
        raise TypeError(f"{what}: expected a path, {{vertex or name: point}}, or (vertices, points), found {type(given).__qualname__}")
    entries: list[dict[str, Any]] = []
    for name, place in given.items():
        entry: dict[str, Any] = {"name": str(name)}
        numbers = whole(f"{what}: {name!r}", place)
        if numbers.ndim == 0 and numbers.dtype.kind in "iu" and not scan:
            entry["vertex"] = int(numbers)
        elif numbers.dtype.kind in "fiu" and numbers.shape in ((3,), (4,)):
            values = [float(x) for x in numbers]
            if not np.isfinite(values).all():
                raise ValueError(f"{what}: {name!r} is not finite")
            entry["position"] = values[:3]
            if len(values) == 4:
                entry["sigma"] = values[3]
        else:
            expected = "x, y, z, and its standard deviation if known" if scan else "a vertex index, or x, y, z"
            raise ValueError(f"{what}: {name!r}: expected {expected}, found {place!r}")
        entries.append(entry)
    return _nonrigid.Landmarks.parse(json.dumps({"unit": unit or "mm", "landmarks": entries}), f"{what}.json")


def _mask(what: str, given: Any, vertices: int) -> _nonrigid.Mask | None:
    if given is None:
        return None
    if is_path(given):
        return _nonrigid.Mask.read(os.fspath(given), vertices)
    values = whole(what, given)
    if values.dtype.kind not in "fiub" or values.shape != (vertices,):
        raise ValueError(f"{what}: expected {vertices} numbers, one for each template vertex, found {values.dtype} of {values.shape}")
    return _nonrigid.Mask.of(np.ascontiguousarray(values, dtype=np.float64))


_UNITS = ("template", "target", "neutral", "rig", "landmarks", "template_landmarks")


class _Units:
    """`unit`, for each input."""

    def __init__(self, given: str | Mapping[str, str] | None) -> None:
        self.given = given
        if isinstance(given, Mapping):
            for name in given:
                if name not in _UNITS:
                    raise ValueError(f"unit: no input {name!r}; there are {', '.join(_UNITS)}")

    def of(self, name: str, thing: Any = None) -> str | None:
        """That of an input. One that is in millimetres already has none."""
        unit = self.given.get(name) if isinstance(self.given, Mapping) else self.given
        if isinstance(thing, (Mesh, Rig)) and isinstance(self.given, Mapping) and unit is not None:
            raise ValueError(f"unit of {name}: a {type(thing).__name__} is in millimetres already; leave that out")
        return None if unit == "auto" else unit

    def refuse_idle(self, inputs: Mapping[str, Any]) -> None:
        """Refuses the unit of an input that is not given."""
        idle = [name for name, thing in inputs.items() if thing is None and isinstance(self.given, Mapping) and name in self.given]
        if idle:
            raise ValueError(f"unit of {idle[0]}: there is no {idle[0]}; leave that out, or give it")


def register(
    template: Any,
    scan: Any,
    *,
    rig: Rig | PathLike | None = None,
    landmarks: Any = None,
    template_landmarks: Any = None,
    model: Model | None = None,
    schedule: Schedule | PathLike | Mapping[str, Any] | None = None,
    neutral: Any = None,
    shapes: Iterable[str] | None = None,
    identity_modes: int | None = None,
    expression_bounds: tuple[float, float] | None = None,
    identity_bounds: tuple[float, float] | None = None,
    mask: ArrayLike | PathLike | None = None,
    free_mask: ArrayLike | PathLike | None = None,
    regions: Iterable[str] = (),
    free_regions: Iterable[str] = (),
    flip: Literal["auto", "yes", "no"] | None = None,
    unit: str | Mapping[str, str] | None = None,
    warm_start: Registration | PathLike | None = None,
    subdivide: int = 0,
    threads: int | None = None,
    callback: Callable[[Step], Any] | None = None,
    on_positions: Callable[[Step, Floats], Any] | None = None,
    equations: bool = False,
) -> Registration:
    """Wraps a template onto a scan: the result has the scan's shape and the template's topology. Arguments are those of `nonrigid register`;
    the same inputs give the same bits as there, at any number of threads.

    template, scan: paths, arrays (vertices, faces), a `Mesh`, or meshes of trimesh, meshio, Open3D or PyVista. A scan may be a point cloud
    with normals. Files are brought to millimetres as the command line does, everything else is in millimetres unless `unit` says otherwise.

    rig: blendshapes on the template's vertices, a `Rig` or a path; shapes: names of the expressions to use, all unless stated;
    identity_modes: how many of the first identity modes to use besides; unless stated 60 or as many as there are, and none beside the subject's
    own neutral. expression_bounds, identity_bounds: between which weights are held, such as (0, 1) and (-3, 3).

    landmarks: a file, {template vertex or name: (x, y, z)} with a standard deviation as a fourth number where known, or
    (vertices (L,), points (L, 3)). template_landmarks: what names mean, a file or {name: vertex or point}. With fewer than three landmarks the
    start is searched.

    model: "hybrid" (Klimov 2020; "klimov2020" is the paper's energy alone), "sequential", "blendshape", "flame", "gpmm", "gpmm_rig", "graph", "sumner", "arap", "poisson", "laplacian", "affine", "mass_spring", "fem", "ffd", "free", "rigid" or "similarity"; unless stated "hybrid" with a rig or a schedule, and "sumner" without.
    schedule: a `Schedule`, its keys, or a TOML file; the model's own unless stated.

    neutral: the subject's own neutral, (V, 3) or a file. mask: (V,) from 0 to 1, what the scan says counts so much; free_mask: 1 for vertices
    that follow smoothness alone; regions, free_regions: the same by names of the rig's regions, or of groups of the template.

    flip: whether the scan is inside out. unit: "mm", "cm", "m", "um", "in" or "auto", for all inputs, landmarks too, or {"target": "m"} for
    some; a `Mesh` or a `Rig` is in millimetres already.
    warm_start: the registration of the frame before, or its state file. subdivide: how often
    to divide the result, up to 3 times, for `Registration.finer`. threads: one a core unless stated; the result does not depend on it.

    callback: sees every `Step` on the thread that called; returning False stops, and the result is what was reached; an exception stops
    and is raised, as is Ctrl-C. on_positions: the same with the positions (V, 3) after the step; stopping there ends the run after the
    next step. equations: keep the normal equations, for `Registration.normal_equations`.

    Raises ValueError or TypeError for inputs that cannot be used, FileNotFoundError and other OSErrors for files that cannot be read,
    ComputationError if no start is found, nothing overlaps, or the solver fails.

    Source: Klimov 2020 (hybrid); Bhat et al. 2013; Sumner et al. 2007; Sorkine & Alexa 2007; Amberg et al. 2007; Balaniuk et al. 2006; Mueller & Gross 2004; Sederberg & Parry 1986.

    >>> import numpy as np, nonrigid
    >>> x, y = np.meshgrid(np.arange(9.) * 10, np.arange(9.) * 10)
    >>> bowl = np.stack([x, y, 0.01 * ((x - 40) ** 2 + (y - 40) ** 2) + 0.1 * x], axis=-1).reshape(-1, 3)
    >>> corner = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    >>> quads = np.stack([corner, corner + 1, corner + 10, corner + 9], axis=1)
    >>> raised = bowl + [0, 0, 5]
    >>> found = nonrigid.register((bowl, quads), (raised, quads), landmarks={v: raised[v] for v in (0, 8, 72, 76)}, model="graph")
    >>> bool(np.abs(found.positions - raised).max() < 0.5)
    True
    """
    units = _Units(unit)
    units.refuse_idle({"neutral": neutral, "rig": rig, "landmarks": landmarks, "template_landmarks": template_landmarks})
    start = Mesh.of(template, unit=units.of("template", template))
    target = Mesh.of(scan, unit=units.of("target", scan))
    identity_modes, subdivide = count_or_none("identity_modes", identity_modes), count("subdivide", subdivide)
    threads = count_or_none("threads", threads)
    vertices = len(start._native.positions)
    rest = None
    if neutral is not None:
        if is_path(neutral) and is_npy(neutral):
            rest = _nonrigid.Mesh.read_points(os.fspath(neutral), units.of("neutral"))
            warn(rest.note)
        else:
            rest = Mesh.of(np.asarray(neutral) if isinstance(neutral, list) else neutral, unit=units.of("neutral", neutral))._native
    of_rig = None
    if rig is not None:
        modes = identity_modes if is_path(rig) else None
        of_rig = Rig.of(rig, identity_modes=modes, unit=units.of("rig", rig) or "auto")
    elif shapes is not None or identity_modes or expression_bounds is not None or identity_bounds is not None:
        raise ValueError("shapes, identity_modes, expression_bounds and identity_bounds are of a rig; give rig")
    elif model == "hybrid":
        warn("no rig given: without blendshapes the hybrid is a graph that stays stiff; the model sumner comes nearer")
    if model is None:
        model = "sumner" if rig is None and schedule is None else "hybrid"
    if not 0 <= subdivide <= 3:
        raise ValueError(f"subdivide: found {subdivide}, expected 0 to 3 rounds")
    if template_landmarks is not None and landmarks is None:
        raise ValueError("template_landmarks say what the names of landmarks mean; give landmarks")
    marks = None if landmarks is None else _landmarks("landmarks", landmarks, True, units.of("landmarks"))
    names = None
    if template_landmarks is not None:
        names = _landmarks("template_landmarks", template_landmarks, False, units.of("template_landmarks"))
    masks = [_mask(what, given, vertices) for what, given in (("mask", mask), ("free_mask", free_mask))]
    steering = Schedule.of(schedule, model)._native.with_options(
        bounds_of("expression_bounds", expression_bounds), bounds_of("identity_bounds", identity_bounds), flip
    )
    for idle in steering.without_effect(model, None if of_rig is None else of_rig._native):
        warn(f"schedule: {idle}")
    warm = None
    if isinstance(warm_start, Registration):
        warm = _nonrigid.WarmStart.parse(warm_start.state_json)
    elif warm_start is not None:
        warm = _nonrigid.WarmStart.read(os.fspath(warm_start))
    found = _nonrigid.register(
        start._native,
        target._native,
        neutral=rest,
        rig=None if of_rig is None else of_rig._native,
        shapes=None if shapes is None else names_of(shapes),
        identity_modes=identity_modes,
        landmarks=marks,
        template_landmarks=names,
        landmark_units=(units.of("landmarks"), units.of("template_landmarks")),
        model=model,
        schedule=steering,
        mask=masks[0],
        free_mask=masks[1],
        regions=names_of(regions),
        free_regions=names_of(free_regions),
        warm_start=warm,
        subdivide=subdivide,
        threads=threads,
        callback=callback,
        on_positions=on_positions,
        equations=equations,
    )
    for_shapes = {
        "shapes": shapes,
        "identity_modes": identity_modes,
        "expression_bounds": expression_bounds,
        "identity_bounds": identity_bounds,
    }
    for option, given in for_shapes.items():
        if given is not None and not found.uses_shapes:
            warn(f"{option} has no effect: the model {model} has no blendshapes")
    for remark in found.remarks:
        warn(remark)
    result = Registration()
    result.mesh = start.with_vertices(found.positions, colors=found.colors)
    result.template, result.model = start, model
    result.weights = {name: Weight(value, std_dev, held) for name, value, std_dev, held in found.weights}
    result.accepted = found.accepted
    result.report_json, result.state_json = found.report + "\n", found.state + "\n"
    result.error_probability, result.doubts = found.error_probability, found.doubts
    result.finished = found.finished
    result.finer = None if found.finer is None else Mesh._of(found.finer)
    result._facing, result._scan, result._equations = found.facing, target, found.equations
    of_shapes = None if of_rig is None else of_rig._native
    read = [start._native, target._native, rest, of_shapes, marks, names, *masks, steering, warm]
    result._reads = [os.fspath(file) for source in read if source is not None for file in source.files]
    name = os.path.basename(target._native.path) or "a scan"
    result._wrong_length = found.wrong_length
    result._title = f"{model} onto {name}; off by over {found.wrong_length}: {100 * result.error_probability:.0f} %"
    return result
