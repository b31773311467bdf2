"""Callbacks, Ctrl-C, errors by kind, pickles, files, normal equations."""

from __future__ import annotations

import copy
import errno
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Data, begun

import nonrigid
from nonrigid import data_gen


def test_the_callback_sees_every_step_on_its_own_thread(face: data_gen.Face, case: data_gen.Case) -> None:
    steps, positions, threads = [], [], set()

    def see(step: nonrigid.Step) -> None:
        steps.append(step)
        threads.add(threading.get_ident())

    def look(step: nonrigid.Step, vertices: np.ndarray) -> None:
        positions.append((step.level, step.step, vertices))
        threads.add(threading.get_ident())

    found = nonrigid.register(
        face.rig.mesh, case.scan, rig=face.rig, landmarks=case.landmarks, model="blendshape", callback=see, on_positions=look
    )
    assert threads == {threading.get_ident()}
    assert [s.energy for s in steps] == [h["energy"] for h in found.history]
    assert [(s.level, s.step) for s in steps] == [p[:2] for p in positions]
    assert np.array_equal(positions[-1][2], found.positions)
    assert steps[0].energies.keys() and 0 < steps[0].inliers <= 1 and "level=0" in repr(steps[0])


def test_a_callback_stops(face: data_gen.Face, case: data_gen.Case) -> None:
    mesh, marks = face.rig.mesh, case.landmarks
    found = nonrigid.register(mesh, case.scan, landmarks=marks, model="graph", callback=lambda step: step.level < 1)
    assert not found.finished and found.history[-1]["level"] == 1 and found.history[-1]["step"] == 0
    assert "stopped" in repr(found)
    calls = []

    def fail(step: nonrigid.Step) -> None:
        calls.append(step)
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        nonrigid.register(mesh, case.scan, landmarks=marks, model="graph", callback=fail)
    assert len(calls) == 1
    assert pickle.loads(pickle.dumps(calls)) == copy.deepcopy(calls) == calls
    with pytest.raises(KeyError, match="mine"):
        nonrigid.register(mesh, case.scan, landmarks=marks, model="graph", on_positions=lambda step, positions: fail(step))


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_within_a_step(tmp_path: Path) -> None:
    program = tmp_path / "long.py"
    program.write_text(
        "import nonrigid\nfrom nonrigid import data_gen\n"
        "face = data_gen.Face(20000, 2)\ncase = face.scan(triangles=100000)\nprint('begin', flush=True)\n"
        "try:\n    while True:\n"
        "        nonrigid.register(face.rig.mesh, case.scan, landmarks=case.landmarks, model='graph')\n"
        "except KeyboardInterrupt:\n    print('interrupted', flush=True)\n"
    )
    process = begun(program)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60)[0] == "interrupted\n" and process.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_the_search_of_a_start(tmp_path: Path) -> None:
    program = tmp_path / "search.py"
    program.write_text(
        "import nonrigid\nfrom nonrigid import data_gen\n"
        "face = data_gen.Face(5000, 2)\ncase = face.scan(triangles=60000)\nkeys = nonrigid.Schedule('rigid').to_dict()\n"
        "keys['search']['rotations'] = 1_000_000\nprint('begin', flush=True)\n"
        "try:\n"
        "    nonrigid.register(face.rig.mesh, case.scan, schedule=keys, model='rigid')\n"
        "except KeyboardInterrupt:\n    print('interrupted', flush=True)\n"
    )
    process = begun(program)
    time.sleep(2.0)
    assert process.poll() is None, "the search was to take minutes"
    clock = time.monotonic()
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60)[0] == "interrupted\n" and process.returncode == 0
    assert time.monotonic() - clock < 1.0


