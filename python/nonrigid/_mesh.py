"""Meshes and point clouds, and whatever other packages call a mesh."""

from __future__ import annotations

import math
import operator
import os
import sys
import warnings
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _nonrigid

PathLike: TypeAlias = "str | os.PathLike[str]"
Floats: TypeAlias = NDArray[np.float64]


class NonrigidWarning(UserWarning):
    """Something about the inputs that may not be meant so; the text says what, and what was done about it."""


def warn(note: str | None) -> None:
    """Says what a user should know, of the line that called this package."""
    if note:
        frame, level = sys._getframe(), 1
        while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "nonrigid":
            frame, level = frame.f_back, level + 1
        warnings.warn(note, NonrigidWarning, stacklevel=level)


def is_path(thing: object) -> bool:
    return isinstance(thing, (str, os.PathLike))


def is_array(thing: object) -> bool:
    """Numbers: an array or list, or what numpy makes one of, such as a table of pandas or a tensor of PyTorch; no mesh."""
    known = hasattr(thing, "__array__") and not hasattr(thing, "vertices") and not hasattr(thing, "points")
    return isinstance(thing, (np.ndarray, list)) or known


def is_npy(path: PathLike) -> bool:
    return os.fspath(path).lower().endswith(".npy")


def load(path: PathLike) -> Any:
    """What numpy has written; what is none is an error that names the file."""
    try:
        loaded = np.load(path, allow_pickle=False)
        return loaded if isinstance(loaded, np.ndarray) else {key: loaded[key] for key in loaded.files}
    except (ValueError, EOFError, zipfile.BadZipFile):
        raise ValueError(f"{os.fspath(path)}: is no file of arrays that numpy has written, or not all of it") from None


def ending(what: str, path: PathLike, expected: str) -> str:
    """A path whose name ends as it must."""
    if not os.fspath(path).lower().endswith(expected):
        raise ValueError(f"{what}: {os.fspath(path)}: give a name that ends in {expected}")
    return os.fspath(path)


