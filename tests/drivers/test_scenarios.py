import numpy as np
import pytest
from slam.drivers.simulators.drive import BASE_T_LASER
from slam.drivers.simulators.paper_bed import BedConfig, paper_bed
from slam.drivers.simulators.robot import drive
from slam.drivers.simulators.worlds import SCENARIOS, scenario

LOOPS = ("office", "office-ring", "symmetric-corridors", "clutter", "mixed")
REVERSING = ("corridor", *LOOPS)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_robot_never_comes_near_a_wall(name, seed):
    place = scenario(name, seed)
    truth = drive(place.path)
    poses = truth.poses[::10]
    assert place.world.clearance(poses[:, :2]).min() >= 0.3
    noses = poses[:, :2] + BASE_T_LASER.x() * np.column_stack(
        [np.cos(poses[:, 2]), np.sin(poses[:, 2])]
    )
    assert place.world.clearance(noses).min() >= 0.2


@pytest.mark.parametrize("name", SCENARIOS)
def test_geometry_is_the_seeds(name):
    same = [scenario(name, seed).world.segments for seed in (4, 4, 5)]
    np.testing.assert_array_equal(same[0], same[1])
    assert not np.array_equal(same[0], same[2])


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_comes_back_to_a_place_it_left_long_before(name):
    xy = drive(scenario(name).path).poses[::25, :2]
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    assert np.any((apart < 0.5) & (gone[None] - gone[:, None] > 35.0))


@pytest.mark.parametrize("name", REVERSING)
def test_a_piece_is_driven_in_reverse(name):
    forward = drive(scenario(name).path).increments[:, 0]
    assert -forward[forward < 0.0].sum() > 1.5


def test_office_ring_is_driven_twice():
    truth = drive(scenario("office-ring").path)
    around = np.unwrap(np.arctan2(truth.poses[:, 1] - 12.5, truth.poses[:, 0] - 20.0))
    assert around[-1] - around[0] >= 2.0 * 2.0 * np.pi - 0.1


def test_symmetric_corridors_map_onto_themselves_by_half_a_turn():
    walls = scenario("symmetric-corridors").world.segments.reshape(-1, 2, 2)
    middle = walls.reshape(-1, 2).mean(axis=0)
    turned = 2.0 * middle - walls

    def ends(segments):
        return sorted(tuple(sorted(map(tuple, np.round(s, 6) + 0.0))) for s in segments)

    assert ends(turned) == ends(walls)


def test_nothing_in_the_hall_is_longer_than_a_crate():
    walls = scenario("clutter").world.segments
    assert np.hypot(*(walls[:, 2:] - walls[:, :2]).T).max() < 0.8


def test_an_unknown_scenario_is_named_with_the_known_ones():
    with pytest.raises(ValueError, match=r"cluter.*office-ring"):
        scenario("cluter")


def test_boards_leave_the_lane_free_and_end_where_the_plain_wall_begins():
    bed = BedConfig(ahead=25.0)
    walls = paper_bed(8.78, bed, np.random.default_rng(0)).segments
    assert np.abs(walls[:, [1, 3]]).min() >= 0.5 * bed.width - bed.depth_max
    plain = walls[(walls[:, 2] - walls[:, 0] > 5.0) & (np.abs(walls[:, 1]) == 1.0)]
    assert len(plain) == 2
    assert plain[:, 0].min() >= 8.78 + bed.beyond
    open_ended = paper_bed(8.78, BedConfig(end_wall=False), np.random.default_rng(0)).segments
    assert len(open_ended) == len(walls) - 1


def test_a_bed_that_blocks_the_lane_is_refused():
    with pytest.raises(ValueError, match=r"0\.4 m"):
        BedConfig(depth_max=0.7)
    with pytest.raises(ValueError, match="does not fit"):
        paper_bed(8.78, BedConfig(ahead=5.0), np.random.default_rng(0))
