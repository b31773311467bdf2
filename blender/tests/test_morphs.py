"""Presets of morphs as shape keys: a slider's millimetres are the preset's."""

from __future__ import annotations

from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix
from conftest import Data, Scene, everything, grow, numbers, seen

from test_wrap import part, wrap


def test_sliders_are_millimetres(scene: Scene, data: Data) -> None:
    """Of a scan in centimetres, so that units tell."""
    import nonrigid

    scene.chosen.unit = "CM"
    for thing in (scene.scan, scene.template):
        grow(thing, 0.1)
    result = wrap()
    expressions = list(result.data.shape_keys.key_blocks.keys())
    for key in result.data.shape_keys.key_blocks[1:]:
        key.value = 0.0
    neutral = 10.0 * seen(result)
    assert bpy.ops.nonrigid.morph_add(preset="ALL") == {"FINISHED"}
    keys = result.data.shape_keys.key_blocks
    presets = nonrigid.presets()
    assert list(keys.keys()) == [*expressions, *(f"morph {name}" for name in presets)]
    assert np.array_equal(10.0 * seen(result), neutral)
    landmarks = {str(k): int(v) for k, v in enumerate(data.face.rig.landmarks)}
    for name, preset in presets.items():
        key = keys[f"morph {name}"]
        assert (key.slider_min, key.slider_max) == preset.range
        for amount in preset.range:
            key.value = amount
            expected = nonrigid.morph((neutral, data.face.rig.mesh.faces), {name: amount}, landmarks=landmarks)
            moved = 10.0 * seen(result) - neutral
            assert np.abs(moved - (expected.mesh.vertices - neutral)).max() < 1e-3, (name, amount)
            assert np.abs(moved).max() > 0.3 * abs(amount)
        key.value = 0.0
        mask = part("scene").group_weights(result, f"morph {name}")
        assert np.abs(mask - expected.mask).max() < 1e-3


def test_a_result_may_be_scaled(scene: Scene) -> None:
    """A slider's millimetre is one of the world as it was wrapped, whether the object's scale is applied or not."""
    result = wrap()
    for key in result.data.shape_keys.key_blocks[1:]:
        key.value = 0.0
    result.data.transform(Matrix.Scale(0.001, 4), shape_keys=True)
    result.scale *= 1000.0
    bpy.context.view_layer.update()
    neutral = seen(result)
    assert bpy.ops.nonrigid.morph_add(preset="chin-forward") == {"FINISHED"}
    result.data.shape_keys.key_blocks["morph chin-forward"].value = 2.0
    assert 1.8 < 1000.0 * np.linalg.norm(seen(result) - neutral, axis=1).max() < 2.2


def test_any_mesh_with_landmarks(scene: Scene) -> None:
    """The template too, by its empties; its vertices stay."""
    template = scene.template
    bpy.context.view_layer.objects.active = template
    before = numbers(template.data.vertices)
    assert bpy.ops.nonrigid.morph_add(preset="nose-bridge") == {"FINISHED"}
    assert np.array_equal(numbers(template.data.vertices), before)
    key = template.data.shape_keys.key_blocks["morph nose-bridge"]
    moved = np.abs(numbers(key.data) - before).max(axis=1)
    nose = moved > 0.5
    assert 0.9 < moved.max() < 1.1 and 3 < nose.sum() < 100


def test_what_is_there_stays(scene: Scene) -> None:
    """A key that was edited by hand is not made again, and no other is lost."""
    template = scene.template
    bpy.context.view_layer.objects.active = template
    bpy.ops.nonrigid.morph_add(preset="chin-forward")
    key = template.data.shape_keys.key_blocks["morph chin-forward"]
    key.data[0].co.x += 3.0
    key.value = 2.0
    before = everything()
    with pytest.raises(RuntimeError, match="has the shape key 'morph chin-forward' already"):
        bpy.ops.nonrigid.morph_add(preset="chin-forward")
    assert everything() == before
    edited = numbers(key.data).copy()
    assert bpy.ops.nonrigid.morph_add(preset="ALL") == {"FINISHED"}
    key = template.data.shape_keys.key_blocks["morph chin-forward"]
    assert np.array_equal(numbers(key.data), edited) and key.value == 2.0


