"""Batches on this machine: the same files as the command line's, and what is done is not done again."""

from __future__ import annotations

import concurrent.futures
import csv
import multiprocessing
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, Data, listing, manifest, results

import nonrigid.batch


def by_command_line(program: Path, data: Data, listed: Path, out: Path) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([program, "batch", listed, "--out", out, "--template", data.template], capture_output=True)


def test_same_files_as_the_command_line(data: Data, program: Path, tmp_path: Path) -> None:
    listed = manifest(data, tmp_path / "scans.csv", 5)
    assert by_command_line(program, data, listed, tmp_path / "a").returncode == 2, "one scan is missing"
    seen = []
    batch = nonrigid.batch.run(listed, tmp_path / "b", template=data.template, callback=seen.append)
    assert results(tmp_path / "a") == results(tmp_path / "b")
    assert listing(tmp_path / "a") == listing(tmp_path / "b") >= {"scan0.timing.json", "summary.timing.json", "log/scan0.txt"}
    assert [row["name"] for row in batch.failed] == ["broken"] and "missing.ply" in batch.failed[0]["note"]
    assert sorted(row["name"] for row in seen) == sorted(row["name"] for row in batch.rows)
    assert batch.rows[3]["start"] in ("warm", "cold again"), "frames go on from the one before"
    assert (batch.ran, batch.before) == (6, 0) and "1 failed" in repr(batch)

    # each takes what the other has done for done
    again = nonrigid.batch.run(listed, tmp_path / "a", template=data.template)
    assert (again.ran, again.before) == (1, 5) and results(tmp_path / "a") == results(tmp_path / "b")
    ended = by_command_line(program, data, listed, tmp_path / "b")
    assert b"5 were done before" in ended.stdout
    assert listing(tmp_path / "a") == listing(tmp_path / "b")
    # options that decide the result do
    nonrigid.batch.run(listed, tmp_path / "b", template=data.template, format="ply")
    assert not (tmp_path / "b" / "scan0.obj").exists() and (tmp_path / "b" / "scan0.ply").exists()
    with open(tmp_path / "b" / "summary.csv") as file:
        assert [row["name"] for row in csv.DictReader(file)] == [row["name"] for row in batch.rows]
    assert batch.rows[-1] == batch.rows[5] and batch.rows[4:] == list(batch.rows)[4:] and len(batch.rows[::2]) == 3
    assert pickle.loads(pickle.dumps(batch)) == batch


def test_an_executor(data: Data, tmp_path: Path) -> None:
    listed = manifest(data, tmp_path / "scans.csv", 4, broken=False)
    nonrigid.batch.run(listed, tmp_path / "a", template=data.template)
    with concurrent.futures.ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        batch = nonrigid.batch.run(listed, tmp_path / "b", template=data.template, scheduler=pool, chunk=1)
    assert not batch.failed and results(tmp_path / "a") == results(tmp_path / "b")


def test_a_worker_that_is_killed_leaves_no_folder(data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = manifest(data, tmp_path / "scans.csv", 1, broken=False)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    there: list[Path] = []
    real = nonrigid.batch._nonrigid.batch_run

    def killed(*arguments: Any) -> Any:
        there.extend(scratch.iterdir())
        return real(*arguments)

    monkeypatch.setattr(nonrigid.batch._nonrigid, "batch_run", killed)
    assert not nonrigid.batch.run(listed, tmp_path / "out", template=data.template).failed
    assert not there


def test_tasks_are_made_when_they_are_needed(data: Data, tmp_path: Path) -> None:
    waiting: list[int] = []

    class Counting(concurrent.futures.ThreadPoolExecutor):
        def submit(self, *arguments: Any, **options: Any) -> Any:
            waiting.append(self._work_queue.qsize())
            return super().submit(*arguments, **options)

    # there is no such model: every scan fails at once
    lines = ["target,name", *(f"none{k}.ply,s{k}" for k in range(400))]
    (tmp_path / "scans.csv").write_text("\n".join(lines))
    with Counting(2) as pool:
        batch = nonrigid.batch.run(tmp_path / "scans.csv", tmp_path / "out", template=data.template, model="none", scheduler=pool, chunk=1)
    assert len(waiting) == 400 and max(waiting) <= 4 * 2 + 64
    assert [row["name"] for row in batch.failed] == [f"s{k}" for k in range(400)]


def test_who_distributes_holds_little(tmp_path: Path) -> None:
    program = ROOT / "python" / "benchmarks" / "planning.py"
    if not program.exists():
        pytest.skip("the benchmarks are not here")

    def peak(rows: int) -> float:
        said = subprocess.run([sys.executable, program, "--rows", str(rows)], capture_output=True, text=True, check=True).stdout
        return float(said.split("memory of this process ")[1].split()[0]) * 1e6

    few, many = 1000, 41_000
    assert (peak(many) - peak(few)) / (many - few) < 1500, "bytes a row"


def test_nothing_of_anybody_is_overwritten(data: Data, tmp_path: Path) -> None:
    listed = manifest(data, tmp_path / "scans.csv", 1, broken=False)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "scan0.obj").write_text("mine")
    with pytest.raises(ValueError, match="no record of an earlier batch lists it"):
        nonrigid.batch.run(listed, tmp_path / "out", template=data.template)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["scan0.obj"]
    (tmp_path / "summary.csv").write_text(listed.read_text())
    with pytest.raises(ValueError, match="would overwrite"):
        nonrigid.batch.run(tmp_path / "summary.csv", tmp_path, template=data.template)


