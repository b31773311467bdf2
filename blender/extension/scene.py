"""Objects of the scene as the arrays of `bridge`, and results as objects."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import bridge
from .bridge import Problem, Surface, Wrapped, report_text

DISTANCE = "nonrigid distance"
DISTANCE_MM = "nonrigid distance mm"
SCAN_COLOUR = "nonrigid scan colour"
DOUBT = "nonrigid doubt"
MORPH = "morph "
LANDMARKS = "nonrigid_landmarks"
TOPOLOGY = "nonrigid_topology"
MILLIMETRES = "nonrigid_millimetres"
OF_RIG = "nonrigid_of_rig"


def millimetres(scene: bpy.types.Scene, name: str, surface: Surface) -> tuple[float, str | None]:
    """How many a Blender unit is, for a mesh in Blender units; and what is to be said of that. Raises Problem where its size does not tell."""
    chosen = scene.nonrigid.unit
    if chosen == "SIZE":
        return bridge.unit_by_size(name, surface)
    unit = 1000.0 * scene.unit_settings.scale_length if chosen == "SCENE" else bridge.package()._nonrigid.millimetres(chosen.lower())
    return unit, bridge.odd_size(name, surface.times(unit), f"Unit says that a Blender unit is {unit:g} mm")


def own_millimetres(scene: bpy.types.Scene, thing: bpy.types.Object, surface: Surface) -> tuple[float, str | None]:
    """The same, of a result as it was when it was wrapped."""
    if MILLIMETRES not in thing:
        return millimetres(scene, thing.name, surface)
    unit = float(thing[MILLIMETRES])
    remedy = f"it was wrapped where a Blender unit was {unit:g} mm; without its custom property {MILLIMETRES} Unit decides"
    return unit, bridge.odd_size(thing.name, surface.times(unit), remedy)


def refuse_disabled(context: bpy.types.Context, thing: bpy.types.Object) -> None:
    """Raises Problem where Blender leaves an object's matrix and mesh as they once were: it is not shown in viewports, nor is a collection of
    it. What the eye hides is kept up to date."""

    def shown(layer: bpy.types.LayerCollection) -> bool:
        if layer.collection.hide_viewport:
            return False
        return (not layer.exclude and thing.name in layer.collection.objects) or any(shown(child) for child in layer.children)

    if thing.hide_viewport or not shown(context.view_layer.layer_collection):
        raise Problem(
            f"{thing.name} is disabled in viewports, or its collection is, and Blender keeps neither its place nor its modifiers up to date: "
            "enable it in the Outliner, and hide it by the eye"
        )


def even_scale(thing: bpy.types.Object) -> float:
    """By how much the object is scaled. Raises Problem where that is not the same in all directions."""
    linear = np.array(thing.matrix_world.to_3x3(), dtype=np.float64)
    square = linear.T @ linear
    scale = float(np.cbrt(abs(np.linalg.det(linear))))
    if scale == 0.0 or np.abs(square / scale**2 - np.eye(3)).max() > 1e-3:
        sizes = ", ".join(f"{x:.3g}" for x in np.sqrt(np.diag(square)))
        raise Problem(f"{thing.name} is not scaled evenly ({sizes}): apply its scale first (Object > Apply > Scale)")
    if np.linalg.det(linear) < 0.0:
        raise Problem(f"{thing.name} is mirrored by a negative scale: apply its scale first (Object > Apply > Scale)")
    return scale


def _numbers(collection: object, what: str, count: int, width: int = 3) -> np.ndarray:
    flat = np.empty(count * width, dtype=np.float32)
    collection.foreach_get(what, flat)
    return flat.reshape(count, width).astype(np.float64)


def _surface(name: str, mesh: bpy.types.Mesh, points: object, factor: float) -> Surface:
    if len(mesh.vertices) == 0 or len(mesh.polygons) == 0:
        raise Problem(f"{name} is an empty mesh: it has {len(mesh.vertices)} vertices and {len(mesh.polygons)} faces")
    positions = _numbers(points, "co", len(mesh.vertices)) * factor
    if not np.isfinite(positions).all():
        raise Problem(f"{name} has vertices that are not finite: clean it up (Mesh > Clean Up)")
    starts = np.empty(len(mesh.polygons) + 1, dtype=np.int32)
    mesh.polygons.foreach_get("loop_start", starts[:-1])
    starts[-1] = len(mesh.loops)
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    color = mesh.color_attributes.active_color
    colors = None
    if color is not None and color.domain == "POINT" and color.name != DISTANCE:
        colors = _numbers(color.data, "color_srgb", len(mesh.vertices), 4)[:, :3].clip(0.0, 1.0)
    return Surface(positions, starts, corners, colors)


def basis(thing: bpy.types.Object) -> object:
    """The points of a mesh without its shape keys."""
    keys = thing.data.shape_keys
    return thing.data.vertices if keys is None else keys.reference_key.data


def base_surface(thing: bpy.types.Object, factor: float) -> Surface:
    """A mesh as it is stored, without modifiers and shape keys, times `factor`."""
    if thing.mode == "EDIT":
        thing.update_from_editmode()
    return _surface(thing.name, thing.data, basis(thing), factor)


def seen_surface(thing: bpy.types.Object, depsgraph: bpy.types.Depsgraph, factor: float) -> Surface:
    """A mesh as it is seen, with modifiers and shape keys, times `factor`."""
    if thing.mode == "EDIT":
        thing.update_from_editmode()
        depsgraph.update()
    seen = thing.evaluated_get(depsgraph)
    try:
        mesh = seen.to_mesh()
        return _surface(thing.name, mesh, mesh.vertices, factor)
    finally:
        seen.to_mesh_clear()


def own_shape_keys(thing: bpy.types.Object, factor: float) -> dict[str, np.ndarray]:
    """Displacements of an object's shape keys at 1, by name, times `factor`, as their vertex groups let them act. Morphs are left out."""
    keys = thing.data.shape_keys
    if keys is None or len(keys.key_blocks) < 2:
        raise Problem(f"{thing.name} has no shape keys: choose another source of the rig, or none")
    count = len(thing.data.vertices)
    taken = [key for key in keys.key_blocks if key != keys.reference_key and not key.name.startswith(MORPH)]
    # where a group is gone Blender lets the whole key act
    weights = {group: group_weights(thing, group) for group in {key.vertex_group for key in taken} if group in thing.vertex_groups}
    shapes = {}
    for key in taken:
        delta = _numbers(key.data, "co", count) - _numbers(key.relative_key.data, "co", count)
        if not np.isfinite(delta).all():
            raise Problem(f"{thing.name} has vertices that are not finite in the shape key {key.name!r}: delete it, or make it anew")
        if key.vertex_group in weights:
            delta *= weights[key.vertex_group][:, None]
        shapes[key.name] = delta * factor
    return shapes


