"""The same registration through Rust, the command line and Python gives the same bytes, at any number of threads and from any of them."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from conftest import Data

import nonrigid


def by_command_line(program: list[str], data: Data, folder: Path, *options: str) -> None:
    files = ["--out", folder / "out.obj", "--report", folder / "out.json", "--state", folder / "state.json", "--picture", folder / "out.png"]
    inputs = ["--template", data.template, "--target", data.scan(), "--rig", data.rig, "--landmarks", data.landmarks()]
    command = [*program, "register", *inputs, *files, *options]
    subprocess.run([str(word) for word in command], check=True, capture_output=True)


def test_rust_command_line_and_python(data: Data, program: Path, rust: Path, tmp_path: Path) -> None:
    by_command_line([str(program)], data, tmp_path, "--identity-modes", "5")
    found = nonrigid.register(data.template, data.scan(), rig=data.rig, identity_modes=5, landmarks=data.landmarks(), threads=1)
    (tmp_path / "python").mkdir()
    mine = tmp_path / "python"
    found.save(mine / "out.obj", report=mine / "out.json", state=mine / "state.json")
    found.picture(mine / "out.png")
    assert (found.report_json.encode(), found.state_json.encode()) == ((tmp_path / "out.json").read_bytes(), (tmp_path / "state.json").read_bytes())
    subprocess.run([rust, data.template, data.rig, "5", data.scan(), data.landmarks(), mine / "rust.obj"], check=True)
    for name in ("out.obj", "out.json", "state.json", "out.png"):
        assert (mine / name).read_bytes() == (tmp_path / name).read_bytes(), name
    assert (mine / "rust.obj").read_bytes() == (tmp_path / "out.obj").read_bytes().replace(b"mtllib out.mtl\n", b"")


def test_options_mean_the_same(data: Data, program: Path, tmp_path: Path) -> None:
    mask = tmp_path / "mask.npy"
    np.save(mask, np.linspace(0, 1, len(nonrigid.Mesh.read(data.template).vertices)))
    schedule = tmp_path / "schedule.toml"
    schedule.write_text(nonrigid.Schedule("blendshape").to_toml())
    options = ["--identity-modes=3", "--model=blendshape", "--expression-bounds=0,1", "--identity-bounds=-2,2", f"--mask={mask}",
               "--free-regions=lips", f"--config={schedule}", "--flip=no", "--shapes=jawOpen,mouthSmile_L", "--unit=mm"]  # fmt: skip
    by_command_line([str(program)], data, tmp_path, *options)
    found = nonrigid.register(
        data.template, data.scan(), rig=data.rig, identity_modes=3, model="blendshape", expression_bounds=(0, 1), identity_bounds=(-2, 2),
        mask=mask, free_regions=["lips"], schedule=schedule, flip="no", shapes=["jawOpen", "mouthSmile_L"], unit="mm",
        landmarks=data.landmarks(),
    )  # fmt: skip
    assert found.report_json == (tmp_path / "out.json").read_text()
    arrays = nonrigid.register(
        nonrigid.Mesh.read(data.template), nonrigid.Mesh.read(data.scan()), rig=nonrigid.Rig.read(data.rig), identity_modes=3,
        model="blendshape", expression_bounds=(0, 1), identity_bounds=(-2, 2), mask=np.load(mask), free_regions="lips",
        schedule=nonrigid.Schedule("blendshape").to_dict(), flip="no", shapes=["jawOpen", "mouthSmile_L"],
        landmarks={k: v for k, v in json.loads(data.landmarks().read_text()).items()},
    )  # fmt: skip
    assert np.array_equal(arrays.positions, found.positions)


def test_any_threads(data: Data) -> None:
    def run(threads: int | None) -> bytes:
        found = nonrigid.register(data.template, data.scan(), rig=data.rig, landmarks=data.landmarks(), threads=threads)
        return found.positions.tobytes() + found.report_json.encode()

    first = run(1)
    with ThreadPoolExecutor(4) as pool:
        assert all(result == first for result in pool.map(run, [1, 2, 4, None, 2, 1]))


def test_the_package_has_the_command_line(data: Data, program: Path, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    by_command_line([str(program)], data, tmp_path / "a", "--model=rigid")
    by_command_line([sys.executable, "-m", "nonrigid"], data, tmp_path / "b", "--model=rigid")
    for name in ("out.obj", "out.json", "state.json", "out.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    wrong = subprocess.run([sys.executable, "-m", "nonrigid", "register", "--colour"], capture_output=True)
    assert wrong.returncode == 1


def test_warm_start(data: Data, program: Path, tmp_path: Path) -> None:
    first = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="rigid")
    first.save(tmp_path / "first.obj", state=tmp_path / "first.json")
    second = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="rigid", warm_start=first)
    of_file = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="rigid", warm_start=tmp_path / "first.json")
    assert np.array_equal(second.positions, of_file.positions)
    with pytest.raises(ValueError, match="warm start does not fit"):
        nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="graph", warm_start=first)


def test_generated_data(program: Path, tmp_path: Path) -> None:
    from conftest import built

    generator = built("-p", "data-gen", "--bin", "data-gen")
    options = ["--seed=5", "--vertices=1000", "--identity-modes=3", "--triangles=5000", "--camera=0,0", "--camera=-40,10"]
    subprocess.run([str(generator), f"--out={tmp_path / 'a'}", *options, "--case=new_open"], check=True, capture_output=True)
    nonrigid.data_gen.write(
        tmp_path / "b", seed=5, vertices=1000, identity_modes=3, triangles=5000, camera=[(0, 0), (-40, 10)], case="new_open"
    )
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert files and all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def files_of(path: Path) -> dict[str, bytes]:
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    return {p.name: p.read_bytes() for p in files}


def written(rig: nonrigid.Rig, path: Path, form: Literal["folder", "shapes"] = "folder") -> set[str]:
    """Writes a rig; what was said of that, without the path."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rig.write(path, form=form)
    return {str(one.message).split(": ", 1)[1] for one in said}


