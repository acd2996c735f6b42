"""`map.png` for people: the known part of a map in metres, with the trajectory over it.

Drawn with Pillow: matplotlib took 2.0 s of CPU and 260 MB of memory for the same picture, more
than any stage of a short run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slam.logs.messages import OccupancyMap
from slam.logs.trajectory import Trajectory
from slam.maps.nav2_map import known_part

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

Points = NDArray[np.float64]  # (n, 2)
Colour = tuple[int, int, int]

# All sizes in pixels.
_LONG_SIDE = 1650  # of the map
_SHORT_SIDE = 330  # at least: what the legend needs
_LEFT, _TOP, _RIGHT, _BOTTOM = 80, 48, 24, 64  # around the map
_TICK, _FONT = 7, 18
_LINE, _MARK = 2.5, 6.0  # width of the trajectory, half width of its ends
_SMOOTH = 2  # the trajectory is drawn so many times as large, and shrunk
_LABELS = 9  # numbers along the longer axis, about

_PAPER, _INK, _FRAME = (255, 255, 255), (40, 40, 40), (187, 187, 187)
_UNKNOWN, _FREE, _OCCUPIED = (232, 235, 238), (255, 255, 255), (30, 41, 59)
_PATH, _START, _END = (209, 73, 91), (42, 127, 98), (29, 53, 87)


@dataclass(frozen=True, slots=True)
class _Sheet:
    """Where metres of the map frame are on a picture of the map alone."""

    left: float  # m, of the picture's lower left corner
    bottom: float  # m
    scale: float  # pixels per m
    width: int  # pixels
    height: int

    def pixels(self, points: Points) -> Points:
        """(n, 2) pixels from the upper left of points in m."""
        offsets = (points - (self.left, self.bottom)) * self.scale
        return np.column_stack([offsets[:, 0], self.height - offsets[:, 1]])


def write_map_png(path: Path, grid: OccupancyMap, trajectory: Trajectory | None = None) -> None:
    """Draw the known part of the map in metres, with the trajectory over it if given.

    Raises:
        OSError: if the file cannot be written.
    """
    from PIL import Image, ImageDraw  # half of all commands draw nothing

    sheet, drawing = _map_picture(grid)
    places = np.empty((0, 2)) if trajectory is None else sheet.pixels(trajectory.poses[:, :2])
    places = places[np.isfinite(places).all(axis=1)]
    if len(places):
        _draw_path(drawing, places)
    whole = sheet.width + _LEFT + _RIGHT, sheet.height + _TOP + _BOTTOM
    picture = Image.new("RGB", whole, _PAPER)
    picture.paste(drawing, (_LEFT, _TOP))
    pen = ImageDraw.Draw(picture)
    _draw_axes(pen, sheet)
    if len(places):
        _draw_legend(pen, whole[0] - _RIGHT)
    picture.save(path, compress_level=6)


def _map_picture(grid: OccupancyMap) -> tuple[_Sheet, Image]:
    """The known cells on a ground of unknown that is wide enough for a legend."""
    from PIL import Image

    rows, columns = known_part(grid.cells)
    cells = grid.cells[rows, columns]
    scale = _LONG_SIDE / max(cells.shape)  # pixels per cell
    height, width = (max(round(n * scale), 1) for n in cells.shape)
    across, up = max(width, _SHORT_SIDE), max(height, _SHORT_SIDE)
    beside, below = (across - width) // 2, (up - height) // 2
    coloured = Image.fromarray(np.ascontiguousarray(_shaded(_shrunk(cells))[::-1]))
    kind = Image.Resampling.BOX if scale < 1.0 else Image.Resampling.NEAREST
    picture = Image.new("RGB", (across, up), _UNKNOWN)
    picture.paste(coloured.resize((width, height), kind), (beside, up - below - height))
    per_m = scale / grid.resolution
    return _Sheet(
        grid.origin_x + columns.start * grid.resolution - beside / per_m,
        grid.origin_y + rows.start * grid.resolution - below / per_m,
        per_m, across, up,
    ), picture  # fmt: skip


def _draw_path(picture: Image, places: Points) -> None:
    """The way through places (n, 2) in pixels, a disc where it starts, a square where it ends."""
    from PIL import Image, ImageDraw

    large = (picture.width * _SMOOTH, picture.height * _SMOOTH)
    mask = Image.new("L", large)
    corners = np.rint(places * _SMOOTH)
    moves = np.ones(len(corners), dtype=np.bool_)  # scans within a pixel are drawn once
    moves[1:] = (np.diff(corners, axis=0) != 0).any(axis=1)
    ImageDraw.Draw(mask).line(
        corners[moves].ravel().tolist(), fill=255, width=round(_LINE * _SMOOTH)
    )
    picture.paste(_PATH, mask=mask.resize(picture.size, Image.Resampling.BOX))
    pen = ImageDraw.Draw(picture)
    pen.ellipse(_box(places[0]), fill=_START)
    pen.rectangle(_box(places[-1]), fill=_END)


def _draw_axes(pen: ImageDraw, sheet: _Sheet) -> None:
    """Frame, ticks and metres around the map."""
    font = _font()
    right, low = _LEFT + sheet.width, _TOP + sheet.height
    pen.rectangle((_LEFT - 1, _TOP - 1, right, low), outline=_FRAME)
    span = max(sheet.width, sheet.height) / sheet.scale
    for metres, text in ticks(sheet.left, sheet.width / sheet.scale, span):
        x = _LEFT + (metres - sheet.left) * sheet.scale
        pen.line((x, low, x, low + _TICK), fill=_FRAME)
        pen.text((x, low + _TICK + 4), text, fill=_INK, font=font, anchor="mt")
    for metres, text in ticks(sheet.bottom, sheet.height / sheet.scale, span):
        y = low - (metres - sheet.bottom) * sheet.scale
        pen.line((_LEFT - _TICK, y, _LEFT, y), fill=_FRAME)
        pen.text((_LEFT - _TICK - 4, y), text, fill=_INK, font=font, anchor="rm")
    pen.text(((_LEFT + right) / 2, low + 36), "x [m]", fill=_INK, font=font, anchor="mt")
    pen.text((_LEFT - _TICK - 4, _TOP - 12), "y [m]", fill=_INK, font=font, anchor="rb")


def ticks(first: float, length: float, span: float) -> Iterator[tuple[float, str]]:
    """Round numbers within `length` (m) from `first` on, so far apart that few fit into `span`."""
    power = 10.0 ** math.floor(math.log10(span / _LABELS))
    step = next(power * m for m in (1, 2, 5, 10) if power * m >= span / _LABELS)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    for k in range(math.ceil(first / step), math.floor((first + length) / step) + 1):
        yield k * step, f"{k * step:.{decimals}f}"


def _draw_legend(pen: ImageDraw, right: float) -> None:
    """What line, disc and square are, above the map's right end."""
    font, y = _font(), _TOP - 20
    for text in ("end", "start", "trajectory"):
        pen.text((right, y), text, fill=_INK, font=font, anchor="rm")
        x = right - pen.textlength(text, font) - 14
        if text == "trajectory":
            pen.line((x - 24, y, x + 6, y), fill=_PATH, width=round(_LINE))
        elif text == "start":
            pen.ellipse(_box((x, y)), fill=_START)
        else:
            pen.rectangle(_box((x, y)), fill=_END)
        right = x - 24


def _box(middle: Any) -> tuple[float, float, float, float]:
    x, y = middle
    return x - _MARK, y - _MARK, x + _MARK, y + _MARK


def _font() -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(_FONT)


def _shrunk(cells: NDArray[np.int8]) -> NDArray[np.int8]:
    """Merge cells until there are about as many as pixels; the most occupied one stays visible."""
    step = max(1, int(max(cells.shape) // _LONG_SIDE))
    if step == 1:
        return cells
    rows, columns = (-(-n // step) for n in cells.shape)
    padded = np.full((rows * step, columns * step), -1, dtype=np.int8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    return np.asarray(padded.reshape(rows, step, columns, step).max(axis=(1, 3)))


def _shaded(cells: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Return RGB pixels: white where free, slate where occupied, pale grey where unknown."""
    share = np.linspace(0.0, 1.0, 101)[:, None] ** 2  # so that hardly seen free space is pale
    table = np.empty((256, 3))
    table[:] = _UNKNOWN
    table[:101] = (1.0 - share) * _FREE + share * _OCCUPIED
    return table.round().astype(np.uint8)[cells.view(np.uint8)]
