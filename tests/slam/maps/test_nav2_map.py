"""The map files, reloaded by the rules that nav2's map server documents."""

from pathlib import Path

import numpy as np
import pytest
from slam.logs.messages import OccupancyMap

from slam.maps.nav2_map import known_part, write_nav2_map


def nav2_load(yaml_path: Path) -> tuple[np.ndarray, float, list[float]]:
    """Load a trinary map as nav2_map_server does: bottom row first, 0, 100 or -1."""
    yaml = pytest.importorskip("yaml")
    settings = yaml.safe_load(yaml_path.read_text())
    assert settings["mode"] == "trinary"
    magic, size, depth, pixels = (yaml_path.parent / settings["image"]).read_bytes().split(b"\n", 3)
    assert (magic, depth) == (b"P5", b"255")
    columns, rows = (int(n) for n in size.split())
    grey = np.frombuffer(pixels, dtype=np.uint8).reshape(rows, columns) / 255.0
    occupancy = grey if settings["negate"] else 1.0 - grey
    cells = np.full((rows, columns), -1)
    cells[occupancy > settings["occupied_thresh"]] = 100
    cells[occupancy < settings["free_thresh"]] = 0
    return cells[::-1], settings["resolution"], settings["origin"]


def corner_map() -> OccupancyMap:
    cells = np.full((4, 6), -1, dtype=np.int8)
    cells[0, 0], cells[0, 5], cells[3, 2], cells[1, 1] = 100, 0, 3, 50
    cells[2, :] = [64, 65, 66, 19, 20, 98]
    return OccupancyMap(1, 0.05, -12.35, 7.1, cells)


def test_nav2_reloads_what_was_known_and_leaves_the_rest_unknown(tmp_path):
    grid = corner_map()
    write_nav2_map(tmp_path, grid)
    cells, resolution, origin = nav2_load(tmp_path / "map.yaml")
    assert (resolution, origin) == (0.05, [-12.35, 7.1, 0.0])
    expected = np.full((4, 6), -1)
    expected[0, 0], expected[0, 5], expected[3, 2] = 100, 0, 0
    expected[2] = [-1, 100, 100, 0, -1, 100]
    assert np.array_equal(cells, expected)


def test_the_top_of_the_image_is_the_far_side_of_the_map(tmp_path):
    write_nav2_map(tmp_path, corner_map())
    pixels = (tmp_path / "map.pgm").read_bytes()[-24:]
    assert pixels[2] == 254
    assert pixels[18] == 0


def test_the_known_part_is_tight():
    cells = np.full((10, 10), -1, dtype=np.int8)
    cells[2:5, 3:9] = 0
    assert known_part(cells) == (slice(2, 5), slice(3, 9))
