"""Blendshape rigs."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _nonrigid
from ._mesh import Floats, Mesh, PathLike, bounds_of, count, count_or_none, is_array, is_npy, is_path, mapping, names_of, points, vertices_of, warn

Align = Literal["rigid", "similarity", "none"]


class Weight(NamedTuple):
    """A blendshape's weight."""

    value: float
    """w_k."""
    std_dev: float | None
    """Its standard deviation, with correspondences and model taken as right: a lower bound. None at a bound, or where nothing
    determines it."""
    at_bound: bool
    """Whether a bound holds it."""


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """What the weights of a rig's shapes make of one mesh: y = scale rotation b(w) + translation."""

    weights: dict[str, float]
    """By shape."""
    scale: float
    """1 unless the pose is a similarity."""
    rotation: Floats
    """(3, 3)."""
    translation: Floats
    """(3,), millimetres."""
    rms: float
    """Root mean square distance of the vertices, millimetres."""
    max: float
    """Largest distance, millimetres."""
    converged: bool
    """Whether the minimiser came to rest."""
    doubts: list[str]
    """What looks as if the mesh had not the rig's vertices, or the rig not the mesh's shapes."""


class Rig:
    """A neutral and shapes that add to it: b_i(w) = n_i + sum_k w_k delta_ki (Klimov 2020, equation 4). Lengths are millimetres; the
    differences have 32 bits, as in files. Expressions have weight 1 where they are full; identity modes are scaled by their standard
    deviations.

    >>> rig = Rig([[0, 0, 0], [100, 0, 0], [0, 100, 0]], {"up": [[0, 0, 0], [0, 0, 5], [0, 0, 5]]}, faces=[[0, 1, 2]])
    >>> rig.names
    ['up']
    >>> rig.blend({"up": 0.5}).vertices[1]
    array([100. ,   0. ,   2.5])
    """

    __slots__ = ("_native", "standard_deviations", "explained")
    _native: _nonrigid.Rig
    standard_deviations: Floats | None
    """(K,) of a rig that `pca` has made, otherwise None: the length of each mode over all coordinates, millimetres."""
    explained: Floats | None
    """(K,) of a rig that `pca` has made, otherwise None: share of the variance of each mode."""

    def __init__(
        self,
        neutral: Any,
        shapes: Mapping[str, ArrayLike],
        *,
        faces: ArrayLike | Sequence[Sequence[int]] | None = None,
        families: Literal["expression", "identity", "other"] | Mapping[str, str] = "expression",
        shape_kind: Literal["full", "delta"] = "delta",
        landmarks: ArrayLike | None = None,
        regions: Mapping[str, ArrayLike] | None = None,
        unit: str | None = None,
    ) -> None:
        """A rig of arrays.

        neutral: (V, 3), or a mesh or a path, whose polygons the rig then has. shapes: by name, (V, 3) differences to the neutral, or with
        shape_kind="full" whole shapes. faces: as of `Mesh`. families: what the shapes are, one word for all or one for each name.
        landmarks: vertex indices of the 68 landmarks of Multi-PIE/iBUG. regions: vertex indices by name. unit: of all
        lengths; unless stated arrays are in millimetres, and a file's is found as by `Mesh.read`. A `Mesh` is in millimetres already.

        Raises ValueError where numbers of vertices differ, or a name comes twice; shapes that move nothing are left out with a warning.
        """
        factor = 1.0 if unit in (None, "auto") else _nonrigid.millimetres(unit)
        of_arrays = is_array(neutral) or (isinstance(neutral, tuple) and np.ndim(neutral[:1]) == 2)
        if of_arrays:
            rest = points("neutral", neutral) * factor
            mesh = None if faces is None else Mesh(rest, faces)
        else:
            mesh = Mesh.of(neutral, unit=unit)
            if faces is not None:
                raise ValueError("faces: the neutral is a mesh, which has its own")
            rest = mesh.vertices
        shapes = mapping("shapes", shapes, "{name: differences}")
        deltas = np.empty((len(shapes), *rest.shape), dtype=np.float64)
        for k, (name, shape) in enumerate(shapes.items()):
            deltas[k] = points(f"shape {name!r}", shape, len(rest)) * factor
            if shape_kind == "full":
                deltas[k] -= rest
            elif shape_kind != "delta":
                raise ValueError(f'shape_kind: {shape_kind!r}; there are "full" and "delta"')
        names = list(shapes)
        if not isinstance(families, str) and (lacking := [name for name in names if name not in families]):
            raise ValueError(f"families: none is given for {', '.join(lacking)}")
        kinds: list[str] = [families] * len(names) if isinstance(families, str) else [families[name] for name in names]
        self._assemble(rest, mesh, names, kinds, deltas, landmarks, regions, [])

    def _assemble(
        self,
        neutral: Floats,
        mesh: Mesh | None,
        names: list[str],
        families: list[str],
        deltas: NDArray[Any],
        landmarks: ArrayLike | None,
        regions: Mapping[str, ArrayLike] | None,
        files: list[str],
        known: tuple[str, str] | None = None,
        kept: tuple[Any, ...] | None = None,
    ) -> None:
        flat = np.ascontiguousarray(deltas, dtype=np.float32).reshape(-1)
        marks = None if landmarks is None else vertices_of("landmarks", landmarks)
        parts = parts_of(regions)
        of_mesh = None if mesh is None else mesh._native
        self._native = _nonrigid.Rig.of(neutral, of_mesh, names, families, flat, marks, parts, files, known, kept)
        self.standard_deviations = self.explained = None
        for note in self._native.notes:
            warn(note)

    @classmethod
    def _of(cls, native: _nonrigid.Rig) -> Rig:
        rig = cls.__new__(cls)
        rig._native = native
        rig.standard_deviations = rig.explained = None
        for note in native.notes:
            warn(note)
        return rig

    @classmethod
    def read(
        cls,
        path: PathLike,
        *,
        identity_modes: int | None = None,
        shape_kind: Literal["full", "delta"] | None = None,
        unit: str = "auto",
    ) -> Rig:
        """Reads a rig where its owners have it.

        path: a folder with template.obj, expression_deltas.npy and so on; a folder of .obj or .ply shapes; .npz, .glb or .gltf of this
        project; ICT-FaceKit's folder; FLAME's .npz or .pkl; a Basel Face Model or scalismo model, .h5 (needs h5py). FLAME's pickle is read
        without running any code of it. Those of others have functions of their own with more options: `read_ict`, `read_flame`,
        `read_morphable`.

        identity_modes: how many to read, all unless stated. shape_kind: what a folder of shapes holds. unit: as of `Mesh.read`.

        Raises OSError if a file cannot be read, ValueError if it is malformed.
        """
        from . import _field

        identity_modes = count_or_none("identity_modes", identity_modes)
        if not os.path.exists(path):
            raise FileNotFoundError(2, "no such rig", os.fspath(path))
        foreign = _field.reader_of(Path(path))
        if foreign is not None:
            if shape_kind is not None:
                raise ValueError(f"shape_kind: says what a folder of shapes holds, which {os.fspath(path)} is not; leave it out")
            return foreign(path, identity_modes=identity_modes, unit=unit)
        return cls._of(_nonrigid.Rig.read(os.fspath(path), identity_modes, shape_kind, None if unit == "auto" else unit))

    @classmethod
    def of(cls, thing: Rig | PathLike, *, identity_modes: int | None = None, unit: str = "auto") -> Rig:
        """A rig that is one already, in millimetres whatever `unit` says, or is read from a path."""
        if isinstance(thing, Rig):
            return thing
        if is_path(thing):
            return cls.read(thing, identity_modes=identity_modes, unit=unit)
        raise TypeError(f"rig: expected a nonrigid.Rig or a path, found {type(thing).__qualname__}")

    @property
    def neutral(self) -> Floats:
        """(V, 3) float64, millimetres."""
        return self._native.neutral

    @property
    def names(self) -> list[str]:
        """Names of the shapes, in order."""
        return self._native.names

    @property
    def families(self) -> list[str]:
        """"expression", "identity" or "other" of each shape."""
        return self._native.families

    @property
    def deltas(self) -> NDArray[np.float32]:
        """(K, V, 3) float32: differences to the neutral at weight 1, millimetres."""
        return self._native.deltas

    @property
    def mesh(self) -> Mesh | None:
        """The neutral with its polygons; None if the rig has none."""
        native = self._native.mesh
        return None if native is None else Mesh._of(native)

    @property
    def landmarks(self) -> NDArray[np.uint32] | None:
        """Vertex indices of the 68 landmarks of Multi-PIE/iBUG; None if there are none."""
        marks = self._native.landmarks
        return None if marks is None else np.array(marks, dtype=np.uint32)

    @property
    def regions(self) -> dict[str, NDArray[np.uint32]]:
        """Vertex indices by name; empty if there are none."""
        return dict(self._native.regions or [])

    @property
    def unit(self) -> str | None:
        """Unit of the file that it was read from, and how that is known; None for arrays. Everything is in millimetres."""
        return self._native.unit

    def blend(self, weights: Mapping[str, float | Weight]) -> Mesh:
        """The mesh at these weights, by name, such as those of a `Registration`; others are 0. Raises KeyError for a name that there is
        not, TypeError or ValueError for what is no finite number."""
        rest, names = self.neutral, self.names
        deltas = self.deltas
        for name, weight in mapping("weights", weights, "{shape: weight}").items():
            if name not in names:
                raise KeyError(f"no shape {name!r}; there are {', '.join(names)}")
            value = np.asarray(weight.value if isinstance(weight, Weight) else weight)
            if value.ndim != 0 or value.dtype.kind not in "fiub":
                raise TypeError(f"weight of {name!r}: expected a number, found {weight!r}")
            if not np.isfinite(value):
                raise ValueError(f"weight of {name!r} is not finite")
            rest += float(value) * deltas[names.index(name)].astype(np.float64)
        mesh = self.mesh
        return Mesh(rest) if mesh is None else mesh.with_vertices(rest)

    def write(self, path: PathLike, *, form: Literal["folder", "shapes"] = "folder") -> None:
        """Writes a rig: .npz or .glb by extension, otherwise a folder of arrays, or with form="shapes" of one .obj a shape. All of it or
        nothing; what was read is never overwritten; a rig that is there already is replaced.

        Landmarks by name and materials beside the rig that was read go along into folders, components of `pca` into folders of arrays.
        Warns of what a form does not hold: a folder of shapes has no families and landmarks; .npz no groups and materials; neither .npz nor
        .glb landmarks by name.

        Raises OSError if it cannot be written, ValueError if it must not.
        """
        ending = os.path.splitext(os.fspath(path))[1].lower()
        kind: str = {".npz": "npz", ".glb": "gltf"}.get(ending, form)
        if ending == ".gltf":
            raise ValueError(f"{os.fspath(path)}: .gltf is not written; give .glb, .npz or a folder")
        for note in self._native.write(os.fspath(path), kind):
            warn(note)

    def transfer(self, subject: Any, *, anchor: float = 1.0) -> Rig:
        """The rig of another neutral with the same vertices, by deformation transfer (Sumner & Popovic 2004). Identity modes are left out.

        subject: a mesh, or (V, 3) vertices in the rig's order, millimetres. anchor: how much vertices keep to their own displacement.

        Raises ValueError if the subject is no mesh of this rig or the rig has no polygons.
        """
        return self._of(self._native.transfer(_vertices("subject", subject), anchor))

    def fit(
        self,
        meshes: Iterable[Any],
        *,
        shapes: Iterable[str] | None = None,
        neutral: Any = None,
        align: Align = "rigid",
        bounds: tuple[float, float] = (0.0, 1.0),
    ) -> list[FittedFrame]:
        """The weights that explain meshes of the rig's vertices, such as registered frames: each starts from the one before.

        meshes: meshes, or arrays (V, 3), or a folder of .obj and .ply (or, without any, .glb). shapes: names; all but identity modes
        unless stated. neutral: the subject's own. align: what else moves. bounds: of every weight.

        Raises ValueError if a mesh is none of this rig, ComputationError if the minimiser fails.
        """
        names = None if shapes is None else names_of(shapes)
        if names == [] or (names is None and set(self.families) <= {"identity"}):
            raise ValueError("shapes: none to fit; identity modes are left out unless shapes names them")
        rest = None if neutral is None else _vertices("neutral", neutral)
        frames = [_vertices("meshes", mesh) for mesh in _meshes_of(meshes)]
        found, fitted = self._native.fit(frames, names, rest, align, bounds_of("bounds", bounds) or (0.0, 1.0))
        return [
            FittedFrame(dict(zip(found, w)), scale, np.array(rotation), np.array(translation), rms, largest, converged, doubts)
            for w, scale, rotation, translation, rms, largest, converged, doubts in fitted
        ]

    @classmethod
    def pca(cls, meshes: Iterable[Any], components: int, *, align: Align = "rigid") -> Rig:
        """Mean and principal components of meshes with the same vertices, such as registered templates: a rig of identity modes, each scaled
        by its standard deviation, so that weights are N(0, 1). `standard_deviations` and `explained` say how much each is.

        meshes: two or more meshes or arrays (V, 3), or a folder of .obj and .ply, in the order of their names; the polygons are those of
        the first. components: at most one fewer. align: what is taken out first; "rigid" keeps size as shape.

        Raises ValueError if meshes differ in topology or there are too few, ComputationError if they cannot be aligned.
        """
        all_meshes = [points("meshes", m) if is_array(m) else Mesh.of(m) for m in _meshes_of(meshes)]
        first = None if not all_meshes or isinstance(all_meshes[0], np.ndarray) else all_meshes[0]
        if first is not None and len(first._native.starts) < 2:
            first = None
        if first is not None:
            corners = first._native.corners
            for k, mesh in enumerate(all_meshes):
                if isinstance(mesh, Mesh) and not np.array_equal(mesh._native.corners, corners):
                    raise ValueError(f"meshes: number {k}, from 0, has other polygons than the first; they must correspond")
        samples = [_vertices("meshes", mesh) for mesh in all_meshes]
        files = [file for mesh in all_meshes if isinstance(mesh, Mesh) for file in mesh._native.files]
        kept = count("components", components, 1)
        native, deviations, explained = _nonrigid.Rig.pca(samples, None if first is None else first._native, kept, align, files)
        rig = cls._of(native)
        rig.standard_deviations, rig.explained = np.array(deviations), np.array(explained)
        return rig

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.neutral, self.mesh, self.names, self.families, self.deltas, self.landmarks, self._native.regions)
        return _unpickled, (*parts, self.standard_deviations, self.explained, self._native.kept)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Rig):
            return NotImplemented
        if (self.names, self.families, self.mesh) != (other.names, other.families, other.mesh):
            return False
        arrays: list[list[Any]] = [
            [rig.neutral, rig.deltas, rig.landmarks, rig.standard_deviations, rig.explained, *rig.regions.values()] for rig in (self, other)
        ]
        return list(self.regions) == list(other.regions) and all(map(np.array_equal, *arrays))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        families = self.families
        counts = {family: families.count(family) for family in ("expression", "identity", "other") if family in families}
        shapes = ", ".join(f"{count} {family}" for family, count in counts.items()) or "no"
        return f"Rig({len(self.neutral)} vertices, {shapes} shapes)"