def test_one_batch_at_a_time(data: Data, program: Path, tmp_path: Path) -> None:
    listed = manifest(data, tmp_path / "scans.csv", 2, broken=False)
    codes = []

    def meanwhile(row: object) -> None:
        codes.append(by_command_line(program, data, listed, tmp_path / "out"))
        with pytest.raises(nonrigid.ComputationError, match="another batch writes here"):
            nonrigid.batch.run(listed, tmp_path / "out", template=data.template)

    nonrigid.batch.run(listed, tmp_path / "out", template=data.template, jobs=1, callback=meanwhile)
    assert codes[0].returncode == 3 and b"another batch writes here" in codes[0].stderr
    assert not list((tmp_path / "out" / ".nonrigid").glob("*.lock"))


def test_what_makes_no_sense(data: Data, tmp_path: Path) -> None:
    listed = manifest(data, tmp_path / "scans.csv", 1)
    run = lambda **options: nonrigid.batch.run(listed, tmp_path / "out", **{"template": data.template, **options})
    for options, error, words in [
        ({"tempate": 1}, TypeError, "did you mean 'template'"),
        ({"target": "a.ply"}, TypeError, "target"),
        ({"scheduler": 7}, TypeError, "Dask"),
        ({"format": "stl"}, ValueError, "obj, ply and glb"),
        ({"chunk": 0}, ValueError, "chunk"),
        ({"threads": 0}, ValueError, "threads"),
        ({"threads": 1.5}, TypeError, "threads: expected a whole number"),
        ({"fps": "fast"}, TypeError, "fps: expected a number"),
        ({"fps": 0.5}, ValueError, "fps: expected a number from 1 to 1000"),
        ({"pictures": "yes"}, TypeError, "pictures: expected True or False"),
        ({"jobs": 0}, ValueError, "jobs"),
        ({"jobs": -1}, ValueError, "jobs"),
        ({"scheduler": "slurm"}, TypeError, "scheduler"),
        ({"regions": {"lips": 1}}, TypeError, "regions"),
        ({"rig": "flame.pkl"}, ValueError, "write it once as a rig of ours"),
    ]:
        with pytest.raises(error, match=words):
            run(**options)
        assert not (tmp_path / "out").exists(), options
    assert nonrigid.batch._options({"unit": {"template_landmarks": "cm", "target": "m"}}, ["unit"], frozenset()) == [
        ("unit", "template-landmarks=cm,target=m")
    ]
    with pytest.raises(FileNotFoundError, match="none.csv"):
        nonrigid.batch.run(tmp_path / "none.csv", tmp_path / "out")
    # notes by the names of arguments, as they come and afterwards; files have those of the command line
    seen: list[dict[str, Any]] = []
    batch = run(identity_modes=3, callback=seen.append)
    assert len(batch.failed) == len(seen) == 2
    for row in (*batch.failed, *seen):
        assert row["note"].endswith("were not provided: rig"), row["note"]
    assert "--rig" in (tmp_path / "out" / "summary.csv").read_text()
