"""Writes arap_libigl.json: energies of as-rigid-as-possible deformations by libigl (pip install libigl numpy scipy), for
tests/arap_reference.rs, which builds the same mesh.

ARAP_ENERGY_TYPE_SPOKES on a bumpy, bent, uneven sheet of 32 x 32 vertices with obtuse triangles, cotangents not clamped. The first
row is held where it is, the last one turned by 75 degrees and shifted; everything else starts at rest. Energies are
sum_i sum_(j in N(i)) w_ij |(v_i - v_j) - R_i (n_i - n_j)|^2, w_ij = (cot alpha + cot beta) / 2, with the best rotations, in double
precision. libigl itself fits rotations by an approximate single-precision decomposition on x86, which puts its intermediate energies
up to 2.5e-4 off and its last one 1e-7, so the alternation is done a second time, in double precision.
"""

import json
import pathlib

import igl
import numpy as np
import scipy.sparse.linalg

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


def spokes(rest, f):
    """Ends and weights of all directed edges."""
    weights = igl.cotmatrix(rest, f).tocoo()
    off = weights.row != weights.col
    return weights.row[off], weights.col[off], weights.data[off]


def best_rotations(rest, v, f):
    i, j, w = spokes(rest, f)
    a = np.zeros((len(v), 3, 3))
    np.add.at(a, i, w[:, None, None] * (v[i] - v[j])[:, :, None] * (rest[i] - rest[j])[:, None, :])
    u, _, vt = np.linalg.svd(a)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt


def energy(rest, v, f):
    i, j, w = spokes(rest, f)
    residual = v[i] - v[j] - np.einsum("kab,kb->ka", best_rotations(rest, v, f)[i], rest[i] - rest[j])
    return float((w * (residual**2).sum(axis=1)).sum())


def alternate(rest, f, b, bc, iterations):
    """The same alternation in double precision: positions after each iteration."""
    i, j, w = spokes(rest, f)
    laplacian = -igl.cotmatrix(rest, f).tocsr()
    free = np.setdiff1d(np.arange(len(rest)), b)
    solve = scipy.sparse.linalg.factorized(laplacian[free][:, free].tocsc())
    v = rest.copy()
    v[b] = bc
    for _ in range(iterations):
        r = best_rotations(rest, v, f)
        right = np.zeros_like(rest)
        turned = np.einsum("kab,kb->ka", r[i] + r[j], rest[i] - rest[j])
        np.add.at(right, i, 0.5 * w[:, None] * turned)
        right = right[free] - laplacian[free][:, b] @ bc
        v[free] = np.column_stack([solve(right[:, k]) for k in range(3)])
        yield v


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
        after[k] = energy(v, u, f)
        print(k, after[k], np.abs(u[b] - bc).max())
    data.max_iter = 100
    settled = abs(energy(v, igl.arap_solve(bc, data, u), f) / after[CONVERGED] - 1.0)
    print("relative change over 100 iterations more:", settled)
    assert settled < 1e-9
    double = {}
    for k, u in enumerate(alternate(v, f, b, bc, ITERATIONS[-1]), 1):
        if k in ITERATIONS:
            double[k] = energy(v, u, f)
            print(k, double[k], "libigl relative to it:", after[k] / double[k] - 1.0)
    result = {
        "libigl": "2.6.3",
        "vertices": len(v),
        "least_weight": float(spokes(v, f)[2].min()),
        "start": energy(v, start, f),
        "after": [{"steps": k, "libigl": after[k], "double": double[k]} for k in ITERATIONS],
        "converged": after[CONVERGED],
    }
    path = pathlib.Path(__file__).with_suffix(".json")
    path.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
