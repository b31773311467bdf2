"""Registers one case with another program, as its users would: `experiments peers` runs this once a method and case.

    peers.py METHOD CASE.npz RESULT.npy

CASE.npz, written by `experiments peers` (millimetres, the scan's frame): `rest` (N, 3), the template laid on the scan by its
landmarks; `triangles`; `scan` (M, 3); `scan_triangles`; `landmark_vertices` (L) and `landmark_points` (L, 3); `shapes` (K, N, 3),
the rig's deltas, turned as `rest` is; `threads`. Writes the vertices (N, 3) and prints one line of JSON: seconds of the call alone,
without imports and files, and the greatest memory of the process. Every method has what it can use of the same information.
"""

import json
import resource
import sys
import time

import numpy as np

# Pyramids, kernels and stiffnesses are the libraries' defaults; those that expect a size of their own get it.
SCIPY_ROUNDS = 15
HUBER = 0.5  # mm
PRIOR = 3.0  # against one square millimetre a vertex
ARAP_ITERATIONS = 100


class Case:
    def __init__(self, path):
        data = np.load(path)
        for name in data.files:
            setattr(self, name, data[name])
        self.centre = self.rest.mean(0)
        self.scale = 1.0 / np.linalg.norm(np.ptp(self.rest, axis=0))

    def to_unit(self, points):
        """Centred, the template's diagonal 1."""
        return (points - self.centre) * self.scale

    def from_unit(self, points):
        return np.asarray(points) / self.scale + self.centre


def open3d_icp(case):
    """Rigid, point to plane with Tukey's loss."""
    import open3d

    registration, utility = open3d.pipelines.registration, open3d.utility
    scan = open3d.geometry.TriangleMesh(
        utility.Vector3dVector(case.scan), utility.Vector3iVector(case.scan_triangles.astype(np.int32))
    )
    scan.compute_vertex_normals()

    def run():
        source = open3d.geometry.PointCloud(utility.Vector3dVector(case.rest))
        target = open3d.geometry.PointCloud(scan.vertices)
        target.normals = scan.vertex_normals
        plane = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(5.0))
        criteria = registration.ICPConvergenceCriteria(max_iteration=100)
        found = registration.registration_icp(source, target, 20.0, np.eye(4), plane, criteria).transformation
        return case.rest @ found[:3, :3].T + found[:3, 3]

    return run


def trimesh_nicp(case, method):
    import trimesh
    import trimesh.registration

    source = trimesh.Trimesh(case.to_unit(case.rest), case.triangles, process=False)
    target = trimesh.Trimesh(case.to_unit(case.scan), case.scan_triangles, process=False)
    points = case.to_unit(case.landmark_points)
    call = getattr(trimesh.registration, method)
    return lambda: case.from_unit(call(source, target, source_landmarks=case.landmark_vertices, target_positions=points))


def trimesh_amberg(case):
    """Optimal-step N-ICP (Amberg et al. 2007), with the landmarks."""
    return trimesh_nicp(case, "nricp_amberg")


def trimesh_sumner(case):
    """N-ICP after Sumner and Popovic 2004, with the landmarks."""
    return trimesh_nicp(case, "nricp_sumner")


def meshmonk(case):
    """Visco-elastic registration (White et al. 2019); it takes no landmarks but for the start. Its defaults are for faces in mm."""
    import meshmonk as library
    import trimesh

    floating = trimesh.Trimesh(case.rest, case.triangles, process=False)
    target = trimesh.Trimesh(case.scan, case.scan_triangles, process=False)
    return lambda: np.array(library.nonrigid_register(floating=floating, target=target).aligned_vertices)


