"""Many scans: the manifest that `nonrigid batch` reads, on engines that distribute work already.

`run` makes the same files as `nonrigid batch`, byte for byte but for times and logs, and does not do again what is done: jobs, keys, resume
rule and lock are the library's own. Each scan is a process of its own, so that no failure of one reaches another. Who has more scans
than one machine can take gives a Dask client, Ray, or any `concurrent.futures.Executor`; inputs and results may be URLs of fsspec.

    import nonrigid.batch
    from distributed import Client

    nonrigid.batch.run("scans.csv", "wrapped", scheduler=Client("tcp://scheduler:8786"), template="face.obj", rig="rig")
"""

from __future__ import annotations

import collections
import concurrent.futures
import contextlib
import difflib
import hashlib
import itertools
import json
import math
import os
import re
import shutil
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

import numpy as np

from . import _nonrigid
from ._field import reader_of
from ._mesh import PathLike, count, count_or_none
from ._program import how

__all__ = ["Batch", "run"]

Row: TypeAlias = "tuple[int, str, str | None, list[tuple[str, str]]]"
"""Line of the manifest, name, sequence, options."""
Done: TypeAlias = "tuple[int, str, bool, float]"
"""Number of the row, its row of the summary (JSON), whether it was done before, seconds."""

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_WHOLE_WRITES = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "memory"}
"""Protocols whose files appear when they are whole."""


def _url(text: str) -> str | None:
    """A text that is a URL."""
    return text if _URL.match(text) else None


def _local(path: str) -> str:
    """A path without file://."""
    return path[len("file://") :] if path.startswith("file://") else path


def _filesystem(url: str, storage: Mapping[str, Mapping[str, Any]]) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise ImportError(f"{url}: URLs are read and written by fsspec; pip install nonrigid[fsspec]") from None
    protocol = url.split("://", 1)[0]
    fs, path = fsspec.core.url_to_fs(url, **storage.get(protocol, {}))
    return fs, path


@dataclass(frozen=True)
class _Task:
    """A few scans, for one worker; `chains` are indices into `rows`."""

    rows: list[Row]
    chains: list[list[int]]
    setting: dict[str, Any]
    paths: frozenset[str]
    run: str
    aside: str | None
    storage: Mapping[str, Mapping[str, Any]]


_kept: collections.OrderedDict[str, tempfile.TemporaryDirectory[str]] = collections.OrderedDict()
_keeping = threading.Lock()


def _shared(run: str) -> str:
    """This process's folder for what all scans of a run need."""
    if run not in _kept:
        _kept[run] = tempfile.TemporaryDirectory(prefix="nonrigid-", ignore_cleanup_errors=True)
        while len(_kept) > 4:
            _kept.popitem(last=False)
    return _kept[run].name


def _fetch(url: str, folder: str, storage: Mapping[str, Mapping[str, Any]]) -> str:
    """A copy of a file or folder, of the same name. What is not there is not there either: reading it says so."""
    fs, path = _filesystem(url, storage)
    inside = os.path.join(folder, hashlib.sha256(url.encode()).hexdigest()[:16])
    target = os.path.join(inside, PurePosixPath(path).name)
    if os.path.exists(target):
        return target
    part = f"{inside}-{uuid.uuid4().hex}"
    os.makedirs(part)
    try:
        if fs.isdir(path):
            fs.get(path.rstrip("/") + "/", os.path.join(part, PurePosixPath(path).name) + os.sep, recursive=True)
        else:
            fs.get_file(path, os.path.join(part, PurePosixPath(path).name))
            _fetch_named(fs, path, os.path.join(part, PurePosixPath(path).name))
    except FileNotFoundError:
        pass
    try:
        os.rename(part, inside)
    except OSError:  # another thread was faster
        shutil.rmtree(part, ignore_errors=True)
    return target


def _fetch_named(fs: Any, path: str, copy: str) -> None:
    """What a mesh names: buffers, material libraries, images. What is in another folder, or not there, reading says."""
    tried: set[str] = set()
    # a library names images
    while wanted := set(_nonrigid.missing_files(copy)) - tried:
        tried |= wanted
        for name in sorted(wanted):
            named = PurePosixPath(os.path.relpath(name, os.path.dirname(copy)).replace("\\", "/"))
            for inside in dict.fromkeys((named, PurePosixPath(named.name))):
                at = str(PurePosixPath(path).parent / inside)
                tiles = "<UDIM>" in at
                found = fs.glob(at.replace("<UDIM>", "[0-9]" * 4)) if tiles else [at] * fs.isfile(at)
                if ".." in inside.parts or not found:
                    continue
                folder = os.path.join(os.path.dirname(copy), *inside.parent.parts)
                os.makedirs(folder, exist_ok=True)
                for file in found:
                    fs.get_file(file, os.path.join(folder, PurePosixPath(file).name))
                break