def count(what: str, value: Any, least: int = 0, most: int = 2**32 - 1) -> int:
    """A whole number from `least` to `most`; of numpy as well."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{what}: expected a whole number, found {value!r}") from None
    if not least <= number <= most:
        raise ValueError(f"{what}: expected a whole number from {least} to {most}, found {number}")
    return number


def count_or_none(what: str, value: Any, least: int = 0) -> int | None:
    return None if value is None else count(what, value, least)


def mapping(what: str, value: Any, expected: str) -> Mapping[Any, Any]:
    """What has keys."""
    if not isinstance(value, Mapping):
        raise TypeError(f"{what}: expected {expected}, found {type(value).__qualname__}")
    return value


def bounds_of(what: str, given: Any) -> tuple[float, float] | None:
    """Smallest and largest weight."""
    if given is None:
        return None
    try:
        lower, upper = (float(x) for x in given)
    except (TypeError, ValueError):
        raise TypeError(f"{what}: expected the smallest and the largest weight, found {given!r}") from None
    if not (lower <= upper and lower < math.inf and upper > -math.inf):
        raise ValueError(f"{what}: no weight lies between {lower:g} and {upper:g}")
    return lower, upper


def whole(what: str, values: ArrayLike) -> NDArray[Any]:
    """An array of which nothing is masked: what a mask hides would be taken for data."""
    rows = values if isinstance(values, (list, tuple)) else []
    if np.ma.is_masked(values) or any(map(np.ma.is_masked, rows)):
        raise ValueError(f"{what}: expected an array without a mask; leave out what is masked")
    return np.asarray(values)


def points(what: str, values: ArrayLike, count: int | None = None) -> Floats:
    """(N, 3) float64, C order: converted from any real numbers, never from another shape."""
    array = whole(what, values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{what}: expected numbers, found an array of {array.dtype}")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{what}: expected an array of shape (N, 3), found {array.shape}")
    if count is not None and len(array) != count:
        raise ValueError(f"{what}: expected {count} rows, one for each vertex, found {len(array)}")
    return np.ascontiguousarray(array, dtype=np.float64)


def indices(what: str, values: ArrayLike) -> NDArray[np.uint32]:
    """Vertex indices: whole numbers from 0."""
    array = whole(what, values)
    if array.size == 0:
        return np.zeros(array.shape, dtype=np.uint32)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{what}: expected whole numbers, found an array of {array.dtype}")
    if array.min() < 0 or array.max() >= 2**32 - 1:
        raise ValueError(f"{what}: expected vertex indices, found {array.min()} to {array.max()}")
    return np.ascontiguousarray(array, dtype=np.uint32)


def vertices_of(what: str, values: ArrayLike) -> list[int]:
    """A plain list of vertex indices."""
    array = indices(what, values)
    if array.ndim != 1:
        raise ValueError(f"{what}: expected a list of vertex indices, found an array of shape {array.shape}")
    listed: list[int] = array.tolist()
    return listed


#: More corners than a polygon of a few has: such an array has its faces in columns.
MOST_CORNERS = 64


def _polygons(faces: Any) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Where each polygon starts in the list of all corners, and that list."""
    if hasattr(faces, "__array__"):  # pandas' and others'
        faces = whole("faces", faces)
    elif not (faces is None or (isinstance(faces, Sequence) and all(hasattr(face, "__len__") for face in faces))):
        raise TypeError(f"faces: expected an array, or a list of polygons, found {faces!r:.80}")
    if faces.shape[:1] == (0,) if isinstance(faces, np.ndarray) else not faces:
        return np.zeros(0, dtype=np.uint32), np.zeros(0, dtype=np.uint32)
    if not isinstance(faces, np.ndarray):
        sizes = np.array([len(face) for face in faces], dtype=np.int64)
        if len(set(sizes.tolist())) > 1:
            starts = np.concatenate([[0], np.cumsum(sizes)])
            corners = np.concatenate([indices("faces", face) for face in faces])
            return starts.astype(np.uint32), corners
        faces = whole("faces", faces)
    if faces.ndim == 2 and len(faces) <= 4 < MOST_CORNERS < faces.shape[1]:
        raise ValueError(f"faces: expected a row for each face, found an array of shape {faces.shape}: transpose it")
    if faces.ndim != 2 or faces.shape[1] < 3:
        raise ValueError(f"faces: expected an array of shape (F, 3) or (F, 4), or a list of polygons, found {faces.shape}")
    corners = indices("faces", faces).reshape(-1)
    return np.arange(0, faces.size + 1, faces.shape[1], dtype=np.uint32), corners


def _colors(values: ArrayLike, count: int) -> NDArray[np.uint8]:
    """(N, 3) of 0 to 255, from numbers of 0 to 1 as well, without transparency."""
    array = whole("colors", values)
    if array.ndim != 2 or array.shape[1] not in (3, 4) or len(array) != count:
        raise ValueError(f"colors: expected an array of shape ({count}, 3), found {array.shape}")
    array = array[:, :3]
    if array.dtype.kind == "f":
        if not ((array >= 0) & (array <= 1)).all():
            raise ValueError("colors: expected numbers from 0 to 1, or whole ones from 0 to 255")
        array = np.rint(array * 255)
    elif array.dtype.kind not in "iu" or (array.size and (array.min() < 0 or array.max() > 255)):
        raise ValueError("colors: expected numbers from 0 to 1, or whole ones from 0 to 255")
    return np.ascontiguousarray(array, dtype=np.uint8)