def libigl_arap(case):
    """As-rigid-as-possible deformation with the landmarks as handles: no correspondences with the scan."""
    import igl

    vertices, faces = case.rest.astype(float), case.triangles.astype(np.int64)
    handles, first = np.unique(case.landmark_vertices, return_index=True)
    places = case.landmark_points[first].copy()

    def run():
        if hasattr(igl, "ARAPData"):
            data = igl.ARAPData()
            data.max_iter = ARAP_ITERATIONS
            igl.arap_precomputation(vertices, faces, 3, handles.astype(np.int32), data)
            return np.array(igl.arap_solve(places, data, vertices.copy()))
        model, found = igl.ARAP(vertices, faces, 3, handles.astype(np.int32)), vertices.copy()
        for _ in range(ARAP_ITERATIONS // 10):
            found = model.solve(places, found)
        return found

    return run


def vertex_normals(points, triangles):
    corners = points[triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def scipy_map(case):
    """Weights and pose as users of linear head models fit them: closest points, point to plane, robust least squares with a prior."""
    from scipy.optimize import least_squares
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    count, vertices = len(case.shapes), len(case.rest)
    basis = case.shapes.reshape(count, 3 * vertices).T
    normals = vertex_normals(case.scan, case.scan_triangles)
    tree = cKDTree(case.scan)
    marks, points = case.landmark_vertices, case.landmark_points

    def place(x):
        turn = Rotation.from_rotvec(x[:3]).as_matrix()
        blend = case.rest + (basis @ x[6:]).reshape(vertices, 3) - case.centre
        return turn, blend, blend @ turn.T + case.centre + x[3:6]

    def run():
        x = np.zeros(6 + count)
        for rounds in range(SCIPY_ROUNDS):
            _, _, now = place(x)
            distance, nearest = tree.query(now, distance_upper_bound=25.0 if rounds < 5 else 8.0)
            found = np.flatnonzero(np.isfinite(distance))
            alike = (vertex_normals(now, case.triangles)[found] * normals[nearest[found]]).sum(1) > 0.5
            found = found[alike]
            if rounds == 0:
                found = found[:0]  # the landmarks alone
            target, normal = case.scan[nearest[found]], normals[nearest[found]]
            off = np.abs(((now[found] - target) * normal).sum(1))
            trust = np.sqrt(np.minimum(1.0, HUBER / np.maximum(off, 1e-9)))[:, None]

            def residuals(x):
                _, _, now = place(x)
                plane = trust[:, 0] * ((now[found] - target) * normal).sum(1)
                return np.concatenate([plane, (now[marks] - points).ravel(), np.sqrt(PRIOR) * x[6:]])

            def jacobian(x):
                turn, blend, _ = place(x)
                turned = blend @ turn.T
                # The rotation vector is small: its left Jacobian is taken as the identity.
                local = trust * (normal @ turn)
                shapes = np.einsum("ni,nik->nk", local, basis.reshape(vertices, 3, count)[found], optimize=True)
                plane = np.hstack([np.cross(turned[found], trust * normal), trust * normal, shapes])
                rows = []
                for axis in range(3):
                    unit = np.broadcast_to(np.eye(3)[axis], (len(marks), 3))
                    of_shapes = np.einsum("i,nik->nk", turn[axis], basis.reshape(vertices, 3, count)[marks])
                    rows.append(np.hstack([np.cross(turned[marks], unit), unit, of_shapes]))
                landmarks = np.stack(rows, axis=1).reshape(-1, 6 + count)
                prior = np.hstack([np.zeros((count, 6)), np.sqrt(PRIOR) * np.eye(count)])
                return np.concatenate([plane, landmarks, prior])

            x = least_squares(residuals, x, jac=jacobian, max_nfev=3).x
        return place(x)[2]

    return run


METHODS = {
    "open3d-icp": open3d_icp,
    "trimesh-amberg": trimesh_amberg,
    "trimesh-sumner": trimesh_sumner,
    "meshmonk": meshmonk,
    "libigl-arap": libigl_arap,
    "scipy-map": scipy_map,
}


def main():
    method, case, result = sys.argv[1:4]
    np.random.seed(7)
    try:
        run = METHODS[method](Case(case))
    except ImportError as missing:
        sys.exit(f"not installed: {missing}")
    start = time.perf_counter()
    vertices = np.asarray(run(), dtype=float)
    seconds = time.perf_counter() - start
    np.save(result, vertices)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak *= 1 if sys.platform == "darwin" else 1024
    print(json.dumps({"seconds": seconds, "peak_bytes": peak}))


if __name__ == "__main__":
    main()
