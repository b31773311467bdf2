"""Generated faces with exact truth: a rig, and scans of people as a scanner would make them, from one seed.

>>> from nonrigid import data_gen
>>> face = data_gen.Face(vertices=1000, identity_modes=5)
>>> case = face.scan(seed=7, preset="smile", triangles=5000)
>>> case.truth.shape == face.rig.neutral.shape
True
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _nonrigid
from ._mesh import Floats, Mesh, PathLike, count, count_or_none
from ._rig import Rig

__all__ = ["Case", "Face", "write"]


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple, np.ndarray)):
        return ",".join(_text(item) for item in value)
    return repr(float(value)) if isinstance(value, (float, np.floating)) else str(value)


def _arguments(options: Mapping[str, Any]) -> list[str]:
    """Options of the command line: several cameras are a list of tuples, expressions a dict."""
    arguments = []
    for key, value in options.items():
        name = "--" + key.replace("_", "-")
        if key in ("expression", "expressions"):
            if not isinstance(value, Mapping):
                raise TypeError(f"{key}: expected {{name: weight}}, found {value!r}")
            arguments += [f"--expression={shape}={_text(weight)}" for shape, weight in value.items()]
        elif key in ("camera", "camera_at", "case"):
            several = value if isinstance(value, list) else [value]
            arguments += [f"{name}={_text(one)}" for one in several]
        elif value is True:
            arguments.append(name)
        elif value is not None and value is not False:
            arguments.append(f"{name}={_text(value)}")
    return arguments


@dataclass(frozen=True, eq=False)
class Case:
    """One scan, and what is true of it."""

    scan: Mesh
    """What the scanner delivers."""
    truth: Floats = field(repr=False)
    """(V, 3): where each template vertex truly is, in the scan's frame, millimetres."""
    observed: NDArray[np.bool_] = field(repr=False)
    """(V,): whether the scan shows the surface all round the vertex."""
    landmarks: dict[int, Floats] = field(repr=False)
    """Template vertex and its noisy place on the scan, of the landmarks that the scan shows."""
    expression_weights: dict[str, float] = field(repr=False)
    """Of each expression of the rig."""
    identity_weights: Floats = field(repr=False)
    """Of each identity mode."""


class Face:
    """A face of quads, made by formulas: a template with 54 expressions of ARKit's names, identity modes, landmarks and regions."""

    __slots__ = ("_native", "_size", "rig")
    _native: _nonrigid.Face
    _size: tuple[int, int]
    rig: Rig
    """The rig of this face."""

    def __init__(self, vertices: int = 5000, identity_modes: int = 100) -> None:
        """vertices: of the template, approximately, 1,000 to 500,000. identity_modes: at most 200. Raises ValueError for other numbers."""
        self._size = count("vertices", vertices), count("identity_modes", identity_modes)
        self._native = _nonrigid.Face(*self._size)
        self.rig = Rig._of(self._native.rig())

    @property
    def anthropometric(self) -> dict[str, int]:
        """The landmarks that `nonrigid.measure` knows, by name: vertices."""
        return dict(self._native.anthropometric())

    def scan(self, seed: int = 1, **options: Any) -> Case:
        """Scans a person with this face. Everything random comes from `seed`.

        options: those of `data-gen` for cases, scanner and faults, with underscores: expressions={"jawOpen": 0.5}, preset="smile",
        identity=[1.5, -1], triangles=60000, camera=[(0, 0), (30, 0)], see_all=True, noise=0.1, holes=4, landmark_noise=1, and so on.

        Raises ValueError for an option that makes no sense, ComputationError if the cameras see next to nothing.
        """
        scan, truth, observed, vertices, points, expressions, identities = self._native.scan(_arguments(options), count("seed", seed, most=2**64 - 1))
        weights = dict(zip(self._native.expressions(), expressions))
        landmarks = {int(vertex): point for vertex, point in zip(vertices, points)}
        return Case(Mesh._of(scan), truth, observed, landmarks, weights, np.array(identities))

    def __reduce__(self) -> tuple[Any, ...]:
        return Face, self._size

    def __repr__(self) -> str:
        return f"Face(vertices={self._size[0]}, identity_modes={self._size[1]})"


def write(out: PathLike, *, threads: int | None = None, **options: Any) -> None:
    """Writes what `data-gen --out OUT` writes, the same bytes: OUT/rig, and OUT/cases/NAME or OUT/sequence, OUT/population.

    options: those of the command line with underscores: seed=7, vertices=5000, cases=20, frames=60, population=200, and those of `Face.scan`. Ctrl-C ends it between two folders.

    Raises ValueError for an option that makes no sense, OSError where it cannot be written.
    """
    _nonrigid.write_data([f"--out={os.fsdecode(out)}", *_arguments(options)], count_or_none("threads", threads))