def test_other_threads_run_meanwhile(face: data_gen.Face, case: data_gen.Case) -> None:
    ticks = []
    stop = threading.Event()

    def tick() -> None:
        while not stop.wait(0.002):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    nonrigid.register(face.rig.mesh, case.scan, rig=face.rig, landmarks=case.landmarks)
    stop.set()
    thread.join()
    assert len(ticks) > 10
    with ThreadPoolExecutor(4) as pool:
        run = lambda _: nonrigid.register(face.rig.mesh, case.scan, landmarks=case.landmarks, model="rigid").positions
        results = list(pool.map(run, range(8)))
    assert all(np.array_equal(r, results[0]) for r in results)


def within_itself() -> dict[str, Any]:
    keys: dict[str, Any] = {}
    keys["model"] = keys
    return keys


def test_errors_by_kind(face: data_gen.Face, case: data_gen.Case, data: Data, tmp_path: Path) -> None:
    mesh, marks = face.rig.mesh, case.landmarks
    with pytest.raises(FileNotFoundError, match="missing.ply"):
        nonrigid.register(mesh, tmp_path / "missing.ply")
    for argument in ("landmarks", "mask", "schedule", "rig", "neutral", "warm_start"):
        with pytest.raises(FileNotFoundError):
            nonrigid.register(mesh, case.scan, **{argument: tmp_path / "missing.npy"})
    (tmp_path / "bad.ply").write_text("ply\nformat ascii 1.0\nelement vertex 1\n")
    with pytest.raises(ValueError, match="bad.ply"):
        nonrigid.Mesh.read(tmp_path / "bad.ply")
    with pytest.raises(IsADirectoryError):
        nonrigid.register(mesh, case.scan, landmarks=tmp_path)
    (tmp_path / "state.json").write_text("{}")
    (tmp_path / "latin.obj").write_bytes(b"v 0 0 \xe9\n")
    (tmp_path / "latin.toml").write_bytes(b"# \xe9\n")
    for latin in (lambda: nonrigid.Mesh.read(tmp_path / "latin.obj"), lambda: nonrigid.Schedule.read(tmp_path / "latin.toml")):
        with pytest.raises(ValueError, match="latin"):
            latin()
    for wrong, words in [
        ({"model": "hybird"}, "unknown model"),
        ({"schedule": {"levels": []}}, "level"),
        ({"landmarks": {"99999": (0, 0, 0)}}, "99999"),
        ({"landmarks": {0: (0, 0)}}, "x, y, z"),
        ({"landmarks": ([3, 3, 9], np.zeros((3, 3)))}, "found 3 more often"),
        ({"schedule": within_itself()}, "in more than 32 others"),
        ({"mask": [0.5]}, "one for each template vertex"),
        ({"mask": np.full(len(mesh.vertices), 2.0)}, "from 0 to 1"),
        ({"threads": 0}, "threads"),
        ({"flip": "maybe"}, "flip"),
        ({"warm_start": tmp_path / "state.json"}, "is no state of a registration"),
        ({"regions": ["nowhere"]}, "nowhere"),
        ({"identity_modes": 3}, "give rig"),
        ({"unit": {"scan": "m"}}, "no input 'scan'"),
        ({"unit": {"rig": "m"}}, "unit of rig: there is no rig"),
        ({"unit": {"template_landmarks": "m"}}, "there is no template_landmarks"),
        ({"unit": "furlong"}, "unit"),
        ({"model": "blendshape"}, "blendshapes"),
    ]:
        with pytest.raises(ValueError, match=words):
            nonrigid.register(mesh, case.scan, **{"landmarks": marks, "model": "graph", **wrong})
    hidden = np.ma.array(case.scan.vertices, mask=np.arange(case.scan.vertices.size).reshape(-1, 3) < 3)
    with pytest.raises(ValueError, match="mask"):
        nonrigid.Mesh(hidden, case.scan.faces)
    with pytest.raises(ValueError, match="transpose"):
        nonrigid.Mesh(case.scan.vertices, case.scan.faces.T)
    last = len(mesh.vertices) - 1
    turned = nonrigid.Mesh(mesh.vertices[::-1], [[last - v for v in face] for face in mesh.faces])
    with pytest.raises(ValueError, match="in the rig's order"):
        nonrigid.register(turned, case.scan, rig=face.rig)
    with pytest.raises(ValueError, match="in the rig's order"):
        nonrigid.morph(turned, "nose-tip", rig=face.rig)
    with pytest.raises(ValueError, match="in the first mesh's order"):
        nonrigid.measure(mesh, turned.vertices, landmarks=face.anthropometric)
    few = nonrigid.Mesh(mesh.vertices[:3], [[0, 1, 2]])
    with pytest.raises(ValueError, match="found 3 vertices"):
        nonrigid.morph(few, "nose-tip", rig=face.rig)
    with pytest.raises(ValueError, match="not finite"):
        nonrigid.register(mesh, (np.full((3, 3), np.nan), [[0, 1, 2]]), model="rigid")
    far = nonrigid.Mesh(case.scan.vertices + 1e4, case.scan.faces)
    with pytest.raises(nonrigid.ComputationError, match="no vertex of the template"):
        here = {v: mesh.vertices[v] for v in (0, 100, 500)}
        nonrigid.register(mesh, far, landmarks=here, model="rigid")
    assert issubclass(nonrigid.ComputationError, RuntimeError)


