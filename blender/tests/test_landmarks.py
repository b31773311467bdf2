"""Landmarks: empties on template and scan, by cursor, by a line of sight, and of the rig."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from conftest import Data, Scene, everything, numbers, put, turned


def surface_distance(thing: bpy.types.Object, empty: bpy.types.Object) -> float:
    """How far an empty is from an object, by Blender's own search."""
    local = thing.matrix_world.inverted() @ empty.matrix_world.translation
    return (thing.closest_point_on_mesh(local)[1] - local).length


def test_of_the_rig(scene: Scene, data: Data) -> None:
    """68 of them, on the vertices that the rig says; a second time none is added."""
    empties = {child.name.split(".")[0]: child for child in scene.template.children}
    assert set(empties) == {str(k) for k in range(68)}
    for k, vertex in enumerate(data.face.rig.landmarks):
        assert np.abs(np.array(empties[str(k)].location) - data.face.rig.neutral[vertex]).max() < 1e-4
    before = everything()
    assert bpy.ops.nonrigid.landmarks_of_rig() == {"FINISHED"}
    assert everything() == before


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_at_the_cursor(scene: Scene, scale: float) -> None:
    """On the surface, wherever the cursor is, however the object lies; as large as it looks right."""
    scan = scene.scan
    scan.rotation_euler, scan.scale, scan.location = (0.4, 0.5, 0.6), (scale, scale, scale), (20 * scale, 0, 0)  # as 32 bits can hold
    bpy.context.view_layer.update()
    place = turned(scan, numbers(scan.data.vertices)[1234])
    bpy.context.scene.cursor.location = place + 0.01 * scale
    scene.chosen.landmark = "mole"
    before = everything()
    assert bpy.ops.nonrigid.landmark_add(on="SCAN") == {"FINISHED"}
    mole = bpy.data.objects["mole"]
    assert mole.parent == scan and mole.type == "EMPTY" and mole.name in bpy.context.scene.objects
    assert np.abs(np.array(mole.matrix_world.translation) - place).max() < 0.05 * scale
    assert surface_distance(scan, mole) < 1e-4
    size = mole.empty_display_size * mole.matrix_world.median_scale
    assert 1.0 * scale < size < 2.0 * scale  # of a face in millimetres
    assert {name: now for name, now in everything().items() if name in before} == before


def test_by_a_line_of_sight(scene: Scene) -> None:
    """What a click gives: the first point of the surface along it, not the one behind."""
    vertices = numbers(scene.scan.data.vertices)
    tip = vertices[vertices[:, 2].argmax()]
    there = turned(scene.scan, tip)
    forward = turned(scene.scan, [0, 0, 1]) - turned(scene.scan, [0, 0, 0])
    assert bpy.ops.nonrigid.landmark_pick(on="SCAN", name="tip", origin=there + 500 * forward, direction=-forward) == {"FINISHED"}
    tip_mark = bpy.data.objects["tip"]
    assert np.abs(np.array(tip_mark.matrix_world.translation) - there).max() < 1e-2
    with pytest.raises(RuntimeError, match="click on its surface"):
        bpy.ops.nonrigid.landmark_pick(on="SCAN", name="missed", origin=there + 500 * forward, direction=forward)
    assert "missed" not in bpy.data.objects


def test_the_same_name_pairs_and_is_not_given_twice(scene: Scene) -> None:
    assert bpy.ops.nonrigid.landmark_add(on="SCAN", name="chin") == {"FINISHED"}
    assert bpy.ops.nonrigid.landmark_add(on="TEMPLATE", name="chin") == {"FINISHED"}
    assert {thing.name: thing.parent for thing in bpy.data.objects if thing.name.startswith("chin")} == {
        "chin": scene.scan,
        "chin.001": scene.template,
    }
    before = everything()
    with pytest.raises(RuntimeError, match="has a landmark 'chin' already"):
        bpy.ops.nonrigid.landmark_add(on="SCAN", name="chin")
    longest = bpy.data.objects.new("n" * 300, None)
    names = [("chin.007", "numbers that Blender gives"), ("P.1", "numbers that Blender gives"), ("  ", "no name")]
    names += [(name, "too long") for name in ("n" * 300, longest.name)]  # the second fits, but not twice
    bpy.data.objects.remove(longest)
    for name, why in names:
        with pytest.raises(RuntimeError, match=why):
            bpy.ops.nonrigid.landmark_add(on="TEMPLATE", name=name)
    assert everything() == before


def test_not_on_what_is_disabled(scene: Scene) -> None:
    """Blender knows neither its place nor its surface."""
    scene.scan.hide_viewport = scene.template.hide_viewport = True
    before = everything()
    for add in (
        lambda: bpy.ops.nonrigid.landmark_add(on="SCAN", name="chin"),
        lambda: bpy.ops.nonrigid.landmark_pick(on="SCAN", name="chin", direction=(0, 0, -1)),
        lambda: bpy.ops.nonrigid.landmarks_of_rig(),
    ):
        with pytest.raises(RuntimeError, match="is disabled in viewports") as raised:
            add()
        assert "Traceback" not in str(raised.value)
    assert everything() == before


def test_of_a_rig_in_another_order(scene: Scene) -> None:
    put(scene.template, numbers(scene.template.data.vertices)[::-1])
    for empty in list(scene.template.children):
        bpy.data.objects.remove(empty)
    before = everything()
    with pytest.raises(RuntimeError, match="in the rig's order"):
        bpy.ops.nonrigid.landmarks_of_rig()
    assert everything() == before
