import os
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

_Floats: TypeAlias = NDArray[np.float64]
_Path: TypeAlias = str | os.PathLike[str]
_Metadata: TypeAlias = tuple[_Floats, list[NDArray[np.uint32]], list[str], list[tuple[int, str, str]]]
_Files: TypeAlias = list[tuple[str, str]]
_Source: TypeAlias = tuple[str, str, _Files, tuple[str, str] | None]
_Kept: TypeAlias = tuple[
    _Files, list[str], tuple[str, str] | None, str, list[tuple[str, bytes | None]], tuple[_Floats, list[float], float] | None
]
_Row: TypeAlias = tuple[int, str, str | None, list[tuple[str, str]]]

__all__ = [
    "ComputationError",
    "Face",
    "Holder",
    "Landmarks",
    "Mask",
    "Mesh",
    "Registration",
    "Rig",
    "Rows",
    "Schedule",
    "Step",
    "WarmStart",
    "__version__",
    "batch_columns",
    "batch_files",
    "batch_lost",
    "batch_run",
    "check_plan",
    "command_line",
    "evaluate_scan",
    "evaluate_truth",
    "glossary",
    "measure_mesh",
    "mesh_files",
    "millimetres",
    "missing_files",
    "models",
    "morph_mesh",
    "picture",
    "presets",
    "register",
    "unit_of",
    "write_data",
    "write_text",
]

__version__: str

class ComputationError(RuntimeError):
    """The inputs are sound, but the computation on them did not succeed: no start was found, nothing overlaps, no step lowers the energy."""

@final
class Step:
    """One step of a registration."""

    @property
    def level(self) -> int:
        """Level, from 0; counts on over the stages of the schedule."""
    @property
    def step(self) -> int:
        """Step within the level, from 0."""
    @property
    def energy_before(self) -> float:
        """Energy before the step, at the step's correspondences."""
    @property
    def energy(self) -> float:
        """Energy after the step, at the same correspondences."""
    @property
    def energies(self) -> dict[str, float]:
        """The same by term and regulariser."""
    @property
    def inliers(self) -> float:
        """Share of the template's vertices with an accepted correspondence, 0 to 1."""
    @property
    def motion(self) -> float:
        """Largest motion of a vertex in this step, in the schedule's millimetres: those of a subject of its reference size, such as a face."""

@final
class Mesh:
    @staticmethod
    def read(path: _Path, unit: str | None = None) -> Mesh: ...
    @staticmethod
    def read_points(path: _Path, unit: str | None = None) -> Mesh: ...
    @staticmethod
    def of(
        positions: _Floats,
        starts: NDArray[np.uint32],
        corners: NDArray[np.uint32],
        normals: _Floats | None = None,
        colors: NDArray[np.uint8] | None = None,
        metadata: _Metadata | None = None,
        source: _Source | None = None,
    ) -> Mesh: ...
    @property
    def source(self) -> _Source: ...
    @property
    def positions(self) -> _Floats: ...
    @property
    def starts(self) -> NDArray[np.uint32]: ...
    @property
    def corners(self) -> NDArray[np.uint32]: ...
    @property
    def triangles(self) -> NDArray[np.uint32]: ...
    @property
    def normals(self) -> _Floats | None: ...
    @property
    def colors(self) -> NDArray[np.uint8] | None: ...
    @property
    def metadata(self) -> _Metadata: ...
    @property
    def groups(self) -> list[tuple[str, tuple[int, int]]]: ...
    @property
    def path(self) -> str: ...
    @property
    def unit(self) -> str | None: ...
    @property
    def note(self) -> str | None: ...
    @property
    def files(self) -> list[str]: ...
    def with_positions(self, positions: _Floats, colors: NDArray[np.uint8] | None = None) -> Mesh: ...
    def write(self, path: _Path, reads: list[str]) -> list[str]: ...

@final
class Landmarks:
    @staticmethod
    def read(path: _Path, scan: bool) -> Landmarks: ...
    @staticmethod
    def parse(text: str, name: _Path) -> Landmarks: ...
    @property
    def files(self) -> list[str]: ...