def remove_vertices(thing: bpy.types.Object, count: int) -> None:
    mesh = bmesh.new()
    mesh.from_mesh(thing.data)
    mesh.verts.ensure_lookup_table()
    bmesh.ops.delete(mesh, geom=mesh.verts[:count], context="VERTS")
    mesh.to_mesh(thing.data)
    mesh.free()


def greatest_motion(thing: bpy.types.Object, preset: str) -> np.ndarray:
    """Where a morph moves most, in the object's coordinates."""
    keys = thing.data.shape_keys.key_blocks
    rest = numbers(keys[0].data)
    return rest[np.linalg.norm(numbers(keys[f"morph {preset}"].data) - rest, axis=1).argmax()]


def test_landmarks_are_those_of_the_vertices(scene: Scene, data: Data) -> None:
    """A result whose vertices were removed has landmarks no more, until it is given some."""
    result = wrap()
    result.shape_key_clear()
    tip = numbers(result.data.vertices)[data.face.rig.landmarks[30]]
    edited = result.copy()
    edited.data = result.data.copy()
    bpy.context.collection.objects.link(edited)
    assert bpy.ops.nonrigid.morph_add(preset="nose-tip") == {"FINISHED"}
    assert np.array_equal(greatest_motion(result, "nose-tip"), tip)

    remove_vertices(edited, 3)
    bpy.context.view_layer.objects.active = edited
    before = everything()
    with pytest.raises(RuntimeError, match="has other vertices or polygons than when it was wrapped.*: add morphs before"):
        bpy.ops.nonrigid.morph_add(preset="nose-tip")
    assert everything() == before
    for mark, vertex in enumerate(data.face.rig.landmarks):
        empty = bpy.data.objects.new(str(mark), None)
        empty.parent, empty.location = edited, numbers(result.data.vertices)[vertex]
        bpy.context.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert bpy.ops.nonrigid.morph_add(preset="nose-tip") == {"FINISHED"}
    assert np.array_equal(greatest_motion(edited, "nose-tip"), tip)


def morphed(preset: str) -> list[tuple[str, str]]:
    """Adds a morph to the active mesh; what the operator reports."""
    said: list[tuple[str, str]] = []
    execute = vars(part("morphs").NONRIGID_OT_morph_add)["execute"]
    operator = SimpleNamespace(preset=preset, report=lambda kind, text: said.append((*kind, text)))
    assert execute(operator, bpy.context) == {"FINISHED"}
    return said


def test_a_template_in_metres(scene: Scene) -> None:
    """Its unit is found; one that cannot be is said."""
    template = scene.template
    grow(template, 0.001)
    bpy.context.view_layer.objects.active = template
    assert [kind for kind, _ in morphed("nose-bridge")] == ["INFO"]
    keys = template.data.shape_keys.key_blocks
    assert 0.0009 < np.abs(numbers(keys["morph nose-bridge"].data) - numbers(keys[0].data)).max() < 0.0011
    scene.chosen.unit = "MM"
    (kind, text), _ = morphed("chin-forward")
    assert kind == "WARNING" and "mm across, as no face" in text and text.endswith("Unit says that a Blender unit is 1 mm")


def test_a_result_that_was_scaled(scene: Scene) -> None:
    """Its millimetres are those of the wrap: that its size is no face's then is said."""
    wrap().scale = (0.001, 0.001, 0.001)
    (kind, text), _ = morphed("nose-bridge")
    assert kind == "WARNING" and "it was wrapped where a Blender unit was 1 mm" in text


def test_no_landmarks(scene: Scene, data: Data) -> None:
    scene.chosen.rig_path = ""
    bpy.context.view_layer.objects.active = scene.scan
    for empty in list(scene.scan.children):
        bpy.data.objects.remove(empty)
    before = everything()
    with pytest.raises(RuntimeError, match="has no landmarks"):
        bpy.ops.nonrigid.morph_add(preset="nose-bridge")
    scene.chosen.rig_path = str(data.rig)
    with pytest.raises(RuntimeError, match=r"The rig has \d+ vertices and scan \d+"):
        bpy.ops.nonrigid.morph_add(preset="nose-bridge")
    assert everything() == before
