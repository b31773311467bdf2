"""What cannot be wrapped: one error that says what to do, and nothing is changed or made."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from conftest import Data, Scene, everything, grow, moved_to_collection, numbers


def no_template(scene: Scene) -> None:
    scene.chosen.template = None


def no_scan(scene: Scene) -> None:
    scene.chosen.scan = None


def deleted_scan(scene: Scene) -> None:
    bpy.data.objects.remove(scene.scan)


def scan_of_another_scene(scene: Scene) -> None:
    for collection in list(scene.scan.users_collection):
        collection.objects.unlink(scene.scan)


def the_same_mesh(scene: Scene) -> None:
    scene.chosen.scan = scene.template


def empty_scan(scene: Scene) -> None:
    scene.scan.data = bpy.data.meshes.new("nothing")


def points_without_faces(scene: Scene) -> None:
    mesh = bpy.data.meshes.new("points")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [])
    scene.template.data = mesh


def not_finite(scene: Scene) -> None:
    scene.scan.data.vertices[5].co.y = float("nan")


def uneven_scale(scene: Scene) -> None:
    scene.scan.scale = (1.0, 1.0, 1.2)


def sheared_by_its_parent(scene: Scene) -> None:
    parent = bpy.data.objects.new("parent", None)
    bpy.context.collection.objects.link(parent)
    parent.scale = (1.0, 2.0, 1.0)
    scene.template.parent = parent
    scene.template.rotation_euler = (0.0, 0.0, 0.7)


def mirrored(scene: Scene) -> None:
    scene.template.scale = (-1.0, 1.0, 1.0)


def flat(scene: Scene) -> None:
    scene.template.scale = (1.0, 0.0, 1.0)


def disabled_scan(scene: Scene) -> None:
    scene.scan.hide_viewport = True


def scan_in_an_excluded_collection(scene: Scene) -> None:
    moved_to_collection(scene.scan).exclude = True


def template_in_a_disabled_collection(scene: Scene) -> None:
    moved_to_collection(scene.template).collection.hide_viewport = True


def disabled_landmark_that_follows(scene: Scene) -> None:
    """Only where it is evaluated is it known where a constraint brings it."""
    empty = scene.scan.children[0]
    empty.constraints.new("COPY_LOCATION").target = scene.template
    empty.hide_viewport = True


def size_of_no_face(scene: Scene) -> None:
    grow(scene.scan, 0.01)


def size_of_two_faces(scene: Scene) -> None:
    grow(scene.template, 0.06)


def sizes_of_two_units(scene: Scene) -> None:
    grow(scene.scan, 0.001)


def shape_key_not_finite(scene: Scene) -> None:
    scene.template.shape_key_add(name="Basis")
    scene.template.shape_key_add(name="jawOpen").data[3].co.x = float("nan")
    scene.chosen.rig_source = "KEYS"


def no_schedule(scene: Scene) -> None:
    scene.chosen.schedule = "/nowhere/levels.toml"


def landmark_on_scan_alone(scene: Scene) -> None:
    bpy.ops.nonrigid.landmark_add(on="SCAN", name="left ear")


def landmark_on_template_alone(scene: Scene) -> None:
    bpy.ops.nonrigid.landmark_add(on="TEMPLATE", name="left ear")


def two_of_a_name(scene: Scene) -> None:
    bpy.ops.object.select_all(action="DESELECT")
    first = scene.scan.children[0]
    copy = first.copy()
    bpy.context.collection.objects.link(copy)


def missing_rig(scene: Scene) -> None:
    scene.chosen.rig_path = "/nowhere/rig"


def no_rig_path(scene: Scene) -> None:
    scene.chosen.rig_path = ""


def rig_of_another_mesh(scene: Scene) -> None:
    import nonrigid

    mesh = nonrigid.Mesh([[0, 0, 0], [90, 0, 0], [0, 90, 0], [90, 90, 20]], [[0, 1, 3, 2]])
    path = Path(bpy.app.tempdir) / "other.npz"
    path.unlink(missing_ok=True)
    nonrigid.Rig(mesh, {"up": np.eye(4, 3)}).write(path)
    scene.chosen.rig_path = str(path)


def rig_in_hdf5(scene: Scene) -> None:
    path = Path(bpy.app.tempdir) / "basel.h5"
    path.write_bytes(b"\x89HDF\r\n")
    scene.chosen.rig_path = str(path)


def no_rig_in_the_folder(scene: Scene) -> None:
    folder = Path(bpy.app.tempdir) / "no rig"
    folder.mkdir(exist_ok=True)
    scene.chosen.rig_path = str(folder)


def no_shape_keys(scene: Scene) -> None:
    scene.chosen.rig_source = "KEYS"


def no_such_group(scene: Scene) -> None:
    scene.chosen.mask = "beard"


def no_such_region(scene: Scene) -> None:
    scene.chosen.free_regions = "antlers"


def scan_like_a_line(scene: Scene) -> None:
    mesh = bpy.data.meshes.new("line")
    mesh.from_pydata([(x, 0, 0) for x in range(9)], [], [(k, k + 1, k + 2) for k in range(7)])
    scene.scan.data = mesh


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (no_template, "No template is chosen"),
        (no_scan, "No scan is chosen"),
        (deleted_scan, "No scan is chosen"),
        (scan_of_another_scene, "No scan is chosen"),
        (the_same_mesh, "both face"),
        (empty_scan, "scan is an empty mesh"),
        (points_without_faces, "3 vertices and 0 faces"),
        (not_finite, "not finite"),
        (uneven_scale, r"scan is not scaled evenly \(1, 1, 1.2\): apply its scale"),
        (sheared_by_its_parent, "face is not scaled evenly"),
        (mirrored, "face is mirrored"),
        (flat, "face is not scaled evenly"),
        (disabled_scan, "scan is disabled in viewports, .*: enable it"),
        (scan_in_an_excluded_collection, "scan is disabled in viewports"),
        (template_in_a_disabled_collection, "face is disabled in viewports"),
        (disabled_landmark_that_follows, r"\d+\.\d+ is disabled in viewports"),
        (size_of_no_face, "scan: 2.* across, which no face is in mm, cm, m or um: choose what a Blender unit is"),
        (size_of_two_faces, r"face: 1.* across, which a face may be in cm \(.* mm\) and in in \(.* mm\): choose what a Blender unit is"),
        (sizes_of_two_units, "By size a Blender unit is 1 mm for face and 1000 mm for scan: scale one of them, or choose Unit"),
        (shape_key_not_finite, "face has vertices that are not finite in the shape key 'jawOpen'"),
        (landmark_on_scan_alone, "without a partner: left ear only on scan"),
        (landmark_on_template_alone, "without a partner: left ear only on face"),
        (two_of_a_name, "two landmarks '"),
        (no_schedule, "no schedule at '/nowhere/levels.toml'"),
        (missing_rig, "no rig at '/nowhere/rig'"),
        (no_rig_path, "no rig at ''"),
        (rig_of_another_mesh, r"The rig has 4 vertices and the template \d+"),
        (rig_in_hdf5, "read by h5py"),
        (no_rig_in_the_folder, "no rig"),
        (no_shape_keys, "face has no shape keys"),
        (no_such_group, "no vertex group 'beard'"),
        (no_such_region, "antlers"),
        (scan_like_a_line, "triangle|scan|line"),
    ],
)
def test_bad_input(scene: Scene, spoil: Callable[[Scene], None], expected: str) -> None:
    spoil(scene)
    bpy.context.view_layer.update()
    before, texts, meshes = everything(), list(bpy.data.texts), len(bpy.data.meshes)
    with pytest.raises(RuntimeError, match=expected) as raised:
        bpy.ops.nonrigid.wrap()
    assert len(re.findall("^Error:", str(raised.value), re.M)) == 1, raised.value
    assert "Traceback" not in str(raised.value)
    assert everything() == before and list(bpy.data.texts) == texts and len(bpy.data.meshes) == meshes
    assert bpy.ops.nonrigid.wrap.poll()  # the next may start


def test_no_package(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A zip for another system: every operator says so, and Blender goes on."""
    monkeypatch.setitem(sys.modules, "nonrigid", None)
    bpy.context.view_layer.objects.active = scene.template
    before = everything()
    for operator in (bpy.ops.nonrigid.wrap, bpy.ops.nonrigid.landmarks_of_rig, bpy.ops.nonrigid.morph_add):
        with pytest.raises(RuntimeError, match="The Python package nonrigid cannot be loaded"):
            operator()
    assert everything() == before


def test_corrected_input_goes_on(scene: Scene, data: Data) -> None:
    """After an error the same scene wraps."""
    scene.scan.scale = (1.0, 1.0, 1.2)
    with pytest.raises(RuntimeError):
        bpy.ops.nonrigid.wrap()
    scene.scan.scale = (1.0, 1.0, 1.0)
    assert bpy.ops.nonrigid.wrap() == {"FINISHED"}
    assert len(numbers(bpy.context.object.data.vertices)) == len(data.face.rig.neutral)