@final
class Mask:
    @staticmethod
    def read(path: _Path, vertices: int) -> Mask: ...
    @staticmethod
    def of(values: _Floats) -> Mask: ...
    @property
    def values(self) -> _Floats: ...
    @property
    def files(self) -> list[str]: ...

@final
class Schedule:
    @staticmethod
    def of_model(model: str) -> Schedule: ...
    @staticmethod
    def read(path: _Path) -> Schedule: ...
    @staticmethod
    def of_toml(text: str) -> Schedule: ...
    @staticmethod
    def of_dict(keys: dict[str, Any]) -> Schedule: ...
    def to_toml(self) -> str: ...
    def to_dict(self) -> dict[str, Any]: ...
    def with_options(
        self,
        expression_bounds: tuple[float, float] | None = None,
        identity_bounds: tuple[float, float] | None = None,
        flip: str | None = None,
    ) -> Schedule: ...
    @property
    def files(self) -> list[str]: ...

_Frame: TypeAlias = tuple[list[float], float, list[list[float]], list[float], float, float, bool, list[str]]

@final
class Rig:
    @staticmethod
    def read(path: _Path, identity_modes: int | None = None, kind: str | None = None, unit: str | None = None) -> Rig: ...
    @staticmethod
    def of(
        neutral: _Floats,
        mesh: Mesh | None,
        names: list[str],
        families: list[str],
        deltas: NDArray[np.float32],
        landmarks: list[int] | None,
        regions: list[tuple[str, list[int]]] | None,
        files: list[str],
        known: tuple[str, str] | None = None,
        kept: _Kept | None = None,
    ) -> Rig: ...
    @property
    def kept(self) -> _Kept: ...
    @property
    def neutral(self) -> _Floats: ...
    @property
    def mesh(self) -> Mesh | None: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def families(self) -> list[str]: ...
    @property
    def deltas(self) -> NDArray[np.float32]: ...
    @property
    def landmarks(self) -> list[int] | None: ...
    @property
    def regions(self) -> list[tuple[str, NDArray[np.uint32]]] | None: ...
    @property
    def unit(self) -> str | None: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def files(self) -> list[str]: ...
    def write(self, path: _Path, form: str) -> list[str]: ...
    def transfer(self, subject: _Floats, anchor: float) -> Rig: ...
    def fit(
        self, frames: list[_Floats], names: list[str] | None, neutral: _Floats | None, align: str, bounds: tuple[float, float]
    ) -> tuple[list[str], list[_Frame]]: ...
    @staticmethod
    def pca(
        samples: list[_Floats], mesh: Mesh | None, components: int, align: str, made_of: list[str]
    ) -> tuple[Rig, list[float], list[float]]: ...

@final
class WarmStart:
    @staticmethod
    def read(path: _Path) -> WarmStart: ...
    @staticmethod
    def parse(text: str) -> WarmStart: ...
    @property
    def files(self) -> list[str]: ...

@final
class Registration:
    @property
    def finer(self) -> Mesh | None: ...
    @property
    def positions(self) -> _Floats: ...
    @property
    def colors(self) -> NDArray[np.uint8] | None: ...
    @property
    def accepted(self) -> NDArray[np.bool_]: ...
    @property
    def weights(self) -> list[tuple[str, float, float | None, bool]]: ...
    @property
    def report(self) -> str: ...
    @property
    def state(self) -> str: ...
    @property
    def error_probability(self) -> float: ...
    @property
    def doubts(self) -> list[str]: ...
    @property
    def uses_shapes(self) -> bool: ...
    @property
    def finished(self) -> bool: ...
    @property
    def facing(self) -> tuple[int, int, bool]: ...
    @property
    def remarks(self) -> list[str]: ...
    @property
    def equations(self) -> tuple[NDArray[np.int64], NDArray[np.int64], _Floats, _Floats] | None: ...

@final
class Face:
    def __new__(cls, vertices: int, identity_modes: int) -> Face: ...
    def rig(self) -> Rig: ...
    def anthropometric(self) -> list[tuple[str, int]]: ...
    def scan(
        self, arguments: list[str], seed: int
    ) -> tuple[Mesh, _Floats, NDArray[np.bool_], list[int], _Floats, list[float], list[float]]: ...
    def expressions(self) -> list[str]: ...

