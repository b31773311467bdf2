"""What a task costs: many tiny scans (1,000 vertices, rigid) with Dask, in tasks of several sizes.

    python benchmarks/chunking.py [--scans 10000] [--chunks 1,8,32,128] [--workers 2]

Prints a line for each size: seconds, core-seconds of all processes (which other work on the machine changes least), scans per core-minute,
memory of this process, which is the scheduler's as well, files and bytes of the results.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from distributed import Client, LocalCluster

import nonrigid
import nonrigid.batch
from nonrigid import data_gen


def write_scans(folder: Path, scans: int, files: int) -> Path:
    """A manifest of so many scans, in fewer files."""
    face = data_gen.Face(1000, 1)
    mesh = face.rig.mesh
    assert mesh is not None
    mesh.write(folder / "template.obj")
    random = np.random.default_rng(7)
    marks = [0, 100, 300, 500, 700, 900]
    for k in range(files):
        moved = mesh.vertices + random.normal(scale=5, size=3) + random.normal(scale=0.1, size=mesh.vertices.shape)
        nonrigid.Mesh(moved, mesh.triangles).write(folder / f"scan{k}.ply")
        places = ", ".join(f'"{v}": [{", ".join(repr(float(x)) for x in moved[v])}]' for v in marks)
        (folder / f"scan{k}.json").write_text("{" + places + "}")
    lines = [f"scan{k % files}.ply,scan{k % files}.json,s{k:06}" for k in range(scans)]
    (folder / "scans.csv").write_text("\n".join(["target,landmarks,name", *lines]) + "\n")
    return folder / "scans.csv"


def own_seconds() -> float:
    """Core-seconds of this process and of those that it has ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def core_seconds(client: Client) -> float:
    """Of this process, which is the scheduler's as well, and of the workers and what they ran."""
    return own_seconds() + sum(client.run(own_seconds).values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=10_000)
    parser.add_argument("--chunks", default="1,8,32,128")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="chunking-"))
    listed = write_scans(folder, arguments.scans, min(arguments.scans, 500))
    try:
        with LocalCluster(n_workers=arguments.workers, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
            for chunk in map(int, arguments.chunks.split(",")):
                out, clock, used = folder / f"out{chunk}", time.monotonic(), core_seconds(client)
                first: list[float] = []

                def see(row: object, first: list[float] = first, clock: float = clock) -> None:
                    if not first:
                        first.append(time.monotonic() - clock)

                batch = nonrigid.batch.run(listed, out, scheduler=client, chunk=chunk, template=folder / "template.obj", model="rigid", callback=see)
                seconds = time.monotonic() - clock
                files = [p for p in out.rglob("*") if p.is_file()]
                size = sum(p.stat().st_size for p in files)
                memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                used, again, used_again = core_seconds(client) - used, time.monotonic(), core_seconds(client)
                nonrigid.batch.run(listed, out, scheduler=client, chunk=chunk, template=folder / "template.obj", model="rigid")
                print(
                    f"chunk {chunk}: {seconds:.1f} s, {used:.1f} core-seconds, first result after {first[0]:.1f} s, {batch.scans_per_core_minute:.0f} scans per core-minute, "
                    f"{len(batch.failed)} failed, {len(files) / arguments.scans:.2f} files and {size / arguments.scans:.0f} bytes a scan, this process "
                    f"{memory:.0f} MB; finding all done {time.monotonic() - again:.1f} s, {core_seconds(client) - used_again:.1f} core-seconds",
                    flush=True,
                )
                shutil.rmtree(out)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