class _Fetched:
    """Local names of URLs."""

    def __init__(self, task: _Task) -> None:
        self.task = task
        self.names: dict[str, str] = {}

    def options(self, options: list[tuple[str, str]], folder: str) -> list[tuple[str, str]]:
        local = []
        for option, value in options:
            url = _url(value) if option in self.task.paths else None
            if url is not None:
                value = _fetch(url, folder, self.task.storage)
                self.names[value] = url
                self.names[os.path.dirname(value)] = url.rstrip("/").rsplit("/", 1)[0]  # of what it names
            local.append((option, value))
        return local

    def said(self, text: str) -> str:
        """A text with the names that its reader knows."""
        for local, url in self.names.items():
            text = text.replace(json.dumps(local)[1:-1], url)
        return text


def _task(task: _Task) -> list[Done]:
    """What a worker does; numbers are indices into the task's rows."""
    program, command = how()
    setting = {**task.setting, "program": program, "command": command}
    remote = [value for _, _, _, options in task.rows for option, value in options if option in task.paths and _url(value)]
    with contextlib.ExitStack() as stack:
        # a worker that is killed leaves its folder: there is one only for what comes from afar
        scratch = ""
        if remote or task.aside is None:
            scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="nonrigid-", ignore_cleanup_errors=True))
        fetched = _Fetched(task)
        if any(option in task.paths and _url(value) for option, value in task.setting["options"]):
            with _keeping:
                setting["options"] = fetched.options(task.setting["options"], _shared(task.run))
        rows = [(line, name, of, fetched.options(options, scratch)) for line, name, of, options in task.rows]
        if task.aside is None:
            done = _away(task, setting, rows, fetched, scratch)
        else:
            aside = os.path.join(task.aside, uuid.uuid4().hex)
            try:
                os.mkdir(aside)
            except FileNotFoundError:
                raise FileNotFoundError(
                    2, "the folder of results is not seen by this worker; give one that all see, or a URL such as s3://...", task.aside
                ) from None
            try:
                done = _nonrigid.batch_run(setting, aside, rows, task.chains)
            finally:
                shutil.rmtree(aside, ignore_errors=True)
    return [(k, fetched.said(row), before, seconds) for k, row, before, seconds in done]


def _away(task: _Task, setting: dict[str, Any], rows: list[Row], fetched: _Fetched, scratch: str) -> list[Done]:
    """Results at a URL: what is known of them comes here, what is new goes there."""
    fs, root = _filesystem(setting["folder"], task.storage)
    folder, aside = os.path.join(scratch, "out"), os.path.join(scratch, "aside")
    setting = {**setting, "folder": folder}
    of = {row[1] for row in rows} | {f"{row[2]}.sequence" for row in rows if row[2]}
    names = {name for job in of for name in _nonrigid.batch_files(job, setting["format"])}
    there = _read(fs, root, names)
    records = [json.loads(data) for name, data in there.items() if name.startswith("log/") and name.endswith(".json")]
    there.update(_read(fs, root, {name for record in records for name in record.get("outputs", {})} - names))
    for name, data in there.items():
        path = os.path.join(folder, *name.split("/"))
        os.makedirs(os.path.dirname(path), exist_ok=True)
        Path(path).write_bytes(data)
    os.makedirs(folder, exist_ok=True)
    os.makedirs(aside)
    done = _nonrigid.batch_run(setting, aside, rows, task.chains)
    here = {p.relative_to(folder).as_posix(): p for p in Path(folder).rglob("*") if p.is_file()}
    # the record first: what it lists and is not there as listed counts as not done
    for name in sorted(here, key=lambda name: not (name.startswith("log/") and name.endswith(".json"))):
        data = here[name].read_bytes()
        if name.startswith("log/"):
            data = fetched.said(data.decode(errors="replace").replace(folder, task.setting["folder"])).encode()
        if there.get(name) != data:
            _write(fs, f"{root}/{name}", data)
    for name in there.keys() - here.keys():
        fs.rm_file(f"{root}/{name}")
    return done


