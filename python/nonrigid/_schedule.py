"""What steers a registration."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from . import _nonrigid
from ._mesh import PathLike, is_path, mapping


class Schedule:
    """The keys of a schedule's TOML file: levels from stiff to soft, and what each weighs. Begin with a model's own, and change it:

    >>> keys = Schedule("hybrid").to_dict()
    >>> keys["model"]["nodes"] = 200
    >>> Schedule(keys).to_dict()["model"]["nodes"]
    200
    """

    __slots__ = ("_native",)
    _native: _nonrigid.Schedule

    def __init__(self, keys: str | Mapping[str, Any] = "hybrid") -> None:
        """keys: the name of a model, whose own schedule it is then, or all keys as a dict.

        Raises ValueError for an unknown model or key, with the nearest known one, and for numbers out of their bounds; for what belongs to a
        model or data term alone, `register` does.
        """
        if isinstance(keys, str):
            self._native = _nonrigid.Schedule.of_model(keys)
        else:
            self._native = _nonrigid.Schedule.of_dict(dict(mapping("schedule", keys, "the name of a model, or keys")))

    @classmethod
    def _of(cls, native: _nonrigid.Schedule) -> Schedule:
        schedule = cls.__new__(cls)
        schedule._native = native
        return schedule

    @classmethod
    def read(cls, path: PathLike) -> Schedule:
        """Reads a TOML file. Raises OSError if it cannot be read, ValueError with the line of what is wrong."""
        return cls._of(_nonrigid.Schedule.read(os.fspath(path)))

    @classmethod
    def of(cls, thing: Schedule | PathLike | Mapping[str, Any] | None, model: str) -> Schedule:
        """A schedule that is one, of a file, of keys, or of the model."""
        if thing is None:
            return cls(model)
        if isinstance(thing, Schedule):
            return thing
        if isinstance(thing, Mapping):
            return cls(thing)
        if is_path(thing):
            return cls.read(thing)
        raise TypeError(f"schedule: expected a Schedule, a dict of its keys or a path, found {type(thing).__qualname__}")

    def to_dict(self) -> dict[str, Any]:
        """All keys, those that were not given included; what belongs to a model or data term as it was given."""
        return self._native.to_dict()

    def to_toml(self) -> str:
        """The same as the text of a file."""
        return self._native.to_toml()

    def __reduce__(self) -> tuple[Any, ...]:
        return Schedule, (self.to_dict(),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Schedule) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Schedule({len(self.to_dict()['level'])} levels)"
