"""The README's picture, small: what was made is there to be seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import picture


def test_picture(installed: Any, tmp_path: Path) -> None:
    shown = picture.make(tmp_path, 1500, 8000)
    picture.render(shown, tmp_path / "small.png", 200, 4)
    image = bpy.data.images.load(str(tmp_path / "small.png"))
    width, height = image.size
    pixels = np.array(image.pixels[:]).reshape(height, width, 4)[:, :, :3]
    quarters = np.array_split(pixels, 4, axis=1)
    bright = [(quarter.max(axis=2) > 0.4).mean() for quarter in quarters]
    assert min(bright) > 0.15, bright
    green = [((quarter[:, :, 1] - quarter[:, :, 0]) > 0.15).mean() for quarter in quarters]
    assert green[2] > 0.1 and max(green[0], green[1], green[3]) < 0.02, green