@final
class Rows:
    def __new__(cls, path: _Path, text: str | None = None) -> Rows: ...
    def __len__(self) -> int: ...
    def name(self, number: int) -> str: ...
    def tasks(self, chunk: int) -> list[int]: ...
    def numbers(self, first: int, end: int) -> list[int]: ...
    def task(self, first: int, end: int) -> tuple[list[_Row], list[list[int]]]: ...
    def read_below(self, folder: str) -> list[str]: ...
    def writes(self, names: list[str], format: str) -> list[str]: ...
    def tell(self, number: int, row: str, before: bool, seconds: float) -> None: ...
    def told(self, number: int) -> str: ...
    @property
    def counts(self) -> tuple[int, int]: ...
    def summary(self, pictures: bool, seconds: float, cores: int) -> tuple[str, str, str]: ...

@final
class Holder:
    def __new__(cls, setting: Mapping[str, Any], manifest: _Path, rows: Rows) -> Holder: ...
    @property
    def aside(self) -> str: ...
    @property
    def is_lost(self) -> bool: ...
    def finish(self, rows: Rows, seconds: float, cores: int) -> None: ...
    def release(self) -> None: ...

def register(
    template: Mesh,
    scan: Mesh,
    *,
    neutral: Mesh | None,
    rig: Rig | None,
    shapes: list[str] | None,
    identity_modes: int | None,
    landmarks: Landmarks | None,
    template_landmarks: Landmarks | None,
    landmark_units: tuple[str | None, str | None],
    model: str,
    schedule: Schedule,
    mask: Mask | None,
    free_mask: Mask | None,
    regions: list[str],
    free_regions: list[str],
    warm_start: WarmStart | None,
    subdivide: int,
    threads: int | None,
    callback: Callable[[Step], Any] | None,
    on_positions: Callable[[Step, _Floats], Any] | None,
    equations: bool,
) -> Registration: ...
def picture(
    path: _Path, title: str, template: Mesh, scan: Mesh, result: Mesh, facing: tuple[int, int, bool], reads: list[str]
) -> None: ...
def millimetres(unit: str) -> float: ...
def unit_of(path: _Path, points: _Floats, unit: str | None = None) -> tuple[tuple[str, str] | None, float, str | None]: ...
def write_text(path: _Path, text: str, reads: list[str]) -> None: ...
def check_plan(reads: list[str], writes: list[str]) -> None: ...
def models() -> list[str]: ...
def presets() -> list[tuple[str, float, list[float] | None, str, str]]: ...
def morph_mesh(
    mesh: Mesh,
    recipes: list[tuple[str, Any, float | None]],
    landmarks: list[Landmarks],
    unit: str | None,
    rig: Rig | None,
    shapes: list[str] | None,
    identity_modes: int,
    bounds: tuple[float, float] | None,
    until: int | None,
    model: str | None,
    threads: int | None,
) -> tuple[list[str], list[tuple[_Floats, str, list[tuple[str, _Floats]]]]]: ...
def measure_mesh(
    mesh: Mesh,
    after: _Floats | None,
    landmarks: list[Landmarks],
    unit: str | None,
    rig: Rig | None,
    regions: list[tuple[str, list[int]]] | None,
    align: bool,
) -> tuple[str, str, str, str | None]: ...
def glossary() -> str: ...
def evaluate_truth(
    result: _Floats, template: Mesh, truth: _Floats, observed: NDArray[np.bool_] | None
) -> tuple[str, _Floats]: ...
def evaluate_scan(result: _Floats, template: Mesh, scan: Mesh) -> tuple[str, _Floats]: ...
def write_data(arguments: list[str], threads: int | None) -> None: ...
def batch_columns() -> tuple[list[str], list[str]]: ...
def missing_files(path: _Path) -> list[str]: ...
def mesh_files(folder: _Path) -> list[str]: ...
def batch_lost(name: str, note: str) -> str: ...
def batch_run(
    setting: Mapping[str, Any], aside: _Path, rows: list[_Row], chains: list[list[int]]
) -> list[tuple[int, str, bool, float]]: ...
def batch_files(name: str, format: str) -> list[str]: ...
def command_line(arguments: list[str], program: _Path, first: list[str]) -> int: ...
