"""The zip: what Blender says of it, and that it installs, loads its wheel, and goes off and on."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import bpy
import build
from conftest import MODULE


def test_the_same_files_give_the_same_zip(archive: Path, wheel: Path, tmp_path: Path) -> None:
    assert build.build_zip([wheel], tmp_path).read_bytes() == archive.read_bytes()


def test_blender_finds_the_zip_valid(archive: Path) -> None:
    validate(archive)


def test_one_zip_for_all_systems(wheel: Path, tmp_path: Path) -> None:
    """As a release has it: Blender installs the wheel that fits."""
    others = [tmp_path / f"nonrigid-0.1.0-cp310-abi3-{system}.whl" for system in ("macosx_11_0_arm64", "win_amd64")]
    for other in others:
        other.write_bytes(b"of another system")
    archive = build.build_zip([wheel, *others], tmp_path)
    validate(archive)
    with zipfile.ZipFile(archive) as files:
        manifest = tomllib.loads(files.read("blender_manifest.toml").decode())
        assert set(manifest["wheels"]) == {f"./{name}" for name in files.namelist() if name.startswith("wheels/")}
    assert manifest["platforms"] == ["linux-x64", "macos-arm64", "windows-x64"] and len(manifest["wheels"]) == 3


def validate(archive: Path) -> None:
    scripts = Path(bpy.utils.system_resource("SCRIPTS"))
    program = next(scripts.glob("addons_core/bl_pkg/cli/blender_ext.py"))
    done = subprocess.run([sys.executable, str(program), "validate", str(archive)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "Success" in done.stdout, done.stdout + done.stderr


def test_platforms_of_wheels() -> None:
    names = ("manylinux_2_28_x86_64", "linux_x86_64", "win_amd64", "macosx_11_0_arm64", "macosx_10_12_x86_64.macosx_11_0_arm64")
    found = [build.platforms(Path(f"nonrigid-0.1.0-cp310-abi3-{name}.whl")) for name in names]
    assert found == [["linux-x64"], ["linux-x64"], ["windows-x64"], ["macos-arm64"], ["macos-x64"]]


def test_the_package_comes_from_the_extension(installed: Any) -> None:
    import nonrigid

    assert Path(nonrigid.__file__).is_relative_to(bpy.utils.user_resource("EXTENSIONS"))
    assert bpy.context.preferences.addons[MODULE].module == MODULE


def test_off_and_on(installed: Any) -> None:
    assert bpy.ops.preferences.addon_disable(module=MODULE) == {"FINISHED"}
    assert not hasattr(bpy.context.scene, "nonrigid")
    assert bpy.ops.preferences.addon_enable(module=MODULE) == {"FINISHED"}
    assert bpy.context.scene.nonrigid.model == "usual"
