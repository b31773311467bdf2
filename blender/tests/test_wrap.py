"""A wrap through the operators: what the result has, and what stays as it was."""

from __future__ import annotations

import importlib
import json
import re
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from conftest import MARKS, MODULE, Data, Scene, everything, grow, imported, moved_to_collection, nearest, numbers, of_gltf, put, seen, turned


def part(name: str) -> Any:
    return importlib.import_module(f"{MODULE}.{name}")


def wrap() -> bpy.types.Object:
    before = set(bpy.data.objects)
    assert bpy.ops.nonrigid.wrap() == {"FINISHED"}
    (result,) = set(bpy.data.objects) - before
    assert bpy.context.object == result
    return result


def error(result: bpy.types.Object, data: Data, scan: bpy.types.Object) -> float:
    """Root mean square distance to the truth where the scan shows it, millimetres of a world in millimetres."""
    truth = turned(scan, data.case.truth)
    return float(np.sqrt((((turned(result, seen(result)) - truth)[data.case.observed]) ** 2).sum(axis=1).mean()))


def alone(scene: Scene, data: Data) -> Any:
    """The same wrap by the package alone, of the files and the landmarks that are in the scene."""
    import nonrigid

    rig = nonrigid.Rig.read(data.rig)
    marks = {int(rig.landmarks[int(empty.name.split(".")[0])]): np.array(empty.location) for empty in scene.scan.children}
    assert len(marks) == len(MARKS)
    return nonrigid.register(rig.mesh, data.folder / "scan.ply", rig=rig, identity_modes=8, landmarks=marks)


def test_the_result(scene: Scene, data: Data, tmp_path: Path) -> None:
    before, expected = everything(), alone(scene, data)
    result = wrap()
    assert {name: now for name, now in everything().items() if name in before} == before
    template = scene.template

    # topology, texture coordinates and materials are the template's
    corners = [list(polygon.vertices) for polygon in template.data.polygons]
    assert [list(polygon.vertices) for polygon in result.data.polygons] == corners and all(len(c) == 4 for c in corners)
    uvs = [numbers(thing.data.uv_layers.active.data, "uv", 2) for thing in (template, result)]
    assert np.array_equal(*uvs) and np.ptp(uvs[0]) > 0.5
    assert [m.name for m in result.data.materials] == [m.name for m in template.data.materials] and len(result.data.materials) > 1

    # the shape is what the package alone finds, and near the truth
    assert np.array_equal(np.array(result.matrix_world), np.array(scene.scan.matrix_world))
    assert np.abs(seen(result) - expected.positions).max() < 0.01
    assert error(result, data, scene.scan) < 1.5

    # the rig's expressions are shape keys with the weights found; they are the person's own
    keys = result.data.shape_keys.key_blocks
    rig = data.face.rig
    expressions = [name for name, family in zip(rig.names, rig.families) if family == "expression"]
    assert [key.name for key in keys] == ["Basis", *expressions]
    for name in expressions:
        assert keys[name].value == pytest.approx(expected.weights[name].value, abs=1e-3)
    smiling = max(expressions, key=lambda name: expected.weights[name].value)
    assert keys[smiling].value > 0.2
    own = numbers(keys[smiling].data) - numbers(keys["Basis"].data)
    general = rig.deltas[rig.names.index(smiling)]
    assert np.corrcoef(own.ravel(), general.ravel())[0, 1] > 0.9
    assert 0.01 < np.abs(own - general).max() < 0.5 * np.abs(general).max()

    # doubts, regions, distances, report
    unseen = part("scene").group_weights(result, "nonrigid doubt") > 0
    assert (unseen == expected.accepted).sum() <= 2 and unseen.any() and not unseen.all()
    for region, vertices in rig.regions.items():
        assert set(np.flatnonzero(part("scene").group_weights(result, region))) == set(vertices.tolist())
    distances = numbers(result.data.attributes["nonrigid distance mm"].data, "value", 1)[:, 0]
    assert np.median(distances[~unseen]) < 0.3 and distances.max() < 50.0
    colours = numbers(result.data.color_attributes["nonrigid distance"].data, "color_srgb", 4)
    assert result.data.color_attributes.active_color.name == "nonrigid distance"
    redness = colours[~unseen, 0] - colours[~unseen, 1]
    assert redness[distances[~unseen] > 3.0].min(initial=1.0) > redness[distances[~unseen] < 0.5].max()
    assert np.abs(colours[unseen, :3] - 0.4).max() < 0.01
    assert result["nonrigid_error_probability"] == pytest.approx(expected.error_probability, abs=0.01)
    words, _, report = result["nonrigid_report"].as_string().partition("\n\n")
    assert "more than " in words and json.loads(report)["weights"]

    # it survives the file
    shown = seen(result)
    assert bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "wrapped.blend")) == {"FINISHED"}
    name, after = result.name, everything()
    assert bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "wrapped.blend")) == {"FINISHED"}
    assert everything() == after
    again = bpy.data.objects[name]
    assert np.array_equal(seen(again), shown)
    assert json.loads(again["nonrigid_report"].as_string().partition("\n\n")[2]) == json.loads(report)
    assert bpy.context.scene.nonrigid.scan.name == "scan"