def _read(fs: Any, root: str, names: set[str]) -> dict[str, bytes]:
    """Those of the files that are there."""
    if not names:
        return {}
    paths = {fs._strip_protocol(f"{root}/{name}"): name for name in names}
    found = fs.cat(list(paths), on_error="return")
    data = {}
    for path, content in found.items():
        if isinstance(content, bytes):
            data[paths[path]] = content
        elif not isinstance(content, FileNotFoundError):
            raise content
    return data


def _write(fs: Any, path: str, data: bytes) -> None:
    """A file that is whole or not there."""
    protocols = {fs.protocol} if isinstance(fs.protocol, str) else set(fs.protocol)
    if protocols & _WHOLE_WRITES:
        fs.pipe_file(path, data)
        return
    fs.makedirs(str(PurePosixPath(path).parent), exist_ok=True)
    part = f"{path}.{uuid.uuid4().hex}.part"
    fs.pipe_file(part, data)
    fs.mv(part, path)


class _Tasks(Sequence[_Task]):
    """The tasks of a batch, each made when it is asked for: a million of them would not fit."""

    def __init__(self, rows: _nonrigid.Rows, chunk: int, setting: dict[str, Any], paths: frozenset[str], run: str, holder: Any,
                 storage: Mapping[str, Mapping[str, Any]]) -> None:  # fmt: skip
        self.rows, self.bounds = rows, rows.tasks(chunk)
        self.common = (setting, paths, run, None if holder is None else os.fspath(holder.aside), storage)

    def __len__(self) -> int:
        return len(self.bounds) - 1

    def numbers(self, k: int) -> list[int]:
        """Numbers of its rows in the manifest."""
        return self.rows.numbers(self.bounds[k], self.bounds[k + 1])

    def __getitem__(self, k: Any) -> Any:
        if not 0 <= k < len(self):
            raise IndexError(k)
        rows, chains = self.rows.task(self.bounds[k], self.bounds[k + 1])
        return _Task(rows, chains, *self.common)


# Engines: each takes tasks and gives, in any order, the number of a task and what came of it, or why nothing did. They hold so many
# tasks at once as keep their workers busy.

Outcome: TypeAlias = "tuple[int, list[Done] | Exception]"


def _by_executor(executor: concurrent.futures.Executor, tasks: Sequence[_Task], workers: int) -> Iterator[Outcome]:
    left = iter(range(len(tasks)))
    running: dict[concurrent.futures.Future[list[Done]], int] = {}
    try:
        while True:
            for k in itertools.islice(left, 4 * workers + 64 - len(running)):
                running[executor.submit(_task, tasks[k])] = k
            if not running:
                return
            ended, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
            for future in ended:
                error, k = future.exception(), running.pop(future)
                yield k, error if isinstance(error, Exception) else future.result()
    finally:
        for future in running:
            future.cancel()


def _by_dask(client: Any, tasks: Sequence[_Task], run: str) -> Iterator[Outcome]:
    from distributed import as_completed

    left = iter(range(len(tasks)))
    running: dict[str, tuple[int, Any]] = {}
    ended = as_completed(loop=client.loop)

    def submit() -> None:
        most = 4 * sum(client.nthreads().values()) + 256
        numbers = list(itertools.islice(left, max(0, most - len(running))))
        keys = [f"nonrigid-{run}-{k}" for k in numbers]
        futures = client.map(_task, [tasks[k] for k in numbers], key=keys, pure=False) if numbers else []
        running.update(zip(keys, zip(numbers, futures)))
        ended.update(futures)

    try:
        submit()
        while running:
            batch = ended.next_batch()
            good = [future for future in batch if future.status == "finished"]
            for future, result in zip(good, client.gather(good)):
                yield running.pop(future.key)[0], result
            for future in batch:
                if future.status != "finished":
                    error = future.exception() if future.status == "error" else None
                    yield running.pop(future.key)[0], error or RuntimeError(f"the engine says that it was {future.status}")
            del batch, good
            submit()
    finally:
        client.cancel([future for _, future in running.values()])


def _by_ray(ray: Any, tasks: Sequence[_Task], threads: int, retries: int) -> Iterator[Outcome]:
    if not ray.is_initialized():
        ray.init()
    remote = ray.remote(_task).options(num_cpus=threads, max_retries=retries)
    most = 4 * max(1, int(ray.cluster_resources().get("CPU", 1))) + 64
    left = iter(enumerate(tasks))
    running: dict[Any, int] = {}
    try:
        while True:
            for k, task in left:
                running[remote.remote(task)] = k
                if len(running) >= most:
                    break
            if not running:
                return
            ready, _ = ray.wait(list(running), num_returns=1)
            for reference in ready:
                k = running.pop(reference)
                try:
                    yield k, ray.get(reference)
                except Exception as error:  # that of the task, or that its worker was lost once too often
                    yield k, error
    finally:
        for reference in running:
            ray.cancel(reference)


