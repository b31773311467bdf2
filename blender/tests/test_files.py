"""Files of the package come out of Blender's own importers with the same positions, texture coordinates, shape keys and motion."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from conftest import Data, imported, nearest, numbers, of_gltf, seen, turned

ROUNDING = 2e-5
"""Of 32 bits at 100 mm, and of decimals in OBJ."""


def polygons(thing: bpy.types.Object) -> list[list[int]]:
    return [list(polygon.vertices) for polygon in thing.data.polygons]


@pytest.fixture(autouse=True)
def empty(installed: object) -> None:
    bpy.ops.wm.read_homefile(use_empty=True)


def test_obj(data: Data, tmp_path: Path) -> None:
    mesh = data.face.rig.mesh
    mesh.write(tmp_path / "face.obj")
    thing = imported(bpy.ops.wm.obj_import, tmp_path / "face.obj")
    assert np.abs(numbers(thing.data.vertices) - mesh.vertices).max() < ROUNDING
    assert polygons(thing) == mesh.faces.tolist()
    assert np.abs(numbers(thing.data.uv_layers.active.data, "uv", 2) - mesh.uvs).max() < 1e-6
    materials = {line.split()[1] for line in (tmp_path / "face.obj").read_text().splitlines() if line.startswith("usemtl")}
    assert len(materials) > 1 and {material.name for material in thing.data.materials} == materials


def test_ply(data: Data, tmp_path: Path) -> None:
    mesh = data.face.rig.mesh
    painted = mesh.with_vertices(mesh.vertices, colors=np.arange(3 * len(mesh.vertices)).reshape(-1, 3) % 256)
    painted.write(tmp_path / "face.ply")
    thing = imported(bpy.ops.wm.ply_import, tmp_path / "face.ply", import_colors="SRGB")
    assert np.abs(numbers(thing.data.vertices) - mesh.vertices).max() < ROUNDING
    assert polygons(thing) == mesh.faces.tolist()
    colours = numbers(thing.data.color_attributes[0].data, "color_srgb", 4)
    assert np.array_equal(np.rint(255 * colours[:, :3]), painted.colors)


def test_gltf(data: Data, tmp_path: Path) -> None:
    """glTF has triangles, vertices of their own at seams, metres, and Y up, which Blender turns; it puts them in the order of materials."""
    rig = data.face.rig
    rig.write(tmp_path / "rig.glb")
    thing = imported(bpy.ops.import_scene.gltf, tmp_path / "rig.glb")
    bpy.context.view_layer.update()
    positions = of_gltf(turned(thing, numbers(thing.data.vertices)))
    # a copy at a seam, of texture or material, lies where its vertex does
    of = nearest(rig.neutral, positions)
    assert np.abs(positions - rig.neutral[of]).max() < 1e-4 and set(of) == set(rig.mesh.faces.ravel())
    assert {material.name for material in thing.data.materials} == {"skin", "lips"}

    def at_corners(places: np.ndarray, uvs: np.ndarray, triangles: list[tuple[int, ...]]) -> set[tuple[float, ...]]:
        return {tuple(np.round([*places[v], *uv], 3)) for v, uv in zip(np.ravel(triangles), uvs)}

    ours = at_corners(rig.mesh.vertices, rig.mesh.uvs, rig.mesh.faces.tolist())
    shown = numbers(thing.data.uv_layers.active.data, "uv", 2)
    for place in at_corners(positions, shown, polygons(thing)):
        assert min(np.abs(np.subtract(place, mine)).max() for mine in ours if abs(mine[0] - place[0]) < 0.01) < 0.003

    keys = thing.data.shape_keys
    rest = numbers(keys.reference_key.data)
    found = {key.name: of_gltf(numbers(key.data) - rest) for key in keys.key_blocks if key != keys.reference_key}
    assert list(found) == rig.names
    for name, delta in zip(rig.names, rig.deltas):
        assert np.abs(found[name] - delta[of]).max() < 1e-3, name


def of_usd(path: Path, **options: object) -> bpy.types.Object:
    """As it is imported: the file says millimetres, Blender has metres, and Y up becomes Z up."""
    if bpy.app.version >= (5, 0, 0):  # older ones take no notice of units
        options["apply_unit_conversion_scale"] = False
    return imported(bpy.ops.wm.usd_import, path, **options)


def test_usd(data: Data, tmp_path: Path) -> None:
    mesh = data.face.rig.mesh
    mesh.write(tmp_path / "face.usda")
    thing = of_usd(tmp_path / "face.usda")
    # an importer turns or scales the object or its parent, not the mesh
    assert np.abs(numbers(thing.data.vertices) - mesh.vertices).max() < ROUNDING
    assert polygons(thing) == mesh.faces.tolist()
    assert np.abs(numbers(thing.data.uv_layers.active.data, "uv", 2) - mesh.uvs).max() < 1e-6
    mesh.write(tmp_path / "face.obj")
    lines = (tmp_path / "face.obj").read_text().splitlines()
    materials = {line.split()[1] for line in lines if line.startswith("usemtl")}
    assert len([material for material in thing.data.materials if material]) == len(materials)


def walk(data: Data, folder: Path, extension: str) -> tuple[np.ndarray, Path]:
    """(5, V, 3): frames of a face that moves and smiles, and the file that the command line makes of them."""
    import nonrigid

    rig = data.face.rig
    smile = rig.deltas[0]
    steps = [np.array([2.0 * k, 0.5 * k * k, 0.0]) for k in range(5)]
    frames = np.stack([rig.neutral + 0.2 * k * smile + steps[k] for k in range(5)])
    for k, frame in enumerate(frames):
        rig.mesh.with_vertices(frame).write(folder / f"walk{k}.obj")
    out = folder / f"walk.{extension}"
    rig_option = ["--rig", str(data.rig)] if extension == "glb" else []
    nonrigid._nonrigid.command_line(
        ["nonrigid", "animate", "--meshes", str(folder), "--unit", "meshes=mm", "--fps", "24", *rig_option, "--out", str(out)], "", []
    )
    assert out.exists()
    return frames, out


def moved(thing: bpy.types.Object, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    bpy.context.view_layer.update()
    return turned(thing, seen(thing))


def test_animated_usd(data: Data, tmp_path: Path) -> None:
    frames, path = walk(data, tmp_path, "usda")
    thing = of_usd(path, set_frame_range=True)
    assert bpy.context.scene.frame_end - bpy.context.scene.frame_start == 4
    start = bpy.context.scene.frame_start
    still = np.array(thing.matrix_world)
    for k, frame in enumerate(frames):
        bpy.context.scene.frame_set(start + k)
        bpy.context.view_layer.update()
        assert np.abs(seen(thing) - frame).max() < 5 * ROUNDING, k
    assert np.array_equal(np.array(thing.matrix_world), still)


def test_animated_gltf(data: Data, tmp_path: Path) -> None:
    frames, path = walk(data, tmp_path, "glb")
    bpy.context.scene.render.fps = 24
    thing = imported(bpy.ops.import_scene.gltf, path)
    neutral = data.face.rig.neutral
    of = nearest(neutral, of_gltf(numbers(thing.data.vertices)))
    for k, frame in enumerate(frames):
        assert np.abs(of_gltf(moved(thing, k)) - frame[of]).max() < 5e-3, k
