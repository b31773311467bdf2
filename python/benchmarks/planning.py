"""What distributing costs the process that does it: time and memory of a batch whose scans cost nothing.

    python benchmarks/planning.py [--rows 1000000] [--chunk 32]

Everything is real but the work: manifest, checks, lock, tasks, summary; an executor answers each task at once. Prints a line.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import nonrigid.batch

DONE = {"status": "done", "start": "cold", "probability": 0.0312, "inliers": 0.912, "near": 0.934, "median": 0.412, "flipped": 0, "note": ""}


class AtOnce(concurrent.futures.Executor):
    """Says of every scan that it is done."""

    tasks = 0

    def submit(self, work: Any, task: Any, /, *more: Any, **options: Any) -> concurrent.futures.Future[Any]:
        self.tasks += 1
        future: concurrent.futures.Future[Any] = concurrent.futures.Future()
        future.set_result([(k, json.dumps({"name": row[1], **DONE}), False, 1.0) for k, row in enumerate(task.rows)])
        return future


def peak() -> float:
    """Greatest memory of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--chunk", type=int, default=32)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="planning-") as folder:
        listed = Path(folder) / "scans.csv"
        with open(listed, "w") as file:
            file.write("target,landmarks,name\n")
            file.writelines(f"people/{k // 1000:04}/scan{k:07}.ply,people/{k // 1000:04}/scan{k:07}.json,s{k:07}\n" for k in range(arguments.rows))
        before, clock, engine = peak(), time.monotonic(), AtOnce()
        first: list[tuple[float, float]] = []

        def see(row: object) -> None:
            if not first:
                first.append((time.monotonic() - clock, peak()))

        batch = nonrigid.batch.run(
            listed, Path(folder) / "out", scheduler=engine, chunk=arguments.chunk, template=Path(folder) / "face.obj", identity_modes=40, callback=see
        )
        seconds, after = time.monotonic() - clock, peak()
        assert batch.ran == arguments.rows and not batch.before and len(batch.rows) == arguments.rows
    print(
        f"{arguments.rows} rows in {engine.tasks} tasks: {seconds:.1f} s, {first[0][0]:.1f} s of it before the first task; memory of this process "
        f"{after / 1e6:.0f} MB, {first[0][1] / 1e6:.0f} MB before the first task, {before / 1e6:.0f} MB before the batch"
    )


if __name__ == "__main__":
    main()