def test_errors_of_files_are_those_of_python(case: data_gen.Case, face: data_gen.Face, tmp_path: Path) -> None:
    missing, below = tmp_path / "missing.ply", tmp_path / "no folder" / "a.obj"
    (tmp_path / "file").write_text("")
    for call, number, file in [
        (lambda: nonrigid.Mesh.read(missing), errno.ENOENT, missing),
        (lambda: nonrigid.Schedule.read(tmp_path), errno.EISDIR, tmp_path),
        (lambda: nonrigid.register(face.rig.mesh, case.scan, warm_start=missing), errno.ENOENT, missing),
        (lambda: case.scan.write(below), errno.ENOENT, below),
        (lambda: face.rig.write(tmp_path / "file" / "rig.npz"), errno.ENOTDIR, tmp_path / "file" / "rig.npz"),
    ]:
        with pytest.raises(OSError) as raised:
            call()
        assert (raised.value.errno, raised.value.filename) == (number, str(file))
        assert str(raised.value).count(str(file)) == 1


def test_options_without_effect_are_said(face: data_gen.Face, case: data_gen.Case) -> None:
    given = {"landmarks": case.landmarks, "rig": face.rig, "model": "rigid"}
    for option, setting in [("identity_modes", 3), ("shapes", ["jawOpen"]), ("expression_bounds", (0, 1))]:
        with pytest.warns(nonrigid.NonrigidWarning, match=f"{option} has no effect: the model rigid has no blendshapes"):
            nonrigid.register(face.rig.mesh, case.scan, **given, **{option: setting})
    keys = nonrigid.Schedule("sumner").to_dict()
    for level in keys["level"]:
        level["model"].pop("coarse", None)
    with pytest.warns(nonrigid.NonrigidWarning, match="schedule: model: coarse_nodes has no effect: no level is coarse"):
        nonrigid.register(face.rig.mesh, case.scan, landmarks=case.landmarks, model="sumner", schedule=keys)


def test_masks_of_any_numbers(face: data_gen.Face, case: data_gen.Case, tmp_path: Path) -> None:
    whole = np.ones(len(face.rig.mesh.vertices))
    whole[::3] = 0.25
    given = {"landmarks": case.landmarks, "model": "rigid"}
    expected = nonrigid.register(face.rig.mesh, case.scan, mask=whole, **given)
    for dtype in ("<f2", ">f2", "<f4", ">f8"):
        np.save(tmp_path / "mask.npy", whole.astype(dtype))
        for mask in (whole.astype(dtype), tmp_path / "mask.npy"):
            found = nonrigid.register(face.rig.mesh, case.scan, mask=mask, **given)
            assert np.array_equal(found.positions, expected.positions), dtype


