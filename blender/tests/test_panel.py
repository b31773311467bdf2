"""The sidebar is drawn without a window: every call is one that Blender's layout has, of properties, operators and icons that there are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy
import pytest
from conftest import Scene

from test_wrap import part, wrap

FUNCTIONS = bpy.types.UILayout.bl_rna.functions


class Layout:
    """Takes notes of what is drawn, and checks it by what Blender says of its own layout."""

    def __init__(self) -> None:
        self.drawn: list[str] = []
        self.use_property_split = False

    def _check(self, function: str, given: dict[str, Any]) -> None:
        parameters = FUNCTIONS[function].parameters
        assert set(given) <= set(parameters.keys()), (function, given)
        if "icon" in given:
            assert given["icon"] in parameters["icon"].enum_items

    def row(self, **given: Any) -> Layout:
        self._check("row", given)
        return self

    def label(self, **given: Any) -> None:
        self._check("label", given)
        self.drawn.append(given["text"])

    def progress(self, **given: Any) -> None:
        self._check("progress", given)
        assert 0.0 <= given["factor"] <= 1.0
        self.drawn.append(f"progress {given['text']}")

    def prop(self, data: Any, name: str, **given: Any) -> None:
        self._check("prop", given)
        assert name in data.bl_rna.properties
        self.drawn.append(given.get("text", name))

    def prop_search(self, data: Any, name: str, searched: Any, collection: str) -> None:
        assert name in data.bl_rna.properties and collection in searched.bl_rna.properties
        self.drawn.append(name)

    def operator(self, name: str, **given: Any) -> Any:
        self._check("operator", given)
        properties = self._operator(name)
        self.drawn.append(given.get("text", name))

        class Properties:
            def __setattr__(self, key: str, value: Any) -> None:
                assert key in properties and (properties[key].type != "ENUM" or value in properties[key].enum_items)

        return Properties()

    def operator_menu_enum(self, name: str, property: str) -> None:
        assert self._operator(name)[property].type == "ENUM"
        self.drawn.append(name)

    @staticmethod
    def _operator(name: str) -> Any:
        module, function = name.split(".")
        return getattr(getattr(bpy.ops, module), function).get_rna_type().properties


def drawn() -> dict[str, list[str]]:
    """What each panel that is shown draws."""
    shown = {}
    for panel in part("panel").CLASSES:
        if getattr(panel, "poll", lambda _: True)(bpy.context):
            layout = Layout()
            panel.draw(SimpleNamespace(layout=layout), bpy.context)
            shown[panel.bl_label] = layout.drawn
    return shown


def test_before_anything(installed: Any) -> None:
    bpy.ops.wm.read_homefile(use_empty=True)
    shown = drawn()
    assert set(shown) == {"Wrap", "Landmarks"} and "nonrigid.wrap" in shown["Wrap"] and "rig_path" not in shown["Wrap"]


def test_while_and_after(scene: Scene) -> None:
    bpy.ops.nonrigid.landmark_add(on="SCAN", name="left ear")
    assert "left ear: not yet on the template" in drawn()["Landmarks"]
    with pytest.raises(RuntimeError):
        bpy.ops.nonrigid.wrap()
    bpy.ops.nonrigid.landmark_add(on="TEMPLATE", name="left ear")
    assert any(line.startswith("10 pairs: ") for line in drawn()["Landmarks"])

    wrapping = part("wrapping")
    wrapping.current = wrapping.Run(bpy.context)
    during = drawn()["Wrap"]
    assert "nonrigid.cancel" in during and "nonrigid.wrap" not in during and any(line.startswith("progress ") for line in during)
    wrapping.stop()

    result = wrap()
    result["nonrigid_doubts"] = "one\nanother"
    bpy.ops.nonrigid.morph_add(preset="nose-bridge")
    shown = drawn()
    assert shown["Morphs"] == ["nonrigid.morph_add", "nose-bridge, mm"]
    assert shown["Result"][1:] == ["one", "another", "More in the text 'scan wrapped report'"]
