"""Deform meshes by nonlinear least squares: wrap a template onto a scan, fit and transfer blendshape rigs, change a face by masks, measure it.

`register` wraps a template onto a scan; `Mesh`, `Rig` and `Schedule` are what it takes, `Registration` is what it gives. `nonrigid.batch`
does many scans. Lengths are millimetres, arrays are numpy's.
"""

from . import batch, data_gen
from ._field import read_flame, read_ict, read_morphable
from ._mesh import Mesh, NonrigidWarning
from ._morph import Evaluation, Measurements, Morph, MorphStep, Preset, evaluate, glossary, measure, morph, presets
from ._nonrigid import ComputationError, Step, __version__
from ._registration import Registration, register
from ._rig import FittedFrame, Rig, Weight
from ._schedule import Schedule

__all__ = [
    "ComputationError",
    "Evaluation",
    "FittedFrame",
    "Measurements",
    "Mesh",
    "Morph",
    "MorphStep",
    "NonrigidWarning",
    "Preset",
    "Registration",
    "Rig",
    "Schedule",
    "Step",
    "Weight",
    "__version__",
    "batch",
    "data_gen",
    "evaluate",
    "glossary",
    "measure",
    "morph",
    "presets",
    "read_flame",
    "read_ict",
    "read_morphable",
    "register",
]
