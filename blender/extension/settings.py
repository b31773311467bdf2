"""What the user chooses, kept in the scene."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

MODELS = [
    ("usual", "Automatic", "Hybrid with a rig, a graph of affine nodes without"),
    ("hybrid", "Hybrid", "A graph of rigid nodes over blendshapes (Klimov 2020). The most accurate with a rig"),
    ("klimov2020", "Klimov 2020", "The energy of the paper and nothing besides"),
    ("sequential", "Sequential", "Blendshapes first, then free vertices"),
    ("blendshape", "Blendshapes", "The rig's shapes alone"),
    ("flame", "Linear model", "The rig's shapes as users of FLAME and other linear head models fit them"),
    ("gpmm_rig", "Blendshapes and a smooth process", "The rig's shapes and smooth ones (Luethi et al. 2018)"),
    ("sumner", "Graph of affine nodes", "Sumner et al. 2007. The best without a rig"),
    ("graph", "Graph of rigid nodes", "A graph of rigid nodes, without a rig"),
    ("arap", "As rigid as possible", "Sorkine & Alexa 2007"),
    ("poisson", "Gradients", "Poisson editing (Yu et al. 2004)"),
    ("laplacian", "Differential coordinates", "Laplacian editing (Sorkine et al. 2004)"),
    ("gpmm", "Smooth process", "Gaussian-process morphable model (Luethi et al. 2018), without a rig"),
    ("affine", "Affine vertices", "Amberg et al. 2007 (N-ICP)"),
    ("mass_spring", "Springs", "Springs on the surface and through a layer of tissue"),
    ("fem", "Soft tissue", "Corotational finite elements under the skin (Mueller & Gross 2004)"),
    ("ffd", "Lattice", "Free-form deformation (Sederberg & Parry 1986)"),
    ("free", "Free vertices", "Smoothness alone"),
    ("rigid", "Rigid", "Turn and move only"),
    ("similarity", "Similarity", "Turn, move and scale only"),
]

FLIPS = [
    ("SCHEDULE", "As the Schedule Says", "Usually where the scan fits the template better so"),
    ("AUTO", "Where It Fits Better", "The scan is turned over if it fits the template better so"),
    ("YES", "Yes", "The scan is inside out: its normals face inwards"),
    ("NO", "No", "The scan is as it should be"),
]

UNITS = [
    ("SIZE", "By Size", "The one in which a mesh is as large as a face, a head or a body", "NONE", 4),
    ("MM", "Millimetres", "A Blender unit is a millimetre, as most scans and OBJ files have it", "NONE", 0),
    ("CM", "Centimetres", "A Blender unit is a centimetre", "NONE", 1),
    ("M", "Metres", "A Blender unit is a metre, as glTF files have it", "NONE", 2),
    ("IN", "Inches", "A Blender unit is an inch", "NONE", 5),
    ("SCENE", "Scene", "As Scene Properties > Units says: a Blender unit is its Unit Scale in metres", "NONE", 3),
]
"""Files keep the numbers."""


def _is_mesh(_settings: Settings, thing: bpy.types.Object) -> bool:
    return thing.type == "MESH"


class Settings(bpy.types.PropertyGroup):
    template: PointerProperty(
        name="Template", description="The mesh whose polygons, UVs and materials the result has", type=bpy.types.Object, poll=_is_mesh
    )
    scan: PointerProperty(name="Scan", description="The mesh whose shape the result has", type=bpy.types.Object, poll=_is_mesh)
    unit: EnumProperty(name="Unit", description="What a Blender unit is", items=UNITS, default="SIZE")
    model: EnumProperty(name="Model", description="How the template may deform", items=MODELS, default="usual")
    schedule: StringProperty(
        name="Schedule", description="Levels and weights (.toml) instead of the model's own: 'nonrigid' documents the keys", subtype="FILE_PATH"
    )
    flip: EnumProperty(name="Inside Out", description="Whether the scan is turned over", items=FLIPS, default="SCHEDULE")
    rig_source: EnumProperty(
        name="Rig",
        description="Where the template's blendshapes are",
        items=[
            ("NONE", "None", "No blendshapes"),
            ("KEYS", "Shape Keys", "The template's own shape keys; those whose names start with 'identity' say how faces differ"),
            ("FILE", "Folder or File", "A rig on the disk: a folder of arrays or shapes, .npz, .glb, ICT-FaceKit, FLAME, a Basel Face Model"),
        ],
        default="NONE",
    )
    rig_path: StringProperty(name="Path", description="Folder or file of the rig", subtype="FILE_PATH")
    identity_modes: IntProperty(
        name="Identity Modes", description="How many of the rig's first identity modes are used, at most", default=60, min=0, max=1000
    )
    mask: StringProperty(name="Mask", description="Vertex group of the template: how much the scan counts there. All of it if empty")
    free_mask: StringProperty(
        name="Free", description="Vertex group of the template: where the scan is not believed, such as hair; smoothness decides"
    )
    free_regions: StringProperty(name="Free Regions", description="Regions of the rig that are free too, with commas between: mouth_bag")
    landmark: StringProperty(name="Name", description="Name of the next landmark. The same name on template and scan makes a pair", default="chin")
    worst: FloatProperty(
        name="Red At", description="Distance to the scan that is painted red, in millimetres", default=3.0, min=0.01, soft_max=20.0
    )


def register() -> None:
    bpy.utils.register_class(Settings)
    bpy.types.Scene.nonrigid = PointerProperty(type=Settings)


def unregister() -> None:
    del bpy.types.Scene.nonrigid
    bpy.utils.unregister_class(Settings)