def test_saving(registered: nonrigid.Registration, data: Data, tmp_path: Path) -> None:
    registered.save(tmp_path / "a.ply", report=tmp_path / "a.json", state=tmp_path / "b.json")
    again = nonrigid.Mesh.read(tmp_path / "a.ply")
    assert np.array_equal(again.vertices, registered.positions)
    with pytest.raises(FileNotFoundError):
        registered.save(tmp_path / "none" / "a.ply")
    with pytest.raises(ValueError, match="twice|same file"):
        registered.save(tmp_path / "c.obj", report=tmp_path / "d.json", state=tmp_path / "d.json")
    scan = data.scan().read_bytes()
    found = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="rigid")
    with pytest.raises(ValueError, match="would overwrite"):
        found.save(data.scan())
    with pytest.raises(ValueError, match="would overwrite"):
        found.save(tmp_path / "e.obj", report=data.landmarks())
    template = data.template.read_bytes()
    for made in (found.mesh, nonrigid.Mesh.read(data.template).with_vertices(found.positions)):
        with pytest.raises(ValueError, match="would overwrite"):
            made.write(data.template)
    assert data.template.read_bytes() == template
    assert data.scan().read_bytes() == scan and not (tmp_path / "e.obj").exists() and not (tmp_path / "c.obj").exists()


