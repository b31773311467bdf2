"""Presets of morphs as shape keys, whose sliders are millimetres."""

from __future__ import annotations

import json

import bpy
from bpy.props import EnumProperty

from . import bridge, scene
from .bridge import Problem

ALL = "ALL"
_items: list[tuple[str, str, str]] = []
"""Blender wants the texts of a menu to live on."""


def _presets(_self: object, _context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    if not _items:
        try:
            names = bridge.preset_names()
        except Problem as problem:
            return [(ALL, "None", str(problem))]
        _items.extend([(ALL, "All", "Every preset")] + [(name, name.replace("-", " ").capitalize(), about) for name, about in names])
    return _items


def morph_landmarks(context: bpy.types.Context, thing: bpy.types.Object, surface: bridge.Surface, factor: float) -> dict[str, int]:
    """Vertices of a mesh by the names of landmarks: of a result its own while it has its vertices, otherwise the empties on it, otherwise the
    rig's."""
    known: dict[str, int] = json.loads(thing.get(scene.LANDMARKS, "{}"))
    if known and thing.get(scene.TOPOLOGY) == surface.topology():
        return known
    empties = scene.landmarks(thing)
    if empties:
        at = {name: factor * scene.array(scene.local_point(context, thing, empty)) for name, empty in empties.items()}
        return {name: surface.nearest(point) for name, point in at.items()}
    if known:
        raise Problem(
            f"{thing.name} has other vertices or polygons than when it was wrapped, and its landmarks are lost with them: add morphs before such "
            "changes, or choose it as the template and put landmarks on it"
        )
    path = bpy.path.abspath(context.scene.nonrigid.rig_path)
    if not path:
        raise Problem(f"{thing.name} has no landmarks: morphs are drawn by the 68 of Multi-PIE, named 0 to 67. Choose a rig that has them")
    return {str(k): vertex for k, vertex in enumerate(bridge.rig_landmarks(path, thing.name, surface))}


class NONRIGID_OT_morph_add(bpy.types.Operator):
    """Add a preset of a morph to the active mesh, as a shape key whose slider is millimetres. A preset alone moves vertices in proportion to
    its slider; presets on the same place add up, where one after the other would see what the first has done"""

    bl_idname = "nonrigid.morph_add"
    bl_label = "Add Morph"
    bl_options = {"REGISTER", "UNDO"}

    preset: EnumProperty(name="Preset", items=_presets)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and context.object.type == "MESH" and context.mode == "OBJECT"

    def execute(self, context: bpy.types.Context) -> set[str]:
        thing = context.object
        try:
            names = [self.preset] if self.preset != ALL else [name for name, _ in bridge.preset_names()]
            scene.refuse_disabled(context, thing)
            context.view_layer.update()
            scale = scene.even_scale(thing)
            surface = scene.base_surface(thing, scale)
            unit, doubt = scene.own_millimetres(context.scene, thing, surface)
            factor, surface = unit * scale, surface.times(unit)
            landmarks = morph_landmarks(context, thing, surface, factor)
            there = set() if thing.data.shape_keys is None else set(thing.data.shape_keys.key_blocks.keys())
            if self.preset != ALL and scene.MORPH + self.preset in there:
                raise Problem(f"{thing.name} has the shape key {scene.MORPH + self.preset!r} already: delete it to have it made again")
            # all are computed before the first is added: where one fails, none is there
            done = {name: bridge.morph(surface, name, landmarks) for name in names if scene.MORPH + name not in there}
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        if thing.data.shape_keys is None:
            thing.shape_key_add(name="Basis", from_mix=False)
        for name, morphed in done.items():
            key = scene.MORPH + name
            scene.add_key(thing, key, (surface.positions + morphed.delta) / factor, 0.0, morphed.range)
            scene.add_group(thing, key, morphed.mask)
        if doubt is not None:
            self.report({"WARNING"}, doubt)
        self.report({"INFO"}, f"{len(done)} morphs on {thing.name}; their sliders are millimetres")
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(NONRIGID_OT_morph_add)


def unregister() -> None:
    bpy.utils.unregister_class(NONRIGID_OT_morph_add)
