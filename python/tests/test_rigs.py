"""Rigs: arrays, files, transfer, fits, components, and those of the field."""

from __future__ import annotations

import copy
import pickle
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Data

import nonrigid
from nonrigid import Mesh, Rig, data_gen


def same(a: Rig, b: Rig, tolerance: float = 1e-3) -> bool:
    return a.names == b.names and np.allclose(a.deltas, b.deltas, atol=tolerance) and np.allclose(a.neutral, b.neutral, atol=tolerance)


def test_arrays(face: data_gen.Face) -> None:
    rig = face.rig
    assert rig.mesh is not None
    shapes = dict(zip(rig.names, rig.deltas))
    again = Rig(rig.mesh, shapes, families=dict(zip(rig.names, rig.families)), landmarks=rig.landmarks, regions=rig.regions)
    assert same(again, rig, 0) and again.families == rig.families and list(again.regions) == list(rig.regions)
    full = Rig(rig.neutral, {name: rig.neutral + d for name, d in shapes.items()}, shape_kind="full", faces=rig.mesh.faces)
    assert same(full, rig, 1e-4)
    centimetres = Rig(rig.neutral / 10, {n: d / 10 for n, d in shapes.items()}, unit="cm")
    assert same(centimetres, rig, 1e-4) and centimetres.mesh is None
    mesh = Mesh(rig.neutral / 10, rig.mesh.faces, unit="cm")
    for neutral, shapes_of in ((mesh, {}), (rig.neutral / 10, {}), (mesh, {"shape_kind": "full"})):
        in_cm = {n: d / 10 + (rig.neutral / 10 if shapes_of else 0) for n, d in shapes.items()}
        assert same(Rig(neutral, in_cm, unit="cm", **shapes_of), rig, 1e-4)
    with pytest.raises(ValueError, match="families: none is given for browDown_L"):
        Rig(rig.mesh, shapes, families={name: "other" for name in rig.names if name != "browDown_L"})
    with pytest.raises(ValueError, match="one for each vertex"):
        Rig(rig.neutral, {"a": rig.neutral[1:]})
    with pytest.raises(KeyError, match="no shape"):
        rig.blend({"nothing": 1})
    with pytest.raises(TypeError, match="weights: expected {shape: weight}, found list"):
        rig.blend([1.0])
    for options, error, words in [
        ({"shapes": [rig.neutral]}, TypeError, "shapes: expected"),
        ({"neutral": ()}, TypeError, "tuple"),
        ({"regions": [1]}, TypeError, "regions: expected"),
        ({"regions": {"a": [[1, 2]]}}, ValueError, "regions: expected a list of vertex indices"),
        ({"landmarks": np.zeros((2, 34), dtype=int)}, ValueError, "landmarks: expected a list of vertex indices"),
    ]:
        with pytest.raises(error, match=words):
            Rig(**{"neutral": rig.neutral, "shapes": {}, **options})
    with pytest.warns(nonrigid.NonrigidWarning, match="moves nothing"):
        Rig(rig.neutral, {"still": np.zeros_like(rig.neutral), "jawOpen": shapes["jawOpen"]})


def test_tables_and_tensors_are_arrays(face: data_gen.Face) -> None:
    pandas = pytest.importorskip("pandas")

    class Tensor:
        """As those of PyTorch and JAX, which know how to become numpy's."""

        def __init__(self, array: Any) -> None:
            self.array = array

        def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
            return self.array if dtype is None else self.array.astype(dtype)

    rig, mesh = face.rig, face.rig.mesh
    shapes = dict(zip(rig.names, rig.deltas))
    rest = [rig.neutral + k * k * rig.deltas[0] for k in range(3)]
    for kind in (pandas.DataFrame, Tensor):
        assert Rig(kind(rig.neutral), {name: kind(d) for name, d in shapes.items()}) == Rig(rig.neutral, shapes)
        assert rig.transfer(kind(rest[1])) == rig.transfer(rest[1])
        assert rig.fit([kind(rest[1])])[0].weights == rig.fit([rest[1]])[0].weights
        assert Rig.pca([kind(r) for r in rest], 2) == Rig.pca(rest, 2)
        assert Mesh.of(kind(rig.neutral)) == Mesh(rig.neutral)
        assert nonrigid.evaluate(mesh, mesh, truth=kind(rest[1]))["rmse"] == nonrigid.evaluate(mesh, mesh, truth=rest[1])["rmse"]


