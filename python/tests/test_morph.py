"""Morphs, measurements and evaluations: the numbers are the command line's."""

from __future__ import annotations

import json
import pickle
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Data, begun

import nonrigid
from nonrigid import data_gen


def command(*words: object) -> str:
    run = [sys.executable, "-m", "nonrigid", *map(str, words)]
    return subprocess.run(run, check=True, capture_output=True, text=True).stdout


def test_presets_and_recipes(face: data_gen.Face, data: Data, tmp_path: Path) -> None:
    rig = nonrigid.Rig.read(data.rig)
    assert len(nonrigid.presets()) == 20
    command("morph", "--mesh", data.template, "--rig", data.rig, "--preset", "nose-bridge=2.5", "--preset", "chin-forward", "--out", tmp_path / "a.obj")
    found = nonrigid.morph(data.template, {"nose-bridge": 2.5, "chin-forward": None}, rig=rig)
    (tmp_path / "same").mkdir()
    found.mesh.write(tmp_path / "same" / "a.obj")
    for name in ("a.obj", "a.mtl"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "same" / name).read_bytes()
    assert len(found.steps) == 2 and found.steps[0].report["moving"] > 0 and found.mask.max() <= 1
    moved = np.linalg.norm(found.mesh.vertices - found.before.vertices, axis=1)
    assert (moved[found.mask == 0] == 0).all() and 1.5 < moved.max() < 3.5
    # a recipe as a file, as keys, and on an energy
    (tmp_path / "mine.toml").write_text(nonrigid.presets()["nose-bridge"].text)
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11 reads TOML")
    keys = tomllib.loads(nonrigid.presets()["nose-bridge"].text)
    of_file = nonrigid.morph(data.template, tmp_path / "mine.toml", rig=rig, amount=2)
    preset = nonrigid.morph(data.template, "nose-bridge", rig=rig, amount=2)
    assert np.array_equal(of_file.mesh.vertices, preset.mesh.vertices)
    landmarks = rig.landmarks
    of_keys = nonrigid.morph(data.template, keys, landmarks=landmarks, amount=2)
    assert np.array_equal(of_keys.mesh.vertices, preset.mesh.vertices)
    energy = nonrigid.morph(data.template, "nose-bridge", rig=rig, model="arap")
    assert energy.steps[0].report["energy"]["iterations"] > 0 and not np.array_equal(energy.mesh.vertices, preset.mesh.vertices)
    with pytest.warns(nonrigid.NonrigidWarning, match="made for"):
        nonrigid.morph(data.template, {"nose-bridge": 9}, rig=rig)
    with pytest.warns(nonrigid.NonrigidWarning, match="smoothing has no effect"):
        nonrigid.morph(data.template, {**keys, "step": [{**keys["step"][0], "energy": {"smoothing": 3}}]}, rig=rig)
    plain = found.before
    painted = nonrigid.Mesh(plain.vertices, plain.faces, colors=np.arange(3 * len(plain.vertices)).reshape(-1, 3) % 256)
    assert np.array_equal(nonrigid.morph(painted, "nose-bridge", rig=rig).mesh.colors, painted.colors)
    for given in ({"weight_bounds": (0, 1)}, {"shapes": ["jawOpen"]}, {"identity_modes": 2}):
        with pytest.warns(nonrigid.NonrigidWarning, match=f"{next(iter(given))} has no effect: no step's model has blendshapes"):
            nonrigid.morph(data.template, "nose-bridge", rig=rig, **given)
        with pytest.raises(ValueError, match="are of a rig; give rig"):
            nonrigid.morph(data.template, "nose-bridge", landmarks=landmarks, **given)
    for recipe, options, error, words in [
        ({"nose-bridge": 1, "chin-forward": 1}, {"until": 1}, ValueError, "there are several"),
        ("nose-bridge", {"until": -1}, ValueError, "until: expected a whole number"),
        ("nose-bridge", {"weight_bounds": (1, 0), "model": "blendshape"}, ValueError, "no weight lies between 1 and 0"),
        ("nose-bridge", {"identity_modes": -1}, ValueError, "identity_modes: expected a whole number"),
        ("nose-bridg", {}, FileNotFoundError, "presets are"),
        ({"nose-bridg": 1}, {}, ValueError, "unknown preset"),
        ("nose-bridge", {"rig": None}, ValueError, "landmarks"),
        ("nose-bridge", {"model": "clay"}, ValueError, "clay"),
        ("nose-bridge", {"until": 3}, ValueError, "until"),
        ("nose-bridge", {"amount": "2"}, TypeError, "amount"),
        (7, {}, TypeError, "recipe"),
        ({"step": [{"msk": 1}]}, {}, ValueError, "msk"),
    ]:
        with pytest.raises(error, match=words):
            nonrigid.morph(data.template, recipe, **{"rig": rig, **options})