def test_again_makes_another(scene: Scene) -> None:
    first = wrap()
    before = everything()
    second = wrap()
    assert second.name != first.name and second.data != first.data and first["nonrigid_report"] != second["nonrigid_report"]
    assert {name: now for name, now in everything().items() if name in before} == before
    assert np.array_equal(seen(second), seen(first))


def test_places_units_and_scales(scene: Scene, data: Data) -> None:
    """The same wrap, wherever the objects lie and whatever a unit is: here a scan in metres, and a template in half millimetres, both turned."""
    expected = turned(scene.scan, seen(wrap()))
    scan, template = scene.scan, scene.template
    back = np.array(scan.matrix_world.inverted())
    local = expected @ back[:3, :3].T + back[:3, 3]
    for thing, factor in ((scan, 0.001), (template, 0.002)):
        grow(thing, factor)
    template.scale = (0.5, 0.5, 0.5)
    template.rotation_euler = (0.3, -1.0, 2.0)
    scan.rotation_euler = (-0.5, 0.2, 0.1)
    scan.location = (1.0, 2.0, 3.0)
    for unit, scale_length in (("M", 0.3), ("SCENE", 1.0)):
        scene.chosen.unit = unit
        bpy.context.scene.unit_settings.scale_length = scale_length
        result = wrap()
        off = np.abs(1000.0 * seen(result) - local).max()
        assert off < 0.05, (unit, off)
        assert np.allclose(result.matrix_world, scan.matrix_world)


def test_units_by_size(scene: Scene) -> None:
    """A mesh is as large as a face, as importers bring it or scaled; what no face is in the unit that was chosen is said."""
    expected = seen(wrap())
    grow(scene.scan, 0.001)
    scene.template.scale = (0.001, 0.001, 0.001)
    result = wrap()
    assert np.abs(1000.0 * seen(result) - expected).max() < 0.05 and result["nonrigid_millimetres"] == 1000.0
    assert "Note: " not in result["nonrigid_report"].as_string()
    scene.chosen.unit = "MM"
    assert wrap()["nonrigid_report"].as_string().count("mm across, as no face, head or body is: Unit says that a Blender unit is 1 mm") == 2

    thing, surface = scene.template, part("scene").base_surface(scene.template, 1.0)
    millimetres = lambda factor: part("scene").millimetres(bpy.context.scene, thing.name, surface.times(factor))
    for unit, length in (("MM", 1.0), ("CM", 10.0), ("M", 1000.0), ("IN", 25.4)):
        scene.chosen.unit = unit
        assert millimetres(1.0 / length) == (length, None)
    scene.chosen.unit = "SIZE"
    assert millimetres(0.001) == (1000.0, None)
    found, doubt = millimetres(0.1)
    assert found == 10.0 and re.fullmatch(r"face is taken for \d+ mm across, in cm; if it is in in, \d+ mm, choose that Unit", doubt)


@pytest.mark.parametrize("by", ["viewports", "collection", "eye"])
def test_hidden_landmarks(scene: Scene, by: str) -> None:
    """They are where their parent is, though Blender does not look at them while they are hidden."""
    expected = seen(wrap())
    for empty in scene.scan.children:
        if by == "viewports":
            empty.hide_viewport = True
        elif by == "eye":
            empty.hide_set(True)
        else:
            moved_to_collection(empty).exclude = True
    scene.scan.location.y += 400.0
    scene.scan.rotation_euler = (0.3, 0.2, 0.1)
    assert np.abs(seen(wrap()) - expected).max() < 1e-3


def test_a_hidden_scan(scene: Scene) -> None:
    """With its modifiers, as if it were seen."""
    scene.scan.modifiers.new("thicker", "DISPLACE").strength = 6.0
    expected = seen(wrap())
    scene.scan.hide_set(True)
    scene.template.hide_set(True)
    assert np.array_equal(seen(wrap()), expected)