def _unpickled(neutral: Floats, mesh: Mesh | None, names: list[str], families: list[str], deltas: Any, landmarks: Any,
               regions: Any, deviations: Any, explained: Any, kept: Any = None) -> Rig:  # fmt: skip
    rig = Rig.__new__(Rig)
    rig._assemble(neutral, mesh, names, families, deltas, landmarks, None if regions is None else dict(regions), [], kept=kept)
    rig.standard_deviations, rig.explained = deviations, explained
    return rig


def _vertices(what: str, thing: Any, unit: str | None = None) -> Floats:
    """Vertices of a mesh, a path, or an array, which are in `unit`."""
    if is_path(thing) and is_npy(thing):
        read = _nonrigid.Mesh.read_points(os.fspath(thing), unit)
        warn(read.note)
        return read.positions
    if is_array(thing):
        factor = 1.0 if unit in (None, "auto") else _nonrigid.millimetres(unit)
        return points(what, thing) * factor
    return Mesh.of(thing, unit=unit).vertices


def parts_of(regions: Mapping[str, ArrayLike] | None) -> list[tuple[str, list[int]]] | None:
    """Vertex indices by name."""
    if regions is None:
        return None
    return [(name, vertices_of("regions", r)) for name, r in mapping("regions", regions, "{name: vertex indices}").items()]


def _meshes_of(meshes: Any) -> list[Any]:
    """Meshes as given, or all of a folder by name."""
    if is_path(meshes):
        files = _nonrigid.mesh_files(meshes)
        if not files:
            raise ValueError(f"{meshes}: found no .obj, .ply or .glb")
        return [Mesh.read(path) for path in files]
    return list(meshes)
