"""What the extension asks of the package nonrigid: a wrap, a morph, a rig. Arrays in, arrays out, on a thread; nothing of Blender here.

Lengths are millimetres."""

from __future__ import annotations

import hashlib
import json
import re
import sys
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

Result = TypeVar("Result")

UNNAMED = "the mesh"
"""A mesh for the package, which takes units from names of files too: an object may be called `face.glb`."""


class Problem(Exception):
    """Why something cannot be done, in words for the user. Nothing was changed."""


class Cancelled(Exception):
    """The user wants no result any more."""


def package() -> Any:
    """The package nonrigid, and with it numpy's arrays of results. Raises Problem where it is not installed."""
    try:
        import nonrigid
    except ImportError as error:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise Problem(
            f"The Python package nonrigid cannot be loaded ({error}). Install the extension from a zip that holds its wheel for this "
            f"system and Python {version}"
        ) from error
    return nonrigid


@dataclass(frozen=True)
class Surface:
    """A polygon mesh as Blender and nonrigid both have it."""

    positions: np.ndarray
    """(V, 3)"""
    starts: np.ndarray
    """(F + 1,): where each polygon starts in `corners`."""
    corners: np.ndarray
    """Vertices of all polygons, one after another."""
    colors: np.ndarray | None = None
    """(V, 3) of 0 to 1, sRGB."""

    def mesh(self) -> Any:
        """The same as `nonrigid.Mesh`."""
        return package().Mesh(self.positions, self.polygons(), colors=self.colors)

    def polygons(self) -> Any:
        """(F, n) where all have n corners, or a list."""
        sizes = np.diff(self.starts)
        if (sizes == sizes[0]).all():
            return self.corners.reshape(-1, int(sizes[0]))
        return np.split(self.corners, self.starts[1:-1])

    def nearest(self, point: np.ndarray) -> int:
        """The vertex nearest to a point."""
        return int(np.argmin(((self.positions - point) ** 2).sum(axis=1)))

    def topology(self) -> str:
        """The same for the same vertices and polygons in the same order, wherever they lie."""
        return hashlib.sha256(b"%d:%d:" % (len(self.positions), len(self.starts)) + self.starts.tobytes() + self.corners.tobytes()).hexdigest()

    def extent(self) -> float:
        """The diagonal of the box that holds the middle 90 % of the surface along each axis, by which its unit is told."""
        return float(np.linalg.norm(np.ptp(np.quantile(self._points(), [0.05, 0.95], axis=0), axis=0)))

    def unit(self) -> tuple[float, str | None]:
        """Millimetres of the unit in which this is a face, a head or a body; another that it could be in, in words. Raises ValueError."""
        factor, doubt, _ = package()._nonrigid.unit_of(UNNAMED, self._points())
        return factor, doubt

    def _points(self) -> np.ndarray:
        used = np.zeros(len(self.positions), dtype=bool)
        used[self.corners] = True
        return self.positions[used]

    def times(self, factor: float) -> Surface:
        return replace(self, positions=self.positions * factor)

    def is_closed(self) -> bool:
        """Whether it has no open edge."""
        following = np.arange(1, len(self.corners) + 1)
        following[self.starts[1:] - 1] = self.starts[:-1]
        edges = np.sort(np.stack([self.corners, self.corners[following]], axis=1), axis=1)
        return not (np.unique(edges, axis=0, return_counts=True)[1] == 1).any()


class Job(Generic[Result]):
    """Work on a thread of its own. Who started it calls `poll` now and then."""

    def __init__(self, work: Callable[[Job[Result]], Result]) -> None:
        self.progress = 0.0
        """0 to 1."""
        self.stage = "Starting"
        """What is being done."""
        self.cancelled = False
        self._work = work
        self._result: Result | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="nonrigid", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._result = self._work(self)
        except BaseException as error:  # it is raised again by `poll`
            self._error = error

    def at(self, progress: float, stage: str) -> None:
        """Says how far the work is. Raises Cancelled if it is not wanted any more."""
        self.progress, self.stage = max(self.progress, progress), stage
        if self.cancelled:
            raise Cancelled

    def cancel(self) -> None:
        """The work ends at its next step; `poll` raises Cancelled from now on."""
        self.cancelled = True

    def wait(self, seconds: float) -> None:
        """Sleeps until the work has ended, at most so long."""
        self._thread.join(seconds)

    def poll(self) -> Result | None:
        """The result, or None while there is none. Raises Problem where the inputs cannot be used or the computation fails, Cancelled."""
        if self.cancelled:
            raise Cancelled
        if self._thread.is_alive():
            return None
        if self._error is None:
            return self._result
        error = self._error
        if isinstance(error, (Problem, Cancelled)):
            raise error
        if isinstance(error, (ValueError, TypeError, OSError, MemoryError, ImportError, package().ComputationError)):
            raise Problem(str(error) or type(error).__name__) from error
        raise error


