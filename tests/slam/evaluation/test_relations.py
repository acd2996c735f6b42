"""The relations metric reproduces the benchmark's figures for raw odometry."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from slam.backend.se2 import compose
from slam.logs.trajectory import NS, Trajectory, parse_stamp, sorted_trajectory

from slam.evaluation.relations import Relations, read_relations, relation_errors
from slam.runs.errors import ReportError

BENCHMARK = Path(__file__).parents[4] / "shared" / "data" / "benchmark"


def raw_odometry(log: Path) -> Trajectory:
    """Read only times and odometry from the FLASER lines."""
    stamps, poses = [], []
    with gzip.open(log, "rt") as lines:
        for line in lines:
            if line.startswith("FLASER"):
                *_, x, y, theta, stamp, _, _ = line.split()
                stamps.append(parse_stamp(stamp))
                poses.append((float(x), float(y), float(theta)))
    return sorted_trajectory(stamps, poses)


@pytest.mark.skipif(not BENCHMARK.is_dir(), reason=f"{BENCHMARK} is missing")
@pytest.mark.parametrize(
    ("log", "n", "mean_m", "std_m", "digits"),
    [
        ("intel", 2984, 7.370, 14.349, 1e-3),
        ("mit-csail", 1172, 1.682, 5.292, 1e-3),
        ("mit-killian", 4677, 50.3, 128.1, 5e-2),
    ],
)
def test_raw_odometry_scores_what_it_always_has(log, n, mean_m, std_m, digits):
    relations = read_relations(BENCHMARK / f"{log}.relations")
    errors = relation_errors(raw_odometry(BENCHMARK / f"{log}.clf.gz"), relations)
    summary = errors.summary()
    assert (summary["n"], summary["missing"]) == (n, 0)
    assert summary["trans_mean_m"] == pytest.approx(mean_m, abs=digits)
    assert summary["trans_std_m"] == pytest.approx(std_m, abs=digits)


def walk() -> Trajectory:
    rng = np.random.default_rng(0)
    poses = np.zeros((50, 3))
    for k in range(1, 50):
        poses[k] = compose(poses[k - 1], rng.normal([0.3, 0, 0], [0.1, 0.01, 0.3]))
    return Trajectory(np.arange(50) * (NS // 10), poses)


def test_true_relations_score_zero_in_both_directions_of_time():
    trajectory = walk()
    first, second = np.array([3, 40, 0]), np.array([20, 10, 49])
    a, b = trajectory.poses[first], trajectory.poses[second]
    inverse = compose(np.zeros(3), a)
    cosine, sine = np.cos(a[:, 2]), np.sin(a[:, 2])
    inverse[:, 0] = -cosine * a[:, 0] - sine * a[:, 1]
    inverse[:, 1] = sine * a[:, 0] - cosine * a[:, 1]
    inverse[:, 2] = -a[:, 2]
    relations = Relations(
        trajectory.stamps_ns[first], trajectory.stamps_ns[second], compose(inverse, b)
    )
    errors = relation_errors(trajectory, relations)
    assert np.max(errors.trans_m) < 1e-12
    assert np.max(errors.rot_deg) < 1e-9
    assert errors.at_ns.tolist() == trajectory.stamps_ns[[20, 40, 49]].tolist()


def test_relations_without_a_pose_are_missing_not_zero():
    trajectory = walk()
    stamps = np.array([0, trajectory.stamps_ns[-1] + NS, 15_000_000])
    relations = Relations(stamps, np.array([NS, NS, NS]), np.zeros((3, 3)))
    errors = relation_errors(trajectory, relations)
    assert (len(errors.trans_m), errors.missing) == (2, 1)
    assert relation_errors(trajectory, relations, tolerance_s=0.01).missing == 2
    empty = relation_errors(trajectory.select(np.arange(0)), relations).summary()
    assert empty["missing"] == 3
    assert empty["trans_mean_m"] is None


@pytest.mark.parametrize("line", ["1 2 3", "1 2 0 0 0 0 0 nan", "a 2 0 0 0 0 0 0"])
def test_a_bad_relation_is_named(tmp_path, line):
    path = tmp_path / "x.relations"
    path.write_text(f"1 2 0 0 0 0 0 0\n\n{line}\n")
    with pytest.raises(ReportError, match=r"x\.relations:3: not a relation"):
        read_relations(path)


def test_no_relations_is_an_error(tmp_path):
    (tmp_path / "x").write_text("# nothing\n")
    with pytest.raises(ReportError, match="holds no relations"):
        read_relations(tmp_path / "x")
    with pytest.raises(ReportError, match="cannot be read"):
        read_relations(tmp_path / "y")
