"""The wrap: started from the scene, run on a thread, and made an object of."""

from __future__ import annotations

import os
from functools import partial

import bpy
from bpy.app.handlers import persistent

from . import bridge, scene
from .bridge import Cancelled, Job, Problem, Wrapped

TICK = 0.1
"""Seconds between looks at the job."""


class Run:
    """A wrap that is under way: what it was given, and the thread."""

    def __init__(self, context: bpy.types.Context) -> None:
        """Reads the scene and starts. Raises Problem where the inputs cannot be used."""
        bridge.package()
        chosen = context.scene.nonrigid
        template, scan = chosen.template, chosen.scan
        for what, thing in (("template", template), ("scan", scan)):
            if thing is None or thing.name not in context.scene.objects:
                raise Problem(f"No {what} is chosen: choose one in the sidebar's tab Nonrigid")
        if template.data == scan.data:
            raise Problem(f"Template and scan are both {scan.name}: choose two meshes")
        for thing in (template, scan):
            scene.refuse_disabled(context, thing)
        context.view_layer.update()
        scale, scan_scale = scene.even_scale(template), scene.even_scale(scan)
        surface = scene.base_surface(template, scale)
        target = scene.seen_surface(scan, context.evaluated_depsgraph_get(), scan_scale)
        unit, doubt = scene.millimetres(context.scene, template.name, surface)
        of_scan, scan_doubt = scene.millimetres(context.scene, scan.name, target)
        if of_scan != unit:
            found = f"{unit:g} mm for {template.name} and {of_scan:g} mm for {scan.name}"
            raise Problem(f"By size a Blender unit is {found}: scale one of them, or choose Unit in the sidebar's tab Nonrigid")
        self.notes = [note for note in (doubt, scan_doubt) if note is not None]
        factor, scan_factor = unit * scale, unit * scan_scale
        surface, target = surface.times(unit), target.times(unit)
        on_template, on_scan = scene.landmarks(template), scene.landmarks(scan)
        only_template, only_scan = scene.unpaired(on_template, on_scan)
        if only_template or only_scan:
            parts = [f"{', '.join(names)} only on {thing.name}" for names, thing in ((only_template, template), (only_scan, scan)) if names]
            raise Problem(f"Landmarks without a partner: {'; '.join(parts)}. A pair has the same name on both")
        given = bridge.Wrap(
            surface,
            target,
            model=None if chosen.model == "usual" else chosen.model,
            schedule=self._schedule(chosen),
            flip=None if chosen.flip == "SCHEDULE" else chosen.flip.lower(),
            rig=self._rig(chosen, template, factor),
            identity_modes=chosen.identity_modes,
            template_landmarks={name: factor * scene.array(scene.local_point(context, template, empty)) for name, empty in on_template.items()},
            scan_landmarks={name: scan_factor * scene.array(scene.local_point(context, scan, empty)) for name, empty in on_scan.items()},
            mask=scene.group_weights(template, chosen.mask),
            free_mask=scene.group_weights(template, chosen.free_mask),
            regions=tuple(name.strip() for name in chosen.free_regions.split(",") if name.strip()),
        )
        self.places = scene.Places(template.name, scan.name, surface, factor, scan.matrix_world.copy(), scan_factor, unit)
        self.worst = chosen.worst
        self.job: Job[Wrapped] = Job(partial(bridge.wrap, given))

    @staticmethod
    def _rig(chosen: bpy.types.PropertyGroup, template: bpy.types.Object, factor: float) -> object:
        if chosen.rig_source == "NONE":
            return None
        if chosen.rig_source == "KEYS":
            return scene.own_shape_keys(template, factor)
        path = bpy.path.abspath(chosen.rig_path)
        if not chosen.rig_path or not os.path.exists(path):
            raise Problem(f"There is no rig at {path!r}: choose its folder or file, or no rig")
        return path

    @staticmethod
    def _schedule(chosen: bpy.types.PropertyGroup) -> str | None:
        path = bpy.path.abspath(chosen.schedule)
        if chosen.schedule and not os.path.isfile(path):
            raise Problem(f"There is no schedule at {path!r}: choose a .toml file, or none for the model's own")
        return path if chosen.schedule else None

    def poll(self, context: bpy.types.Context) -> tuple[bpy.types.Object, list[str]] | None:
        """The result and what is to be said of it, or None while the wrap is under way. Raises Problem, Cancelled."""
        wrapped = self.job.poll()
        if wrapped is None:
            return None
        wrapped.notes[:0] = self.notes
        result, lost = scene.make_result(context, self.places, wrapped, self.worst)
        notes = [*wrapped.notes, *([lost] if lost else []), *(f"doubt: {doubt}" for doubt in wrapped.doubts)]
        return result, notes


current: Run | None = None
"""The wrap that is under way."""


class NONRIGID_OT_wrap(bpy.types.Operator):
    """Wrap the template onto the scan. The result is a new object; template and scan stay as they are"""

    bl_idname = "nonrigid.wrap"
    bl_label = "Wrap"
    bl_options = {"UNDO"}

    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return current is None

    def _start(self, context: bpy.types.Context) -> bool:
        global current
        try:
            current = Run(context)
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
        return current is not None

    def _step(self, context: bpy.types.Context) -> set[str]:
        """Looks at the job; ends the operator when it has ended."""
        global current
        run = current
        try:
            if run is None:
                raise Cancelled
            ended = run.poll(context)
            if ended is None:
                return {"RUNNING_MODAL"}
        except Cancelled:
            self.report({"WARNING"}, "The wrap was cancelled; nothing was made")
            outcome = {"CANCELLED"}
        except Problem as problem:
            self.report({"ERROR"}, str(problem))
            outcome = {"CANCELLED"}
        except Exception:
            current = None
            raise
        else:
            result, notes = ended
            context.view_layer.objects.active = result
            for thing in context.selected_objects:
                thing.select_set(False)
            result.select_set(True)
            for note in notes:
                self.report({"WARNING"}, note)
            probability = result["nonrigid_error_probability"]
            self.report({"INFO"}, f"{result.name}: {probability:.0%} probably wrong")
            outcome = {"FINISHED"}
        current = None
        return outcome

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Waits for the result: for scripts and without a window."""
        if not self._start(context):
            return {"CANCELLED"}
        while (outcome := self._step(context)) == {"RUNNING_MODAL"}:
            current.job.wait(TICK)
        return outcome

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if not self._start(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
        outcome = self._step(context)
        if outcome == {"RUNNING_MODAL"}:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return outcome

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator: the window closes."""
        stop()
        context.window_manager.event_timer_remove(self._timer)


class NONRIGID_OT_cancel(bpy.types.Operator):
    """Stop the wrap; nothing is made"""

    bl_idname = "nonrigid.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return current is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        current.job.cancel()
        return {"FINISHED"}


@persistent
def stop(*_: object) -> None:
    """Lets go of a wrap: its scene is closed, or the extension switched off."""
    global current
    if current is not None:
        current.job.cancel()
        current = None


CLASSES = (NONRIGID_OT_wrap, NONRIGID_OT_cancel)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.app.handlers.load_pre.append(stop)


def unregister() -> None:
    stop()
    bpy.app.handlers.load_pre.remove(stop)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