def test_equal_rigs(face: data_gen.Face) -> None:
    rig, rest = face.rig, [face.rig.neutral + k * face.rig.deltas[0] for k in range(3)]
    parts = {"families": dict(zip(rig.names, rig.families)), "landmarks": rig.landmarks, "regions": rig.regions}
    shapes = dict(zip(rig.names, rig.deltas))
    assert rig == Rig(rig.mesh, shapes, **parts) == pickle.loads(pickle.dumps(rig)) == copy.deepcopy(rig)
    assert Rig.pca(rest, 1) == Rig.pca(rest, 1) != Rig.pca(rest, 2) and rig != 7
    moved = {**shapes, rig.names[3]: 2 * shapes[rig.names[3]]}
    for other in (
        Rig(rig.neutral, shapes, **parts),
        Rig(rig.mesh, moved, **parts),
        Rig(rig.mesh, dict(reversed(shapes.items())), **parts),
        Rig(rig.mesh, shapes, **{**parts, "families": "other"}),
        Rig(rig.mesh, shapes, **{**parts, "landmarks": None}),
        Rig(rig.mesh, shapes, **{**parts, "regions": {}}),
        Rig(rig.mesh, shapes, **{**parts, "regions": {name: r[1:] for name, r in rig.regions.items()}}),
    ):
        assert other != rig
    with pytest.raises(TypeError, match="unhashable"):
        {rig}


def test_files(face: data_gen.Face, data: Data, tmp_path: Path) -> None:
    rig = face.rig
    for path, options in [("a", {}), ("b.npz", {}), ("c.glb", {}), ("d", {"form": "shapes"})]:
        rig.write(tmp_path / path, **options)
        again = Rig.read(tmp_path / path)
        assert len(again.names) == len(rig.names) and np.allclose(again.neutral, rig.neutral, atol=1e-4), path
        assert again.mesh is not None and again.mesh.faces.shape[1] == 4
    assert same(Rig.read(tmp_path / "a"), rig)
    with pytest.raises(ValueError, match="give another folder"):
        Rig.read(tmp_path / "a").write(tmp_path / "a")
    with pytest.raises(FileNotFoundError):
        Rig.read(tmp_path / "none")
    assert len(Rig.read(data.rig, identity_modes=2).names) == 56
    for path in (data.rig, tmp_path / "b.npz"):
        with pytest.raises(ValueError, match="identity_modes: expected a whole number from 0"):
            Rig.read(path, identity_modes=-1)
    again = pickle.loads(pickle.dumps(rig))
    assert same(again, rig, 0) and again.mesh == rig.mesh and np.array_equal(again.landmarks, rig.landmarks)


def test_transfer_and_fit(face: data_gen.Face) -> None:
    rig = face.rig
    subject = rig.blend({"identity000": 1.5, "identity002": -1})
    mine = rig.transfer(subject)
    assert set(mine.families) == {"expression"} and np.array_equal(mine.neutral, subject.vertices)
    frames = [mine.blend({"jawOpen": w, "mouthSmile_L": 0.3}) for w in (0.2, 0.6)]
    fitted = mine.fit(frames)
    assert [abs(f.weights["jawOpen"] - w) < 0.02 for f, w in zip(fitted, (0.2, 0.6))] == [True, True]
    assert fitted[0].rms < 0.05 and fitted[0].converged and np.allclose(fitted[0].rotation, np.eye(3), atol=1e-3)
    assert mine.fit([frames[0].vertices.tolist()], neutral=mine.neutral.tolist())[0].weights == fitted[0].weights
    for options, words in [({"shapes": []}, "none to fit"), ({"bounds": (1, 0)}, "no weight lies between")]:
        with pytest.raises(ValueError, match=words):
            mine.fit(frames, **options)
    with pytest.raises(ValueError):
        mine.fit([frames[0].vertices[1:]])
    with pytest.raises(ValueError, match="neutral: vertex 0 is not finite"):
        mine.fit(frames, neutral=np.full_like(mine.neutral, np.nan))
    with pytest.raises(ValueError):
        rig.transfer(subject.vertices[::-1])


