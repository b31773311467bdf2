"""Blender as a module, the extension installed in it as a user would, and a generated face and scan in its scene.

The environment must not have the package nonrigid: it comes with the extension, which `build.py` has to have built."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_home = tempfile.TemporaryDirectory(prefix="blender-")
os.environ["BLENDER_USER_RESOURCES"] = _home.name  # before bpy: nothing of the user's Blender is read or written

import bpy
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import build

MODULE = "bl_ext.user_default.nonrigid"


_status = 0


def pytest_sessionfinish(exitstatus: int) -> None:
    global _status
    _status = int(exitstatus)


def pytest_unconfigure() -> None:
    """Blender 4.2 as a module crashes while Python ends, once its own glTF operators have run: Python does not end then."""
    if bpy.app.version < (5, 0, 0):
        sys.stdout.flush()
        _home.cleanup()
        os._exit(_status)


@pytest.fixture(scope="session")
def wheel() -> Path:
    wheels = list((build.HERE / "wheels").glob("nonrigid-*.whl"))
    assert len(wheels) == 1, "run blender/build.py first"
    return wheels[0]


@pytest.fixture(scope="session")
def archive(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build.build_zip([wheel], tmp_path_factory.mktemp("zip"))


@pytest.fixture(scope="session")
def installed(archive: Path) -> Any:
    """The extension, installed from its zip by Blender's operator."""
    with pytest.raises(ImportError):
        __import__("nonrigid")
    assert bpy.ops.extensions.package_install_files(filepath=str(archive), repo="user_default", enable_on_install=True) == {"FINISHED"}
    assert MODULE in bpy.context.preferences.addons
    return sys.modules[MODULE]


@dataclass(frozen=True)
class Data:
    """A generated rig and one scan of it, in files and as arrays."""

    folder: Path
    face: Any
    case: Any

    @property
    def rig(self) -> Path:
        return self.folder / "rig"


MARKS = (8, 27, 30, 36, 39, 42, 45, 48, 54)
"""Which of the 68 landmarks are picked on the scan."""


@pytest.fixture(scope="session")
def data(installed: Any, tmp_path_factory: pytest.TempPathFactory) -> Data:
    from nonrigid import data_gen

    folder = tmp_path_factory.mktemp("data")
    face = data_gen.Face(vertices=1500, identity_modes=8)
    case = face.scan(seed=7, preset="smile", triangles=8000, landmark_noise=0)
    face.rig.write(folder / "rig")
    case.scan.write(folder / "scan.ply")
    return Data(folder, face, case)


@dataclass(frozen=True)
class Scene:
    """Template and scan as Blender's importers bring them, chosen in the sidebar, with landmarks on both."""

    template: bpy.types.Object
    scan: bpy.types.Object

    @property
    def chosen(self) -> bpy.types.PropertyGroup:
        return bpy.context.scene.nonrigid


def imported(operator: Callable[..., set[str]], path: Path, **options: Any) -> bpy.types.Object:
    before = set(bpy.data.objects)
    assert operator(filepath=str(path), **options) == {"FINISHED"}
    (new,) = [thing for thing in bpy.data.objects if thing not in before and thing.type == "MESH"]
    return new


def turned(thing: bpy.types.Object, points: Any) -> np.ndarray:
    """Points of an object's coordinates in the world."""
    matrix = np.array(thing.matrix_world)
    return np.asarray(points) @ matrix[:3, :3].T + matrix[:3, 3]


def of_gltf(points: np.ndarray) -> np.ndarray:
    """What Blender makes of a file in metres, Y up: in millimetres, turned back."""
    return 1000.0 * np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


def nearest(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Indices of the points that are nearest to places."""
    return np.array([np.argmin(((points - place) ** 2).sum(axis=1)) for place in places])


def numbers(collection: Any, what: str = "co", width: int = 3) -> np.ndarray:
    flat = np.empty(len(collection) * width, dtype=np.float32)
    collection.foreach_get(what, flat)
    return flat.reshape(-1, width)


def put(thing: bpy.types.Object, positions: np.ndarray) -> None:
    """Moves a mesh's vertices."""
    thing.data.vertices.foreach_set("co", np.asarray(positions, dtype=np.float32).ravel())
    thing.data.update()


def grow(thing: bpy.types.Object, factor: float) -> None:
    """Scales the coordinates of a mesh and of its landmarks, not the object."""
    put(thing, numbers(thing.data.vertices) * np.float32(factor))
    for empty in thing.children:
        empty.location = empty.location * factor


def moved_to_collection(thing: bpy.types.Object) -> bpy.types.LayerCollection:
    """Puts an object into a collection of its own, and returns that as the view layer has it."""
    collection = bpy.data.collections.new("apart")
    bpy.context.scene.collection.children.link(collection)
    for other in thing.users_collection:
        other.objects.unlink(thing)
    collection.objects.link(thing)
    return bpy.context.view_layer.layer_collection.children[collection.name]


def seen(thing: bpy.types.Object) -> np.ndarray:
    """(V, 3): what shape keys and modifiers make of an object, in its coordinates."""
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    positions = numbers(evaluated.to_mesh().vertices)
    evaluated.to_mesh_clear()
    return positions


@pytest.fixture
def scene(data: Data) -> Iterator[Scene]:
    bpy.ops.wm.read_homefile(use_empty=True)
    template = imported(bpy.ops.wm.obj_import, data.rig / "template.obj")
    scan = imported(bpy.ops.wm.ply_import, data.folder / "scan.ply")
    scan.location = (200.0, 10.0, -5.0)
    chosen = bpy.context.scene.nonrigid
    chosen.template, chosen.scan, chosen.rig_source, chosen.rig_path = template, scan, "FILE", str(data.rig)
    chosen.identity_modes = 8
    assert bpy.ops.nonrigid.landmarks_of_rig() == {"FINISHED"}
    bpy.context.view_layer.update()
    for mark in MARKS:
        vertex = int(data.face.rig.landmarks[mark])
        bpy.context.scene.cursor.location = turned(scan, data.case.truth[vertex])
        assert bpy.ops.nonrigid.landmark_add(on="SCAN", name=str(mark)) == {"FINISHED"}
    yield Scene(template, scan)


def everything() -> dict[str, Any]:
    """What the user has made: every object with its place, mesh, keys, groups and attributes, to be compared."""
    found: dict[str, Any] = {}
    for thing in bpy.data.objects:
        parts: dict[str, Any] = {"matrix": np.array(thing.matrix_world).tolist(), "parent": thing.parent and thing.parent.name}
        if thing.type == "MESH":
            mesh = thing.data
            parts["vertices"] = numbers(mesh.vertices).tobytes()
            parts["corners"] = [list(polygon.vertices) for polygon in mesh.polygons]
            parts["uvs"] = {layer.name: numbers(layer.data, "uv", 2).tobytes() for layer in mesh.uv_layers}
            parts["groups"] = [group.name for group in thing.vertex_groups]
            parts["attributes"] = sorted(mesh.attributes.keys())
            parts["materials"] = [material and material.name for material in mesh.materials]
            keys = mesh.shape_keys
            parts["keys"] = {} if keys is None else {key.name: (key.value, numbers(key.data).tobytes()) for key in keys.key_blocks}
        found[thing.name] = parts
    return found
