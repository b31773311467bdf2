"""Wrap a template onto a scan within Blender: the package nonrigid on objects, empties and shape keys."""

from . import landmarks, morphs, panel, settings, wrapping

_PARTS = (settings, landmarks, wrapping, morphs, panel)


def register() -> None:
    for part in _PARTS:
        part.register()


def unregister() -> None:
    for part in reversed(_PARTS):
        part.unregister()