def test_measurements(face: data_gen.Face, data: Data, tmp_path: Path) -> None:
    rig = nonrigid.Rig.read(data.rig)
    changed = nonrigid.morph(data.template, {"nose-bridge": 2.5}, rig=rig).mesh
    changed.write(tmp_path / "after.obj")
    marks = [data.rig / "landmarks_multipie68.json", data.rig / "landmarks_anthropometric.json"]
    flags = [word for path in marks for word in ("--landmarks", path)]
    command("measure", "--mesh", data.template, "--after", tmp_path / "after.obj", "--rig", data.rig, *flags,
            "--json", tmp_path / "a.json", "--csv", tmp_path / "a.csv")  # fmt: skip
    found = nonrigid.measure(data.template, tmp_path / "after.obj", landmarks=marks, rig=rig)
    assert dict(found) == json.loads((tmp_path / "a.json").read_text()) and found.csv == (tmp_path / "a.csv").read_text()
    width = found.value("face_width")
    assert width is not None and 80 < width < 200 and found.value("face_width", after=True) is not None
    assert "face width" in str(found) and "face_width" in nonrigid.glossary().replace(" ", "_")
    assert dict(pickle.loads(pickle.dumps(found))) == dict(found)
    with pytest.raises(KeyError):
        found.value("nothing")
    # landmarks of the rig: the 68, and those by name in its folder
    for of_rig in (data.rig, rig):
        assert dict(nonrigid.measure(data.template, tmp_path / "after.obj", rig=of_rig)) == dict(found)
    assert dict(nonrigid.measure(data.template, tmp_path / "after.obj", rig=pickle.loads(pickle.dumps(rig)))) == dict(found)
    heights = [face.rig.neutral[face.anthropometric[name]] for name in ("nasion", "menton")]
    with pytest.warns(nonrigid.NonrigidWarning, match="1 landmark lies off the mesh, menton by"):
        nonrigid.measure(face.rig.mesh, landmarks={"nasion": heights[0], "menton": heights[1] - [0, 5, 0]})
    alone = nonrigid.measure(face.rig.mesh, landmarks=face.anthropometric)
    assert alone.value("face_height") is not None
    with pytest.raises(ValueError, match="no landmark"):
        nonrigid.measure(face.rig.mesh, landmarks={"nowhere": 3})
    spiked = face.rig.neutral.copy()
    spiked[0] += 60
    with pytest.warns(nonrigid.NonrigidWarning, match="1 of its vertices stand out from their neighbours"):
        nonrigid.measure(face.rig.mesh, spiked, landmarks=face.anthropometric)


