"""Landmarks: empties parented to the template and to the scan, paired by their names."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatVectorProperty, StringProperty
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

from . import bridge, scene
from .bridge import Problem

ON = EnumProperty(name="On", items=[("TEMPLATE", "Template", "The template"), ("SCAN", "Scan", "The scan")])


def _object(context: bpy.types.Context, on: str) -> bpy.types.Object:
    chosen = context.scene.nonrigid
    thing = chosen.template if on == "TEMPLATE" else chosen.scan
    if thing is None:
        raise Problem(f"No {on.lower()} is chosen: choose one in the sidebar's tab Nonrigid")
    scene.refuse_disabled(context, thing)
    return thing


def size_on(thing: bpy.types.Object) -> float:
    """Of an empty, in the object's coordinates: 1.5 mm on most faces."""
    return 0.006 * scene.base_surface(thing, 1.0).extent()


def place(context: bpy.types.Context, thing: bpy.types.Object, name: str, point: Vector, size: float) -> bpy.types.Object:
    """A new empty at a point of the object's coordinates. Raises Problem where the object has that landmark already."""
    name = name.strip()
    there = scene.landmarks(thing)
    if not name:
        raise Problem("The landmark has no name")
    if name in there:
        raise Problem(f"{thing.name} has a landmark {name!r} already, {there[name].name}: move that one, or delete it")
    empty, partner = bpy.data.objects.new(name, None), bpy.data.objects.new(name, None)  # the name has to do for both of a pair
    keeps = scene.landmark_name(empty) == name == scene.landmark_name(partner)
    bpy.data.objects.remove(partner)
    if not keeps:
        bpy.data.objects.remove(empty)
        raise Problem(f"{name!r} cannot be a landmark's name: it is too long, or ends like the numbers that Blender gives")
    empty.empty_display_type = "SPHERE"
    empty.empty_display_size = size
    empty.show_in_front = True
    empty.parent = thing
    empty.location = point
    for collection in thing.users_collection:
        collection.objects.link(empty)
    context.view_layer.update()
    return empty


class NONRIGID_OT_landmark_add(bpy.types.Operator):
    """Put a landmark where the surface is nearest to the 3D cursor"""

    bl_idname = "nonrigid.landmark_add"
    bl_label = "Landmark at Cursor"
    bl_options = {"REGISTER", "UNDO"}

    on: ON
    name: StringProperty(name="Name", description="The one in the sidebar if empty")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            thing = _object(context, self.on)
            context.view_layer.update()
            cursor = thing.matrix_world.inverted() @ context.scene.cursor.location
            found, point, _, _ = thing.closest_point_on_mesh(cursor)
            if not found:
                raise Problem(f"{thing.name} has no surface to put a landmark on")
            place(context, thing, self.name or context.scene.nonrigid.landmark, point, size_on(thing))
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        return {"FINISHED"}


class NONRIGID_OT_landmark_pick(bpy.types.Operator):
    """Put a landmark where the surface is clicked"""

    bl_idname = "nonrigid.landmark_pick"
    bl_label = "Pick Landmark"
    bl_options = {"UNDO"}

    on: ON
    name: StringProperty(name="Name", description="The one in the sidebar if empty")
    origin: FloatVectorProperty(name="Origin", description="Where the line of sight begins", size=3)
    direction: FloatVectorProperty(name="Direction", description="Where it goes", size=3)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            thing = _object(context, self.on)
            context.view_layer.update()
            back = thing.matrix_world.inverted()
            direction = back.to_3x3() @ Vector(self.direction)
            found, point, _, _ = thing.ray_cast(back @ Vector(self.origin), direction.normalized())
            if not found:
                raise Problem(f"{thing.name} is not there: click on its surface")
            place(context, thing, self.name or context.scene.nonrigid.landmark, point, size_on(thing))
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        try:
            thing = _object(context, self.on)
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        name = self.name or context.scene.nonrigid.landmark
        context.workspace.status_text_set(f"Click on {thing.name} for the landmark {name!r}; Esc or right button ends")
        context.window.cursor_modal_set("CROSSHAIR")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in {"ESC", "RIGHTMOUSE"}:
            return self._end(context, {"CANCELLED"})
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        for area in context.screen.areas:
            region = next((r for r in area.regions if r.type == "WINDOW"), None)
            if area.type != "VIEW_3D" or region is None:
                continue
            at = (event.mouse_x - region.x, event.mouse_y - region.y)
            if 0 <= at[0] < region.width and 0 <= at[1] < region.height:
                self.origin = region_2d_to_origin_3d(region, area.spaces.active.region_3d, at)
                self.direction = region_2d_to_vector_3d(region, area.spaces.active.region_3d, at)
                return self._end(context, self.execute(context))
        return {"PASS_THROUGH"}

    def _end(self, context: bpy.types.Context, outcome: set[str]) -> set[str]:
        context.workspace.status_text_set(None)
        context.window.cursor_modal_restore()
        return outcome


class NONRIGID_OT_landmarks_of_rig(bpy.types.Operator):
    """Put the rig's own landmarks, the 68 of Multi-PIE and iBUG, on the template, named 0 to 67. Those that it has already stay; those that
    the scan has not take no part"""

    bl_idname = "nonrigid.landmarks_of_rig"
    bl_label = "Landmarks of the Rig"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            chosen = context.scene.nonrigid
            thing = _object(context, "TEMPLATE")
            path = bpy.path.abspath(chosen.rig_path)
            points = scene.basis(thing)
            vertices = bridge.rig_landmarks(path, thing.name, scene.base_surface(thing, 1.0))
            there, size = scene.landmarks(thing), size_on(thing)
            made = 0
            for k, vertex in enumerate(vertices):
                if str(k) not in there:
                    place(context, thing, str(k), points[vertex].co, size)[scene.OF_RIG] = True
                    made += 1
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{made} landmarks on {thing.name}; pick some of them on the scan by the same names")
        return {"FINISHED"}


CLASSES = (NONRIGID_OT_landmark_add, NONRIGID_OT_landmark_pick, NONRIGID_OT_landmarks_of_rig)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
