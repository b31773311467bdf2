"""The tab Nonrigid in the sidebar of the 3D view."""

from __future__ import annotations

import bpy

from . import scene, wrapping
from .bridge import Problem


class _Tab:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Nonrigid"


class NONRIGID_PT_wrap(_Tab, bpy.types.Panel):
    bl_label = "Wrap"

    def draw(self, context: bpy.types.Context) -> None:
        layout, chosen = self.layout, context.scene.nonrigid
        layout.use_property_split = True
        layout.prop(chosen, "template")
        layout.prop(chosen, "scan")
        layout.prop(chosen, "unit")
        layout.prop(chosen, "rig_source")
        if chosen.rig_source == "FILE":
            layout.prop(chosen, "rig_path")
        if chosen.rig_source != "NONE":
            layout.prop(chosen, "identity_modes")
        layout.prop(chosen, "model")
        layout.prop(chosen, "schedule")
        layout.prop(chosen, "flip")
        if chosen.template is not None:
            layout.prop_search(chosen, "mask", chosen.template, "vertex_groups")
            layout.prop_search(chosen, "free_mask", chosen.template, "vertex_groups")
        if chosen.rig_source == "FILE":
            layout.prop(chosen, "free_regions")
        layout.prop(chosen, "worst")
        run = wrapping.current
        if run is None:
            layout.operator("nonrigid.wrap", icon="MOD_SHRINKWRAP")
        else:
            layout.progress(factor=run.job.progress, text=run.job.stage)
            layout.operator("nonrigid.cancel", icon="CANCEL")


class NONRIGID_PT_landmarks(_Tab, bpy.types.Panel):
    bl_label = "Landmarks"

    def draw(self, context: bpy.types.Context) -> None:
        layout, chosen = self.layout, context.scene.nonrigid
        layout.prop(chosen, "landmark")
        for operator in ("nonrigid.landmark_pick", "nonrigid.landmark_add"):
            row = layout.row(align=True)
            at = "Click" if operator.endswith("pick") else "Cursor"
            row.operator(operator, text=f"{at}: Template").on = "TEMPLATE"
            row.operator(operator, text=f"{at}: Scan").on = "SCAN"
        if chosen.rig_path:
            layout.operator("nonrigid.landmarks_of_rig")
        if chosen.template is None or chosen.scan is None:
            return
        try:
            on_template, on_scan = scene.landmarks(chosen.template), scene.landmarks(chosen.scan)
        except Problem as problem:
            layout.label(text=str(problem), icon="ERROR")
            return
        pairs = [name for name in on_scan if name in on_template]
        layout.label(text=f"{len(pairs)} pairs: {', '.join(pairs)}" if pairs else "No pairs: the start is searched")
        only_template, only_scan = scene.unpaired(on_template, on_scan)
        for names, on, other in ((only_template, "SCAN", "scan"), (only_scan, "TEMPLATE", "template")):
            for name in names:
                operator = layout.operator("nonrigid.landmark_pick", text=f"{name}: not yet on the {other}", icon="ERROR")
                operator.on, operator.name = on, name


class NONRIGID_PT_result(_Tab, bpy.types.Panel):
    bl_label = "Result"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and "nonrigid_error_probability" in context.object

    def draw(self, context: bpy.types.Context) -> None:
        layout, result = self.layout, context.object
        layout.label(text=f"{result['nonrigid_error_probability']:.0%} probably wrong")
        for doubt in result["nonrigid_doubts"].splitlines():
            layout.label(text=doubt, icon="ERROR")
        report = result.get("nonrigid_report")
        if report is not None:
            layout.label(text=f"More in the text {report.name!r}")


class NONRIGID_PT_morphs(_Tab, bpy.types.Panel):
    bl_label = "Morphs"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and context.object.type == "MESH"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator_menu_enum("nonrigid.morph_add", "preset")
        keys = context.object.data.shape_keys
        for key in [] if keys is None else keys.key_blocks:
            if key.name.startswith(scene.MORPH):
                layout.prop(key, "value", text=f"{key.name.removeprefix(scene.MORPH)}, mm")


CLASSES = (NONRIGID_PT_wrap, NONRIGID_PT_landmarks, NONRIGID_PT_result, NONRIGID_PT_morphs)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