def test_units_reach_every_input(face: data_gen.Face, case: data_gen.Case) -> None:
    """Of arrays in centimetres or metres comes what comes of millimetres; a mesh is in millimetres already."""
    mesh, landmarks = face.rig.mesh, face.anthropometric
    assert mesh is not None
    v, faces = mesh.vertices, mesh.faces
    points = {name: v[vertex] + 0.01 for name, vertex in landmarks.items()}
    in_cm = {name: p / 10 for name, p in points.items()}
    moved = v + [1.0, 0, 0]

    def close(a: dict[str, Any], b: dict[str, Any]) -> bool:
        return np.allclose([row["after"] for row in a["measurements"]], [row["after"] for row in b["measurements"]], rtol=1e-9)

    with pytest.warns(nonrigid.NonrigidWarning, match=r"moved by 0.0° and 1.0 mm: .*; align=True takes it out"):
        plain = nonrigid.measure(mesh, moved, landmarks=points)
    still = nonrigid.measure(mesh, moved, landmarks=points, align=True)
    assert still["regions"][0]["change"]["displacement_max"] < 1e-9
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nonrigid.NonrigidWarning)
        assert close(nonrigid.measure((v / 10, faces), moved / 10, landmarks=in_cm, unit="cm"), plain)
        assert close(nonrigid.measure(mesh, moved / 10, landmarks=in_cm, unit="cm"), plain)
    morphed = nonrigid.morph(mesh, "nose-bridge", landmarks=face.rig.landmarks)
    for given in (mesh, (v / 10, faces)):
        again = nonrigid.morph(given, "nose-bridge", landmarks=face.rig.landmarks, unit="cm")
        assert np.allclose(again.mesh.vertices, morphed.mesh.vertices, atol=1e-9)
    errors = nonrigid.evaluate(moved / 1000, (v / 1000, faces), truth=v / 1000, unit="m")
    assert np.isclose(errors["rmse"], 1.0)
    scan = (case.scan.vertices / 1000, case.scan.faces)
    of_scan = nonrigid.evaluate(moved / 1000, (v / 1000, faces), scan=scan, unit="m")
    expected = nonrigid.evaluate(moved, mesh, scan=case.scan)
    assert np.isclose(of_scan["result_to_scan"]["median"], expected["result_to_scan"]["median"], rtol=1e-6)

    found = nonrigid.register(mesh, case.scan, landmarks=case.landmarks, model="rigid")
    cm = {vertex: point / 10 for vertex, point in case.landmarks.items()}
    of_landmarks = nonrigid.register(mesh, case.scan, landmarks=cm, model="rigid", unit={"landmarks": "cm"})
    assert np.allclose(of_landmarks.positions, found.positions, atol=1e-6)
    named = {str(vertex): v[vertex] / 10 for vertex in case.landmarks}
    of_names = nonrigid.register(
        mesh, case.scan, landmarks={str(vertex): point for vertex, point in case.landmarks.items()}, template_landmarks=named, model="rigid",
        unit={"template_landmarks": "cm"},
    )  # fmt: skip
    assert np.allclose(of_names.positions, found.positions, atol=1e-6)
    with pytest.raises(ValueError, match="unit of template: a Mesh is in millimetres already"):
        nonrigid.register(mesh, case.scan, landmarks=case.landmarks, model="rigid", unit={"template": "cm"})


def test_masked_landmarks_are_refused(face: data_gen.Face, case: data_gen.Case) -> None:
    point, marks = np.ma.array([1.0, 2, 3], mask=[1, 0, 0]), case.landmarks
    vertices = np.ma.array(list(marks), mask=[1] + [0] * (len(marks) - 1))
    of_scan: list[Any] = [dict.fromkeys(marks, point), (vertices, np.array(list(marks.values())))]
    for landmarks in of_scan:
        with pytest.raises(ValueError, match="without a mask"):
            nonrigid.register(face.rig.mesh, case.scan, landmarks=landmarks, model="rigid")
    masked = np.ma.array(face.rig.landmarks, mask=[1] + [0] * 67)
    for landmarks in (masked, {"nasion": point}):
        with pytest.raises(ValueError, match="without a mask"):
            nonrigid.measure(face.rig.mesh, landmarks=landmarks)
    with pytest.raises(ValueError, match=r"landmarks: expected vertex indices \(L,\) and points \(L, 3\), found"):
        nonrigid.measure(face.rig.mesh, landmarks=[([1, 2], [[1, 2, 3]])])


