"""Builds the extension's zip: `build.py [--wheel FILE ...] [--out FOLDER]`.

Without --wheel the package of this checkout is built, for this system. A release gives the wheels of all systems; Blender installs the
one that fits. The same files and wheels give the same bytes."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
MARK = re.compile(r"^# build\.py adds .*$", re.M)
SYSTEMS = {"linux": "linux", "manylinux": "linux", "macosx": "macos", "win": "windows"}
MACHINES = {"x86_64": ["x64"], "amd64": ["x64"], "aarch64": ["arm64"], "arm64": ["arm64"], "universal2": ["x64", "arm64"]}


def build_wheel() -> Path:
    """The wheel of this checkout."""
    folder = HERE / "wheels"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("nonrigid-*.whl"):
        old.unlink()
    # times of 1980 in the wheel, so that the same sources give the same bytes
    environment = {"CARGO_TARGET_DIR": str(ROOT / "target"), "SOURCE_DATE_EPOCH": "315532800", **os.environ}
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT / "python")]
    subprocess.run(command, check=True, env=environment)
    (wheel,) = folder.glob("nonrigid-*.whl")
    return wheel


def platforms(wheel: Path) -> list[str]:
    """Blender's names for the systems that a wheel is for: linux-x64 for manylinux_2_28_x86_64."""
    tag = wheel.stem.split("-")[-1].split(".")[0]
    system = next((blender for python, blender in SYSTEMS.items() if re.match(rf"{python}[\d_]", tag)), None)
    machines = next((blender for python, blender in MACHINES.items() if tag.endswith("_" + python)), None)
    if system is None or machines is None:
        sys.exit(f"{wheel.name}: no system of Blender's is known for {tag}")
    return [f"{system}-{machine}" for machine in machines]


def build_zip(wheels: list[Path], out: Path) -> Path:
    """The zip of the extension's sources and the wheels."""
    source = HERE / "extension"
    manifest = (source / "blender_manifest.toml").read_text(encoding="utf-8")
    named = re.search(r'^version = "(.+)"$', manifest, re.M)
    package = re.search(r'^version = "(.+)"$', (ROOT / "Cargo.toml").read_text(encoding="utf-8"), re.M)
    if named is None or package is None or named[1] != package[1] or not MARK.search(manifest):
        sys.exit("blender_manifest.toml: its version is not the package's, or the line that names wheels is gone")
    systems = sorted({system for wheel in wheels for system in platforms(wheel)})
    quoted = [", ".join(f'"{item}"' for item in items) for items in (systems, [f"./wheels/{wheel.name}" for wheel in wheels])]
    manifest = MARK.sub(f"platforms = [{quoted[0]}]\nwheels = [{quoted[1]}]", manifest)
    files = {path.name: path.read_bytes() for path in source.glob("*.py")}
    files |= {name: (ROOT / name).read_bytes() for name in ("LICENSE-MIT", "LICENSE-APACHE")}
    files |= {"blender_manifest.toml": manifest.encode()}
    files |= {f"wheels/{wheel.name}": wheel.read_bytes() for wheel in wheels}
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"nonrigid-blender-{named[1]}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), files[name], zipfile.ZIP_DEFLATED)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--wheel", type=Path, nargs="+", help="wheels of nonrigid, instead of building one")
    parser.add_argument("--out", type=Path, default=HERE / "dist", help="where the zip goes")
    chosen = parser.parse_args()
    wheels = chosen.wheel or [build_wheel()]
    print(build_zip(sorted(wheels, key=lambda wheel: wheel.name), chosen.out))


if __name__ == "__main__":
    main()