def test_what_was_read_is_kept_in_any_working_folder(data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(data.folder, tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    case = Path("data/cases/same_open")
    found = nonrigid.register("data/rig/template.obj", case / "scan.ply", rig="data/rig", landmarks=case / "landmarks.json", model="rigid")
    rig = nonrigid.Rig.read("data/rig")
    monkeypatch.chdir(case)
    scan = Path("scan.ply").read_bytes()
    with pytest.raises(ValueError, match="would overwrite"):
        found.save("scan.ply")
    with pytest.raises(ValueError, match="would overwrite"):
        found.save("a.obj", report="landmarks.json")
    with pytest.raises(ValueError, match="would overwrite"):
        pickle.loads(pickle.dumps(found)).save("scan.ply")
    with pytest.raises(ValueError, match="give another folder"):
        rig.write("../../rig")
    assert Path("scan.ply").read_bytes() == scan
    found.save("a.obj")
    assert Path("a.mtl").exists()
    for wrong in ({"report": "a.txt"}, {"state": "a.ply"}):
        with pytest.raises(ValueError, match="ends in .json"):
            found.save("b.obj", **wrong)
    with pytest.raises(ValueError, match="ends in .png"):
        found.picture("a.jpg")


def test_pickles(registered: nonrigid.Registration, case: data_gen.Case, tmp_path: Path) -> None:
    again = pickle.loads(pickle.dumps(registered))
    assert np.array_equal(again.positions, registered.positions) and again.report == registered.report
    assert again.weights == registered.weights and again.mesh == registered.mesh and again.doubts == registered.doubts
    with pytest.raises(ValueError, match="give it"):
        again.picture(tmp_path / "a.png")
    again.picture(tmp_path / "a.png", scan=case.scan)
    registered.picture(tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_pickle_saves_the_same_files(data: Data, tmp_path: Path) -> None:
    found = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="rigid")
    for name, which in (("a", found), ("b", pickle.loads(pickle.dumps(found)))):
        (tmp_path / name).mkdir()
        which.save(tmp_path / name / "out.obj")
        with pytest.raises(ValueError, match="would overwrite"):
            which.save(data.template)
    written = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    assert set(written) == {"out.obj", "out.mtl"}
    assert written == {path.name: path.read_bytes() for path in (tmp_path / "b").iterdir()}


def test_weights_have_standard_deviations(registered: nonrigid.Registration, face: data_gen.Face) -> None:
    assert list(registered.weights)[:54] == face.rig.names[:54] and len(registered.weights) == 58
    assert all(w.std_dev is None or w.std_dev > 0 for w in registered.weights.values())
    assert registered.accepted.dtype == bool and registered.accepted.mean() > 0.5
    assert 0 <= registered.error_probability <= 1
    values = {name: weight.value for name, weight in registered.weights.items()}
    assert face.rig.blend(registered.weights) == face.rig.blend(values)
    for wrong, error in (((1.0, 2.0, 3.0), TypeError), ("1", TypeError), (np.nan, ValueError)):
        with pytest.raises(error, match="jawOpen"):
            face.rig.blend({"jawOpen": wrong})


def test_normal_equations(face: data_gen.Face, case: data_gen.Case, registered: nonrigid.Registration) -> None:
    sparse = pytest.importorskip("scipy.sparse", reason="SciPy is not installed")
    found = nonrigid.register(face.rig.mesh, case.scan, rig=face.rig, identity_modes=4, landmarks=case.landmarks, equations=True)
    assert np.array_equal(found.positions, registered.positions), "keeping the equations changes nothing"
    hessian, gradient = found.normal_equations()
    gradient[:] = hessian.data[:] = 0
    hessian, gradient = found.normal_equations()
    # Weights of 58 shapes, and of the three proportions.
    assert sparse.issparse(hessian) and hessian.shape == (len(gradient), len(gradient)) and (len(gradient) - 61) % 6 == 0
    assert abs(hessian - hessian.T).max() == 0
    lowest = np.linalg.eigvalsh(hessian.toarray())[0]
    assert lowest > -1e-6 * hessian.diagonal().max()
    # the deviations of the report are those of the covariance of the border
    inverse = np.linalg.inv(hessian.toarray())[-61:-3, -61:-3]
    deviations = np.array([w.std_dev for w in found.weights.values()], dtype=float)
    ratio = np.sqrt(np.diag(inverse)) / deviations
    assert ratio.std() < 0.02 * ratio.mean()
    with pytest.raises(ValueError, match="equations=True"):
        registered.normal_equations()


FORK = """
import multiprocessing, sys
import nonrigid
from nonrigid import data_gen
def work(seed):
    face = data_gen.Face(1000, 2)
    case = face.scan(seed=seed, triangles=5000)
    return nonrigid.register(face.rig.mesh, case.scan, landmarks=case.landmarks, model="rigid").positions.tobytes()
if __name__ == "__main__":
    here = [work(1), work(2)]  # threads have run in this process
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        assert pool.map(work, [1, 2]) == here
    print("same")
"""


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_after_a_fork(python: Callable[..., subprocess.CompletedProcess[str]], method: str) -> None:
    if sys.platform == "win32" and method == "fork":
        pytest.skip("there is no fork on this system")
    ended = python(FORK, method)
    assert ended.returncode == 0 and ended.stdout == "same\n", ended.stderr


NO_THREADS = """
import os, resource
import nonrigid
from nonrigid import data_gen
face = data_gen.Face(1000, 2)
case = face.scan(triangles=5000)
if os.getuid() == 0:
    os.setuid(65534)  # root has no limit
resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))
register = lambda: nonrigid.register(face.rig.mesh, case.scan, model="rigid")
for work in (lambda: data_gen.Face(1000, 2), register, lambda: face.rig.fit([face.rig.neutral])):
    try:
        work()
    except nonrigid.ComputationError as error:
        print(str(error).split(":")[0])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of threads")
def test_without_threads_is_an_error(python: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    ended = python(NO_THREADS)
    assert ended.returncode == 0 and ended.stdout == "threads\n" * 3, ended.stderr


def test_a_result_is_divided(face: data_gen.Face, case: data_gen.Case) -> None:
    found = nonrigid.register(face.rig.mesh, case.scan, rig=face.rig, landmarks=case.landmarks, subdivide=1)
    finer = pickle.loads(pickle.dumps(found)).finer
    assert finer is not None and len(found.positions) == len(face.rig.mesh.vertices)
    assert len(finer.triangles) > 3 * len(face.rig.mesh.triangles)
    detail = found.report["detail"]
    assert detail["vertices"] == len(finer.vertices)
    assert detail["quality"]["median_within"] < detail["before"]["median_within"]
    with pytest.raises(ValueError, match="subdivide"):
        nonrigid.register(face.rig.mesh, case.scan, subdivide=4)