def test_evaluations(data: Data, tmp_path: Path) -> None:
    found = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="similarity")
    found.save(tmp_path / "a.obj")
    case = data.case()
    truth = command("eval", "--result", tmp_path / "a.obj", "--template", data.template, "--truth", case / "truth.npy",
                    "--observed", case / "observed.npy", "--json")  # fmt: skip
    mine = nonrigid.evaluate(found.mesh, data.template, truth=case / "truth.npy", observed=case / "observed.npy")
    assert dict(mine) == json.loads(truth)
    observed = np.load(case / "observed.npy")
    errors = np.linalg.norm(found.positions - np.load(case / "truth.npy"), axis=1)
    assert np.allclose(mine.distances[observed], errors[observed]) and np.isnan(mine.distances[~observed]).all()
    scan = command("eval", "--result", tmp_path / "a.obj", "--template", data.template, "--target", data.scan(), "--json")
    assert dict(nonrigid.evaluate(found.positions, data.template, scan=data.scan())) == json.loads(scan)
    none, unknown = np.zeros_like(observed), np.full_like(found.positions, np.nan)
    for options, words in [({"truth": found.positions, "observed": none}, "no vertex is observed"), ({"truth": unknown}, "truth is not finite")]:
        with pytest.raises(ValueError, match=words):
            nonrigid.evaluate(found.positions, data.template, **options)
    for options in ({}, {"truth": found.positions, "scan": data.scan()}, {"truth": found.positions[1:]}, {"scan": data.scan(), "observed": observed}):
        with pytest.raises(ValueError):
            nonrigid.evaluate(found.positions, data.template, **options)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_generated_data(tmp_path: Path) -> None:
    program = tmp_path / "long.py"
    program.write_text(
        "import sys\nfrom nonrigid import data_gen\nprint('begin', flush=True)\n"
        "try:\n    data_gen.write(sys.argv[1], vertices=1000, triangles=5000, cases=5_000)\n"
        "except KeyboardInterrupt:\n    print('interrupted', flush=True)\n"
    )
    process = begun(program, tmp_path / "data")
    time.sleep(2.0)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    try:
        assert process.communicate(timeout=60)[0] == "interrupted\n" and process.returncode == 0
    finally:
        process.kill()


LONG = """
import sys
import numpy as np
from nonrigid import Rig, data_gen
face = data_gen.Face(20000, 2)
samples = face.rig.neutral + np.random.default_rng(1).normal(size=(150, *face.rig.neutral.shape))
work = {
    "face": lambda: data_gen.Face(500_000, 200),
    "scan": lambda: face.scan(triangles=2_000_000),
    "transfer": lambda: face.rig.transfer(face.rig.neutral * 1.1),
    "pca": lambda: Rig.pca(samples, 5),
}[sys.argv[1]]
print("begin", flush=True)
try:
    while True:
        work()
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("work", ["face", "scan", "transfer", "pca"])
def test_ctrl_c_ends_what_takes_long(tmp_path: Path, work: str) -> None:
    (tmp_path / "long.py").write_text(LONG)
    process = begun(tmp_path / "long.py", Path(work))
    try:
        time.sleep(1.0)
        clock = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=60)[0] == "interrupted\n" and process.returncode == 0
        assert time.monotonic() - clock < 1.0
    finally:
        process.kill()


def test_generated_faces(face: data_gen.Face, case: data_gen.Case) -> None:
    assert len(face.rig.landmarks) == 68 and face.rig.regions and face.anthropometric["pronasale"] >= 0
    assert case.truth.shape == face.rig.neutral.shape and 0.3 < case.observed.mean() < 1
    assert case.expression_weights["mouthSmile_L"] > 0 and len(case.identity_weights) == 6
    again = pickle.loads(pickle.dumps(face)).scan(seed=3, preset="smile", triangles=6000)
    assert len(repr(case)) < 200 and repr(face) == "Face(vertices=1200, identity_modes=6)"
    assert again.scan == case.scan and np.array_equal(again.truth, case.truth)
    open_mouth = face.scan(seed=3, expressions={"jawOpen": 0.5}, triangles=5000, camera=[(0, 0)], identity=[1.0, -1.0], no_eyeballs=True)
    assert open_mouth.expression_weights["jawOpen"] == 0.5 and open_mouth.identity_weights[:2].tolist() == [1, -1]
    for options, words in [({"preset": "grin"}, "grin"), ({"colour": 3}, "colour"), ({"triangles": 3}, "triangles"), ({"noise": -1}, "noise"),
                           ({"population": 3}, "population: has no effect"), ({"frames": 4}, "frames: has no effect"),
                           ({"vertices": 2000}, "vertices: has no effect"), ({"seed": -1}, "seed")]:  # fmt: skip
        with pytest.raises(ValueError, match=words):
            face.scan(**options)
    for vertices in (3, -3):
        with pytest.raises(ValueError, match="vertices"):
            data_gen.Face(vertices=vertices)
