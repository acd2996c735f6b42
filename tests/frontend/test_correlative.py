"""The search must find exactly what trying every pose would find."""

from dataclasses import dataclass

import numpy as np
import pytest
from gtsam import Pose2
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from slam.drivers.simulators.laser import LASERS, take_scan
from slam.drivers.simulators.world import World
from slam.frontend.correlative import (
    CorrelativeConfig,
    LikelihoodField,
    Window,
    build_field,
    search,
    thin,
)
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics

APART = 0.35  # m


@dataclass
class Tried:
    score: float
    cell: tuple[int, int]
    theta: float


def try_all(field: LikelihoodField, points, window) -> list[Tried]:
    """Every pose of the window on the grid that `search` promises, scored one by one."""
    res, grid = field.resolution, field.levels[0]
    far = max(np.hypot(points[:, 0], points[:, 1]).max(), 1.0)
    turns = max(1, int(np.ceil(window.turn / (res / far))))
    thetas = window.centre.theta() + np.arange(-turns, turns + 1) * min(
        res / far, window.turn / turns
    )
    cells = max(1, int(np.ceil(window.reach / res)))
    corner = (np.array([window.centre.x(), window.centre.y()]) - field.origin) / res
    tried = []
    for theta in thetas:
        c, s = np.cos(theta), np.sin(theta)
        px, py = points.T / res
        xs = np.floor(c * px - s * py + corner[0]).astype(int)
        ys = np.floor(s * px + c * py + corner[1]).astype(int)
        for dy in range(-cells, cells + 1):
            for dx in range(-cells, cells + 1):
                x, y = xs + dx, ys + dy
                inside = (x >= 0) & (x < grid.shape[1]) & (y >= 0) & (y < grid.shape[0])
                score = grid[y[inside], x[inside]].sum(dtype=np.float64) / len(points)
                tried.append(Tried(float(score), (dx, dy), float(theta)))
    return tried


def clouds(most):
    return npst.arrays(
        np.float64,
        st.tuples(st.integers(1, most), st.just(2)),
        elements=st.integers(-150, 150).map(lambda n: n / 100),
    )


@settings(max_examples=150, deadline=None)
@given(
    clouds(25),
    clouds(12),
    st.integers(1, 6),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3)),
    st.floats(0.01, 0.5),
    st.floats(0.01, 0.3),
)
def test_branch_and_bound_finds_the_best_pose_of_all(target, query, levels, centre, reach, turn):
    field = build_field(target, CorrelativeConfig(levels=levels, smoothing=0.15))
    window = Window(Pose2(*centre), reach, turn)
    found = search(field, query, window, min_score=1e-9, apart=APART)
    tried = try_all(field, query, window)
    best = max(tried, key=lambda t: t.score)
    if found is None:
        assert best.score <= 1e-9
        return
    assert found.score == pytest.approx(best.score, abs=1e-12)
    # The pose is one of the window, and has the score that is claimed for it.
    dx = round((found.target_T_query.x() - centre[0]) / field.resolution)
    dy = round((found.target_T_query.y() - centre[1]) / field.resolution)
    theta = found.target_T_query.theta()
    claimed = [
        t.score for t in tried
        if t.cell == (dx, dy) and abs(np.angle(np.exp(1j * (t.theta - theta)))) < 1e-9
    ]  # fmt: skip
    assert claimed == [pytest.approx(found.score, abs=1e-12)]
    rivals = [
        t.score for t in tried
        if np.hypot(t.cell[0] - dx, t.cell[1] - dy) > APART / field.resolution
    ]  # fmt: skip
    second = max(rivals, default=0.0)
    if second > 0.7 * found.score + 1e-9:
        assert found.second_score == pytest.approx(second, abs=1e-12)
    elif second < 0.7 * found.score - 1e-9:
        assert found.second_score == 0.0


@settings(max_examples=50, deadline=None)
@given(clouds(25), st.integers(1, 6))
def test_a_block_is_never_below_a_cell_that_it_covers(target, levels):
    field = build_field(target, CorrelativeConfig(levels=levels))
    finest = field.levels[0]
    rows, columns = finest.shape
    for level in range(levels):
        block = 1 << level
        for y in range(0, rows, 3):
            for x in range(0, columns, 3):
                covered = finest[y : y + block, x : x + block]
                assert field.levels[level][y, x] == covered.max()


def test_a_scan_is_found_again_where_it_was_taken():
    world = World.from_polygon([(-4, -2), (6, -2), (6, 1), (3, 1), (3, 4), (-4, 4)])
    laser, rng = LASERS["hokuyo-181"], np.random.default_rng(2)

    def cloud(pose):
        extrinsics = LaserExtrinsics(0, 0.0, 0.0, 0.0)
        points = prepare(take_scan(world, pose, laser, rng), extrinsics, ScanConfig()).points
        return points[np.isfinite(points[:, 0])]

    map_T_old, map_T_new = Pose2(0.0, 0.0, 0.2), Pose2(0.8, 0.5, 0.5)
    config = CorrelativeConfig()
    field = build_field(cloud(map_T_old), config)
    query = thin(cloud(map_T_new), config.resolution, config.max_points)
    found = search(field, query, Window(Pose2(), 2.0, 0.6), 0.3)
    error = map_T_old.between(map_T_new).between(found.target_T_query)
    assert np.hypot(error.x(), error.y()) < 1.5 * config.resolution
    assert abs(error.theta()) < 0.05
    assert found.second_score < found.score


def test_nothing_is_found_where_nothing_fits():
    field = build_field(np.array([[0.0, 0.0], [1.0, 0.0]]), CorrelativeConfig())
    far = Window(Pose2(50.0, 0.0, 0.0), 0.5, 0.1)
    assert search(field, np.array([[0.0, 0.0]]), far, 0.1) is None
    assert search(field, np.empty((0, 2)), Window(Pose2(), 0.5, 0.1), 0.1) is None


def test_thinning_keeps_one_point_a_cell_and_no_more_than_asked():
    rng = np.random.default_rng(0)
    points = rng.uniform(-2, 2, (500, 2))
    kept = thin(points, 0.5, limit=10_000)
    cells = [tuple(c) for c in np.floor(kept / 0.5).astype(int)]
    assert len(cells) == len(set(cells)) == len({tuple(c) for c in np.floor(points / 0.5)})
    assert len(thin(points, 0.01, limit=50)) <= 50