def test_shape_keys_as_blender_shows_them(scene: Scene, data: Data) -> None:
    """Within their vertex group; those that move nothing are named, and so is that none is left."""
    template, rig = scene.template, data.face.rig
    scene.chosen.rig_source = "KEYS"
    for name in ("Basis", "still", "jawOpen"):
        template.shape_key_add(name=name)
    report = wrap()["nonrigid_report"].as_string()
    for name in ("still", "jawOpen"):
        assert f'Note: shape "{name}" moves nothing and was left out' in report
    assert "Note: nothing of the rig is used" in report

    rest = numbers(template.data.vertices)
    key = template.data.shape_keys.key_blocks["jawOpen"]
    key.data.foreach_set("co", (rest + rig.deltas[rig.names.index("jawOpen")]).astype(np.float32).ravel())
    left = template.vertex_groups.new(name="left")
    left.add(np.flatnonzero(rest[:, 0] > 10.0).tolist(), 1.0, "REPLACE")
    left.add(np.flatnonzero(np.abs(rest[:, 0]) <= 10.0).tolist(), 0.5, "REPLACE")
    for group in ("left", ""):
        key.vertex_group, key.value = group, 1.0
        shown = seen(template) - rest
        key.value = 0.0
        shapes = part("scene").own_shape_keys(template, 1.0)
        assert np.abs(shapes["jawOpen"] - shown).max() < 1e-4
    assert np.abs(shown[rest[:, 0] < -20.0]).max() > 5.0
    assert "nothing of the rig" not in wrap()["nonrigid_report"].as_string()


def test_template_from_gltf(scene: Scene, data: Data, tmp_path: Path) -> None:
    """Blender turns glTF: the rig's file turns with it. Its own shape keys do as well for a rig."""
    rig = data.face.rig
    rig.write(tmp_path / "rig.glb")
    template = imported(bpy.ops.import_scene.gltf, tmp_path / "rig.glb")
    # it is in metres, and so the scan has to be
    grow(scene.scan, 0.001)
    scene.chosen.template, scene.chosen.unit = template, "M"
    bpy.context.view_layer.update()
    basis = part("scene").basis(template)
    places = of_gltf(turned(template, numbers(basis)))  # in the order of materials, with copies at their borders and at seams
    for mark, vertex in zip(MARKS, nearest(places, rig.neutral[rig.landmarks[list(MARKS)]])):
        bpy.context.scene.cursor.location = template.matrix_world @ basis[int(vertex)].co
        assert bpy.ops.nonrigid.landmark_add(on="TEMPLATE", name=str(mark)) == {"FINISHED"}
    scene.chosen.rig_source = "KEYS"
    result = wrap()
    of = nearest(rig.neutral, places)
    off = 1000.0 * seen(result) - data.case.truth[of]
    assert np.sqrt((off[data.case.observed[of]] ** 2).sum(axis=1).mean()) < 1.5
    apart = np.array([np.ptp(off[of == v], axis=0).max() for v in np.unique(of)])
    assert apart.max() < 1e-3, "no crack between materials"
    assert "jawOpen" in result.data.shape_keys.key_blocks and not any("identity" in k.name for k in result.data.shape_keys.key_blocks)


def test_rig_of_a_turned_template(scene: Scene, data: Data) -> None:
    """A template whose very coordinates are turned and in metres, with the rig of the file that is not."""
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=np.float32)
    expected = seen(wrap())
    template = scene.template
    put(template, numbers(template.data.vertices) @ turn.T)
    for empty in template.children:
        empty.location = turn @ np.array(empty.location)
    assert np.abs(seen(wrap()) - expected).max() < 0.05


def test_landmarks_alone_carry_morphs(scene: Scene, data: Data) -> None:
    """Without a rig the vertices that were picked go with the result, also by a name longer than a custom property's."""
    bpy.context.scene.cursor.location = (0.0, -80.0, 30.0)
    for on in ("TEMPLATE", "SCAN"):
        assert bpy.ops.nonrigid.landmark_add(on=on, name="the place that has a name of almost sixty letters, and more") == {"FINISHED"}
    scene.chosen.rig_source, scene.chosen.model = "NONE", "graph"
    result = wrap()
    assert len(json.loads(result["nonrigid_landmarks"])) == 69
    scene.chosen.rig_path = ""
    assert bpy.ops.nonrigid.morph_add(preset="nose-tip") == {"FINISHED"}
    assert "morph nose-tip" in result.data.shape_keys.key_blocks


