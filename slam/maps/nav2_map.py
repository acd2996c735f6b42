"""Writes maps for nav2's map server, `map.pgm` + `map.yaml`, and reads them back.

The thresholds are chosen so that unknown stays unknown: nav2 reads grey 205 as an occupancy
of (255 - 205) / 255 = 0.19608 and calls it free if that is below `free_thresh`.  Its own
default of 0.25 therefore turns unknown into free; 0.196 does not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.logs.errors import LogError
from slam.logs.messages import OccupancyMap

OCCUPIED_THRESHOLD = 0.65
FREE_THRESHOLD = 0.196

# Grey values of the trinary mode of nav2_map_server (map_io.cpp)
OCCUPIED, FREE, UNKNOWN = 0, 254, 205


def trinary(cells: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Return grey values for occupancy percents (rows, columns), in the same row order."""
    table = np.full(256, UNKNOWN, dtype=np.uint8)  # indexed by the byte, so -1 is 255
    percent = np.arange(101)
    table[:101][percent <= FREE_THRESHOLD * 100] = FREE
    table[:101][percent >= OCCUPIED_THRESHOLD * 100] = OCCUPIED
    return table[cells.view(np.uint8)]


def write_nav2_map(directory: Path, grid: OccupancyMap) -> None:
    """Write `map.pgm` and `map.yaml` into the directory.

    Raises:
        OSError: if a file cannot be written.
    """
    rows, columns = grid.cells.shape
    pixels = np.ascontiguousarray(trinary(grid.cells)[::-1])  # an image starts at the top
    header = f"P5\n{columns} {rows}\n255\n".encode("ascii")
    (directory / "map.pgm").write_bytes(header + pixels.tobytes())
    (directory / "map.yaml").write_text(
        "image: map.pgm\n"
        "mode: trinary\n"
        f"resolution: {grid.resolution!r}\n"
        f"origin: [{grid.origin_x!r}, {grid.origin_y!r}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESHOLD}\n"
        f"free_thresh: {FREE_THRESHOLD}\n",
        encoding="ascii",
    )


def read_nav2_map(directory: Path) -> OccupancyMap:
    """Read back what `write_nav2_map` wrote: 0 free, 100 occupied, -1 unknown.

    Raises:
        LogError: if a file is missing or is not such a map.
    """
    try:
        lines = (directory / "map.yaml").read_text(encoding="utf-8").splitlines()
        settings = {
            key.strip(): value.strip() for key, _, value in (s.partition(":") for s in lines)
        }
        origin = [float(number) for number in settings["origin"].strip("[]").split(",")]
        resolution = float(settings["resolution"])
        magic, size, _, pixels = (directory / "map.pgm").read_bytes().split(b"\n", 3)
        columns, rows = (int(number) for number in size.split())
        grey = np.frombuffer(pixels, dtype=np.uint8).reshape(rows, columns)[::-1]
    except OSError as error:
        raise LogError(f"{error.filename}: cannot be read: {error.strerror}") from error
    except (KeyError, ValueError, IndexError) as error:
        raise LogError(f"{directory / 'map.yaml'}: not a map of ours: {error}") from error
    if magic != b"P5" or not resolution > 0.0:
        raise LogError(f"{directory / 'map.pgm'}: not a map of ours")
    cells = np.full(grey.shape, -1, dtype=np.int8)
    cells[grey == FREE] = 0
    cells[grey == OCCUPIED] = 100
    return OccupancyMap(0, resolution, origin[0], origin[1], cells)


def known_part(cells: NDArray[np.int8]) -> tuple[slice, slice]:
    """Return the rows and columns that hold everything known; all of them if nothing is."""
    known = cells >= 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if len(rows) == 0:
        return slice(0, cells.shape[0]), slice(0, cells.shape[1])
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
