"""Writes nricp_trimesh.json: what trimesh's nricp_amberg makes of a closed surface, step by step.

    python nricp_trimesh.py            # needs numpy, scipy, trimesh

Surface, targets, weights and landmarks are formulas that tests/affine_reference.rs repeats. Correspondences are
given instead of sought: trimesh's search is replaced by a function that returns them, everything else is its own
code. Energies are computed here in double precision from its solution; trimesh itself rounds edge weights and
right-hand sides to single precision, so agreement ends at about 1e-7.
"""

import json
import pathlib

import numpy as np
import trimesh
from trimesh import registration

RINGS, SIDES = 20, 24
# ws (smoothness), wl (landmarks): trimesh squares both
STEPS = [(0.1, 3.0), (0.03, 1.0), (0.01, 0.5), (0.003, 0.0)]
GAMMA = 0.7
LANDMARKS = [0, 1, 100, 207, 333, 481]


def surface():
    """A sphere of RINGS x SIDES vertices and two poles, made uneven by a term that keeps its centroid: it is the
    same after half a turn about any axis, so the mean of the vertices and the centroid of the surface agree."""
    points, triangles = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)], []
    for r in range(RINGS):
        theta = np.pi * (r + 1) / (RINGS + 1)
        for s in range(SIDES):
            phi = 2 * np.pi * s / SIDES
            points.append((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)))
    at = lambda r, s: 2 + r * SIDES + s % SIDES
    for s in range(SIDES):
        triangles += [(0, at(0, s), at(0, s + 1)), (1, at(RINGS - 1, s + 1), at(RINGS - 1, s))]
        for r in range(RINGS - 1):
            triangles += [(at(r, s), at(r + 1, s), at(r + 1, s + 1)), (at(r, s), at(r + 1, s + 1), at(r, s + 1))]
    x, y, z = np.array(points).T
    bump = 1 + 0.3 * x * y * z
    return np.stack([80 * x * bump + 30, 60 * y * bump - 20, 50 * z * bump + 7], axis=1), np.array(triangles)


def targets(points, step):
    """Where each vertex belongs in a step, and whether that is believed."""
    i = np.arange(len(points))
    wave = np.stack([np.sin(0.05 * points[:, (a + 1) % 3] + a + step) for a in range(3)], axis=1)
    return points + 9 * wave, (7 * i + 3 * step) % 5 != 0


def landmark_targets(points):
    return targets(points, 0)[0][LANDMARKS] + np.array([2.0, -1.0, 3.0])


def main():
    points, triangles = surface()
    mesh = trimesh.Trimesh(points, triangles, process=False)
    assert np.abs(mesh.centroid - points.mean(axis=0)).max() < 1e-10 and mesh.is_winding_consistent
    centroid, scale = mesh.centroid.copy(), mesh.scale
    normal = lambda p: (p - centroid) / scale
    calls, solutions = [], []

    def correspondences(target, vertices, **_):
        nearest, believed = targets(points, len(calls))
        calls.append(vertices)
        return {"nearest": normal(nearest), "distances": np.where(believed, 0.0, np.inf)}

    solve = registration.sparse.linalg.spsolve

    def recorded(a, b):
        solutions.append(solve(a, b))
        return solutions[-1]

    registration._from_mesh = correspondences
    registration.sparse.linalg.spsolve = recorded
    records = registration.nricp_amberg(
        mesh.copy(), mesh.copy(), source_landmarks=np.array(LANDMARKS), target_positions=landmark_targets(points),
        steps=[(ws, wl, 0, 1) for ws, wl in STEPS], gamma=GAMMA, return_records=True)

    edges = mesh.edges
    lengths = np.linalg.norm(normal(points)[edges[:, 0]] - normal(points)[edges[:, 1]], axis=1)
    homogeneous = np.column_stack([normal(points), np.ones(len(points))])
    result = []
    for k, ((ws, wl), solution) in enumerate(zip(STEPS, solutions)):
        x = solution.toarray().reshape(-1, 4, 3)
        moved = np.einsum("ik,ika->ia", homogeneous, x)
        difference = (x[edges[:, 0]] - x[edges[:, 1]]) * np.array([1, 1, 1, GAMMA])[:, None] / lengths[:, None, None]
        nearest, believed = targets(points, k)
        data = ((moved - normal(nearest))[believed] ** 2).sum()
        landmarks = ((moved[LANDMARKS] - normal(landmark_targets(points))) ** 2).sum()
        vertices = moved * scale + centroid
        assert np.abs(vertices - records[k + 1]).max() < 1e-10, "trimesh's own record"
        result.append({
            "ws": ws, "wl": wl, "stiffness": ws**2 * (difference**2).sum(), "data": data,
            "landmarks": wl**2 * landmarks, "vertices": vertices.round(9).tolist(),
        })
    text = json.dumps({
        "trimesh": trimesh.__version__, "gamma": GAMMA, "scale": scale, "landmarks": LANDMARKS, "steps": result,
    })
    pathlib.Path(__file__).with_suffix(".json").write_text(text.replace('{"ws"', '\n{"ws"') + "\n")


main()