def test_polygons_of_all_sizes_keep_their_order(scene: Scene, data: Data) -> None:
    """Two quads become a hexagon, one two triangles, in the middle of the list; the template has no rig then."""
    faces = [list(map(int, face)) for face in data.face.rig.mesh.faces]
    first = faces[300]
    k = next(k for k in range(301, 600) if len(set(faces[k]) & set(first)) == 2)
    shared = set(faces[k]) & set(first)
    edge = next(i for i in range(4) if {first[i], first[(i + 1) % 4]} == shared)
    around = first[edge + 1 :] + first[: edge + 1]
    start = faces[k].index(around[-1])
    other = faces[k][start:] + faces[k][:start]
    hexagon = around + other[1:3] if other[3] == around[0] else around + other[-1:1:-1]
    assert len(set(hexagon)) == 6
    mixed = [*faces[:300], hexagon, *faces[301:k], *faces[k + 1 :]]
    split = mixed[100]
    mixed[100:101] = [[split[0], split[1], split[2]], [split[0], split[2], split[3]]]
    mesh = bpy.data.meshes.new("mixed")
    mesh.from_pydata(data.face.rig.neutral.tolist(), [], mixed)
    scene.template.data = mesh
    scene.chosen.rig_source, scene.chosen.model = "NONE", "graph"
    result = wrap()
    assert [list(polygon.vertices) for polygon in result.data.polygons] == mixed
    assert result.data.shape_keys is None
    assert error(result, data, scene.scan) < 4.0


def test_masks_leave_vertices_to_smoothness(scene: Scene) -> None:
    """Where a painted group is free the scan has no say: nothing there is accepted."""
    free = scene.template.vertex_groups.new(name="hair")
    high = np.flatnonzero(numbers(scene.template.data.vertices)[:, 1] > 40.0)
    free.add(high.tolist(), 1.0, "REPLACE")
    group_weights = part("scene").group_weights
    without = group_weights(wrap(), "nonrigid doubt")
    scene.chosen.free_mask = "hair"
    result = wrap()
    assert "hair" in result.vertex_groups
    assert (group_weights(result, "nonrigid doubt")[high] > 0).mean() > 0.95 > 0.5 > (without[high] > 0).mean()


def test_progress_and_the_window(scene: Scene) -> None:
    """What the modal operator does at each tick of its timer."""
    wrapping = part("wrapping")
    run = wrapping.Run(bpy.context)
    seen_progress, stages = [], set()
    deadline = time.monotonic() + 60
    while (ended := run.poll(bpy.context)) is None:
        assert time.monotonic() < deadline
        seen_progress.append(run.job.progress)
        stages.add(run.job.stage.split()[0])
        time.sleep(0.01)
    result, _ = ended
    assert result.name == "scan wrapped"
    assert seen_progress == sorted(seen_progress) and len(set(seen_progress)) > 3 and run.job.progress == 1.0
    assert "Level" in stages


@pytest.mark.parametrize("model", ["hybrid", "sequential"])
def test_steps_of_a_schedule(scene: Scene, model: str) -> None:
    """Those that are done are no more, also with a stage that comes after."""
    import nonrigid

    bridge = part("bridge")
    schedule = nonrigid.Schedule.of(None, model).to_dict()
    sheet = scene_surface(scene.template)
    assert not sheet.is_closed()
    steps: list[Any] = []
    rig = nonrigid.Rig.read(scene.chosen.rig_path)
    nonrigid.register(rig.mesh, scene_surface(scene.scan).mesh(), rig=rig, model=model, callback=steps.append)
    levels = [*schedule["level"], *schedule.get("then", {}).get("level", [])]
    assert max(step.level for step in steps) == len(levels) - 1
    assert len(steps) <= bridge._step_count(schedule, closed=False) == sum(level["steps"] for level in levels)


def scene_surface(thing: bpy.types.Object) -> Any:
    return part("scene").base_surface(thing, 1.0)


def test_steps_for_a_closed_subject() -> None:
    bridge = part("bridge")
    corners = np.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3], dtype=np.int32)
    tetrahedron = bridge.Surface(np.eye(4, 3), np.arange(0, 13, 3, dtype=np.int32), corners)
    assert tetrahedron.is_closed()
    assert not bridge.Surface(np.eye(4, 3), tetrahedron.starts[:-1], corners[:-3]).is_closed()
    schedule = {"level": [{"steps": 2}], "closed": {"bend": [{"steps": 9}], "level": [{"steps": 5}]}, "then": {"level": [{"steps": 1}], "then": None}}
    assert [bridge._step_count(schedule, closed) for closed in (False, True)] == [3, 6]