@dataclass(frozen=True)
class Wrap:
    """A template, a scan, and how to bring one onto the other."""

    template: Surface
    scan: Surface
    model: str | None = None
    """The usual one unless stated."""
    schedule: str | None = None
    """A TOML file, in place of the model's own."""
    flip: str | None = None
    """Whether the scan is turned over, "auto", "yes" or "no"; as the schedule says unless stated."""
    rig: str | dict[str, np.ndarray] | None = None
    """A path, or displacements (V, 3) by name, of shape keys."""
    identity_modes: int = 0
    template_landmarks: dict[str, np.ndarray] = field(default_factory=dict)
    scan_landmarks: dict[str, np.ndarray] = field(default_factory=dict)
    mask: np.ndarray | None = None
    """(V,) of 0 to 1: how much the scan counts."""
    free_mask: np.ndarray | None = None
    """(V,): 1 where only smoothness counts."""
    regions: tuple[str, ...] = ()
    """Regions of the rig that follow smoothness alone."""


@dataclass(frozen=True)
class Wrapped:
    """What came of a wrap, in the scan's frame."""

    positions: np.ndarray
    """(V, 3): the template's vertices on the scan."""
    basis: np.ndarray
    """(V, 3): the same with the rig's expressions taken out; `positions` without a rig."""
    shapes: dict[str, np.ndarray]
    """Displacements (V, 3) of this person's expressions. The basis with `weights` of them is `positions`."""
    weights: dict[str, float]
    accepted: np.ndarray
    """(V,): what the scan speaks of."""
    distances: np.ndarray
    """(V,): to the scan."""
    colors: np.ndarray | None
    """(V, 3) of 0 to 1, sRGB, where the scan has colours."""
    landmarks: dict[str, int]
    """Vertices by name: those of the rig, or those that were picked."""
    regions: dict[str, np.ndarray]
    """Vertices by name, of the rig."""
    error_probability: float
    doubts: list[str]
    report: str
    """JSON."""
    notes: list[str]
    """What was found odd."""


def unit_by_size(name: str, surface: Surface) -> tuple[float, str | None]:
    """The unit of a mesh, millimetres, as `nonrigid register` finds it, and what is to be said of it. Raises Problem where its size does not tell."""

    def named(said: object) -> str:  # what the package says, but for the argument to give
        return name + re.split(r"[;,] say ", str(said))[0].removeprefix(UNNAMED)

    try:
        unit, doubt = surface.unit()
    except ValueError as error:
        raise Problem(f"{named(error)}: choose what a Blender unit is, Unit in the sidebar's tab Nonrigid") from error
    return unit, doubt and f"{named(doubt)}, choose that Unit"


def odd_size(name: str, surface: Surface, remedy: str) -> str | None:
    """That a mesh, in millimetres as somebody has said, is then no face, head or body."""
    try:
        if surface.unit()[0] == 1.0:
            return None
    except ValueError:
        pass
    return f"{name} is {surface.extent():.3g} mm across, as no face, head or body is: {remedy}"


def models() -> list[str]:
    return list(package()._nonrigid.models())


def read_rig(source: str | dict[str, np.ndarray], template: Surface) -> Any:
    """A rig whose neutral lies as the template does: a file's may be turned and of another size, as importers turn and scale meshes.

    On a template of another shape than the neutral a small turn or growth says only that faces differ: the rig stays as it is then."""
    nonrigid = package()
    if not isinstance(source, str):
        families = {name: "identity" if name.startswith("identity") else "expression" for name in source}
        return nonrigid.Rig(template.mesh(), source, families=families)
    rig = nonrigid.Rig.read(source)
    _refuse_other_mesh(rig, "the template", len(template.positions))
    linear, moved = similarity(rig.neutral, template.positions)
    off = np.abs(rig.neutral @ linear.T + moved - template.positions).max()
    same_shape = off < 1e-3 * np.ptp(template.positions, axis=0).max()
    if np.abs(linear - np.eye(3)).max() < (1e-4 if same_shape else 0.1):
        return rig
    shapes = {name: delta @ linear.T for name, delta in zip(rig.names, rig.deltas.astype(np.float64))}
    families = dict(zip(rig.names, rig.families))
    return nonrigid.Rig(template.mesh(), shapes, families=families, landmarks=rig.landmarks, regions=rig.regions or None)


