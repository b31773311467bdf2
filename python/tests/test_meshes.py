"""Meshes of arrays, files and other packages."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import numpy as np
import pytest
from conftest import Data

import nonrigid
from nonrigid import Mesh, data_gen

SQUARE = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [5, 15, 0]], dtype=np.float64)
TWO = [[0, 1, 2, 3], [3, 2, 4]]


def test_arrays_are_converted_and_never_misread() -> None:
    plain = Mesh(SQUARE, TWO)
    wide = np.zeros((5, 6))
    wide[:, ::2] = SQUARE
    for same in (SQUARE.astype(np.float32), SQUARE.astype(np.int16), wide[:, ::2], np.asfortranarray(SQUARE), SQUARE.tolist()):
        assert np.array_equal(Mesh(same, TWO).vertices, plain.vertices)
    assert plain.vertices.flags.c_contiguous and plain.vertices.dtype == np.float64
    plain.vertices[0] = 7
    assert np.array_equal(plain.vertices, SQUARE), "a mesh does not change"
    assert [f.tolist() for f in plain.faces] == TWO and plain.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
    assert Mesh(SQUARE, np.array([[0, 1, 2]], dtype=np.int64)).faces.shape == (1, 3)
    assert Mesh(SQUARE).faces.shape == (0, 3)
    assert np.allclose(Mesh(SQUARE, unit="cm").vertices, 10 * SQUARE)
    for vertices, faces, error in [
        (SQUARE.T, None, ValueError),
        (SQUARE.astype(complex), None, TypeError),
        (np.array(["a"]), None, TypeError),
        (SQUARE, [[0, 1, 5]], ValueError),
        (SQUARE, [[0, 1, -1]], ValueError),
        (SQUARE, [[0, 1]], ValueError),
        (SQUARE, [[0, 1], [0, 1, 2]], ValueError),
        (SQUARE, [[0.0, 1.0, 2.0]], TypeError),
        (SQUARE, 5, TypeError),
        (SQUARE, [0, 1, 2], TypeError),
    ]:
        with pytest.raises(error, match="vertices|faces"):
            Mesh(vertices, faces)
    with pytest.raises(ValueError, match="normals"):
        Mesh(SQUARE, normals=SQUARE[:2])
    with pytest.raises(ValueError, match="0 to 1"):
        Mesh(SQUARE, colors=SQUARE)
    assert Mesh(SQUARE, colors=np.full((5, 4), 0.5)).colors.tolist() == [[128] * 3] * 5


def test_tables_are_arrays() -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    assert Mesh(pandas.DataFrame(SQUARE, columns=list("xyz")), pandas.DataFrame([[0, 1, 2]])).faces.tolist() == [[0, 1, 2]]


def test_usd_is_opened_and_found_right_by_usd_itself(data: Data, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdShade, UsdValidation

    mesh = Mesh.read(data.template)
    mesh.write(tmp_path / "still.usda")
    for k in range(3):
        mesh.with_vertices(mesh.vertices + [k, 0, 0]).write(tmp_path / f"f{k}.obj")
    command = ["nonrigid", "animate", "--meshes", str(tmp_path), "--unit", "meshes=mm", "--out", str(tmp_path / "moves.usda")]
    assert nonrigid._nonrigid.command_line(command, "", []) == 0
    for name, frames in (("still.usda", 1), ("moves.usda", 3)):
        stage = Usd.Stage.Open(str(tmp_path / name))
        assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (0.001, "Y")
        surface = UsdGeom.Mesh(stage.GetPrimAtPath("/Subject/Surface"))
        for k in range(frames):
            points = np.array(surface.GetPointsAttr().Get(k if frames > 1 else Usd.TimeCode.Default()))
            assert np.abs(points - mesh.vertices - [k, 0, 0]).max() < 1e-4
        assert np.array_equal(np.array(surface.GetFaceVertexIndicesAttr().Get()), mesh.faces.ravel())
        texture = UsdGeom.PrimvarsAPI(surface).GetPrimvar("st")
        assert np.allclose(np.array(texture.ComputeFlattened()), mesh.uvs, atol=1e-6)
        names = [subset.GetPrim().GetDisplayName() for subset in UsdShade.MaterialBindingAPI(surface).GetMaterialBindSubsets()]
        lines = data.template.read_text().splitlines()
        assert set(names) == {line.removeprefix("usemtl ") for line in lines if line.startswith("usemtl ")}
        errors = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(stage)
        assert not errors, [error.GetMessage() for error in errors]


def test_files(data: Data, tmp_path: Path) -> None:
    mesh = Mesh.read(data.template)
    assert mesh.faces.shape[1] == 4 and mesh.uvs is not None and mesh.uvs.shape == (mesh.faces.size, 2) and mesh.groups
    for name in ("a.obj", "a.glb", "a.ply"):
        mesh.write(tmp_path / name)
        again = Mesh.read(tmp_path / name, unit="mm" if name != "a.glb" else "auto")
        assert np.allclose(again.vertices, mesh.vertices, atol=1e-4) and np.array_equal(again.faces, mesh.faces)
    assert (tmp_path / "a.obj").read_bytes() == data.template.read_bytes().replace(b"mtllib face.mtl", b"mtllib a.mtl")
    assert (tmp_path / "a.mtl").read_bytes() == (data.template.parent / "face.mtl").read_bytes()
    with pytest.raises(ValueError, match="would overwrite"):
        Mesh.read(tmp_path / "a.ply").write(tmp_path / "a.ply")
    with pytest.raises(ValueError, match="stl"):
        mesh.write(tmp_path / "a.stl")
    with pytest.raises(ValueError, match="no face is in"):
        Mesh(SQUARE / 1e6, TWO).write(tmp_path / "tiny.obj")
        Mesh.read(tmp_path / "tiny.obj")
    metres = Mesh(mesh.vertices / 1000, mesh.faces)
    metres.write(tmp_path / "metres.obj")
    assert np.allclose(Mesh.read(tmp_path / "metres.obj").vertices, mesh.vertices, atol=1e-6)
    assert Mesh.read(tmp_path / "metres.obj").unit == "m (by its size)"


def test_pickles_and_equality(data: Data) -> None:
    mesh = Mesh.read(data.template)
    again = pickle.loads(pickle.dumps(mesh))
    assert again == mesh and again.uvs is not None and list(again.groups) == list(mesh.groups)
    assert mesh.with_vertices(mesh.vertices + 1) != mesh and mesh != 3
    painted = Mesh(SQUARE, TWO, normals=SQUARE, colors=np.zeros((5, 3), dtype=np.uint8))
    assert pickle.loads(pickle.dumps(painted)) == painted


def test_copies_overwrite_no_more_than_the_mesh(data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Mesh.read(data.template).write(tmp_path / "face.obj")
    before = (tmp_path / "face.obj").read_bytes()
    monkeypatch.chdir(tmp_path)
    mesh = Mesh.read("face.obj")
    for again in (copy.copy(mesh), copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        assert again.unit == mesh.unit
        (tmp_path / "elsewhere").mkdir(exist_ok=True)
        monkeypatch.chdir(tmp_path / "elsewhere")
        for made in (again, again.with_vertices(again.vertices * 2)):
            with pytest.raises(ValueError, match="would overwrite"):
                made.write(tmp_path / "face.obj")
        again.write("copy.obj")
        assert Path("copy.mtl").read_bytes() == (tmp_path / "face.mtl").read_bytes()
    assert (tmp_path / "face.obj").read_bytes() == before


def test_libraries_that_are_nowhere_are_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("face.mtl").write_text("newmtl mine\n")
    mesh = data_gen.Face(1000, 1).rig.mesh
    assert mesh is not None
    mesh.write("a.obj")
    assert not Path("a.mtl").exists() and "mtllib" not in Path("a.obj").read_text()


def test_normals_of_a_cloud_are_written(tmp_path: Path) -> None:
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    cloud = Mesh(SQUARE, normals=normals)
    cloud.write(tmp_path / "cloud.ply")
    assert np.array_equal(Mesh.read(tmp_path / "cloud.ply", unit="mm").normals, normals)
    with pytest.warns(nonrigid.NonrigidWarning, match="no normals of a point cloud"):
        cloud.write(tmp_path / "cloud.obj")
    for name in ("n.ply", "n.obj"):
        with pytest.raises(ValueError, match="finite coordinates"):
            Mesh(SQUARE * np.nan, TWO).write(tmp_path / name)


def test_a_mesh_is_in_millimetres(tmp_path: Path) -> None:
    mesh = Mesh(SQUARE, TWO, unit="cm")
    assert Mesh.of(mesh, unit="cm") is mesh
    with pytest.raises(ValueError, match="unit"):
        Mesh.of(mesh, unit="furlong")


def test_masked_faces_are_refused() -> None:
    hidden = np.ma.array([0, 1, 2], mask=[0, 0, 1])
    for faces in ([hidden], [hidden, [0, 1, 2, 3]], np.ma.array([[0, 1, 2]], mask=[[0, 0, 1]])):
        with pytest.raises(ValueError, match="without a mask"):
            Mesh(SQUARE, faces)


def colored() -> Mesh:
    return Mesh(SQUARE, [[0, 1, 2], [0, 2, 3]], colors=np.arange(15, dtype=np.uint8).reshape(5, 3))


def test_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    mesh = colored()
    theirs = mesh.to_trimesh()
    assert Mesh.of(theirs) == mesh
    cloud = trimesh.PointCloud(SQUARE)
    assert np.array_equal(Mesh.of(cloud).vertices, SQUARE)
    assert np.array_equal(Mesh.of(Mesh(SQUARE).to_trimesh()).vertices, SQUARE)
    with pytest.raises(TypeError, match="scene"):
        Mesh.of(trimesh.Scene(theirs))


def test_pyvista() -> None:
    pyvista = pytest.importorskip("pyvista", reason="PyVista is not installed")
    mesh = colored()
    assert Mesh.of(mesh.to_pyvista()) == mesh
    polygons = Mesh(SQUARE, TWO)
    assert Mesh.of(polygons.to_pyvista()) == polygons
    assert np.array_equal(Mesh.of(pyvista.PolyData(SQUARE)).vertices, SQUARE)
    ball = pyvista.Sphere().compute_normals(cell_normals=False)
    assert Mesh.of(ball).normals is not None
    assert len(Mesh.of(pyvista.Sphere().strip()).triangles) == pyvista.Sphere().n_cells
    assert Mesh.of(pyvista.PointSet(SQUARE)) == Mesh(SQUARE)
    grid = pyvista.ImageData(dimensions=(2, 2, 2)).cast_to_unstructured_grid()
    assert len(Mesh.of(grid).faces) == 6


def test_meshio() -> None:
    meshio = pytest.importorskip("meshio", reason="meshio is not installed")
    theirs = meshio.Mesh(SQUARE, [("quad", [[0, 1, 2, 3]]), ("triangle", [[3, 2, 4]]), ("line", [[0, 1]])])
    assert Mesh.of(theirs) == Mesh(SQUARE, TWO)
    with pytest.raises(TypeError, match="tetra"):
        Mesh.of(meshio.Mesh(SQUARE, [("tetra", [[0, 1, 2, 3]])]))


def test_open3d() -> None:
    o3d = pytest.importorskip("open3d", reason="Open3D is not installed, or not what it loads", exc_type=ImportError)
    theirs = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(SQUARE), o3d.utility.Vector3iVector([[0, 1, 2], [0, 2, 3]]))
    theirs.compute_vertex_normals()
    ours = Mesh.of(theirs)
    assert ours.faces.tolist() == [[0, 1, 2], [0, 2, 3]] and ours.normals is not None
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(SQUARE))
    assert np.array_equal(Mesh.of(cloud).vertices, SQUARE) and Mesh.of(cloud).normals is None
    tensors = o3d.t.geometry.TriangleMesh.from_legacy(theirs)
    assert np.allclose(Mesh.of(tensors).vertices, SQUARE)


def test_like_a_mesh() -> None:
    class Theirs:
        vertices = SQUARE
        faces = np.array([[0, 1, 2]])

    assert Mesh.of(Theirs()).faces.tolist() == [[0, 1, 2]]
    assert Mesh.of((SQUARE, TWO)) == Mesh(SQUARE, TWO)
    with pytest.raises(TypeError, match="no mesh that is known"):
        Mesh.of(7)


def test_a_scan_of_another_package_is_registered(data: Data) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    theirs = trimesh.load(data.scan(), process=False)
    a = nonrigid.register(data.template, theirs, landmarks=data.landmarks(), model="rigid")
    b = nonrigid.register(data.template, data.scan(), landmarks=data.landmarks(), model="rigid")
    assert np.abs(a.positions - b.positions).max() < 1e-3, "trimesh reads 64 bits as 32"