_OPTION = re.compile(rf"(?<![\w-])--({'|'.join(_nonrigid.batch_columns()[0])})(?: <[^>]*>)?(?![\w-])")


def _row(told: str) -> dict[str, Any]:
    """A row of the summary, whose note names arguments of `run`, not options of the command line."""
    row: dict[str, Any] = json.loads(told)
    row["note"] = _OPTION.sub(lambda option: option[1].replace("-", "_"), row["note"])
    return row


class _Table(Sequence[dict[str, Any]]):
    """Rows of a summary, each made when it is asked for."""

    def __init__(self, rows: _nonrigid.Rows) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        return _row(self._rows.told(range(len(self))[k]))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and all(a == b for a, b in zip(self, other))

    def __repr__(self) -> str:
        return f"<{len(self)} rows>"

    def __reduce__(self) -> tuple[Any, ...]:
        return list, (list(self),)


@dataclass
class Batch:
    """What came of a batch."""

    rows: Sequence[dict[str, Any]] = field(default_factory=list)
    """A row for each scan in the manifest's order: name, status (done, doubtful, failed, pending), start, probability of an error (in summary.csv
    error_probability), inliers, near, median (median_mm, millimetres), flipped, note."""
    before: int = 0
    """Scans that were done before."""
    ran: int = 0
    """Scans that this run did, those that failed included."""
    seconds: float = 0.0
    """From start to end."""
    cores: int = 1
    """Cores that it had."""

    @property
    def failed(self) -> list[dict[str, Any]]:
        """The rows of those that failed; `note` says why."""
        return [row for row in self.rows if row["status"] == "failed"]

    @property
    def scans_per_core_minute(self) -> float:
        """Speed."""
        return self.ran / (self.seconds / 60 * self.cores)

    def __repr__(self) -> str:
        counts = collections.Counter(row["status"] for row in self.rows)
        told = ", ".join(f"{count} {status}" for status, count in counts.items())
        return f"Batch({told}; {self.ran} ran in {self.seconds:.1f} s, {self.before} were done before)"


def _options(given: Mapping[str, Any], known: list[str], paths: frozenset[str]) -> list[tuple[str, str]]:
    """Options as the command line has them."""
    options = []
    for key, value in given.items():
        name = key.replace("_", "-")
        if name not in known or name == "target":
            near = difflib.get_close_matches(name, [k for k in known if k != "target"], 1)
            hint = f"; did you mean {near[0].replace('-', '_')!r}?" if near else ""
            raise TypeError(f"run() has no option {key!r}{hint}")
        if value is None:
            continue
        if name in paths:
            text = _local(os.fsdecode(value))
            if name == "rig" and reader_of(Path(text)) is not None:
                raise ValueError(f'rig: {text}: for many scans, write it once as a rig of ours: nonrigid.Rig.read(...).write("rig")')
            options.append((name, text if _url(text) else os.path.abspath(text)))
        elif name == "unit" and isinstance(value, Mapping):
            options.append((name, ",".join(f"{of.replace('_', '-')}={unit}" for of, unit in value.items())))
        elif isinstance(value, Mapping):
            raise TypeError(f"{key}: expected text, a number or a list, found {value!r}")
        elif isinstance(value, (list, tuple, set, frozenset)) or np.ndim(value):
            # a set has another order in every process
            items = sorted(value) if isinstance(value, (set, frozenset)) else value if isinstance(value, (list, tuple)) else np.asarray(value).tolist()
            options.append((name, ",".join(map(str, items))))
        else:
            options.append((name, str(value)))
    return options


