"""The command line, without the rest of the package: it starts in the time that the native part takes to load."""

import importlib.machinery
import importlib.util
import os
import sys
from typing import Any


def native() -> Any:
    """The module nonrigid._nonrigid, loaded from beside this file without the package around it."""
    folder = os.path.dirname(os.path.abspath(__file__))
    for suffix in importlib.machinery.EXTENSION_SUFFIXES:
        path = os.path.join(folder, "_nonrigid" + suffix)
        if os.path.exists(path):
            loader = importlib.machinery.ExtensionFileLoader("_nonrigid", path)
            spec = importlib.util.spec_from_file_location("_nonrigid", path, loader=loader)
            assert spec is not None
            module = importlib.util.module_from_spec(spec)
            loader.exec_module(module)
            return module
    raise ImportError(f"{folder}: the native part of nonrigid is not there; install the package again")


def how() -> tuple[str, list[str]]:
    """Program and first arguments that start this command line again."""
    return sys.executable, ["-I", "-S", os.path.abspath(__file__)]


if __name__ == "__main__":
    program, first = how()
    sys.exit(native().command_line(["nonrigid", *sys.argv[1:]], program, first))
