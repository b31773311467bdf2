"""Generated faces, and the programs that results are compared with."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

import nonrigid
from nonrigid import data_gen

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Data:
    """A rig and cases of it, in files."""

    folder: Path

    @property
    def rig(self) -> Path:
        return self.folder / "rig"

    @property
    def template(self) -> Path:
        return self.rig / "template.obj"

    def case(self, name: str = "same_open") -> Path:
        return self.folder / "cases" / name

    def scan(self, name: str = "same_open") -> Path:
        return self.case(name) / "scan.ply"

    def landmarks(self, name: str = "same_open") -> Path:
        return self.case(name) / "landmarks.json"


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Data:
    folder = tmp_path_factory.mktemp("data")
    data_gen.write(folder, seed=7, vertices=1500, identity_modes=8, triangles=8000, case=["same_open", "new_neutral"])
    return Data(folder)


@pytest.fixture(scope="session")
def face() -> data_gen.Face:
    return data_gen.Face(vertices=1200, identity_modes=6)


@pytest.fixture(scope="session")
def case(face: data_gen.Face) -> data_gen.Case:
    return face.scan(seed=3, preset="smile", triangles=6000)


@pytest.fixture(scope="session")
def registered(face: data_gen.Face, case: data_gen.Case) -> nonrigid.Registration:
    return nonrigid.register(face.rig.mesh, case.scan, rig=face.rig, identity_modes=4, landmarks=case.landmarks)


def built(*arguments: str) -> Path | None:
    """A program of the workspace, built by cargo unless `NONRIGID_BUILT` says that it is; None where there is no cargo."""
    if shutil.which("cargo") is None or not (ROOT / "Cargo.toml").exists():
        return None
    if not os.environ.get("NONRIGID_BUILT"):
        subprocess.run(["cargo", "build", "--release", "--quiet", *arguments], cwd=ROOT, check=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
    return target / ("examples/" + arguments[-1] if "--example" in arguments else arguments[-1])


@pytest.fixture(scope="session")
def program() -> Path:
    """The command line, as cargo builds it."""
    path = built("--bin", "nonrigid")
    if path is None:
        pytest.skip("cargo or the workspace is not here, so there is no command line to compare with")
    return path


@pytest.fixture(scope="session")
def rust() -> Path:
    """A program in Rust on the library."""
    path = built("--example", "register_files")
    if path is None:
        pytest.skip("cargo or the workspace is not here, so there is no Rust program to compare with")
    return path


@pytest.fixture(scope="session")
def python(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], subprocess.CompletedProcess[str]]:
    """Runs a program in a Python of its own, for at most two minutes."""

    def run(text: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        file = tmp_path_factory.mktemp("program") / "main.py"
        file.write_text(text)
        return subprocess.run([sys.executable, str(file), *arguments], capture_output=True, text=True, timeout=120)

    return run


def manifest(data: Data, path: Path, count: int, broken: bool = True) -> Path:
    """Some scans: singles, a sequence, and one that cannot be read."""
    lines = ["target,landmarks,name,sequence,model"]
    for k in range(count):
        case = ("same_open", "new_neutral")[k % 2]
        sequence = "walk" if k in (1, 3) else ""
        lines.append(f"{data.scan(case)},{data.landmarks(case)},scan{k},{sequence},rigid")
    if broken:
        lines.append(f"{data.folder}/missing.ply,,broken,,")
    path.write_text("\n".join(lines) + "\n")
    return path


def results(folder: Path) -> dict[str, bytes]:
    """What has to be the same however a batch ran: all but times, logs and the batch's own folder."""
    files = (p for p in folder.rglob("*") if p.is_file() and not p.relative_to(folder).parts[0].startswith("."))
    keep = (p for p in files if ".timing." not in p.name and not (p.parent.name == "log" and p.suffix == ".txt"))
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in keep}


def listing(folder: Path) -> set[str]:
    """Names of everything in a folder of results, hidden files and folders included."""
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


def begun(program: Path, *arguments: Path) -> subprocess.Popen[str]:
    """A process of Python that has printed `begin`, and whom Ctrl-C interrupts: one that a script started in the background may ignore it, as
    do those that it starts."""
    heed = None if sys.platform == "win32" else lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen([sys.executable, program, *arguments], stdout=subprocess.PIPE, text=True, preexec_fn=heed)
    assert process.stdout is not None and process.stdout.readline() == "begin\n"
    return process
