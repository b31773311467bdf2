"""The stubs say what the native part has, the package passes mypy, its examples run, and its help says enough."""

from __future__ import annotations

import doctest
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import nonrigid
import nonrigid.batch
from nonrigid import data_gen

PACKAGE = Path(nonrigid.__file__).parent
SOURCE = Path(__file__).parents[1]


def test_stubtest(tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="mypy is not installed")
    command = [sys.executable, "-m", "mypy.stubtest", "nonrigid._nonrigid", "--concise"]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_mypy() -> None:
    pytest.importorskip("mypy", reason="mypy is not installed")
    command = [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", "-p", "nonrigid"]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=SOURCE)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert (PACKAGE / "py.typed").exists()


@pytest.mark.parametrize("name", ["_mesh", "_rig", "_schedule", "_registration", "_morph", "data_gen"])
def test_examples_run(name: str) -> None:
    outcome = doctest.testmod(importlib.import_module(f"nonrigid.{name}"))
    assert outcome.failed == 0 and outcome.attempted > 0


def test_everything_public_says_what_it_is() -> None:
    for name in nonrigid.__all__:
        thing = getattr(nonrigid, name)
        if name == "__version__":
            continue
        assert inspect.getdoc(thing), name
        if inspect.isclass(thing) and thing.__module__.startswith("nonrigid._"):
            for inner, member in vars(thing).items():
                if not inner.startswith("_") and (callable(member) or isinstance(member, (property, classmethod))):
                    assert inspect.getdoc(member), f"{name}.{inner}"
    for function in (nonrigid.register, nonrigid.morph, nonrigid.measure, nonrigid.evaluate, nonrigid.batch.run, data_gen.write):
        assert "Raises" in (inspect.getdoc(function) or ""), function