def test_rigs_are_written_as_by_the_command_line(data: Data, program: Path, tmp_path: Path) -> None:
    """With landmarks by name and materials, also after a pickle; and what a form does not hold is said."""

    def convert(*words: object) -> set[str]:
        run = subprocess.run([str(word) for word in (program, "rig", *words)], check=True, capture_output=True, text=True)
        lines = [line.removeprefix("warning: ") for line in run.stderr.splitlines() if line.startswith("warning: ")]
        return {line.split(": ", 1)[1] for line in lines}

    rig = nonrigid.Rig.read(data.rig)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    for name, form in [("folder", "npy"), ("shapes", "shapes"), ("rig.npz", "npy"), ("rig.glb", "npy")]:
        told = convert("convert", "--rig", data.rig, "--out", tmp_path / "a" / name, "--format", form)
        for which in (rig, pickle.loads(pickle.dumps(rig))):
            out = tmp_path / "b" / name
            assert written(which, out, "shapes" if form == "shapes" else "folder") == told, name
            assert files_of(out) == files_of(tmp_path / "a" / name), name
        assert told or name == "folder"
    assert {"landmarks.json", "landmarks_anthropometric.json", "template.mtl"} <= set(files_of(tmp_path / "b" / "folder"))

    subject = rig.blend({"identity000": 1.0})
    subject.write(tmp_path / "subject.obj")
    convert("transfer", "--rig", data.rig, "--subject", tmp_path / "subject.obj", "--out", tmp_path / "a" / "mine")
    mine = rig.transfer(tmp_path / "subject.obj")
    mine.write(tmp_path / "b" / "mine")
    assert files_of(tmp_path / "b" / "mine") == files_of(tmp_path / "a" / "mine")
    assert dict(nonrigid.measure(subject, rig=mine)) == dict(nonrigid.measure(subject, rig=tmp_path / "a" / "mine"))

    (tmp_path / "people").mkdir()
    for k in range(5):
        rig.blend({f"identity{k:03}": 2.0}).write(tmp_path / "people" / f"{k}.obj")
    convert("pca", "--meshes", tmp_path / "people", "--components", 3, "--out", tmp_path / "a" / "modes")
    modes = nonrigid.Rig.pca(tmp_path / "people", 3)
    for which in (modes, pickle.loads(pickle.dumps(modes))):
        which.write(tmp_path / "b" / "modes")
        assert files_of(tmp_path / "b" / "modes") == files_of(tmp_path / "a" / "modes")
    assert {"template.mtl", "components.npy", "standard_deviations.npy"} <= set(files_of(tmp_path / "b" / "modes"))
    for made, source in ((mine, data.rig), (modes, tmp_path / "people"), (pickle.loads(pickle.dumps(mine)), data.rig)):
        with pytest.raises(ValueError, match="give another folder"):
            made.write(source)


def test_a_finer_result_is_what_is_written(data: Data, program: Path, tmp_path: Path) -> None:
    by_command_line([str(program)], data, tmp_path, "--model=rigid", "--subdivide=1")
    found = nonrigid.register(data.template, data.scan(), rig=data.rig, landmarks=data.landmarks(), model="rigid", subdivide=1)
    (tmp_path / "python").mkdir()
    found.save(tmp_path / "python" / "out.obj")
    assert (tmp_path / "python" / "out.obj").read_bytes() == (tmp_path / "out.obj").read_bytes()
