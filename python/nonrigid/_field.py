"""Rigs of the field, in the files in which their owners publish them."""

from __future__ import annotations

import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from . import _nonrigid
from ._mesh import Mesh, PathLike, count_or_none, indices, load, points, warn
from ._rig import Rig

ICT_NEUTRAL = "generic_neutral_mesh.obj"
SMPL_SHAPES = 10
"""SMPL has identity modes alone."""
ICT_FACE = (9409, 9230)
"""Vertices and polygons of ICT-FaceKit's face: the first ones. Eyes, teeth and neck follow."""


def _whole_indices(what: str, values: Any) -> Any:
    """Indices that some programs keep as floating-point numbers."""
    array = np.asarray(values)
    if array.dtype.kind == "f" and np.array_equal(array, np.trunc(array)):
        array = array.astype(np.int64)
    return indices(what, array)


def _is_flame(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return {"v_template.npy", "shapedirs.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def reader_of(path: Path) -> Callable[..., Rig] | None:
    """What reads this file or folder, if it is of another project."""
    if path.is_dir():
        return read_ict if any((path / inner / ICT_NEUTRAL).is_file() for inner in (".", "FaceXModel")) else None
    ending = path.suffix.lower()
    if ending in (".pkl", ".pickle") or (ending == ".npz" and _is_flame(path)):
        return read_flame
    return read_morphable if ending in (".h5", ".hdf5") else None


def _rig(
    mesh: Mesh, names: list[str], families: list[str], deltas: Any, path: PathLike, unit: str, files: list[str], own: str | None = None
) -> Rig:
    """A rig whose lengths are in `unit`; "auto" is the format's own, or one that is found."""
    factor, note, known = _nonrigid.unit_of(os.fspath(path), mesh.vertices, own if unit == "auto" else unit)
    if unit == "auto" and own is not None:
        known = (own, "file")
    warn(note)
    neutral = mesh.vertices * factor
    rig = Rig.__new__(Rig)
    rig._assemble(neutral, mesh.with_vertices(neutral), names, families, np.asarray(deltas) * factor, None, None, files, known)
    return rig


def read_ict(
    path: PathLike, *, identity_modes: int | None = None, part: Literal["face", "all"] = "face", unit: str = "auto"
) -> Rig:
    """Reads ICT-FaceKit's folder, FaceXModel or the one above (github.com/ICT-VGL/ICT-FaceKit, Li et al. 2020): expressions, and identity
    modes scaled by their standard deviations.

    part: "face", its first 9,409 vertices, or "all", with eyes, teeth and neck. unit: ICT-FaceKit is in centimetres ("auto").

    Raises OSError if a file cannot be read, ValueError if one is malformed or has other vertices than the neutral.
    """
    identity_modes = count_or_none("identity_modes", identity_modes)
    folder = Path(path)
    folder = folder if (folder / ICT_NEUTRAL).is_file() else folder / "FaceXModel"
    neutral = Mesh.read(folder / ICT_NEUTRAL, unit="mm")
    total = len(neutral.vertices)
    if part == "face":
        vertices, polygons = ICT_FACE
        if total < vertices:
            raise ValueError(f'{folder}: {total} vertices, ICT-FaceKit\'s face has {vertices}; read all of it with part="all"')
        starts, corners = neutral._native.starts[: polygons + 1], neutral._native.corners
        corners = corners[: int(starts[-1])]
        if corners.max() >= vertices:
            raise ValueError(f"{folder}: the first {polygons} polygons reach beyond the first {vertices} vertices; this is no ICT-FaceKit")
        mesh = Mesh._of(_nonrigid.Mesh.of(neutral.vertices[:vertices], starts, corners))
    elif part == "all":
        vertices, mesh = total, neutral
    else:
        raise ValueError(f'part: {part!r}; there are "face" and "all"')
    files = sorted(p for p in folder.glob("*.obj") if p.name != ICT_NEUTRAL)
    identities = [p for p in files if p.stem.startswith("identity")][:identity_modes]
    expressions = [p for p in files if not p.stem.startswith("identity")]
    if not files:
        raise ValueError(f"{folder}: no shapes beside {ICT_NEUTRAL}")
    rest, deltas = mesh.vertices, []
    for file in expressions + identities:
        shape = Mesh.read(file, unit="mm").vertices
        if len(shape) != total:
            raise ValueError(f"{file}: found {len(shape)} vertices, the neutral has {total}")
        deltas.append(shape[:vertices] - rest)
    names = [p.stem for p in expressions + identities]
    families = ["expression"] * len(expressions) + ["identity"] * len(identities)
    read = [folder / ICT_NEUTRAL, *expressions, *identities]
    return _rig(mesh, names, families, deltas, folder, unit, [str(p) for p in read], "cm")


class _Held:
    """The state of an object of a pickle, held as it is; no code of its class runs."""

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Chumpy(_Held):
    """chumpy.ch.Ch, which keeps its numbers as `x`."""


def _reconstructor(cls: Any, base: Any, state: Any) -> Any:
    """copyreg._reconstructor for held objects alone."""
    if not (isinstance(cls, type) and issubclass(cls, _Held)):
        raise pickle.UnpicklingError(f"copyreg._reconstructor of {cls!r}")
    return cls()


class _Numbers(pickle.Unpickler):
    """Reads arrays and plain containers. Whatever else a pickle asks for is refused by name; what it would run is never looked up."""

    path: str

    def find_class(self, module: str, name: str) -> Any:
        of_numpy = module in ("numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
        if of_numpy and name in ("_reconstruct", "scalar", "_frombuffer"):
            return super().find_class(module.replace("numpy.core", "numpy._core") if _has_new_core() else module, name)
        if module == "numpy" and name in ("ndarray", "dtype"):
            return getattr(np, name)
        if (module, name) == ("_codecs", "encode"):
            return _encode
        if module in ("copyreg", "copy_reg") and name == "_reconstructor":
            return _reconstructor
        if module in ("builtins", "__builtin__") and name in ("object", "set", "frozenset"):
            return {"object": object, "set": set, "frozenset": frozenset}[name]
        if module == "collections" and name == "OrderedDict":
            return dict
        if module.split(".")[0] == "scipy" and "sparse" in module:
            return _Held
        if (module, name) == ("chumpy.ch", "Ch"):
            return _Chumpy
        raise pickle.UnpicklingError(
            f"{self.path}: needs the class {module}.{name}, whose code is not run here; where it can be loaded, convert it:\n"
            "    import numpy, pickle\n"
            f"    flame = pickle.load(open({os.path.basename(self.path)!r}, 'rb'), encoding='latin1')\n"
            "    numpy.savez('flame.npz', **{key: numpy.array(flame[key]) for key in ('v_template', 'shapedirs', 'f')})"
        )


def _has_new_core() -> bool:
    return hasattr(np, "_core")


def _encode(text: str, encoding: str = "utf-8") -> bytes:
    return text.encode("latin1" if encoding == "latin1" else encoding)


def _flame_arrays(path: Path) -> dict[str, Any]:
    if path.suffix.lower() == ".npz":
        arrays = load(path)
        return {key: arrays[key] for key in ("v_template", "shapedirs", "f") if isinstance(arrays, dict) and key in arrays}
    with open(path, "rb") as file:
        reader = _Numbers(file, encoding="latin1")
        reader.path = str(path)
        try:
            held = reader.load()
        except pickle.UnpicklingError as error:
            said = str(error)
            raise ValueError(said if said.startswith(str(path)) else f"{path}: is no pickle that can be read: {said}") from None
        except (EOFError, AttributeError, IndexError, KeyError, TypeError, ImportError) as error:
            raise ValueError(f"{path}: is no pickle that can be read: {error}") from None
    if not isinstance(held, dict):
        raise ValueError(f"{path}: expected a dict of arrays, found {type(held).__name__}")
    arrays = {}
    for key in ("v_template", "shapedirs", "f"):
        item = held.get(key)
        if isinstance(item, _Chumpy):
            item = item.state.get("x") if isinstance(item.state, dict) else None
        if item is not None:
            arrays[key] = item
    return arrays


def read_flame(
    path: PathLike, *, identity_modes: int | None = None, expressions: int | None = None, identities: int | None = None, unit: str = "auto"
) -> Rig:
    """Reads FLAME (Li et al. 2017, flame.is.tue.mpg.de), or SMPL's like: `v_template` (V, 3), `shapedirs` (V, 3, K) and `f` (F, 3) of an .npz or
    a pickle. A pickle is read without running any code: arrays are taken, also those that chumpy holds, and a pickle that needs other classes
    is refused by their name. Rotations of neck, jaw and eyes are no blendshapes, so they and their correctives are left out.

    identities: of the K shapes, how many are identity modes; in FLAME 300, then 100 expressions. Where K is not 400 and nothing is said, the
    first 300 are, with a warning. identity_modes, expressions: how many of the first of each to take, all unless stated. unit: FLAME is in
    metres ("auto").

    Raises OSError if the file cannot be read, ValueError if it is malformed or refused, or if nothing of its size in metres is a head or body.
    """
    identity_modes, expressions = count_or_none("identity_modes", identity_modes), count_or_none("expressions", expressions)
    identities = count_or_none("identities", identities)
    file = Path(path)
    arrays = _flame_arrays(file)
    missing = [key for key in ("v_template", "shapedirs", "f") if key not in arrays]
    if missing:
        raise ValueError(f"{file}: no {', '.join(missing)}; this is no FLAME or SMPL model")
    neutral = points(f"{file}: v_template", arrays["v_template"])
    shapes = np.asarray(arrays["shapedirs"])
    if shapes.dtype.kind != "f" or shapes.ndim != 3 or shapes.shape[:2] != neutral.shape:
        raise ValueError(f"{file}: shapedirs: expected numbers of shape ({len(neutral)}, 3, K), found {shapes.dtype} of {shapes.shape}")
    count, size = shapes.shape[2], float(np.ptp(neutral, axis=0).max())
    if unit == "auto" and not 0.05 < size < 5.0:
        raise ValueError(f'{file}: {size:.3g} m in size, if FLAME\'s metres are its unit; say which is, such as unit="mm"')
    if identities is None and count not in (400, SMPL_SHAPES):
        warn(f"{file}: {count} shapes where FLAME has 400: the first 300 are taken for identity modes; identities= says how many are")
    identities = min(300 if identities is None else identities, count)
    chosen = list(range(identities))[:identity_modes]
    chosen_expressions = list(range(identities, count))[:expressions]
    names = [f"expression{k - identities:03}" for k in chosen_expressions] + [f"identity{k:03}" for k in chosen]
    families = ["expression"] * len(chosen_expressions) + ["identity"] * len(chosen)
    deltas = np.moveaxis(shapes[:, :, chosen_expressions + chosen], 2, 0)
    mesh = Mesh(neutral, _whole_indices(f"{file}: f", arrays["f"]))
    return _rig(mesh, names, families, deltas, path, unit, [str(file)], "m")


def read_morphable(path: PathLike, *, identity_modes: int | None = None, expressions: int | None = None, unit: str = "auto") -> Rig:
    """Reads a morphable model in HDF5, as scalismo and statismo write it and the Basel Face Models 2009 to 2019 are published: mean,
    `pcaBasis`, `pcaVariance` and the triangles of `representer`; with `shape` and `expression` groups, both. Needs h5py. Modes are scaled by
    their standard deviations; those of expressions go below zero as well.

    identity_modes, expressions: how many of the first of each to take, all unless stated. unit: as of `Mesh.read`.

    Raises OSError if the file cannot be read, ValueError if it is malformed, ImportError without h5py.
    """
    identity_modes, expressions = count_or_none("identity_modes", identity_modes), count_or_none("expressions", expressions)
    try:
        import h5py
    except ImportError:
        raise ImportError("morphable models in HDF5 are read by h5py; pip install nonrigid[h5py]") from None
    file = Path(path)
    if not file.exists():
        raise FileNotFoundError(2, "no such model", str(file))
    try:
        opened = h5py.File(file, "r")
    except OSError as error:
        if error.errno is not None:
            raise OSError(error.errno, os.strerror(error.errno), str(file)) from None
        raise ValueError(f"{file}: is no HDF5 file that can be read: {error}") from None
    with opened as data:
        prefix = "shape/" if "shape/model" in data else ""

        def array(name: str) -> Any:
            if name not in data:
                raise ValueError(f"{file}: no {name}; expected a model of scalismo, statismo or Basel")
            return np.asarray(data[name], dtype=np.float64)

        def modes(group: str, most: int | None) -> tuple[Any, Any]:
            mean, basis, variance = (array(f"{group}model/{name}") for name in ("mean", "pcaBasis", "pcaVariance"))
            mean, variance = mean.reshape(-1), variance.reshape(-1)
            if basis.ndim != 2 or basis.shape != (len(mean), len(variance)) or len(mean) % 3:
                raise ValueError(
                    f"{file}: {group}model: mean of {len(mean)}, pcaBasis of {basis.shape}, pcaVariance of {len(variance)} do not fit together"
                )
            basis, sigma = basis[:, :most], np.sqrt(variance[:most])
            lengths = np.linalg.norm(basis, axis=0)
            if np.allclose(lengths, 1, atol=1e-3):
                basis = basis * sigma
            elif not np.allclose(lengths, sigma, rtol=1e-3):  # before version 0.9, statismo has the deviations in the basis
                raise ValueError(f"{file}: {group}model/pcaBasis: columns of neither unit length nor that of the standard deviations")
            return mean.reshape(-1, 3), np.moveaxis(basis.reshape(len(mean) // 3, 3, len(sigma)), 2, 0)

        neutral, identity = modes(prefix, identity_modes)
        names = [f"identity{k:03}" for k in range(len(identity))]
        families = ["identity"] * len(identity)
        deltas = [identity]
        if "expression/model" in data:
            mean, expression = modes("expression/", expressions)
            if mean.shape != neutral.shape:
                raise ValueError(f"{file}: expression has {len(mean)} vertices, shape {len(neutral)}")
            neutral = neutral + mean
            names = [f"expression{k:03}" for k in range(len(expression))] + names
            families = ["expression"] * len(expression) + families
            deltas.insert(0, expression)
        cells = np.asarray(data[f"{prefix}representer/cells"]) if f"{prefix}representer/cells" in data else None
    if cells is None:
        raise ValueError(f"{file}: no {prefix}representer/cells, so its triangles are not known")
    faces = cells.T if cells.shape[0] == 3 and cells.shape[1] != 3 else cells
    mesh = Mesh(neutral, _whole_indices(f"{file}: cells", faces))
    return _rig(mesh, names, families, np.concatenate(deltas), path, unit, [str(file)])