class Mesh:
    """A polygon mesh, or without faces a point cloud; lengths are millimetres. Its arrays are copies: a mesh does not change.

    >>> mesh = Mesh([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]], [[0, 1, 2, 3]])
    >>> mesh.faces
    array([[0, 1, 2, 3]], dtype=uint32)
    >>> mesh.triangles
    array([[0, 1, 2],
           [0, 2, 3]], dtype=uint32)
    """

    __slots__ = ("_native",)
    _native: _nonrigid.Mesh

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike | Sequence[Sequence[int]] | None = None,
        *,
        normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        unit: str = "mm",
    ) -> None:
        """A mesh of arrays.

        vertices: (V, 3) numbers, in `unit`. faces: (F, 3) or (F, 4) vertex indices from 0, or a list of polygons of any number of corners,
        counter-clockwise seen from outside; none for a point cloud. normals: (V, 3), of any length; a point cloud that is registered needs
        them. colors: (V, 3), 0 to 255 or 0 to 1, sRGB. unit: "mm", "cm", "m", "um" or "in".

        Raises ValueError for other shapes and for indices past the end, TypeError for what are no numbers.
        """
        array = points("vertices", vertices)
        factor = _nonrigid.millimetres(unit)
        if factor != 1.0:
            array = array * factor
        starts, corners = _polygons(faces)
        bent = None if normals is None else points("normals", normals, len(array))
        painted = None if colors is None else _colors(colors, len(array))
        self._native = _nonrigid.Mesh.of(array, starts, corners, bent, painted)

    @classmethod
    def _of(cls, native: _nonrigid.Mesh) -> Mesh:
        mesh = cls.__new__(cls)
        mesh._native = native
        return mesh

    @classmethod
    def read(cls, path: PathLike, *, unit: str = "auto") -> Mesh:
        """Reads .obj, .ply, .stl, .off, .xyz (each also as .gz), .glb or .gltf.

        unit: of the file, "mm", "cm", "m", "um" or "in"; "auto" takes what the format states (glTF: metres), or else the unit in which the
        mesh has the size of a face, as the command line does.

        Raises OSError if the file cannot be read, ValueError if it is malformed or its unit cannot be told.
        """
        native = _nonrigid.Mesh.read(os.fspath(path), None if unit == "auto" else unit)
        warn(native.note)
        return cls._of(native)

    @classmethod
    def of(cls, thing: Any, *, unit: str | None = None) -> Mesh:
        """A mesh of whatever is one: a Mesh, a path, arrays (vertices, faces), a mesh or point cloud of trimesh, meshio, Open3D or PyVista.

        unit: of what it is; unless stated that of a file is found as by `read`, and everything else is in millimetres. A `Mesh` is in
        millimetres already, so no unit changes it.
        """
        if unit not in (None, "auto"):
            _nonrigid.millimetres(unit)  # refuses what is none
        if isinstance(thing, Mesh):
            return thing
        if is_path(thing):
            return cls.read(thing, unit=unit or "auto")
        vertices, faces, normals, colors = _parts(thing)
        return cls(vertices, faces, normals=normals, colors=colors, unit="mm" if unit in (None, "auto") else unit)

    @property
    def vertices(self) -> Floats:
        """(V, 3) float64, millimetres."""
        return self._native.positions

    @property
    def faces(self) -> NDArray[np.uint32] | list[NDArray[np.uint32]]:
        """(F, n) uint32 if all polygons have n corners, otherwise a list of polygons."""
        starts, corners = self._native.starts, self._native.corners
        if len(starts) < 2:
            return np.zeros((0, 3), dtype=np.uint32)
        sizes = np.diff(starts)
        if (sizes == sizes[0]).all():
            return corners.reshape(-1, int(sizes[0]))
        return np.split(corners, starts[1:-1])

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """(T, 3) uint32: every polygon as a fan from its first corner, in order."""
        return self._native.triangles

    @property
    def normals(self) -> Floats | None:
        """(V, 3) float64 as given, of any length, zero where unknown; None if there are none."""
        return self._native.normals

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """(V, 3) uint8, sRGB; None if there are none."""
        return self._native.colors

    @property
    def uvs(self) -> Floats | None:
        """(C, 2) texture coordinates, one for each corner of a face in order, nan where it has none; None if there are none."""
        uvs, (corner_uvs, _), _, _ = self._native.metadata
        if len(corner_uvs) == 0:
            return None
        known = np.vstack([uvs, [[np.nan, np.nan]]])
        return known[np.minimum(corner_uvs, len(uvs))]

    @property
    def groups(self) -> dict[str, NDArray[np.int64]]:
        """Names of an OBJ file's groups, each with the indices of its polygons."""
        groups: dict[str, list[NDArray[np.int64]]] = {}
        for names, (start, end) in self._native.groups:
            for name in names.split():
                groups.setdefault(name, []).append(np.arange(start, end))
        return {name: np.concatenate(parts) for name, parts in groups.items()}

    @property
    def unit(self) -> str | None:
        """Unit of the file that it was read from, and how that is known; None for arrays. Vertices are in millimetres."""
        return self._native.unit

    def with_vertices(self, vertices: ArrayLike, *, colors: ArrayLike | None = None) -> Mesh:
        """The same polygons, texture coordinates, groups and materials on other vertices (V, 3), millimetres."""
        array = points("vertices", vertices)
        painted = None if colors is None else _colors(colors, len(array))
        return self._of(self._native.with_positions(array, painted))

    def write(self, path: PathLike) -> None:
        """Writes .obj (everything but given normals; materials and images of the OBJ file that it was read from beside it), .glb (the same in
        32 bits), .usda (32 bits) or .ply (vertices and normals in 64 bits, polygons, texture coordinates, colours): the whole file or none.
        Warns of materials that are not where the OBJ file names them, and of a point cloud's normals, which .ply alone holds.

        Raises OSError if it cannot be written, ValueError for another extension or where it would overwrite the file it was read from.
        """
        for note in self._native.write(os.fspath(path), self._native.files):
            warn(note)

    def to_trimesh(self) -> Any:
        """A `trimesh.Trimesh` of the triangles, vertices in their order, colours kept. Needs trimesh."""
        import trimesh

        if len(self._native.starts) < 2:
            return trimesh.PointCloud(self.vertices, colors=self.colors)
        return trimesh.Trimesh(self.vertices, self.triangles, vertex_colors=self.colors, process=False)

    def to_pyvista(self) -> Any:
        """A `pyvista.PolyData` of the polygons, colours as the point data "RGB". Needs PyVista."""
        import pyvista

        starts, corners = self._native.starts, self._native.corners
        if len(starts) < 2:
            data = pyvista.PolyData(self.vertices)
        else:
            flat = np.insert(corners.astype(np.int64), starts[:-1].astype(np.int64), np.diff(starts).astype(np.int64))
            data = pyvista.PolyData(self.vertices, faces=flat)
        if self.colors is not None:
            data.point_data["RGB"] = self.colors
        return data

    def __reduce__(self) -> tuple[Any, ...]:
        native = self._native
        arrays = (native.positions, native.starts, native.corners, native.normals, native.colors)
        return _unpickled, (*arrays, native.metadata, native.source)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Mesh):
            return NotImplemented
        mine, theirs = self.__reduce__()[1], other.__reduce__()[1]
        same = all(np.array_equal(a, b) if a is not None else b is None for a, b in zip(mine[:5], theirs[:5]))
        (uvs, indices, *rest), (their_uvs, their_indices, *their_rest) = mine[5], theirs[5]
        return same and all(map(np.array_equal, (uvs, *indices), (their_uvs, *their_indices))) and rest == their_rest

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        polygons = max(len(self._native.starts) - 1, 0)
        name = f", {self._native.path!r}" if self._native.path else ""
        return f"Mesh({len(self._native.positions)} vertices, {polygons} polygons{name})"