class Manager:
    """Stands for a window manager, which Blender without a window lets no operator wait on."""

    def __init__(self) -> None:
        self.timers: list[object] = []
        self.waiting: list[object] = []
        self.windows: tuple[object, ...] = ()

    def event_timer_add(self, _seconds: float, window: object) -> object:
        self.timers.append(window)
        return window

    def event_timer_remove(self, timer: object) -> None:
        self.timers.remove(timer)

    def modal_handler_add(self, operator: object) -> None:
        self.waiting.append(operator)


class Context:
    """Blender's, with that manager."""

    def __init__(self) -> None:
        self.window_manager = Manager()

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


def waiting_operator() -> Any:
    """The methods of the operator on an object that notes what it reports."""
    said: list[tuple[str, str]] = []
    methods = {name: vars(part("wrapping").NONRIGID_OT_wrap)[name] for name in ("invoke", "modal", "cancel", "_start", "_step")}
    return type("Waiting", (), {**methods, "said": said, "report": lambda _, kind, text: said.append((*kind, text))})()


@pytest.mark.parametrize("end", ["finish", "cancel", "close"])
def test_in_a_window(scene: Scene, end: str) -> None:
    """The operator waits on its timer, lets everything else through, and gives the timer back however it ends."""
    operator, context, before = waiting_operator(), Context(), everything()
    tick, mouse = SimpleNamespace(type="TIMER"), SimpleNamespace(type="MOUSEMOVE")
    assert operator.invoke(context, mouse) == {"RUNNING_MODAL"}
    manager = context.window_manager
    assert len(manager.timers) == 1 and manager.waiting == [operator]
    assert operator.modal(context, mouse) == {"PASS_THROUGH"}
    if end == "close":
        operator.cancel(context)
    elif end == "cancel":
        assert bpy.ops.nonrigid.cancel() == {"FINISHED"}
        assert operator.modal(context, tick) == {"CANCELLED"}
        assert operator.said == [("WARNING", "The wrap was cancelled; nothing was made")]
    else:
        deadline = time.monotonic() + 60
        while (outcome := operator.modal(context, tick)) == {"PASS_THROUGH"}:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert outcome == {"FINISHED"} and bpy.context.object.name == "scan wrapped"
        assert operator.said[-1][0] == "INFO"
    assert manager.timers == [] and part("wrapping").current is None
    now = everything()
    assert {name: now[name] for name in before} == before and len(now) == len(before) + (end == "finish")


def test_cancel_makes_nothing(scene: Scene) -> None:
    wrapping = part("wrapping")
    before = everything()
    wrapping.current = wrapping.Run(bpy.context)
    job = wrapping.current.job
    assert not bpy.ops.nonrigid.wrap.poll()  # one at a time
    assert bpy.ops.nonrigid.cancel() == {"FINISHED"}
    with pytest.raises(part("bridge").Cancelled):
        wrapping.current.poll(bpy.context)
    wrapping.current = None
    job.wait(30)
    assert not job._thread.is_alive() and job._result is None  # ended early, by its next step
    assert everything() == before and not bpy.data.texts
    assert bpy.ops.nonrigid.wrap.poll() and not bpy.ops.nonrigid.cancel.poll()


def test_a_new_file_lets_go_of_the_wrap(scene: Scene) -> None:
    wrapping = part("wrapping")
    wrapping.current = wrapping.Run(bpy.context)
    job = wrapping.current.job
    bpy.ops.wm.read_homefile(use_empty=True)
    assert wrapping.current is None and job.cancelled


@pytest.mark.parametrize("change", ["delete", "edit"])
def test_the_template_goes_while_it_is_wrapped(scene: Scene, change: str) -> None:
    """The result keeps the polygons that were registered."""
    expected = seen(wrap())
    corners = [list(polygon.vertices) for polygon in scene.template.data.polygons]
    run = part("wrapping").Run(bpy.context)
    if change == "delete":
        bpy.data.objects.remove(scene.template)
    else:
        scene.template.data.clear_geometry()
    run.job.wait(60)
    result, notes = run.poll(bpy.context)
    assert np.array_equal(seen(result), expected)
    assert [list(polygon.vertices) for polygon in result.data.polygons] == corners
    assert any("template has changed" in note for note in notes)