def run(
    manifest: PathLike,
    out: PathLike,
    *,
    scheduler: Any = "local",
    chunk: int | None = None,
    jobs: int | None = None,
    threads: int = 1,
    format: str = "obj",
    pictures: bool = False,
    animation: str | None = "usda",
    fps: float = 60,
    smooth: float | None = 4.0,
    again: bool = False,
    retries: int = 3,
    storage_options: Mapping[str, Mapping[str, Any]] | None = None,
    callback: Callable[[dict[str, Any]], Any] | None = None,
    **options: Any,
) -> Batch:
    """Registers the scans of a manifest, as `nonrigid batch MANIFEST --out OUT` does, on an engine that distributes.

    manifest: a CSV file with the columns of `nonrigid batch`: target, name, sequence, and any option. out: folder of the results. Both, and
    whatever is read, may be URLs of fsspec (s3://, gs://, memory://, ...); results at a URL need no disk that workers share.

    scheduler: "local", processes of this machine; a Dask `Client`; "ray", the cluster of `ray.init`, or one of this machine if there is
    none; or a `concurrent.futures.Executor`. chunk: scans in a task, chosen by their number and the workers' unless stated; frames of one
    sequence stay together. jobs: scans at once, of "local", one a core unless stated. threads: of each scan.

    format: "obj", "ply" or "glb". pictures: NAME.png for each scan. animation: format of the one animated file of each sequence, "usda",
    "pc2", "glb" or None; fps: its frames a second, from 1 to 1000, such as 23.976; smooth: above how many Hz motion counts as noise there, or None. again: do what is done again. retries: how often Ray tries a task whose
    worker was lost; Dask has a setting of its own (distributed.scheduler.allowed-failures). storage_options: {protocol: options of fsspec}.
    callback: sees every row of the summary as it comes; what it raises ends the batch. options: those of `nonrigid register`, for every
    scan, with underscores: template="face.obj", rig="rig", expression_bounds=(0, 1).

    What is done is known by the SHA-256 of all that decides it, and is not done again: after an interruption the same call goes on. One scan
    that fails is a row of the summary; so is one whose workers were lost too often. A folder is locked while a batch writes there; at a URL,
    where no lock holds, two batches must not write at once.

    Raises ValueError for a manifest or arguments that make no sense, and where something that is read, or is no result, would be
    overwritten; OSError; ComputationError if another batch has the folder. What `options` of a registration are worth its scans say: a model
    that there is not, or a template that is not there, is a row that failed.
    """
    clock = time.monotonic()
    storage = dict(storage_options or {})
    known, path_names = _nonrigid.batch_columns()
    paths = frozenset(path_names)
    threads, retries = count("threads", threads, 1, 1024), count("retries", retries, -1)
    if isinstance(fps, bool) or not isinstance(fps, Real):
        raise TypeError(f"fps: expected a number from 1 to 1000, found {fps!r}")
    if not 1 <= fps <= 1000:
        raise ValueError(f"fps: expected a number from 1 to 1000, found {fps!r}")
    fps = float(fps)
    chunk, jobs = count_or_none("chunk", chunk, 1), count_or_none("jobs", jobs, 1)
    for what, flag in (("pictures", pictures), ("again", again)):
        if not isinstance(flag, (bool, np.bool_)):
            raise TypeError(f"{what}: expected True or False, found {flag!r}")
    if smooth is not None and not isinstance(smooth, (int, float, np.number)):
        raise TypeError(f"smooth: expected a frequency in Hz, or None, found {smooth!r}")
    pictures, again, smooth = bool(pictures), bool(again), None if smooth is None else float(smooth)
    common = _options(options, known, paths)
    listed = _local(os.fsdecode(manifest))
    if _url(listed):
        fs, path = _filesystem(listed, storage)
        rows = _nonrigid.Rows(listed, fs.cat_file(path).decode())
    else:
        rows = _nonrigid.Rows(os.path.abspath(listed))
    folder = _local(os.fsdecode(out))
    away = _url(folder) is not None
    folder = folder.rstrip("/") if away else os.path.abspath(folder)
    setting = {
        "program": "", "command": [], "folder": folder, "format": format, "pictures": pictures, "animation": animation, "fps": fps,
        "smooth": smooth, "threads": threads, "again": again, "options": common,
    }  # fmt: skip
    engine, cores = _engine(scheduler, jobs, threads)
    holder = None
    if away:
        _refuse_clash(folder, format, rows, common, paths, listed)
    else:
        holder = _nonrigid.Holder(setting, listed, rows)
    try:
        batch = Batch(cores=cores)
        run_id = uuid.uuid4().hex[:12]
        tasks = _Tasks(rows, _chunk(chunk, len(rows), batch.cores, scheduler), setting, paths, run_id, holder, storage)
        for k, result in engine(tasks, run_id, retries):
            numbers = tasks.numbers(k)
            if isinstance(result, Exception):
                note = f"no worker could do it: {type(result).__name__}: {str(result).strip() or 'no message'}"
                result = [(i, _nonrigid.batch_lost(rows.name(n), note.splitlines()[0]), False, 0.0) for i, n in enumerate(numbers)]
            for i, row, before, seconds in result:
                rows.tell(numbers[i], row, before, seconds)
                if callback is not None:
                    callback(_row(row))
            if holder is not None and holder.is_lost:
                raise _nonrigid.ComputationError(f"{folder}: another batch took this folder over while this one stood still")
        batch.rows = _Table(rows)
        (batch.ran, batch.before), batch.seconds = rows.counts, time.monotonic() - clock
        if holder is not None:
            holder.finish(rows, batch.seconds, batch.cores)
        else:
            _finish_away(folder, rows, batch, pictures, storage)
        return batch
    finally:
        if holder is not None:
            holder.release()


