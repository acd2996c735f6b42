"""The occupancy grid as a small picture that lies under the paths."""

from __future__ import annotations

import base64
import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slam.logs.messages import OccupancyMap
from slam.maps.nav2_map import known_part

_LONG_SIDE_PX = 2400  # of the embedded picture
_OCCUPIED = 50  # percent
_COLOURS = (0, 0, 0, 255, 255, 255, 30, 41, 59)  # RGB of unknown (clear), free, occupied


def map_image(grid: OccupancyMap) -> dict[str, Any]:
    """Return a PNG of the known cells as a data URL, and its corners [[y, x], [y, x]] in m."""
    rows, columns = known_part(grid.cells)
    cells = grid.cells[rows, columns]
    step = max(1, math.ceil(max(cells.shape) / _LONG_SIDE_PX))
    kinds = np.where(cells < 0, 0, np.where(cells < _OCCUPIED, 1, 2)).astype(np.uint8)
    pixels = _pooled(kinds, step)
    picture = Image.fromarray(pixels[::-1])
    picture.putpalette(_COLOURS)
    file = io.BytesIO()
    picture.save(file, "PNG", bits=2, transparency=0)
    left = grid.origin_x + columns.start * grid.resolution
    bottom = grid.origin_y + rows.start * grid.resolution
    height, width = (n * step * grid.resolution for n in pixels.shape)
    return {
        "url": "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii"),
        "bounds": [[bottom, left], [bottom + height, left + width]],
    }


def _pooled(pixels: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Shrink by whole steps; of the pixels that merge the highest (a wall) wins."""
    rows, columns = (math.ceil(n / step) for n in pixels.shape)
    padded = np.zeros((rows * step, columns * step), dtype=np.uint8)
    padded[: pixels.shape[0], : pixels.shape[1]] = pixels
    return np.asarray(padded.reshape(rows, step, columns, step).max(axis=(1, 3)))
