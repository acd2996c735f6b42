"""SE(2) algebra on arrays and the TUM text format."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slam.backend.se2 import between, compose, wrap
from slam.logs.errors import LogError
from slam.logs.trajectory import (
    Trajectory,
    format_stamp,
    parse_stamp,
    path_length,
    read_tum,
    write_tum,
)

coordinate = st.floats(-1e3, 1e3)
pose = st.tuples(coordinate, coordinate, st.floats(-math.pi, math.pi)).map(np.array)


def random_trajectory(n: int = 500) -> Trajectory:
    rng = np.random.default_rng(4)
    stamps = 1_700_000_000_000_000_001 + np.cumsum(rng.integers(0, 10**8, n))
    poses = np.column_stack([rng.normal(0, 30, (n, 2)), rng.uniform(-math.pi, math.pi, n)])
    return Trajectory(stamps, poses)


@given(pose, pose)
def test_between_undoes_compose(a_T_b, b_T_c):
    found = between(a_T_b, compose(a_T_b, b_T_c))
    assert np.allclose(found[:2], b_T_c[:2], atol=1e-9)
    assert abs(wrap(found[2:] - b_T_c[2:])[0]) < 1e-9


@given(pose, pose, pose)
def test_composition_is_associative(a, b, c):
    left, right = compose(compose(a, b), c), compose(a, compose(b, c))
    assert np.allclose(left[:2], right[:2], atol=1e-8)
    assert abs(wrap(left[2:] - right[2:])[0]) < 1e-9


def test_angles_inside_the_circle_are_kept_to_the_bit():
    inside = np.array([-math.pi, -1.1, 0.0, 3.0, math.pi])
    assert np.array_equal(wrap(inside), inside)
    assert np.allclose(wrap(inside[1:-1] + 6 * math.pi), inside[1:-1], atol=1e-12)


def test_path_length_starts_at_zero_and_survives_no_poses():
    assert path_length(np.array([[0, 0, 0], [3.0, 4.0, 1.0], [3.0, 4.0, 2.0]])).tolist() == [
        0,
        5,
        5,
    ]
    assert path_length(np.zeros((0, 3))).tolist() == []


@given(st.integers(-(10**18), 4 * 10**18))
def test_stamps_survive_text_to_the_nanosecond(stamp_ns):
    assert parse_stamp(format_stamp(stamp_ns)) == stamp_ns


def test_stamps_of_fewer_digits_and_exponents_are_read():
    assert parse_stamp("1134864645.90321") == 1134864645_903210000
    assert parse_stamp("12") == 12_000_000_000
    assert parse_stamp("1.5e1") == 15_000_000_000
    for bad in ("nan", "", "12:30", "1.2.3"):
        with pytest.raises(ValueError):  # noqa: PT011 - each text has its own message
            parse_stamp(bad)


def test_tum_text_returns_the_same_trajectory(tmp_path):
    written = random_trajectory()
    write_tum(tmp_path / "a.tum", written)
    read = read_tum(tmp_path / "a.tum")
    assert np.array_equal(read.stamps_ns, written.stamps_ns)
    assert np.array_equal(read.poses[:, :2], written.poses[:, :2])
    assert np.max(np.abs(read.poses[:, 2] - written.poses[:, 2])) < 1e-15
    write_tum(tmp_path / "b.tum", written)
    assert (tmp_path / "a.tum").read_bytes() == (tmp_path / "b.tum").read_bytes()


def test_evo_reads_what_we_write(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    written = random_trajectory(50)
    write_tum(tmp_path / "a.tum", written)
    read = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    assert np.allclose(read.positions_xyz[:, :2], written.poses[:, :2], atol=1e-12)


def test_tum_is_ordered_and_a_tilted_pose_keeps_its_yaw(tmp_path):
    half = math.sqrt(0.5)
    (tmp_path / "t").write_text(
        f"# comment\n2.0 1 0 0 0 0 {half} {half}\n\n1.0 0 0 0.5 0.01 0 0 1\n"
    )
    read = read_tum(tmp_path / "t")
    assert read.stamps_ns.tolist() == [10**9, 2 * 10**9]
    assert read.poses[:, 2] == pytest.approx([0.0, math.pi / 2], abs=1e-9)


@pytest.mark.parametrize("line", ["1 2 3", "1 2 3 4 5 6 7 x", "1 0 0 0 0 0 0 0", "x 0 0 0 0 0 0 1"])
def test_a_bad_line_is_named(tmp_path, line):
    (tmp_path / "bad.tum").write_text(f"0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(LogError, match=r"bad\.tum:2: not a TUM pose"):
        read_tum(tmp_path / "bad.tum")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(LogError, match=r"none\.tum: cannot be read"):
        read_tum(tmp_path / "none.tum")


def test_a_trajectory_refuses_what_it_is_not():
    with pytest.raises(ValueError, match="backwards"):
        Trajectory(np.array([2, 1]), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="needs"):
        Trajectory(np.array([1, 2]), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("stamp", "unit"),
    [
        ("1311875572406161000", "nanoseconds"), ("1.3e18", "nanoseconds"),
        ("1311875572406161", "microseconds"), ("1311875572406.161", "milliseconds"),
        ("1311875572406", "milliseconds"),
    ],
)  # fmt: skip
def test_a_stamp_in_another_unit_is_named(tmp_path, stamp, unit):
    path = tmp_path / "ns.tum"
    path.write_text(f"# t x y z\n{stamp} 0 0 0 0 0 0 1\n")
    with pytest.raises(LogError) as caught:
        read_tum(path)
    said = f"{path}:2: stamp {stamp} is no time in seconds ({unit}?)"
    assert str(caught.value) == said


def test_a_mark_of_byte_order_is_no_part_of_the_first_number(tmp_path):
    path = tmp_path / "bom.tum"
    path.write_bytes(b"\xef\xbb\xbf1.5 1 2 0 0 0 0 1\n")
    assert read_tum(path).stamps_ns.tolist() == [1_500_000_000]
