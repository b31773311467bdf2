"""Writes arap_libigl.json: energies of as-rigid-as-possible deformations by libigl (pip install libigl numpy), for
tests/arap_reference.rs, which builds the same mesh.

ARAP_ENERGY_TYPE_SPOKES on a bumpy, bent, uneven sheet of 32 x 32 vertices with obtuse triangles, cotangents not clamped. The first
row is held where it is, the last one turned by 75 degrees and shifted; everything else starts at rest. Energies are
sum_i sum_(j in N(i)) w_ij |(v_i - v_j) - R_i (n_i - n_j)|^2, w_ij = (cot alpha + cot beta) / 2, with the best rotations, in double
precision. (libigl itself fits rotations in single precision on x86.)
"""

import json
import pathlib

import igl
import numpy as np

SIDE = 32
ITERATIONS = [1, 2, 5, 10, 30, 100]
CONVERGED = 6000


def sheet():
    positions, triangles = [], []
    for r in range(SIDE):
        for c in range(SIDE):
            x = c - 0.25 * r + 0.2 * np.sin(2.1 * c + 4.3 * r)
            y = r + 0.2 * np.sin(3.7 * c - 2.9 * r)
            z = 4.0 * np.sin(0.11 * c) + 0.3 * np.sin(1.3 * c + 0.4 * r) * np.cos(0.9 * r)
            positions.append([x, y, z])
    for r in range(SIDE - 1):
        for c in range(SIDE - 1):
            a, b = r * SIDE + c, r * SIDE + c + 1
            d, e = b + SIDE, a + SIDE
            triangles += [[a, b, d], [a, d, e]]
    return np.array(positions), np.array(triangles)


def handles(v):
    """Held vertices and where they are held."""
    first, last = np.arange(SIDE), np.arange(SIDE * (SIDE - 1), SIDE * SIDE)
    centre = v[last].mean(axis=0)
    angle = np.radians(75.0)
    c, s = np.cos(angle), np.sin(angle)
    about_y = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    turned = (v[last] - centre) @ about_y.T + centre + np.array([-6.0, -4.0, 5.0])
    return np.concatenate([first, last]), np.concatenate([v[first], turned])


def energy(rest, v, f):
    weights = igl.cotmatrix(rest, f).tocoo()
    off = weights.row != weights.col
    i, j, w = weights.row[off], weights.col[off], weights.data[off]
    n, e = rest[i] - rest[j], v[i] - v[j]
    a = np.zeros((len(v), 3, 3))
    np.add.at(a, i, w[:, None, None] * e[:, :, None] * n[:, None, :])
    u, _, vt = np.linalg.svd(a)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    residual = e - np.einsum("kab,kb->ka", rotation[i], n)
    return float((w * (residual**2).sum(axis=1)).sum()), float(w.min())


def main():
    v, f = sheet()
    b, bc = handles(v)
    data = igl.ARAPData()
    data.energy = igl.ARAPEnergyType.ARAP_ENERGY_TYPE_SPOKES
    data.max_iter = 1
    igl.arap_precomputation(v, f, 3, b.astype(np.int32), data)
    start = v.copy()
    start[b] = bc
    u, done, after = v.copy(), 0, {}
    for k in [*ITERATIONS, CONVERGED]:
        data.max_iter = k - done
        u = igl.arap_solve(bc, data, u)
        done = k
        after[k] = energy(v, u, f)[0]
        print(k, after[k], np.abs(u[b] - bc).max())
    data.max_iter = 100
    settled = abs(energy(v, igl.arap_solve(bc, data, u), f)[0] / after[CONVERGED] - 1.0)
    print("relative change over 100 iterations more:", settled)
    assert settled < 1e-9
    result = {
        "libigl": "2.6.3",
        "vertices": len(v),
        "least_weight": energy(v, v, f)[1],
        "start": energy(v, start, f)[0],
        "after": [[k, after[k]] for k in ITERATIONS],
        "converged": after[CONVERGED],
    }
    path = pathlib.Path(__file__).with_suffix(".json")
    path.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