def _unpickled(
    positions: Floats,
    starts: NDArray[np.uint32],
    corners: NDArray[np.uint32],
    normals: Floats | None,
    colors: NDArray[np.uint8] | None,
    metadata: tuple[Any, ...],
    source: tuple[Any, ...] | None = None,
) -> Mesh:
    return Mesh._of(_nonrigid.Mesh.of(positions, starts, corners, normals, colors, metadata, source))


def _flat_faces(flat: Any) -> Any:
    """Polygons of VTK's list: a number of corners, the corners, a number of corners, ..."""
    flat = np.asarray(flat)
    if len(flat) == 0:
        return None
    first = int(flat[0])
    if len(flat) % (first + 1) == 0:
        table = flat.reshape(-1, first + 1)
        if (table[:, 0] == first).all():
            return table[:, 1:]
    polygons, at = [], 0
    while at < len(flat):
        size = int(flat[at])
        polygons.append(flat[at + 1 : at + 1 + size])
        at += size + 1
    return polygons


def _parts(thing: Any) -> tuple[Any, Any, Any, Any]:
    """Vertices, faces, normals and colours of another package's mesh, known by its attributes."""
    if isinstance(thing, (tuple, list)) and len(thing) == 2 and np.ndim(thing[0]) == 2:
        return thing[0], thing[1], None, None
    if is_array(thing) and not isinstance(thing, list):
        return thing, None, None, None
    if hasattr(thing, "geometry") and hasattr(thing, "to_geometry"):  # trimesh.Scene
        raise TypeError("a trimesh scene may hold many meshes; give one of them, such as scene.to_geometry()")
    if hasattr(thing, "to_legacy"):  # Open3D's tensors
        thing = thing.to_legacy()
    if hasattr(thing, "has_vertex_normals"):  # open3d.geometry.TriangleMesh
        normals = np.asarray(thing.vertex_normals) if thing.has_vertex_normals() else None
        colors = np.asarray(thing.vertex_colors) if thing.has_vertex_colors() else None
        return np.asarray(thing.vertices), np.asarray(thing.triangles), normals, colors
    if hasattr(thing, "has_points") and hasattr(thing, "normals"):  # open3d.geometry.PointCloud
        normals = np.asarray(thing.normals) if thing.has_normals() else None
        colors = np.asarray(thing.colors) if thing.has_colors() else None
        return np.asarray(thing.points), None, normals, colors
    if hasattr(thing, "point_data") and hasattr(thing, "extract_surface"):  # PyVista
        is_cloud = hasattr(thing, "cast_to_polydata")  # a PointSet
        if not is_cloud and not hasattr(thing, "verts"):  # a volume
            thing = thing.extract_surface()
        if getattr(thing, "n_strips", 0):
            thing = thing.triangulate()
        data = thing.point_data
        normals = data["Normals"] if "Normals" in data else None
        colors = next((data[key] for key in ("RGB", "RGBA", "colors") if key in data), None)
        return np.asarray(thing.points), None if is_cloud else _flat_faces(thing.faces), normals, colors
    if hasattr(thing, "point_data") and hasattr(thing, "cells_dict"):  # meshio.Mesh
        return _of_meshio(thing)
    if hasattr(thing, "vertices"):  # trimesh, and what is like it
        faces = getattr(thing, "faces", None)
        colors = None
        visual = getattr(thing, "visual", None)
        if faces is not None and visual is not None and visual.kind == "vertex":
            colors = visual.vertex_colors
        elif faces is None and getattr(thing, "colors", None) is not None and len(thing.colors) == len(thing.vertices):
            colors = thing.colors
        return np.asarray(thing.vertices), None if faces is None else np.asarray(faces), None, colors
    raise TypeError(
        f"a {type(thing).__module__}.{type(thing).__qualname__} is no mesh that is known here; give a path, arrays (vertices, faces), a "
        "nonrigid.Mesh, or a mesh of trimesh, meshio, Open3D or PyVista"
    )


def _of_meshio(thing: Any) -> tuple[Any, Any, Any, Any]:
    faces: list[Any] = []
    for block in thing.cells:
        if block.type in ("vertex", "line"):
            continue
        if block.type not in ("triangle", "quad", "polygon"):
            raise TypeError(f"a meshio mesh with cells of the kind {block.type!r} is no surface; take its boundary first")
        faces.extend(np.asarray(block.data))
    data: Mapping[str, Any] = thing.point_data
    normals = next((data[key] for key in ("Normals", "normals") if key in data), None)
    if normals is None and all(key in data for key in ("nx", "ny", "nz")):
        normals = np.stack([data["nx"], data["ny"], data["nz"]], axis=1)
    colors = None
    if all(key in data for key in ("red", "green", "blue")):
        colors = np.stack([data["red"], data["green"], data["blue"]], axis=1)
    return thing.points, faces, normals, colors


def names_of(values: str | Iterable[str] | None) -> list[str]:
    """One name or several."""
    if values is None:
        return []
    return [values] if isinstance(values, str) else list(values)
