"""The picture of a map, opened again."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from slam.logs.messages import OccupancyMap
from slam.logs.trajectory import Trajectory

from slam.maps.map_picture import _LEFT, _TOP, _shrunk, ticks, write_map_png

RED, SLATE, WHITE = (209, 73, 91), (30, 41, 59), (255, 255, 255)


def room() -> OccupancyMap:
    """10 m by 5 m, from (-2, 1) on, with a wall along its far side."""
    cells = np.zeros((100, 200), dtype=np.int8)
    cells[90:] = 100
    return OccupancyMap(1, 0.05, -2.0, 1.0, cells)


def drawn(folder: Path, grid: OccupancyMap, *poses: tuple[float, float, float]) -> np.ndarray:
    stamps = np.arange(len(poses))
    path = folder / "map.png"
    write_map_png(path, grid, Trajectory(stamps, np.array(poses).reshape(-1, 3)))
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def at(picture: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    """Colour at a place of the room, whose longer side takes 1650 pixels."""
    row, column = _TOP + (6.0 - y) * 165.0, _LEFT + (x + 2.0) * 165.0
    return tuple(picture[int(row), int(column)].tolist())


def test_walls_floor_and_path_are_where_they_are_in_metres(tmp_path):
    picture = drawn(tmp_path, room(), (-1.0, 2.0, 0.0), (3.0, 2.0, 0.0), (3.0, 4.0, 0.0))
    assert at(picture, 0.0, 5.8) == SLATE
    assert at(picture, 0.0, 4.0) == WHITE
    assert at(picture, 1.0, 2.0) == RED
    assert at(picture, 3.0, 3.0) == RED
    assert at(picture, 3.0, 4.0) == (29, 53, 87)  # the end, over the path
    assert at(picture, -1.0, 2.0) == (42, 127, 98)


def test_equal_runs_give_equal_pictures(tmp_path):
    poses = ((-1.0, 2.0, 0.0), (3.0, 4.0, 0.0))
    assert np.array_equal(drawn(tmp_path, room(), *poses), drawn(tmp_path, room(), *poses))


@pytest.mark.parametrize("shape", [(1, 1), (1, 4000), (4000, 1)])
def test_a_picture_is_drawn_of_nothing_and_of_the_narrowest(tmp_path, shape):
    unknown = OccupancyMap(1, 0.05, 0.0, 0.0, np.full(shape, -1, dtype=np.int8))
    assert min(drawn(tmp_path, unknown, (np.nan, 0.0, 0.0)).shape[:2]) > 330
    assert min(drawn(tmp_path, unknown).shape[:2]) > 330


def test_a_large_map_is_drawn_small_and_keeps_its_walls():
    cells = np.zeros((3601, 5500), dtype=np.int8)
    cells[1234, :] = 100
    shrunk = _shrunk(cells)
    assert shrunk.shape == (1201, 1834)
    assert np.all(shrunk[1234 // 3] == 100)
    assert np.count_nonzero(shrunk) == 1834


def test_ticks_are_round_and_few():
    assert [text for _, text in ticks(-11.3, 56.0, 85.0)] == ["-10", "0", "10", "20", "30", "40"]
    assert [text for _, text in ticks(0.12, 0.2, 0.2)][:3] == ["0.15", "0.20", "0.25"]


def test_no_plotting_library_is_loaded_for_it(tmp_path):
    code = (
        "import sys, numpy as np; from pathlib import Path\n"
        "from slam.logs.messages import OccupancyMap\n"
        "from slam.maps.map_picture import write_map_png\n"
        "grid = OccupancyMap(1, 0.05, 0.0, 0.0, np.zeros((4, 4), np.int8))\n"
        "write_map_png(Path(sys.argv[1]), grid)\n"
        "assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.png")], check=True)
