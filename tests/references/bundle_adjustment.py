"""A small bundle adjustment in the format of https://grail.cs.washington.edu/projects/bal/, and its minimum by SciPy.

    python3 tests/references/bundle_adjustment.py      # numpy 2, scipy 1; writes bundle_adjustment.txt and .json beside itself

Five cameras in an arc before 40 points, pictures of half a pixel of noise (uniform), a start that is off. The energy is the sum of
squares of the differences in the pictures, without a factor 1/2. SciPy's trust-region reflective solver with exact derivatives by
complex steps, all tolerances at rounding; the seven directions of the gauge are left to it.
"""

import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

CAMERAS, POINTS = 5, 40


def project(cameras, points):
    r, t, f, k1, k2 = cameras[:, :3], cameras[:, 3:6], cameras[:, 6], cameras[:, 7], cameras[:, 8]
    s = (r * r).sum(1)[:, None]
    angle = np.sqrt(s)
    a, b = np.sin(angle) / angle, (1 - np.cos(angle)) / s
    v = points + a * np.cross(r, points) + b * np.cross(r, np.cross(r, points)) + t
    p = -v[:, :2] / v[:, 2:]
    square = (p * p).sum(1)
    return (f * (1 + k1 * square + k2 * square * square))[:, None] * p


def split(x):
    return x[: 9 * CAMERAS].reshape(-1, 9), x[9 * CAMERAS :].reshape(-1, 3)


rng = np.random.default_rng(3)
points = rng.uniform(-1, 1, (POINTS, 3))
cameras = np.array([[0.05, 0.25 * (k - 2), 0.02, 0.1, -0.1, -5, 800, -0.05, 0.01] for k in range(CAMERAS)])
camera, point = np.nonzero(rng.uniform(size=(CAMERAS, POINTS)) < 0.8)
seen = project(cameras[camera], points[point]) + rng.uniform(-0.5, 0.5, (len(camera), 2))
cameras += rng.uniform(-1, 1, cameras.shape) * [0.02, 0.02, 0.02, 0.1, 0.1, 0.1, 20, 0.02, 0.01]
points += rng.uniform(-0.05, 0.05, points.shape)
seen = seen.round(6)
start = np.concatenate([cameras.ravel(), points.ravel()]).round(9)

lines = [f"{CAMERAS} {POINTS} {len(camera)}"]
lines += [f"{c} {p}     {x:.6f} {y:.6f}" for c, p, (x, y) in zip(camera, point, seen)]
lines += [f"{v:.9f}" for v in start]
here = Path(__file__).parent
(here / "bundle_adjustment.txt").write_text("\n".join(lines) + "\n")


def residuals(x):
    cameras, points = split(x)
    return (project(cameras[camera], points[point]) - seen).ravel()


def jacobian(x):
    h = 1e-30
    columns = []
    for k in range(len(x)):
        z = x.astype(complex)
        z[k] += 1j * h
        columns.append(residuals(z).imag / h)
    return np.array(columns).T


ends = [
    least_squares(residuals, start, jac=jacobian, method=method, xtol=3e-16, ftol=3e-16, gtol=3e-16, max_nfev=2000, **scale)
    for method, scale in [("trf", {"x_scale": "jac"}), ("lm", {"x_scale": "jac"}), ("trf", {})]
]
energies = [2 * end.cost for end in ends]
print(energies, [np.abs(end.grad).max() for end in ends])
assert max(energies) / min(energies) - 1 < 1e-10
record = {"initial_energy": float((residuals(start) ** 2).sum()), "energy": min(energies)}
(here / "bundle_adjustment.json").write_text(json.dumps(record) + "\n")