def _chunk(chunk: int | None, scans: int, cores: int, scheduler: Any) -> int:
    """Scans in a task: a task costs Dask some milliseconds (the book, Register many scans), and workers should end together."""
    if chunk is not None:
        return chunk
    if isinstance(scheduler, str) and scheduler == "local":
        return 1
    return max(1, min(32, math.ceil(scans / (8 * cores))))


Engine: TypeAlias = "Callable[[Sequence[_Task], str, int], Iterator[Outcome]]"


def _engine(scheduler: Any, jobs: int | None, threads: int) -> tuple[Engine, int]:
    """What runs tasks, and how many cores it has."""
    if isinstance(scheduler, str) and scheduler == "local":
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        workers = jobs or max(1, cores // threads)

        def local(tasks: Sequence[_Task], run_id: str, retries: int) -> Iterator[Outcome]:
            with concurrent.futures.ThreadPoolExecutor(workers) as pool:
                yield from _by_executor(pool, tasks, workers)

        return local, workers * threads
    if jobs is not None:
        raise ValueError("jobs: only with scheduler=\"local\"; the engine's own workers say how many scans run at once")
    if (isinstance(scheduler, str) and scheduler == "ray") or getattr(scheduler, "__name__", "") == "ray":
        import ray

        if not ray.is_initialized():
            ray.init()
        cores = int(ray.cluster_resources().get("CPU", 1))
        return (lambda tasks, run_id, retries: _by_ray(ray, tasks, threads, retries)), max(1, cores)
    if hasattr(scheduler, "scheduler_info") and hasattr(scheduler, "nthreads"):
        cores = sum(scheduler.nthreads().values()) * threads
        return (lambda tasks, run_id, retries: _by_dask(scheduler, tasks, run_id)), max(1, cores)
    if isinstance(scheduler, concurrent.futures.Executor):
        workers = int(getattr(scheduler, "_max_workers", None) or 1)
        return (lambda tasks, run_id, retries: _by_executor(scheduler, tasks, workers)), max(1, workers * threads)
    raise TypeError(
        f'scheduler: expected "local", a Dask Client, "ray" or a concurrent.futures.Executor, found {type(scheduler).__qualname__}'
    )


def _refuse_clash(folder: str, format: str, rows: _nonrigid.Rows, common: list[tuple[str, str]], paths: frozenset[str], manifest: str) -> None:
    """Refuses results at a URL that are read."""
    of_all = {value for option, value in common if option in paths} | {manifest}
    read = sorted({path for path in of_all if path.startswith(folder)} | set(rows.read_below(folder)))
    shared = {f"{folder}/{name}" for name in ("summary.csv", "index.html", "summary.timing.json")}
    for path in [*sorted(shared.intersection(read)), *(f"{folder}/{name}" for name in rows.writes([p[len(folder) + 1 :] for p in read], format))]:
        raise ValueError(f"out {path}: would overwrite a file that is read")
    for path in read:
        if path.rstrip("/") == folder:
            raise ValueError(f"out {folder}: is read as well; give another folder")


def _finish_away(folder: str, rows: _nonrigid.Rows, batch: Batch, pictures: bool, storage: Mapping[str, Mapping[str, Any]]) -> None:
    """Writes the summary to a URL."""
    csv, page, times = rows.summary(pictures, batch.seconds, batch.cores)
    fs, root = _filesystem(folder, storage)
    marked = f"{root}/.nonrigid/wrote-1-of-1.json"
    names = ["summary.csv", "index.html", "summary.timing.json"]
    if not fs.exists(marked):
        for name in names:
            if fs.exists(f"{root}/{name}"):
                raise FileExistsError(17, "is there, and no earlier batch has written it; move it away, or give another folder", f"{folder}/{name}")
    _write(fs, marked, json.dumps(names, indent=2).encode())
    for name, text in zip(names, (csv, page, times)):
        _write(fs, f"{root}/{name}", text.encode())