def group_weights(thing: bpy.types.Object, name: str) -> np.ndarray | None:
    """(V,): a vertex group, 0 where a vertex is not in it; None without a name."""
    if not name:
        return None
    group = thing.vertex_groups.get(name)
    if group is None:
        raise Problem(f"{thing.name} has no vertex group {name!r}")
    weights = np.zeros(len(thing.data.vertices))
    for vertex in thing.data.vertices:
        for entry in vertex.groups:
            if entry.group == group.index:
                weights[vertex.index] = entry.weight
    return weights


def landmark_name(empty: bpy.types.Object) -> str:
    """An empty's name without the number that Blender adds where names meet: `chin.001` is the chin too."""
    return re.sub(r"\.\d{3,}$", "", empty.name)


def landmarks(thing: bpy.types.Object) -> dict[str, bpy.types.Object]:
    """The empties parented to an object, by landmark. Raises Problem where two have one name."""
    found: dict[str, bpy.types.Object] = {}
    for child in thing.children:
        if child.type != "EMPTY":
            continue
        name = landmark_name(child)
        if name in found:
            raise Problem(f"{thing.name} has two landmarks {name!r}, {found[name].name} and {child.name}: rename or delete one")
        found[name] = child
    return found


def local_point(context: bpy.types.Context, thing: bpy.types.Object, empty: bpy.types.Object) -> Vector:
    """Where an empty that is parented to an object is in its coordinates. Raises Problem where only Blender knows, and does not say."""
    if empty.parent_type == "OBJECT" and not empty.constraints and empty.animation_data is None:
        return (empty.matrix_parent_inverse @ empty.matrix_basis).translation  # also while it is disabled in viewports
    refuse_disabled(context, empty)
    return thing.matrix_world.inverted() @ empty.matrix_world.translation


def array(point: Vector) -> np.ndarray:
    return np.array(point, dtype=np.float64)


def unpaired(template: dict[str, bpy.types.Object], scan: dict[str, bpy.types.Object]) -> tuple[list[str], list[str]]:
    """Names that only the template has, but for those that its rig has put there, and names that only the scan has."""
    only_template = [name for name, empty in template.items() if name not in scan and not empty.get(OF_RIG)]
    return only_template, [name for name in scan if name not in template]


@dataclass(frozen=True)
class Places:
    """Template and scan when the wrap began: names, since undo invalidates references, and what the result is made with."""

    template: str
    scan: str
    surface: Surface
    """The template, millimetres."""
    template_factor: float
    """Millimetres of a unit of its coordinates."""
    matrix: Matrix
    """Where the scan lies."""
    scan_factor: float
    """Millimetres of a unit of the scan's coordinates."""
    unit: float
    """Millimetres of a Blender unit."""


