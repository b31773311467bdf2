"""Morphs, measurements and evaluations: the numbers are the command line's."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import Data

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
    for recipe, options, error, words in [
        ("nose-bridg", {}, FileNotFoundError, "presets are"),
        ({"nose-bridg": 1}, {}, ValueError, "unknown preset"),
        ("nose-bridge", {"rig": None}, ValueError, "landmarks"),
        ("nose-bridge", {"model": "clay"}, ValueError, "clay"),
        ("nose-bridge", {"until": 3}, ValueError, "until"),
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
    numbered = nonrigid.measure(data.template, landmarks=marks[0], rig=rig)
    assert dict(nonrigid.measure(data.template, rig=pickle.loads(pickle.dumps(rig)))) == dict(numbered)
    heights = [face.rig.neutral[face.anthropometric[name]] for name in ("nasion", "menton")]
    with pytest.warns(nonrigid.NonrigidWarning, match="1 landmark lies off the mesh, menton by"):
        nonrigid.measure(face.rig.mesh, landmarks={"nasion": heights[0], "menton": heights[1] - [0, 5, 0]})
    alone = nonrigid.measure(face.rig.mesh, landmarks=face.anthropometric)
    assert alone.value("face_height") is not None
    with pytest.raises(ValueError, match="no landmark"):
        nonrigid.measure(face.rig.mesh, landmarks={"nowhere": 3})


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
    for options in ({}, {"truth": found.positions, "scan": data.scan()}, {"truth": found.positions[1:]}, {"scan": data.scan(), "observed": observed}):
        with pytest.raises(ValueError):
            nonrigid.evaluate(found.positions, data.template, **options)


def test_generated_faces(face: data_gen.Face, case: data_gen.Case) -> None:
    assert len(face.rig.landmarks) == 68 and face.rig.regions and face.anthropometric["pronasale"] >= 0
    assert case.truth.shape == face.rig.neutral.shape and 0.3 < case.observed.mean() < 1
    assert case.expression_weights["mouthSmile_L"] > 0 and len(case.identity_weights) == 6
    again = face.scan(seed=3, preset="smile", triangles=6000)
    assert again.scan == case.scan and np.array_equal(again.truth, case.truth)
    open_mouth = face.scan(seed=3, expressions={"jawOpen": 0.5}, triangles=5000, camera=[(0, 0)], identity=[1.0, -1.0], no_eyeballs=True)
    assert open_mouth.expression_weights["jawOpen"] == 0.5 and open_mouth.identity_weights[:2].tolist() == [1, -1]
    for options, words in [({"preset": "grin"}, "grin"), ({"colour": 3}, "colour"), ({"triangles": 3}, "triangles"), ({"noise": -1}, "noise")]:
        with pytest.raises(ValueError, match=words):
            face.scan(**options)
    with pytest.raises(ValueError):
        data_gen.Face(vertices=3)