def test_pca(face: data_gen.Face, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    people = [face.rig.blend(dict(zip([f"identity{k:03}" for k in range(3)], random.normal(size=3)))) for _ in range(20)]
    rig = Rig.pca(people, 3)
    assert rig.explained is not None and rig.explained.sum() > 0.999 and rig.families == ["identity"] * 3
    assert rig.mesh is not None and np.array_equal(rig.mesh.faces, people[0].faces)
    for k, mesh in enumerate(people):
        mesh.write(tmp_path / f"{k:02}.ply")
    assert same(Rig.pca(tmp_path, 3), rig)
    assert same(Rig.pca([m.vertices for m in people], 3), rig, 0)
    assert pickle.loads(pickle.dumps(rig)).explained.tolist() == rig.explained.tolist()
    assert same(Rig.pca([m.vertices.tolist() for m in people], 3), rig, 0)
    for wrong in (20, 0, -1):
        with pytest.raises(ValueError):
            Rig.pca(people, wrong)
    with pytest.raises(ValueError, match="other polygons"):
        Rig.pca([people[0], Mesh(people[1].vertices, people[1].triangles)], 1)


def test_ict_facekit(tmp_path: Path) -> None:
    """A folder as ICT-FaceKit's: centimetres, the face first, then eyes and teeth."""
    columns, rows = 97, 97
    x, y = np.meshgrid(np.linspace(-9, 9, columns), np.linspace(-12, 12, rows))
    face = np.stack([x, y, 4 - 0.03 * (x**2 + y**2)], axis=-1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    quads = np.stack([corner, corner + 1, corner + columns + 1, corner + columns], axis=1)
    assert (len(face), len(quads)) == (9409, 9216)
    more = np.concatenate([quads, quads[:14, [0, 1, 2, 2]][:, :4]])  # 9,230 polygons
    more[9216:, 3] = quads[:14, 3]
    eye = np.array([[-3, 4, 3], [-2, 4, 3], [-2.5, 5, 3.5]])
    faces = [*more.tolist(), [9409, 9410, 9411]]
    folder = tmp_path / "ICT-FaceKit" / "FaceXModel"
    folder.mkdir(parents=True)

    def write(name: str, moved: np.ndarray) -> None:
        lines = [f"v {a} {b} {c}" for a, b, c in np.concatenate([face + moved, eye])]
        lines += ["f " + " ".join(str(v + 1) for v in f) for f in faces]
        (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")

    write("generic_neutral_mesh", np.zeros(3))
    write("jawOpen", np.where(y.reshape(-1, 1) < -5, [[0, -1.0, 0]], [[0, 0.0, 0]]))
    write("identity000", 0.05 * face)
    write("identity001", 0.02 * face[:, [1, 0, 2]])
    for path in (folder, folder.parent):
        rig = Rig.read(path, identity_modes=1)
        assert rig.names == ["jawOpen", "identity000"] and rig.families == ["expression", "identity"]
        assert np.allclose(rig.neutral, 10 * face, atol=1e-3) and rig.mesh is not None and rig.mesh.faces.shape == (9230, 4)
        assert np.isclose(rig.deltas[0].min(), -10) and rig.unit == "cm (as the file says)"
    everything = nonrigid.read_ict(folder, part="all")
    assert len(everything.neutral) == 9412 and len(everything.names) == 3


def flame() -> dict[str, np.ndarray]:
    random = np.random.default_rng(2)
    face = data_gen.Face(1000, 1).rig
    assert face.mesh is not None
    shapes = random.normal(size=(len(face.neutral), 3, 400)) * 1e-3
    return {"v_template": face.neutral / 1000, "shapedirs": shapes, "f": face.mesh.triangles.astype(np.uint32)}


def check_flame(rig: Rig, arrays: dict[str, np.ndarray]) -> None:
    assert rig.families == ["expression"] * 100 + ["identity"] * 300
    assert np.allclose(rig.neutral, 1000 * arrays["v_template"], atol=1e-9)
    assert np.allclose(rig.deltas[0], 1000 * arrays["shapedirs"][:, :, 300], atol=1e-4)
    assert rig.unit == pickle.loads(pickle.dumps(rig)).unit == "m (as the file says)"
    assert rig.mesh is not None and np.array_equal(rig.mesh.triangles, arrays["f"])


def test_flame_arrays_and_pickles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arrays = flame()
    np.savez(tmp_path / "flame.npz", **arrays, posedirs=np.zeros(3))
    check_flame(Rig.read(tmp_path / "flame.npz"), arrays)
    for protocol in (0, 2, pickle.HIGHEST_PROTOCOL):
        (tmp_path / "flame.pkl").write_bytes(pickle.dumps({**arrays, "kintree": [1, 2], "name": "flame"}, protocol=protocol))
        check_flame(Rig.read(tmp_path / "flame.pkl"), arrays)
    with pytest.raises(ValueError, match="shape_kind"):
        Rig.read(tmp_path / "flame.pkl", shape_kind="delta")
    few = nonrigid.read_flame(tmp_path / "flame.pkl", identity_modes=2, expressions=1)
    assert few.names == ["expression000", "identity000", "identity001"]

    for negative in ("identity_modes", "expressions", "identities"):
        with pytest.raises(ValueError, match=f"{negative}: expected a whole number from 0"):
            nonrigid.read_flame(tmp_path / "flame.pkl", **{negative: -1})

    # made smaller, or in millimetres
    np.savez(tmp_path / "small.npz", **{**arrays, "shapedirs": arrays["shapedirs"][:, :, :150]})
    with pytest.warns(nonrigid.NonrigidWarning, match="150 shapes where FLAME has 400"):
        assert Rig.read(tmp_path / "small.npz").families == ["identity"] * 150
    assert nonrigid.read_flame(tmp_path / "small.npz", identities=100).families == ["expression"] * 50 + ["identity"] * 100
    np.savez(tmp_path / "mm.npz", **{**arrays, "v_template": 1000 * arrays["v_template"], "shapedirs": 1000 * arrays["shapedirs"]})
    with pytest.raises(ValueError, match=r'm in size.*unit="mm"'):
        Rig.read(tmp_path / "mm.npz")
    assert np.allclose(nonrigid.read_flame(tmp_path / "mm.npz", unit="mm").neutral, 1000 * arrays["v_template"])

    # as chumpy and SciPy leave them in the files that are handed out; neither is asked
    chumpy = types.ModuleType("chumpy")
    ch = types.ModuleType("chumpy.ch")

    class Ch:
        def __init__(self, x: np.ndarray) -> None:
            self.x, self._dirty_vars, self._itr = x, set(), None

    Ch.__module__, Ch.__qualname__ = "chumpy.ch", "Ch"
    ch.Ch = Ch  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "chumpy", chumpy)
    monkeypatch.setitem(sys.modules, "chumpy.ch", ch)
    held = {"v_template": Ch(arrays["v_template"]), "shapedirs": Ch(arrays["shapedirs"]), "f": arrays["f"]}
    data = [pickle.dumps(held, protocol=p) for p in (0, 2, 4)]
    monkeypatch.delitem(sys.modules, "chumpy.ch")
    for text in data:
        (tmp_path / "chumpy.pkl").write_bytes(text)
        check_flame(Rig.read(tmp_path / "chumpy.pkl"), arrays)


class Evil:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        import os

        return os.system, (f"touch {self.mark}",)


def test_a_pickle_runs_nothing(tmp_path: Path) -> None:
    arrays = flame()
    mark = tmp_path / "has-run-code"
    for k, foreign in enumerate([Evil(mark), Path("a"), np.random.default_rng(1)]):
        (tmp_path / "evil.pkl").write_bytes(pickle.dumps({**arrays, "more": foreign}))
        with pytest.raises(ValueError, match="(?s)needs the class .*numpy.savez") as refused:
            Rig.read(tmp_path / "evil.pkl")
        assert ("posix.system", "pathlib", "numpy.random")[k] in str(refused.value).replace("nt.system", "posix.system")
    assert not mark.exists()
    (tmp_path / "half.pkl").write_bytes(pickle.dumps(arrays)[:1000])
    with pytest.raises(ValueError, match="no pickle"):
        Rig.read(tmp_path / "half.pkl")
    (tmp_path / "other.pkl").write_bytes(pickle.dumps({"v_template": arrays["v_template"]}))
    with pytest.raises(ValueError, match="no shapedirs, f"):
        Rig.read(tmp_path / "other.pkl")
    (tmp_path / "floats.pkl").write_bytes(pickle.dumps({**arrays, "f": arrays["f"].astype(np.float64)}))
    check_flame(Rig.read(tmp_path / "floats.pkl"), arrays)
    (tmp_path / "halves.pkl").write_bytes(pickle.dumps({**arrays, "f": arrays["f"] + 0.5}))
    with pytest.raises(TypeError, match="halves.pkl: f: expected whole numbers"):
        Rig.read(tmp_path / "halves.pkl")
    np.savez(tmp_path / "whole.npz", **arrays)
    (tmp_path / "half.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:-3000])
    with pytest.raises(ValueError, match="half.npz"):
        nonrigid.read_flame(tmp_path / "half.npz")


@pytest.mark.parametrize("basel", [False, True])
@pytest.mark.parametrize("scaled", [False, True])
def test_morphable_models(tmp_path: Path, basel: bool, scaled: bool) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    face = data_gen.Face(1000, 1).rig
    assert face.mesh is not None
    count = 3 * len(face.neutral)
    random = np.random.default_rng(3)
    bases = [np.linalg.qr(random.normal(size=(count, 5)))[0] for _ in range(2)]
    variances = [np.array([900.0, 400, 100, 50, 20]), np.array([100.0, 50, 20, 10, 5])]
    shift = random.normal(size=count)
    with h5py.File(tmp_path / "model.h5", "w") as file:
        for group, basis, variance, mean in zip(
            ("shape/", "expression/") if basel else ("",), bases, variances, (face.neutral.reshape(-1), shift)
        ):
            file[f"{group}model/mean"] = mean
            file[f"{group}model/pcaBasis"] = basis * np.sqrt(variance) if scaled else basis
            file[f"{group}model/pcaVariance"] = variance
            file[f"{group}representer/points"] = face.neutral.T
            file[f"{group}representer/cells"] = face.mesh.triangles.T.astype(np.int32)
    rig = Rig.read(tmp_path / "model.h5", identity_modes=4)
    assert rig.unit == "mm (by its size)" and Rig.read(tmp_path / "model.h5", unit="mm").unit == "mm (by unit)"
    expressions = 5 if basel else 0
    assert rig.families == ["expression"] * expressions + ["identity"] * 4
    neutral = face.neutral + (shift.reshape(-1, 3) if basel else 0)
    assert np.allclose(rig.neutral, neutral) and rig.mesh is not None and np.array_equal(rig.mesh.triangles, face.mesh.triangles)
    assert np.allclose(rig.deltas[expressions], 30 * bases[0][:, 0].reshape(-1, 3), atol=1e-5)
    if basel:
        assert Rig.read(tmp_path / "model.h5", identity_modes=0).families == ["expression"] * expressions
    with pytest.raises(ValueError, match="no model/mean"):
        with h5py.File(tmp_path / "empty.h5", "w") as file:
            file["a"] = [1]
        Rig.read(tmp_path / "empty.h5")
    (tmp_path / "text.h5").write_text("no model")
    with pytest.raises(ValueError, match="text.h5"):
        Rig.read(tmp_path / "text.h5")
