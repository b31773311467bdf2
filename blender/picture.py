"""The picture of the README: `picture.py OUT.webp`. A generated template and scan, the wrap in the distances' colours, and the wrapped face
with the expression taken out and morphs. Wants bpy, and the zip that build.py makes."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

MARKS = (8, 27, 30, 36, 39, 42, 45, 48, 54)


def make(folder: Path, vertices: int, triangles: int) -> list[Any]:
    """Template, scan, result, and a copy of the result with its morph, side by side, in an empty file."""
    import bpy
    from mathutils import Vector
    from nonrigid import data_gen

    face = data_gen.Face(vertices=vertices, identity_modes=20)
    case = face.scan(seed=11, expressions={"jawOpen": 0.5, "mouthSmile_L": 0.5, "mouthSmile_R": 0.5}, triangles=triangles)
    face.rig.write(folder / "rig")
    case.scan.write(folder / "scan.ply")
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.obj_import(filepath=str(folder / "rig" / "template.obj"))
    template = bpy.context.object
    bpy.ops.wm.ply_import(filepath=str(folder / "scan.ply"))
    scan = bpy.context.object
    scan.rotation_euler = template.rotation_euler
    chosen = bpy.context.scene.nonrigid
    chosen.template, chosen.scan, chosen.rig_source, chosen.rig_path = template, scan, "FILE", str(folder / "rig")
    chosen.worst = 1.5
    bpy.ops.nonrigid.landmarks_of_rig()
    for mark in MARKS:
        vertex = int(face.rig.landmarks[mark])
        if vertex in case.landmarks:
            bpy.context.view_layer.update()
            bpy.context.scene.cursor.location = scan.matrix_world @ Vector(case.landmarks[vertex])
            bpy.ops.nonrigid.landmark_add(on="SCAN", name=str(mark))
    bpy.ops.nonrigid.wrap()
    result = bpy.context.object
    morphed = result.copy()
    morphed.data = result.data.copy()
    bpy.context.collection.objects.link(morphed)
    bpy.context.view_layer.objects.active = morphed
    keys = morphed.data.shape_keys.key_blocks
    for key in keys[1:]:
        key.value = 0.0
    for preset, millimetres in (("nose-bridge", 4.0), ("chin-forward", 5.0)):
        bpy.ops.nonrigid.morph_add(preset=preset)
        morphed.data.shape_keys.key_blocks[f"morph {preset}"].value = millimetres
    return [template, scan, result, morphed]


def render(shown: list[Any], out: Path, width: int, samples: int) -> None:
    """The objects beside each other, through Cycles on the processor."""
    import bpy
    from mathutils import Matrix, Vector

    def material(name: str, attribute: str | None) -> Any:
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        shader = made.node_tree.nodes["Principled BSDF"]
        shader.inputs["Roughness"].default_value = 0.6
        shader.inputs["Base Color"].default_value = (0.55, 0.55, 0.57, 1.0)
        if attribute:
            colour = made.node_tree.nodes.new("ShaderNodeVertexColor")
            colour.layer_name = attribute
            made.node_tree.links.new(colour.outputs["Color"], shader.inputs["Base Color"])
        return made

    plain, distance, dot = material("plain", None), material("distance", "nonrigid distance"), material("dot", None)
    dot.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.05, 0.05, 1.0)
    collection = bpy.context.collection
    bpy.context.view_layer.update()
    for k, thing in enumerate(shown):
        middle = sum((thing.matrix_world @ Vector(corner) for corner in thing.bound_box), Vector()) / 8.0
        turn = Matrix.Rotation(-0.45, 4, "Z")
        thing.matrix_world = Matrix.Translation((190.0 * k, 0.0, 0.0)) @ turn @ Matrix.Translation(-middle) @ thing.matrix_world
        for slot in thing.material_slots:
            slot.link, slot.material = "OBJECT", distance if k == 2 else plain
        if not thing.material_slots:
            thing.data.materials.append(plain)
        thing.data.polygons.foreach_set("use_smooth", [True] * len(thing.data.polygons))
        bpy.context.view_layer.update()
        if k == 1:
            for empty in thing.children:
                bpy.ops.mesh.primitive_uv_sphere_add(radius=2.5, location=empty.matrix_world.translation)
                bpy.context.object.data.materials.append(dot)
    white = material("white", None)
    white.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.9, 0.9, 0.9, 1.0)
    for k, words in enumerate(("template", "scan, landmarks", "wrapped: distance", "neutral, nose and chin")):
        curve = bpy.data.curves.new(words, "FONT")
        curve.body, curve.size, curve.align_x = words, 14.0, "CENTER"
        label = bpy.data.objects.new(words, curve)
        label.location, label.rotation_euler = (190.0 * k, -60.0, -142.0), (1.5708, 0.0, 0.0)
        curve.materials.append(white)
        collection.objects.link(label)
    for location, energy in (((-400.0, -900.0, 700.0), 1.6e7), ((1200.0, -700.0, 200.0), 0.7e7)):
        lamp = bpy.data.lights.new("lamp", "AREA")
        lamp.energy, lamp.size = energy, 500.0
        light = bpy.data.objects.new("lamp", lamp)
        light.location = location
        light.rotation_euler = (Vector((285.0, 0.0, 0.0)) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
        collection.objects.link(light)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.data.clip_end = "ORTHO", 780.0, 3000.0
    camera.location, camera.rotation_euler = (285.0, -1200.0, -15.0), (1.5708, 0.0, 0.0)
    collection.objects.link(camera)
    scene = bpy.context.scene
    scene.camera = camera
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.05, 0.05, 0.06, 1.0)
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.samples, scene.cycles.use_denoising = samples, samples > 8
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, width * 2 // 5, 100
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format, scene.render.image_settings.quality = out.suffix[1:].upper(), 85
    scene.render.filepath = str(out)
    bpy.ops.render.render(write_still=True)


def main() -> None:
    out = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["BLENDER_USER_RESOURCES"] = f"{folder}/user"  # before bpy
        import bpy

        (archive,) = (Path(__file__).resolve().parent / "dist").glob("nonrigid-blender-*.zip")
        bpy.ops.extensions.package_install_files(filepath=str(archive), repo="user_default", enable_on_install=True)
        render(make(Path(folder), 5000, 60_000), out, 1400, 16)


if __name__ == "__main__":
    main()