def make_result(context: bpy.types.Context, places: Places, wrapped: Wrapped, worst: float) -> tuple[bpy.types.Object, str | None]:
    """A new object with the template's polygons, UVs and materials on the scan; with what was lost, where the template is not what it was."""
    template, lost = bpy.data.objects.get(places.template), None
    if template is not None and template.type == "MESH" and len(template.data.polygons) > 0:
        same = base_surface(template, places.template_factor).topology() == places.surface.topology()
    else:
        same = False
    name = f"{places.scan} wrapped"
    if same:
        mesh = template.data.copy()
        mesh.name = name
    else:
        lost = "the template has changed meanwhile: the result has its old polygons, without UVs and materials"
        mesh = bpy.data.meshes.new(name)
        polygons = np.split(places.surface.corners, places.surface.starts[1:-1])
        mesh.from_pydata(places.surface.positions.tolist(), [], [polygon.tolist() for polygon in polygons])
    result = bpy.data.objects.new(name, mesh)
    if same:
        strip(result)
    context.collection.objects.link(result)
    if same:
        for mine, theirs in zip(result.material_slots, template.material_slots):
            if theirs.link == "OBJECT":
                mine.link, mine.material = "OBJECT", theirs.material
    result.matrix_world = places.matrix
    factor = 1.0 / places.scan_factor
    mesh.vertices.foreach_set("co", (wrapped.basis * factor).astype(np.float32).reshape(-1))
    if wrapped.shapes:
        result.shape_key_add(name="Basis", from_mix=False)
        for shape, delta in wrapped.shapes.items():
            add_key(result, shape, (wrapped.basis + delta) * factor, wrapped.weights[shape])
    add_group(result, DOUBT, (~wrapped.accepted).astype(np.float64))
    for region, vertices in wrapped.regions.items():
        if region not in result.vertex_groups:
            result.vertex_groups.new(name=region).add([int(v) for v in vertices], 1.0, "REPLACE")
    paint(mesh, wrapped, worst)
    text = bpy.data.texts.new(f"{name} report")
    text.from_string(report_text(wrapped))
    result["nonrigid_report"] = text
    result["nonrigid_error_probability"] = wrapped.error_probability
    result["nonrigid_doubts"] = "\n".join(wrapped.doubts)
    result[LANDMARKS] = json.dumps(wrapped.landmarks)
    result[TOPOLOGY] = places.surface.topology()
    result[MILLIMETRES] = places.unit
    mesh.update()
    return result, lost


def strip(result: bpy.types.Object) -> None:
    """Takes from a template's copy what the result has of its own: shape keys, and what is left of an earlier wrap."""
    if result.data.shape_keys is not None:
        result.shape_key_clear()
    for group in [group for group in result.vertex_groups if group.name == DOUBT or group.name.startswith(MORPH)]:
        result.vertex_groups.remove(group)
    for name in (DISTANCE, DISTANCE_MM, SCAN_COLOUR):
        if name in result.data.attributes:
            result.data.attributes.remove(result.data.attributes[name])


def add_key(thing: bpy.types.Object, name: str, positions: np.ndarray, value: float, bounds: tuple[float, float] = (0.0, 1.0)) -> None:
    """A shape key with a slider that reaches `value`."""
    key = thing.shape_key_add(name=name, from_mix=False)
    key.data.foreach_set("co", positions.astype(np.float32).reshape(-1))
    key.slider_min, key.slider_max = min(bounds[0], value), max(bounds[1], value)
    key.value = value


def add_group(thing: bpy.types.Object, name: str, weights: np.ndarray) -> str:
    """A new vertex group; returns the name that Blender has given it."""
    group = thing.vertex_groups.new(name=name)
    for weight in np.unique(weights[weights > 0.0]):
        group.add(np.flatnonzero(weights == weight).tolist(), float(weight), "REPLACE")
    return group.name


def paint(mesh: bpy.types.Mesh, wrapped: Wrapped, worst: float) -> None:
    """Distances to the scan: colours from green over yellow to red at `worst` millimetres, grey where the scan says nothing; and the
    millimetres themselves as an attribute. The scan's own colours, if it has any, as another attribute."""
    share = np.clip(wrapped.distances / worst, 0.0, 1.0)
    stops = np.array([[0.05, 0.55, 0.15], [0.95, 0.8, 0.1], [0.8, 0.05, 0.05]])
    rgba = np.ones((len(share), 4))
    for k in range(3):
        rgba[:, k] = np.interp(share, [0.0, 0.5, 1.0], stops[:, k])
    rgba[~wrapped.accepted, :3] = 0.4
    if wrapped.colors is not None:
        _colour(mesh, SCAN_COLOUR, np.column_stack([wrapped.colors, np.ones(len(share))]))
    mesh.color_attributes.active_color = _colour(mesh, DISTANCE, rgba)
    millimetres_of = mesh.attributes.new(DISTANCE_MM, "FLOAT", "POINT")
    millimetres_of.data.foreach_set("value", wrapped.distances.astype(np.float32))


def _colour(mesh: bpy.types.Mesh, name: str, srgb: np.ndarray) -> bpy.types.Attribute:
    colour = mesh.color_attributes.new(name, "FLOAT_COLOR", "POINT")
    colour.data.foreach_set("color_srgb", srgb.astype(np.float32).reshape(-1))
    return mesh.color_attributes[colour.name]