def _refuse_other_mesh(rig: Any, name: str, vertices: int) -> None:
    if len(rig.neutral) != vertices:
        raise Problem(f"The rig has {len(rig.neutral)} vertices and {name} {vertices}: a rig moves the vertices of its own template, in their order")


def rig_landmarks(path: str, name: str, surface: Surface) -> list[int]:
    """The vertices of a rig's 68 landmarks, on a mesh of this name. Raises Problem where the rig cannot be read, is of another mesh, or has
    none."""
    nonrigid = package()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", nonrigid.NonrigidWarning)
            rig = nonrigid.Rig.read(path, identity_modes=0)
            _refuse_other_mesh(rig, name, len(surface.positions))
            if rig.landmarks is None:
                raise Problem(f"The rig at {path} has no landmarks")
            nonrigid.measure(surface.mesh(), rig=rig)  # refuses vertices in another order
    except (ValueError, OSError, ImportError) as error:
        raise Problem(str(error)) from error
    return [int(v) for v in rig.landmarks]


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, t) with A = s R, for which A p + t of the source's points are nearest to the target's (Umeyama 1991)."""
    from_middle, to_middle = source.mean(axis=0), target.mean(axis=0)
    centred, aimed = source - from_middle, target - to_middle
    u, stretch, vt = np.linalg.svd(aimed.T @ centred)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    linear = (stretch * signs).sum() / (centred**2).sum() * (u * signs) @ vt
    return linear, to_middle - linear @ from_middle


def _step_count(schedule: dict[str, Any], closed: bool) -> int:
    """Steps of all levels of a schedule and its further stages, at most; `closed` is whether its levels for closed subjects are the ones."""
    stage, steps = schedule, 0
    while stage is not None:
        levels = schedule["closed"]["level"] if closed and stage is schedule else stage["level"]
        steps += sum(level["steps"] for level in levels)
        stage = stage.get("then")
    return steps


def _warn_of_idle_rig(nonrigid: Any, rig: Any, identity_modes: int, model: str) -> None:
    if model == "hybrid" and identity_modes == 0 and all(family == "identity" for family in rig.families):
        why = "nothing of the rig is used (Identity Modes takes modes of it): without blendshapes the hybrid is a graph that stays stiff"
        warnings.warn(f"{why}; the model Graph of affine nodes comes nearer", nonrigid.NonrigidWarning, stacklevel=2)


def wrap(given: Wrap, job: Job[Wrapped]) -> Wrapped:
    """Wraps; the work of a `Job`."""
    nonrigid = package()
    job.at(0.0, "Reading")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        wrapped = _wrap(nonrigid, given, job)
    notes = [str(w.message) for w in caught if issubclass(w.category, nonrigid.NonrigidWarning)]
    wrapped.notes.extend(dict.fromkeys(notes))
    for other in caught:  # of another thread
        if not issubclass(other.category, nonrigid.NonrigidWarning):
            warnings.warn_explicit(other.message, other.category, other.filename, other.lineno)
    return wrapped


def _wrap(nonrigid: Any, given: Wrap, job: Job[Wrapped]) -> Wrapped:
    rig = None if given.rig is None else read_rig(given.rig, given.template)
    template, scan = given.template.mesh(), given.scan.mesh()
    model = given.model or ("sumner" if rig is None and given.schedule is None else "hybrid")
    schedule = nonrigid.Schedule.of(given.schedule, model)
    levels = schedule.to_dict()
    identities = rig is None or all(family == "identity" for family in rig.families)
    total, done = max(_step_count(levels, "closed" in levels and identities and given.template.is_closed()), 1), 0
    share = 0.7 if rig is not None else 0.9
    modes = 0 if rig is None else min(given.identity_modes, rig.families.count("identity"))
    if rig is not None:
        _warn_of_idle_rig(nonrigid, rig, modes, model)

    def stepped(step: Any) -> bool:
        nonlocal done
        done += 1
        job.progress = max(job.progress, share * min(done / total, 1.0))
        job.stage = f"Level {step.level + 1}, step {step.step + 1}: {100 * step.inliers:.0f} % on the scan"
        return not job.cancelled

    job.at(0.0, "Bringing the template to the scan" if len(given.scan_landmarks) >= 3 else "Searching where the template lies")
    found = nonrigid.register(
        template,
        scan,
        rig=rig,
        identity_modes=modes,
        landmarks=given.scan_landmarks or None,
        template_landmarks=given.template_landmarks if given.scan_landmarks else None,
        model=model,
        schedule=schedule,
        flip=given.flip,
        mask=given.mask,
        free_mask=given.free_mask,
        free_regions=given.regions,
        callback=stepped,
    )
    positions = found.positions
    basis, shapes, weights = positions, {}, {}
    if rig is not None and any(family != "identity" for family in rig.families):
        job.at(share, "Making the person's shapes")
        basis, shapes, weights = own_shapes(rig, positions, {name: weight.value for name, weight in found.weights.items()})
    job.at(0.95, "Measuring")
    distances = nonrigid.evaluate(positions, template, scan=scan).distances
    job.at(1.0, "Done")
    if rig is not None and rig.landmarks is not None:
        landmarks = {str(k): int(v) for k, v in enumerate(rig.landmarks)}
    else:
        landmarks = {name: given.template.nearest(point) for name, point in given.template_landmarks.items()}
    colors = found.mesh.colors
    return Wrapped(
        positions, basis, shapes, weights, found.accepted, distances, None if colors is None else colors / 255.0, landmarks,
        {} if rig is None else dict(rig.regions), found.error_probability, list(found.doubts), found.report_json, [],
    )  # fmt: skip


def own_shapes(rig: Any, positions: np.ndarray, found: dict[str, float]) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, float]]:
    """A neutral of the person, their own shapes by deformation transfer, and weights with which the shapes bring the neutral to `positions`.

    The rig's shapes, turned and scaled as the face is, take a first neutral out of the positions; the shapes are transferred to it; and the
    neutral is what they take out."""
    linear, _ = similarity(rig.blend(found).vertices, positions)
    deltas = {name: delta for name, family, delta in zip(rig.names, rig.families, rig.deltas) if family != "identity"}
    weights = {name: found.get(name, 0.0) for name in deltas}

    def without(shapes: dict[str, np.ndarray]) -> np.ndarray:
        return positions - sum((w * shapes[name] for name, w in weights.items() if w), np.zeros_like(positions))

    first = without({name: delta.astype(np.float64) @ linear.T for name, delta in deltas.items()})
    own = rig.transfer(first)
    shapes = dict(zip(own.names, own.deltas.astype(np.float64)))
    weights = {name: w for name, w in weights.items() if name in shapes}
    return without(shapes), shapes, weights


@dataclass(frozen=True)
class Morphed:
    """A preset of a morph at a millimetre."""

    delta: np.ndarray
    """(V, 3), for a millimetre."""
    mask: np.ndarray
    """(V,) of 0 to 1."""
    range: tuple[float, float]
    """What the preset is made for, millimetres."""
    about: str


def preset_names() -> list[tuple[str, str]]:
    """Names of presets, and what each does."""
    return [(name, preset.about) for name, preset in package().presets().items()]


def morph(surface: Surface, preset: str, landmarks: dict[str, int]) -> Morphed:
    """A preset on a mesh, for a millimetre: displacements grow with the millimetres in proportion, the masks stay.

    Raises Problem where the landmarks that it is drawn by are not there."""
    nonrigid = package()
    told = nonrigid.presets()[preset]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", nonrigid.NonrigidWarning)  # that a millimetre is outside of the preset's range
            done = nonrigid.morph(surface.mesh(), {preset: 1.0}, landmarks=landmarks)
    except (ValueError, nonrigid.ComputationError) as error:
        raise Problem(str(error)) from error
    return Morphed(done.mesh.vertices - surface.positions, done.mask, told.range or (-told.amount, told.amount), told.about)


def report_text(wrapped: Wrapped) -> str:
    """The report in words, then as JSON."""
    report = json.loads(wrapped.report)
    lines = [f"Probability that the result is wrong by more than {report['wrong_mm']:.1f} mm: {wrapped.error_probability:.0%}"]
    lines += [f"Doubt: {doubt}" for doubt in wrapped.doubts] or ["No doubts."]
    lines += [f"Note: {note}" for note in wrapped.notes]
    return "\n".join([*lines, "", json.dumps(report, indent=1), ""])
