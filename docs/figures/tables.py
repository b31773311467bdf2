"""How the tables of this folder are made: a function for each, whose docstring says what it holds. `run(COMMAND)` runs a command with the
programs of target/release in out/figures, once however many tables ask for it, and returns what it prints. A table is {row: {column: value}}, a
string is a block of text."""

import csv
import json
import os
import re
import statistics
import subprocess
import time
from pathlib import Path

MAKERS = {}


class Run:
    def __init__(self, root: Path) -> None:
        self.folder = root / "out/figures"
        self.folder.mkdir(parents=True, exist_ok=True)
        beside = next((p / "shared/data" for p in root.parents if (p / "shared/data").is_dir()), None)
        self.data = os.environ.get("NONRIGID_DATA", str(beside or ""))
        self.ceres = root / "build/ceres/ceres_case"
        self.environment = {**os.environ, "PATH": f"{root}/target/release:{os.environ['PATH']}", "NONRIGID_DATA": self.data}
        self.said: dict[str, tuple[str, str, float]] = {}
        # Of the table that is being made: its commands, and the seconds that they took.
        self.commands: list[str] = []
        self.seconds = 0.0

    def missing(self, maker) -> str:
        """What a table needs and is not here, if anything."""
        if maker.needs == "data" and not Path(self.data, "ict-facekit/narrow").is_dir():
            return "as $NONRIGID_DATA is not there"
        if maker.needs == "ceres" and not self.ceres.exists():
            return f"as {self.ceres} is not built"
        return ""

    def __call__(self, command: str, with_remarks: bool = False) -> str:
        self.commands.append(command)
        if command not in self.said:
            begin = time.monotonic()
            done = subprocess.run(["bash", "-c", command], cwd=self.folder, env=self.environment, capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError(f"{command}\n{done.stderr}")
            self.said[command] = done.stdout, done.stderr, time.monotonic() - begin
        said, remarks, seconds = self.said[command]
        self.seconds += seconds
        return remarks + said if with_remarks else said

    def cpu_seconds(self, command: str) -> float:
        """Processor time of a command, which is not among those that are listed."""
        before, begin = os.times(), time.monotonic()
        subprocess.run(["bash", "-c", command], cwd=self.folder, env=self.environment, capture_output=True, check=True)
        after = os.times()
        self.seconds += time.monotonic() - begin
        return after.children_user + after.children_system - before.children_user - before.children_system

    def csv(self, path: str) -> list[dict[str, str]]:
        with (self.folder / path).open(encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def json(self, path: str):
        return json.loads((self.folder / path).read_text(encoding="utf-8"))


def table(name: str, needs: str = ""):
    def known(maker):
        maker.needs = needs
        MAKERS[name] = maker
        return maker

    return known


ICT = "$NONRIGID_DATA/scanner-bench", "$NONRIGID_DATA/ict-facekit/narrow"


def generated(run: Run, name: str, options: str) -> tuple[str, str]:
    """Cases that data-gen makes, and their rig."""
    run(f"data-gen {options} --out {name}")
    given = re.match(r"--rig (\S+)", options)
    return f"{name}/cases", given[1] if given else f"{name}/rig"


def bench(run: Run, out: str, cases: str, rig: str, options: str = "") -> dict[str, dict]:
    """What scan-bench says of each model."""
    run(f"experiments scan-bench {cases} --rig {rig} {options + ' ' if options else ''}--out {out}")
    return {row["model"]: row for row in run.json(f"{out}/scan-bench.json")["summary"]}


def errors(models: dict[str, dict]) -> dict[str, dict]:
    keys = ["mean_rmse", "worst_rmse", "mean_normal", "mean_tangential", "worst_unobserved", "worst_self_intersections", "mean_lip_aperture"]
    return {model: {key: row[key] for key in keys} for model, row in models.items()}


@table("six-scans")
def six_scans(run):
    "Errors of every model on six generated scans, mm."
    return errors(bench(run, "bench-six", *generated(run, "seed7", "--seed 7")))


@table("ict-scans", needs="data")
def ict_scans(run):
    "Errors of every model on eight scans of the ICT-FaceKit rig, mm."
    return errors(bench(run, "bench-ict", *ICT))


@table("ict-intersections", needs="data")
def ict_intersections(run):
    "Pairs of triangles that pass through each other on the eight scans of the ICT-FaceKit rig: in the truth, in the hybrid's result, and in what its last step leaves."
    bench(run, "bench-ict-hybrid", *ICT, "--models hybrid")
    run("sed 's/^untangle = true/untangle = false/' ../../src/model/schedules/hybrid.toml > left.toml")
    bench(run, "bench-ict-left", *ICT, "--models hybrid --config left.toml")
    measured = {}
    for case in sorted(path.parent.name for path in Path(run.data, "scanner-bench").glob("*/case.json")):
        of = {name: next(r for r in run.json(f"bench-ict-{name}/scan-bench.json")["rows"] if r["case"] == case) for name in ("hybrid", "left")}
        said = run(f"nonrigid eval --json --result {ICT[0]}/{case}/truth.npy --template {ICT[1]}/template.obj --target {ICT[0]}/{case}/scan.ply")
        measured[case] = {"truth": json.loads(said)["self_intersections"]} | {name: row["self_intersections"] for name, row in of.items()}
    return measured


REAL = {"james": ("menpo3d-james/james.ply", "menpo3d-james/landmarks.json"), "lps": ("lps-head/lps_head_neckcut.ply", "lps-head/landmarks.json")}


@table("real-points", needs="data")
def real_points(run):
    "Distance, rms, from points that people placed on two real heads (51 on james, 8 on lps) to the result's, mm, and the probability of an error above 3 mm that the report states, %: without landmarks, and where the same points pull (`told`)."
    measured = {}
    for model in ["hybrid", "told", "klimov2020", "sequential", "blendshape", "flame", "gpmm_rig", "graph", "sumner"]:
        measured[model] = {}
        for name, (scan, points) in REAL.items():
            scan, points = (f"$NONRIGID_DATA/scans/{path}" for path in (scan, points))
            result, how = f"real-{name}-{model}", f"--landmarks {points}" if model == "told" else f"--model {model}"
            run(f"nonrigid register --template {ICT[1]}/template.obj --rig {ICT[1]} --target {scan} {how} --out {result}.obj --report {result}.json")
            said = json.loads(run(f"nonrigid eval --json --result {result}.obj --template {ICT[1]}/template.obj --landmarks {points}"))
            measured[model][name] = said["landmarks"]["summary"]["rms"]
            measured[model][f"{name}_probability"] = 100 * run.json(f"{result}.json")["error_probability"]
    return measured


@table("seconds")
def seconds(run):
    "Processor time of `nonrigid register --threads 1` on the six generated scans: median over them, each the lower of two runs."
    cases, rig = generated(run, "seed7", "--seed 7")
    names = sorted(path.name for path in (run.folder / cases).iterdir())
    command = (f"nonrigid register --threads 1 --template {rig}/template.obj --rig {rig} --identity-modes 40 --target {cases}/CASE/scan.ply "
               f"--landmarks {cases}/CASE/landmarks.json --out seconds.obj --model MODEL")
    run.commands.append(f"# {command}")
    models = ["hybrid", "klimov2020", "sequential", "blendshape", "sumner", "graph", "arap"]
    of = lambda model, case: min(run.cpu_seconds(command.replace("CASE", case).replace("MODEL", model)) for _ in range(2))
    return {model: {"median": statistics.median(of(model, case) for case in names)} for model in models}


SETS = {
    "s101": ("--seed 101 --cases 10", ""),
    "s102": ("--seed 102", ""),
    "s102-fused": ("--seed 102 --scanner fused", ""),
    "ict-fused": ("--rig $NONRIGID_DATA/ict-facekit/narrow --seed 101 --scanner fused", ""),
    "ict-frame": ("--rig $NONRIGID_DATA/ict-facekit/narrow --seed 103 --scanner frame", ""),
    "ict": (ICT, ""),
    "ict-align": (ICT, "--landmarks align"),
    "ict-none": (ICT, "--landmarks none"),
    "s7": ("--seed 7", ""),
    "s301": ("--seed 301 --cases 8", ""),
    "s302": ("--seed 302 --cases 8", ""),
}


@table("sets", needs="data")
def sets(run):
    "Mean and worst rmse of the hybrid and of klimov2020 on the sets that are for design, validation and test, mm."
    measured = {}
    for name, (where, options) in SETS.items():
        data = where if isinstance(where, tuple) else generated(run, name, where)
        models = bench(run, f"bench-{name}", *data, f"--models hybrid,klimov2020 {options}".strip())
        columns = {"hybrid": "mean_rmse", "hybrid_worst": "worst_rmse", "klimov2020": "mean_rmse", "klimov2020_worst": "worst_rmse"}
        measured[name] = {column: models[column.split("_")[0]][key] for column, key in columns.items()}
    return measured


@table("identities", needs="data")
def identities(run):
    "Consistency over twelve real faces without landmarks: rms and worst face, and median distance to the scan, mm."
    run("experiments consistency --population $NONRIGID_DATA/population/faces.npy --template-of-population $NONRIGID_DATA/population/template.ply "
        "--rig $NONRIGID_DATA/ict-facekit/narrow --models hybrid,klimov2020 --out identities")
    return {row["model"]: {key: row[key] for key in ["rms", "worst", "distance"]} for row in run.json("identities/consistency.json")["rows"]}


@table("closed", needs="data")
def closed(run):
    "Mean rmse on bodies and femurs, mm."
    models = ["hybrid", "graph", "blendshape", "sequential", "klimov2020"]
    measured = {}
    for subject, rig in [("femur", "$NONRIGID_DATA/femur/rig"), ("bodies", "$NONRIGID_DATA/bodies/rig")]:
        for scanner, seed in [("fused", 101), ("frame", 102)]:
            cases, _ = generated(run, f"{subject}-{scanner}", f"--rig {rig} --seed {seed} --scanner {scanner} --cases 6")
            measured[f"{subject}-{scanner}"] = bench(run, f"bench-{subject}-{scanner}", cases, rig, f"--models {','.join(models)}")
        measured[subject] = bench(run, f"bench-{subject}", f"$NONRIGID_DATA/{subject}/cases", rig, f"--models {','.join(models)}")
    return {name: {model: of[model]["mean_rmse"] for model in models} for name, of in measured.items()}


@table("deformed", needs="data")
def deformed(run):
    "Mean and worst rmse on posed bodies, half femurs and femurs that the rig's modes do not say, mm."
    bent = lambda degrees: " ".join(
        f"--bend {tip}_{side},{joint}_{side}={degrees}"
        for tip, joint in [("wrist", "elbow"), ("wrist", "acromion"), ("ankle", "knee")] for side in "lr")
    sets = {
        "bent": ("bodies", f"--seed 101 --scanner fused --cases 6 {bent(60)}"),
        "bent-wide": ("bodies", f"--seed 103 --scanner fused --cases 6 {bent(90)}"),
        "bent-frame": ("bodies", f"--seed 105 --scanner frame --cases 8 {bent(60)}"),
        "bent-far": ("bodies", f"--seed 125 --scanner fused --cases 8 {bent(110)}"),
        "bent-frame-more": ("bodies", f"--seed 111 --scanner frame --cases 10 {bent(60)}"),
        "half": ("femur", "--seed 101 --scanner fused --cases 6 --keep 0.5"),
        "field": ("femur", "--seed 101 --scanner fused --cases 6 --field 1.5"),
        "bent-test": ("bodies", f"--seed 401 --scanner fused --cases 8 {bent(60)}"),
        "bent-frame-test": ("bodies", f"--seed 522 --scanner frame --cases 8 {bent(60)}"),
        "half-test": ("femur", "--seed 401 --scanner fused --cases 8 --keep 0.5"),
        "field-test": ("femur", "--seed 401 --scanner fused --cases 8 --field 1.5"),
    }
    measured = {}
    for name, (subject, options) in sets.items():
        rig = f"$NONRIGID_DATA/{subject}/rig"
        cases, _ = generated(run, name, f"--rig {rig} {options}")
        models = bench(run, f"bench-{name}", cases, rig, "--models hybrid,graph")
        measured[name] = {f"{model}{column}": models[model][key]
                          for model in ("hybrid", "graph") for column, key in [("", "mean_rmse"), ("_worst", "worst_rmse")]}
    return measured


def outcomes(rows: list[dict]) -> dict[str, float]:
    verdicts = [row["verdict"] for row in rows]
    count = lambda *names: sum(verdict in names for verdict in verdicts)
    solvable = [row["verdict"] for row in rows if row["solvable"] == "true"]
    counts = {
        "runs": len(rows),
        "good": count("good", "good, doubted"), "good_doubted": count("good, doubted"),
        "bad": count("bad, doubted", "bad, silent"), "bad_silent": count("bad, silent"),
        "solvable": len(solvable), "refused": sum(verdict == "refused" for verdict in solvable),
    }
    share = lambda some, of: 100.0 * counts[some] / max(counts[of], 1)
    return {**counts, "silent_percent": share("bad_silent", "bad"), "doubted_percent": share("good_doubted", "good"), "refused_percent": share("refused", "solvable")}


def silence_rows(run: Run, out: str, options: str) -> list[dict]:
    run(f"experiments silence {options} --out {out}")
    return run.csv(f"{out}/silence.csv")


@table("silence")
def silence(run):
    "Scans with all that can be wrong with them, test set: results that are bad and silent, good but doubted, solvable but refused."
    rows = silence_rows(run, "silence-test", "--set test")
    kinds = {"all": rows, "design-kinds": [r for r in rows if r["design_kind"] == "true"], "kept-apart": [r for r in rows if r["design_kind"] != "true"]}
    return {name: outcomes(of) for name, of in kinds.items()}


@table("calibration")
def calibration(run):
    "Share of bad results by the probability of error that was stated, on the runs of `silence`, but those that say that nothing tells left from right, %."
    rows = [r for r in silence_rows(run, "silence-test", "--set test") if r["probability"] and r["rmse"] and not r["verdict"].startswith("mirrored")]
    bands = {"below-2": (0.0, 0.02), "2-10": (0.02, 0.1), "10-30": (0.1, 0.3), "30-60": (0.3, 0.6), "60-90": (0.6, 0.9), "above-90": (0.9, 1.01)}
    of = lambda low, high: [float(r["rmse"]) > 3.0 for r in rows if low <= float(r["probability"]) < high]
    return {name: {"results": len(of(*ends)), "bad_percent": 100.0 * sum(of(*ends)) / max(len(of(*ends)), 1)} for name, ends in bands.items()}


@table("silence-design", needs="data")
def silence_design(run):
    "Scans with all that can be wrong with them, design set, on generated faces and on scans of the ICT-FaceKit rig."
    return {"all": outcomes(silence_rows(run, "silence-design", f"--set design --runs 20 --cases {ICT[0]} --rig {ICT[1]}"))}


@table("starts", needs="data")
def starts(run):
    "Starts without landmarks of scans that are turned, of another size, cut, inside out and more: right to 15 mm, wrong, refused."
    sets = {
        "design": generated(run, "starts-102", "--seed 102 --scanner fused --cases 12"),
        "test": generated(run, "starts-7", "--seed 7 --scanner fused --cases 12"),
        "ict": ICT,
    }
    found = {name: run(f"experiments dev start-bench --kinds all --poses 2 --rig {rig} {cases}") for name, (cases, rig) in sets.items()}
    return {name: dict(re.findall(r"(right|wrong|refused): (\d+)", said)) for name, said in found.items()}


@table("rigs", needs="data")
def rigs(run):
    "The generated rig beside ICT-FaceKit."
    generated(run, "seed7", "--seed 7")
    real, made = json.loads(run(f"experiments compare-rigs {ICT[1]} seed7/rig --json"))
    listed = lambda values, form: ", ".join(format(float(format(v, form)) + 0.0, form) for v in values)  # no negative zero
    modes = lambda rig: [rig["identity_rms"][k - 1] for k in [1, 2, 5, 10, 20, 40, 100]]
    of = {
        "vertices": lambda rig: f"{rig['vertices']}, {rig['polygons']}",
        "edges": lambda rig: listed(rig["edge_lengths"], ".1f"),
        "curvature": lambda rig: listed(rig["curvature"], ".2f"),
        "modes": lambda rig: listed(modes(rig), ".2g"),
        "identity": lambda rig: f"{rig['identity_total']:.1f}",
    }
    return {name: {"ict": value(real), "generated": value(made)} for name, value in of.items()}


@table("nist")
def nist(run):
    "Runs on NIST's 27 problems, two starts each, that reach six digits and more."
    said = json.loads(run("experiments dev nist --json"))
    return {"levenberg-marquardt": {"passed": said["passed"], "total": said["total"]},
            "dogleg": {"passed": said["dogleg"]["passed"], "total": said["dogleg"]["total"]}}


@table("ceres", needs="ceres")
def ceres(run):
    "Time of an iteration of Ceres Solver over ours, with the fastest of its linear solvers, by numbers of blendshapes."
    run("experiments ceres --program ../../build/ceres/ceres_case --out ceres")
    said = run.json("ceres/ceres.json")
    ratios: dict[str, dict] = {}
    for row in said["rows"]:
        of = ratios.setdefault(row["derivatives"], {})
        key = f"shapes_{row['shapes']}"
        of[key] = min(of.get(key, row["ratio"]), row["ratio"])
    for of in ratios.values():
        of["registration"] = said["registration"]["ceres_iterations"]
    return ratios


@table("studies")
def studies(run):
    "What `experiments --list` expects of each study on two cores."
    rows: dict[str, dict] = {}
    for column, options in [("usual", ""), ("quick", "--quick ")]:
        for name, minutes, secs in re.findall(r"^(\S+) +(?:(\d+) min )?(\d+) s ", run(f"experiments {options}--list"), re.M):
            rows.setdefault(name, {})[column] = f"{minutes} min {secs} s" if minutes else f"{secs} s"
    return rows


DEMO = "seed7/cases/same_open"


def wrapped(run: Run) -> str:
    generated(run, "seed7", "--seed 7")
    return run("nonrigid register --template seed7/rig/template.obj --rig seed7/rig --identity-modes 40 "
               f"--target {DEMO}/scan.ply --landmarks {DEMO}/landmarks.json --out wrapped.obj --report wrapped.json", with_remarks=True)


@table("artist")
def artist(run):
    "What the first registration of the artist's tutorial says."
    return wrapped(run)


@table("artist-error")
def artist_error(run):
    "Error of the first registration of the artist's tutorial against the truth, mm."
    wrapped(run)
    truth = json.loads(run(f"nonrigid eval --json --result wrapped.obj --template seed7/rig/template.obj --truth {DEMO}/truth.npy --observed {DEMO}/observed.npy"))
    return {"wrapped": {key: truth[key] for key in ["rmse", "normal", "tangential"]}}


@table("surgery")
def surgery(run):
    "What the presets of the surgeon's tutorial change."
    generated(run, "seed7", "--seed 7")
    case = "seed7/cases/new_neutral"
    run(f"nonrigid register --template seed7/rig/template.obj --rig seed7/rig --identity-modes 40 --target {case}/scan.ply "
        f"--landmarks {case}/landmarks.json --out patient.obj")
    run("nonrigid morph --mesh patient.obj --rig seed7/rig --preset nose-bridge=2.5 --preset chin-forward=2 --out plan.obj --report plan")
    run("nonrigid measure --mesh patient.obj --after plan.obj --rig seed7/rig --csv plan.csv")
    changes = {row["name"]: float(row["difference"]) for row in run.csv("plan.csv") if row["group"] in ("angles", "profile")}
    return {"chin": {"change": changes["chin_projection"]}, "mentolabial": {"change": changes["mentolabial"]}}


@table("drag")
def drag(run):
    "Milliseconds of one core for a step of a handle that is dragged over some 10,000 vertices: median of five."
    run("experiments --only mask-models --out masks")
    rows = run.csv("masks/mask-speed.timing.csv")
    measured = {}
    for model in ["arap", "graph"]:
        of = [r for r in rows if r["stage"] == f"dragged handle, {model}"]
        nearest = min({int(r["moving"]) for r in of}, key=lambda moving: abs(moving - 10_000))
        steps = [float(r["milliseconds"]) for r in of if int(r["moving"]) == nearest]
        measured[model] = {"moving": nearest, "milliseconds": statistics.median(steps)}
    return measured


# What is taken from the hybrid's default schedule, one at a time, by sed.
PARTS = {
    "default": "",
    "expressions": "/^beyond/d",
    "sparse": "s/, sparse = [0-9.]*//",
    "scan": "/^terms.scan_to_template/d",
    "symmetric": "/^terms.symmetric/d; s/^terms.point_to_plane = { weight = 0.0 }/terms.point_to_plane = { weight = 1.0 }/",
    "nodes": "s/^nodes = 600/nodes = 400/",
    "rim": "/^reject_rim/d",
    "crossings": "s/^untangle = true/untangle = false/",
    "everywhere": "/^coarse_nodes/d; s/coarse = true, //",
    "vertices": "/^thinned/d",
}


@table("parts", needs="data")
def parts(run):
    "The hybrid's default schedule, one part changed at a time: mean rmse on three sets, rms of the identities, mm; processor seconds of a registration."
    sets = {"s101": generated(run, "s101", "--seed 101 --cases 10"), "s102": generated(run, "s102", "--seed 102"), "ict": ICT}
    run("data-gen --seed 7 --out seed7")
    measured = {}
    for part, change in PARTS.items():
        run(f"sed '{change}' ../../src/model/schedules/hybrid.toml > {part}.toml")
        of = {name: bench(run, f"bench-{part}-{name}", *data, f"--models hybrid --config {part}.toml")["hybrid"]["mean_rmse"]
              for name, data in sets.items()}
        run("experiments consistency --population $NONRIGID_DATA/population/faces.npy --template-of-population $NONRIGID_DATA/population/template.ply "
            f"--rig $NONRIGID_DATA/ict-facekit/narrow --models hybrid --config {part}.toml --out identities-{part}")
        of["identities"] = run.json(f"identities-{part}/consistency.json")["rows"][0]["rms"]
        command = (f"nonrigid register --threads 1 --config {part}.toml --template seed7/rig/template.obj --rig seed7/rig --identity-modes 40 "
                   f"--target {DEMO}/scan.ply --landmarks {DEMO}/landmarks.json --out {part}.obj")
        run.commands.append(command)
        of["seconds"] = min(run.cpu_seconds(command) for _ in range(3))
        measured[part] = of
    return measured


@table("detail")
def detail(run):
    "Distance of the true surface (the scan without faults) from the result, mm, before and after `--subdivide 2`."
    options = "--seed 101 --vertices 3000 --case same_open"
    run(f"data-gen {options} --out detail")
    run(f"data-gen {options} --noise 0 --spikes 0 --outliers 0 --loose-parts 0 --holes 0 --out detail-clean")
    case, rigs = "cases/same_open", {"before": "detail/rig", "after": "detail-fine"}
    run(f"nonrigid rig subdivide --rig {rigs['before']} --rounds 2 --out {rigs['after']}")
    measured: dict[str, dict] = {"median": {}, "p95": {}}
    for column, rounds in [("before", ""), ("after", " --subdivide 2")]:
        run(f"nonrigid register --template detail/rig/template.obj --rig detail/rig --identity-modes 40 --target detail/{case}/scan.ply "
            f"--landmarks detail/{case}/landmarks.json{rounds} --out detail-{column}.obj")
        said = json.loads(run(f"nonrigid eval --json --result detail-{column}.obj --template {rigs[column]}/template.obj --target detail-clean/{case}/scan.ply"))
        for row, of in measured.items():
            of[column] = said["scan_to_result"][row]
    return measured


@table("flicker")
def flicker(run):
    "Error and flicker of generated sequences of a second at 60 and 15 frames a second, mm."
    run("experiments flicker --seeds 101,102,7,301 --cutoffs 2.5,4,6 --out flicker")
    ways = {"alone": "as they are", "before": "0.5 to frame before", "line": "1 to where two lead", "third-2.5": "smooth 2.5 Hz", "third-4": "smooth 4 Hz",
            "third-6": "smooth 6 Hz"}
    rows = {name: (101, way) for name, way in ways.items()}
    rows |= {f"s{seed}-{name}": (seed, way) for seed in [102, 7, 301] for name, way in [("alone", "as they are"), ("4", "smooth 4 Hz")]}
    said = {(row["seed"], row["way"], row["frames_per_second"]): row for row in run.json("flicker/flicker.json")}
    of = lambda seed, way: {f"{column}{rate}": said[seed, way, rate][key] for rate in [60, 15] for column, key in [("error", "rmse"), ("flicker", "flicker")]}
    return {name: of(*row) for name, row in rows.items()}


@table("sequence")
def sequence(run):
    "Starts of the frames of a sequence (hybrid, 40 identity modes): rmse in mm, processor seconds of a frame on one thread."
    measured = {}
    for name, fps, landmarks, warm in [("cold", 15, 1, 0), ("warm", 15, 1, 1), ("warm-alone", 15, 0, 1), ("warm-alone-4", 4, 0, 1)]:
        data = f"sequence{fps}"
        run(f"data-gen --seed 11 --frames 12 --fps {fps} --out {data}")
        # The first frame always has its landmarks.
        given = "--landmarks $f/landmarks.json" if landmarks else "$([ -e $was ] || echo --landmarks $f/landmarks.json)"
        start = "$([ ! -e $was ] || echo --warm-start $was)" if warm else ""
        command = (f"was=none; for f in {data}/sequence/frame_*; do n={name}-$(basename $f); nonrigid register --threads 1 --template {data}/rig/template.obj "
                   f"--rig {data}/rig --identity-modes 40 --target $f/scan.ply {given} {start} --state $n.state.json --out $n.obj || exit; was=$n.state.json; done")
        run.commands.append(command)
        seconds = run.cpu_seconds(command) / 12
        said = run(f"for f in {data}/sequence/frame_*; do nonrigid eval --json --result {name}-$(basename $f).obj --template {data}/rig/template.obj "
                   "--truth $f/truth.npy --observed $f/observed.npy | jq -c .; done")
        rmse = [json.loads(line)["rmse"] for line in said.splitlines()]
        measured[name] = {"mean": statistics.mean(rmse), "worst": max(rmse), "seconds": seconds}
    return measured


@table("mask-models")
def mask_models(run):
    "The same masks on every model, means over masks and faces: milliseconds and MB at 20,000 vertices, distances in % of the displacement."
    run("experiments --only mask-models --out masks")
    percent = lambda row, key: 100.0 * float(row[key])
    return {row["model"]: {"drag": float(row["drag_ms"]), "first": float(row["first_ms"]), "memory": float(row["memory_mb"]),
                           "asked": percent(row, "off_asked"), "tissue": percent(row, "off_tissue"), "volume": percent(row, "volume_over_direct"),
                           "stretch": float(row["stretch_max"]), "border": float(row["border_step"])}
            for row in run.csv("masks/mask-argument.timing.csv")}
