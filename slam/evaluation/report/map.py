"""The report's map: paths as vectors over the occupancy grid as an embedded PNG."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from slam.evaluation.report.svg import Values, nice_step, svg_path
from slam.logs.messages import OccupancyMap
from slam.logs.trajectory import Poses
from slam.maps.nav2_map import known_part

_LONG_SIDE_PX = 2400  # of the embedded picture


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """One path over the map."""

    name: str
    style: str
    poses: Poses


def map_figure(
    grid: OccupancyMap | None, tracks: Sequence[Track], links: Values | None = None
) -> Markup:
    """Draw tracks in metres over the known part of the map, and links (n, 4) between places."""
    left, bottom, right, top = _view(grid, tracks)
    width, height = right - left, top - bottom
    parts: list[Markup] = []
    if grid is not None:
        parts.append(_map_image(grid, left, top))
    if links is not None and len(links):
        ends = links * [1.0, -1.0, 1.0, -1.0] + [-left, top, -left, top]
        d = "".join(f"M{a:.2f} {b:.2f}L{c:.2f} {e:.2f}" for a, b, c, e in ends)
        parts.append(Markup('<path class="track d" d="{}"/>').format(d))
    for track in reversed(tracks):  # so that the first lies on top
        points = _simplified(track.poses[:, :2], 0.0005 * max(width, height))
        d = svg_path(points[:, 0] - left, top - points[:, 1], digits=3)
        parts.append(Markup('<path class="track {}" d="{}"/>').format(track.style, d))
    parts.append(_ends(tracks, left, top, 0.006 * max(width, height)))
    parts.append(_scale_bar(width, height))
    return Markup(
        '<svg class="map" role="img" aria-label="trajectory over map" viewBox="0 0 {:.3f} {:.3f}" '
        'style="aspect-ratio:{:.4f}">{}</svg>'
    ).format(width, height, width / height, Markup("").join(parts))


def _view(grid: OccupancyMap | None, tracks: Sequence[Track]) -> tuple[float, float, float, float]:
    """Return left, bottom, right, top: the known map and the first track, with a margin.

    Odometry and other later tracks may run far off; they are cut at the edge.
    """
    points = [track.poses[:, :2] for track in tracks[:1]]
    if grid is not None:
        rows, columns = known_part(grid.cells)
        x = grid.origin_x + np.array([columns.start, columns.stop]) * grid.resolution
        y = grid.origin_y + np.array([rows.start, rows.stop]) * grid.resolution
        points.append(np.stack([x, y], axis=1))
    everything = np.concatenate(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    # A straight drive without a map would make a sliver: keep at least a third of the length.
    least = max(1.0, float((high - low).max()) / 3.0)
    middle, half = (low + high) / 2.0, np.maximum(high - low, least) / 2.0
    margin = 0.02 * float(half.max())
    low, high = middle - half - margin, middle + half + margin
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _map_image(grid: OccupancyMap, left: float, top: float) -> Markup:
    """Embed the known cells as a palette PNG: unknown clear, free and occupied two greys."""
    rows, columns = known_part(grid.cells)
    cells = grid.cells[rows, columns]
    step = max(1, math.ceil(max(cells.shape) / _LONG_SIDE_PX))
    pixels = _pooled(np.where(cells < 0, 0, np.where(cells < 50, 1, 2)).astype(np.uint8), step)
    size = grid.resolution * step
    x = grid.origin_x + columns.start * grid.resolution - left
    y = top - (grid.origin_y + (rows.start + pixels.shape[0] * step) * grid.resolution)
    data = base64.b64encode(_palette_png(pixels[::-1])).decode("ascii")
    return Markup(
        '<image x="{:.4f}" y="{:.4f}" width="{:.4f}" height="{:.4f}" '
        'preserveAspectRatio="none" href="data:image/png;base64,{}"/>'
    ).format(x, y, pixels.shape[1] * size, pixels.shape[0] * size, data)


def _pooled(pixels: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Shrink by whole steps; of the pixels that merge the highest (a wall) wins."""
    rows, columns = (math.ceil(n / step) for n in pixels.shape)
    padded = np.zeros((rows * step, columns * step), dtype=np.uint8)
    padded[: pixels.shape[0], : pixels.shape[1]] = pixels
    return np.asarray(padded.reshape(rows, step, columns, step).max(axis=(1, 3)))


def _palette_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode pixels 0, 1, 2 as a PNG of two bits a pixel (W3C PNG, sections 7.2 and 11)."""
    rows, columns = pixels.shape
    padded = np.zeros((rows, -(-columns // 4) * 4), dtype=np.uint8)
    padded[:, :columns] = pixels
    packed = padded[:, 0::4] << 6 | padded[:, 1::4] << 4 | padded[:, 2::4] << 2 | padded[:, 3::4]
    lines = np.concatenate([np.zeros((rows, 1), dtype=np.uint8), packed], axis=1)  # filter 0
    palette = bytes([0, 0, 0, 255, 255, 255, 30, 41, 59])
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 2, 3, 0, 0, 0)),
        (b"PLTE", palette),
        (b"tRNS", bytes([0, 255, 255])),
        (b"IDAT", zlib.compress(lines.tobytes(), 6)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


def _ends(tracks: Sequence[Track], left: float, top: float, radius: float) -> Markup:
    if not tracks or len(tracks[0].poses) == 0:
        return Markup("")
    dots = [("start", tracks[0].poses[0]), ("end", tracks[0].poses[-1])]
    return Markup("").join(
        Markup(
            '<circle class="{0}" cx="{1:.3f}" cy="{2:.3f}" r="{3:.3f}"><title>{0}</title></circle>'
        ).format(name, pose[0] - left, top - pose[1], radius)
        for name, pose in dots
    )


def _scale_bar(width: float, height: float) -> Markup:
    length = nice_step(width / 6.0)
    x, y, size = 0.02 * width, height - 0.02 * max(width, height), 0.018 * max(width, height)
    return Markup(
        '<path class="scale" d="M{0:.3f} {1:.3f}h{2:.3f}"/>'
        '<text class="scale" x="{0:.3f}" y="{3:.3f}" style="font-size:{4:.3f}px">{2:g} m</text>'
    ).format(x, y, length, y - 0.5 * size, size)


def _simplified(points: Values, tolerance: float) -> Values:
    """Drop points that lie within `tolerance` of the line between kept ones (Douglas, Peucker)."""
    if len(points) < 3:
        return points
    keep = np.zeros(len(points), dtype=np.bool_)
    keep[[0, -1]] = True
    stack = [(0, len(points) - 1)]
    while stack:
        first, last = stack.pop()
        chord = points[last] - points[first]
        offset = points[first + 1 : last] - points[first]
        if len(offset) == 0:
            continue
        length_2 = max(float(chord @ chord), 1e-18)
        along = np.clip(offset @ chord / length_2, 0.0, 1.0)
        distance = np.hypot(*(offset - along[:, None] * chord).T)
        farthest = int(np.argmax(distance))
        if distance[farthest] > tolerance:
            middle = first + 1 + farthest
            keep[middle] = True
            stack += [(first, middle), (middle, last)]
    return points[keep]
