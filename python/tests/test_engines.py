"""Batches on the engines themselves: Dask, Ray and Slurm, started here, with workers that are lost in the middle."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import Data, listing, manifest, results

import nonrigid.batch

COUNT = 24


@pytest.fixture(scope="module")
def listed(data: Data, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return manifest(data, tmp_path_factory.mktemp("listed") / "scans.csv", COUNT)


@pytest.fixture(scope="module")
def expected(data: Data, listed: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What `nonrigid batch` makes, by the package's own command line."""
    out = tmp_path_factory.mktemp("expected") / "out"
    command = [sys.executable, "-m", "nonrigid", "batch", str(listed), "--out", str(out), "--template", str(data.template)]
    assert subprocess.run(command, capture_output=True).returncode == 2, "one scan is missing"
    return results(out)


def kill_on_first(pids: Callable[[], list[int]]) -> tuple[Callable[[dict[str, Any]], None], list[int]]:
    """Ends a worker, without a word, when the first result has come."""
    killed: list[int] = []

    def see(row: dict[str, Any]) -> None:
        if not killed:
            killed.append(pids()[0])
            os.kill(killed[0], signal.SIGKILL)

    return see, killed


def test_dask_local_cluster(data: Data, listed: Path, expected: dict[str, bytes], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask's distributed is not installed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        batch = nonrigid.batch.run(listed, tmp_path / "out", scheduler=client, template=data.template)
        assert batch.ran == COUNT + 1 and batch.cores == 2
        again = nonrigid.batch.run(listed, tmp_path / "out", scheduler=client, template=data.template)
        assert (again.ran, again.before) == (1, COUNT)
    assert results(tmp_path / "out") == expected


def port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        number: int = free.getsockname()[1]
        return number


def test_dask_scheduler_and_workers_one_of_which_is_killed(
    data: Data, listed: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask's distributed is not installed")
    address = f"tcp://127.0.0.1:{port()}"
    program = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", address, "--no-dashboard"]
    scheduler = subprocess.Popen(program, stderr=subprocess.DEVNULL)
    start = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    workers = [
        subprocess.Popen([*start, "--local-directory", str(tmp_path / f"worker{k}")], stderr=subprocess.DEVNULL) for k in range(2)
    ]
    try:
        with distributed.Client(address, timeout=60) as client:
            client.wait_for_workers(2, timeout=60)
            see, killed = kill_on_first(lambda: [workers[0].pid])
            out = tmp_path / "out"
            batch = nonrigid.batch.run(listed, out, scheduler=client, chunk=2, template=data.template, callback=see)
            assert killed and len(client.scheduler_info()["workers"]) == 1
        assert [row["name"] for row in batch.failed] == ["broken"]
        assert results(tmp_path / "out") == expected
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def test_ray_one_worker_is_killed(data: Data, listed: Path, expected: dict[str, bytes], tmp_path: Path) -> None:
    ray = pytest.importorskip("ray", reason="Ray is not installed")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    try:

        def workers() -> list[int]:
            import psutil

            found = [p.pid for p in psutil.process_iter(["cmdline"]) if "ray::_task" in " ".join(p.info["cmdline"] or [])]
            assert found, "a worker runs"
            return found

        see, killed = kill_on_first(workers)
        batch = nonrigid.batch.run(listed, tmp_path / "out", scheduler="ray", chunk=2, template=data.template, callback=see)
        assert killed and [row["name"] for row in batch.failed] == ["broken"]
        assert results(tmp_path / "out") == expected
    finally:
        ray.shutdown()


def test_a_worker_that_is_always_lost_is_a_row_of_the_summary(data: Data, tmp_path: Path) -> None:
    """An executor's processes end in the middle of a task: its scans failed, the call returns."""
    import concurrent.futures
    import multiprocessing

    listed = manifest(data, tmp_path / "scans.csv", 4, broken=False)
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:

        def end(row: dict[str, Any]) -> None:
            for pid in list(pool._processes):
                with contextlib.suppress(ProcessLookupError):  # that of an earlier row
                    os.kill(pid, signal.SIGKILL)

        batch = nonrigid.batch.run(listed, tmp_path / "out", scheduler=pool, chunk=1, template=data.template, callback=end)
    assert batch.failed and "no worker could do it" in batch.failed[0]["note"]
    again = nonrigid.batch.run(listed, tmp_path / "out", template=data.template)
    assert not again.failed


@pytest.fixture()
def slurm(tmp_path: Path) -> Iterator[dict[str, str]]:
    """A cluster of one node, as root on this machine."""
    programs = ["slurmctld", "slurmd", "munged", "sbatch", "squeue", "scontrol"]
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        pytest.skip(f"Slurm is not installed: no {', '.join(missing)} (apt-get install slurm-wlm munge)")
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("Slurm's one-node cluster is started as root")
    host = socket.gethostname().split(".")[0]
    base = Path(tempfile.mkdtemp(prefix="nonrigid-slurm-"))  # not pytest's: paths of sockets are short
    base.chmod(0o755)
    key = base / "munge.key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o400)
    sock = base / "munge.socket"
    controller, node = port(), port()
    cores = os.cpu_count() or 1
    (base / "slurm.conf").write_text(
        f"ClusterName=test\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={controller}\nSlurmdPort={node}\nAuthType=auth/munge\n"
        f"AuthInfo=socket={sock}\nCredType=cred/munge\nSlurmUser=root\nSlurmdUser=root\nStateSaveLocation={base}/state\n"
        f"SlurmdSpoolDir={base}/spool\nSlurmctldPidFile={base}/ctld.pid\nSlurmdPidFile={base}/d.pid\nSlurmctldLogFile={base}/ctld.log\n"
        f"SlurmdLogFile={base}/d.log\nProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nSelectType=select/cons_tres\n"
        f"SelectTypeParameters=CR_CPU\nReturnToService=2\nMpiDefault=none\nSwitchType=switch/none\nJobRequeue=1\nMinJobAge=300\n"
        f"AccountingStorageType=accounting_storage/none\nJobAcctGatherType=jobacct_gather/none\nKillWait=5\n"
        f"NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} State=UNKNOWN\nPartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP\n"
    )
    (base / "state").mkdir()
    (base / "spool").mkdir()
    environment = {**os.environ, "SLURM_CONF": str(base / "slurm.conf"), "MUNGE_SOCKET": str(sock)}
    started = []
    with open(base / "log", "wb") as log:
        run = lambda *command: started.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
        try:
            munge = ["--force", "--foreground", f"--key-file={key}", f"--socket={sock}", f"--pid-file={base}/munge.pid"]
            run("munged", *munge, f"--log-file={base}/munge.log", f"--seed-file={base}/munge.seed")
            wait_for(sock.exists, 20, "munged's socket")
            run("slurmctld", "-D")
            run("slurmd", "-D", "-N", host)
            idle = lambda: "idle" in said(["sinfo", "-h", "-o", "%T"], environment)
            wait_for(idle, 60, f"the node; {base}/ctld.log says why not")
            yield environment
            shutil.rmtree(base, ignore_errors=True)
        finally:
            for process in reversed(started):
                process.terminate()
                try:
                    process.wait(20)
                except subprocess.TimeoutExpired:
                    process.kill()


def said(command: list[str], environment: dict[str, str]) -> str:
    return subprocess.run(command, env=environment, capture_output=True, text=True).stdout


def wait_for(true: Callable[[], bool], seconds: float, what: str) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, f"waited {seconds} s for {what}"
        time.sleep(0.1)


RECIPE = Path(__file__).parents[2] / "docs" / "src" / "howto" / "batches.md"


def test_slurm_array_job_one_task_is_requeued(
    data: Data, listed: Path, expected: dict[str, bytes], slurm: dict[str, str], tmp_path: Path
) -> None:
    text = RECIPE.read_text()
    recipe = text[text.index("### Slurm") :].split("```sh\n")[1].split("```")[0]
    assert "--array=1-16" in recipe and "--shard" in recipe
    # fewer and smaller parts, the test's own files, and the program of this package
    recipe = recipe.replace("--array=1-16", "--array=1-4").replace("--cpus-per-task=4", "--cpus-per-task=1").replace("#SBATCH --mem=8G\n", "")
    recipe = recipe.replace("nonrigid batch scans.csv --out wrapped --template face.obj --rig rig",
                            f"exec {sys.executable} -m nonrigid batch {listed} --out {tmp_path}/out --template {data.template}")  # fmt: skip
    script = tmp_path / "job.sh"
    script.write_text(recipe)
    (tmp_path / "out").mkdir()
    job = said(["sbatch", "--parsable", f"--output={tmp_path}/said-%a.txt", str(script)], slurm).strip()
    assert job.isdigit(), "sbatch took it"
    records = lambda: list((tmp_path / "out" / "log").glob("*.json"))
    wait_for(lambda: len(records()) >= 1, 60, "a first result")
    running = said(["squeue", "-h", "-r", "-t", "R", "-o", "%i", "-j", job], slurm).split()
    assert running, "a task runs"
    subprocess.run(["scontrol", "requeue", running[0]], env=slurm, check=True)
    restarts = lambda: said(["scontrol", "show", "job", running[0]], slurm)
    wait_for(lambda: "Restarts=1" in restarts(), 60, "the requeued task")
    # a requeued task waits a while before it may begin again
    states = lambda: set(said(["squeue", "-h", "-r", "-o", "%T", "-j", job], slurm).split()) - {"COMPLETED", "FAILED"}
    wait_for(lambda: not states(), 240, "the end of all tasks")
    last = [sys.executable, "-m", "nonrigid", "batch", str(listed), "--out", str(tmp_path / "out"), "--template", str(data.template)]
    ended = subprocess.run(last, capture_output=True, text=True)
    assert ended.returncode == 2 and f"{COUNT} were done before" in ended.stdout, ended.stdout
    assert results(tmp_path / "out") == expected


def test_urls_in_memory(data: Data, tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed")
    memory = fsspec.filesystem("memory")
    urls(memory, "memory://faces", data, tmp_path, {})


def test_urls_at_s3(data: Data, tmp_path: Path) -> None:
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server = pytest.importorskip("moto.server", reason="moto's server is not installed")
    import fsspec

    started = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    started.start()
    try:
        host, number = started.get_host_and_port()
        options = {"key": "a", "secret": "b", "endpoint_url": f"http://{host}:{number}", "client_kwargs": {"region_name": "eu-west-1"}}
        s3 = fsspec.filesystem("s3", **options)
        s3.mkdir("faces")
        urls(s3, "s3://faces", data, tmp_path, {"s3": options})
    finally:
        started.stop()


def urls(fs: Any, root: str, data: Data, tmp_path: Path, storage: dict[str, dict[str, Any]]) -> None:
    """Everything at URLs gives the same files as everything in files."""
    for case in ("same_open", "new_neutral"):
        fs.put_file(str(data.scan(case)), f"{root}/in/{case}/scan.ply")
        fs.put_file(str(data.landmarks(case)), f"{root}/in/{case}/landmarks.json")
    rig = tmp_path / "rig"
    shutil.copytree(data.rig, rig)
    with open(rig / "face.mtl", "a") as library:
        library.write("map_Kd maps/skin.<UDIM>.png\nmap_Bump C:\\work\\bump map.png\n")
    (rig / "maps").mkdir()
    for name in ("maps/skin.1001.png", "maps/skin.1002.png", "bump map.png"):
        (rig / name).write_bytes(name.encode())
    fs.put(str(rig), f"{root}/in/", recursive=True)
    lines = ["target,landmarks,name,sequence", "same_open/scan.ply,same_open/landmarks.json,a,walk",
             "new_neutral/scan.ply,new_neutral/landmarks.json,b,walk", f"{data.scan()},{data.landmarks()},c,", "none.ply,,d,"]  # fmt: skip
    fs.pipe_file(f"{root}/in/scans.csv", "\n".join(lines).encode())
    options = {"template": f"{root}/in/rig/template.obj", "rig": f"{root}/in/rig", "identity_modes": 3, "model": "blendshape"}
    run = lambda **more: nonrigid.batch.run(
        f"{root}/in/scans.csv", f"{root}/out", storage_options=storage, jobs=2, chunk=2, **{**options, **more}
    )
    batch = run()
    assert [row["name"] for row in batch.failed] == ["d"] and f"{root}/in/none.ply" in batch.failed[0]["note"]
    # the same from files
    for name in ("same_open", "new_neutral"):
        (tmp_path / name).mkdir()
        shutil.copy(data.scan(name), tmp_path / name)
        shutil.copy(data.landmarks(name), tmp_path / name)
    (tmp_path / "scans.csv").write_text("\n".join(lines))
    local = {**options, "template": rig / "template.obj", "rig": rig}
    nonrigid.batch.run(tmp_path / "scans.csv", tmp_path / "out", **local)
    fs.invalidate_cache()
    inside = {path.split("/out/", 1)[1]: fs.cat_file(path) for path in fs.find(f"{root}/out")}
    keep = lambda name: not (name.startswith((".", "log/")) or ".timing." in name or name in ("summary.csv", "index.html"))
    away = {name: content for name, content in inside.items() if keep(name)}
    here = {name: content for name, content in results(tmp_path / "out").items() if keep(name)}
    assert away == here and {"state/b.json", "a.mtl", "a_skin.1002.png", "a_bump_map.png"} <= away.keys()
    files = {name for name in listing(tmp_path / "out") if (tmp_path / "out" / name).is_file()}
    assert inside.keys() == files >= {"a.timing.json", "summary.timing.json"}
    assert b"nonrigid-" not in inside["log/a.txt"], "logs name what the user knows"
    again = run()
    assert (again.ran, again.before) == (1, 3)
    # what shows earlier results goes, as in a folder
    run(animation=None)
    nonrigid.batch.run(tmp_path / "scans.csv", tmp_path / "out", animation=None, **local)
    fs.invalidate_cache()
    left = {path.split("/out/", 1)[1] for path in fs.find(f"{root}/out")}
    assert left == {name for name in files if (tmp_path / "out" / name).is_file()} < files
    # what is there and of nobody's batch stays
    fs.pipe_file(f"{root}/other/a.obj", b"mine")
    with pytest.raises(ValueError, match="would overwrite"):
        nonrigid.batch.run(f"{root}/in/scans.csv", f"{root}/in", storage_options=storage, **{**options, "template": f"{root}/in/a.obj"})
    other = nonrigid.batch.run(f"{root}/in/scans.csv", f"{root}/other", storage_options=storage, jobs=1, **options)
    assert "no record" in other.rows[0]["note"] and fs.cat_file(f"{root}/other/a.obj") == b"mine"
