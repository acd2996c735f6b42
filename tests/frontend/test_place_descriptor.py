"""Place recognition: the same submap is found again at any heading, and nothing else matters."""

import math
from itertools import pairwise

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LaserConfig, take_scan
from slam.drivers.simulators.worlds import scenario
from slam.frontend.place_descriptor import PlaceConfig, PlaceIndex, describe, thinned
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics

CENTRED = LaserExtrinsics(0, 0.0, 0.0, 0.0)
AHEAD = LaserConfig(beams=181, angle_min=-0.5 * math.pi, angle_step=math.pi / 180)
CONFIG = PlaceConfig()
WORLD = scenario("office-ring", 3).world


def submap(poses, centre, noise_seed=0):
    """Scans with a laser that looks ahead only, in the frame of the centre."""
    rng = np.random.default_rng(noise_seed)
    scans = [prepare(take_scan(WORLD, pose, AHEAD, rng), CENTRED, ScanConfig()) for pose in poses]
    return [(centre.between(pose), scan) for pose, scan in zip(poses, scans, strict=True)]


def length(poses):
    return math.dist(poses[0].translation(), poses[-1].translation())


def straight(start, end, steps=12):
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    return [
        Pose2(*(np.array(start) + share * (np.array(end) - start)), heading)
        for share in np.linspace(0, 1, steps)
    ]


@pytest.fixture(scope="module")
def way():
    return [np.array(point) for leg in scenario("office-ring", 3).path for point in leg.points]


@pytest.fixture(scope="module")
def places(way):
    """Submaps along the first pieces of the way, and an index of them."""
    found = []
    for a, b in pairwise(way):
        if np.linalg.norm(b - a) > 4.0 and len(found) < 4:
            found.append(straight(a, b))
    index = PlaceIndex(CONFIG)
    for poses in found:
        index.add(describe(submap(poses, poses[6]), CONFIG))
    return found, index


def test_a_place_is_its_own_best_match(places):
    _, index = places
    for k in range(len(index)):
        best = index.recognise(index.descriptor(k), len(index), 1, 0)[0]
        assert (best.place, best.turn) == (k, 0.0)
        assert best.score == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("turn", [-2.5, -1.0, 0.7, 3.0])
def test_heading_is_found_whatever_it_is(places, turn):
    stretches, index = places
    centre = stretches[1][6] * Pose2(0.0, 0.0, turn)
    query = describe(submap(stretches[1], centre, noise_seed=5), CONFIG)
    best = index.recognise(query, len(index), 1, 0)[0]
    assert best.place == 1
    step = 2 * math.pi / CONFIG.sectors
    assert abs(math.remainder(best.turn - turn, 2 * math.pi)) < step


def test_place_is_recognised_from_the_other_way_by_a_laser_that_looks_ahead(places):
    stretches, index = places
    longest = max(range(len(stretches)), key=lambda k: length(stretches[k]))
    back = [pose * Pose2(0.0, 0.0, math.pi) for pose in reversed(stretches[longest])]
    centre = stretches[longest][6] * Pose2(0.0, 0.0, math.pi)
    query = describe(submap(back, centre, noise_seed=7), CONFIG)
    best = index.recognise(query, len(index), 1, 0)[0]
    assert best.place == longest
    assert abs(abs(best.turn) - math.pi) < math.radians(15)


def test_only_the_first_places_are_asked_and_neighbours_left_out(places):
    _, index = places
    query = index.descriptor(len(index) - 1)
    assert index.recognise(query, 0, 3, 0) == []
    assert {r.place for r in index.recognise(query, 2, 9, 0)} == {0, 1}
    assert len(index.recognise(query, 2, 9, 1)) == 1


def test_ties_go_to_the_older_place(places):
    _, index = places
    twins = PlaceIndex(CONFIG)
    for _ in range(70):  # beyond the room that an index starts with
        twins.add(index.descriptor(0))
    order = [r.place for r in twins.recognise(index.descriptor(0), 70, 70, 0)]
    assert order == list(range(70))


def test_a_submap_of_nothing_resembles_nothing(places):
    _, index = places
    nothing = describe([], CONFIG)
    assert not nothing.any()
    assert all(r.score == 0.0 for r in index.recognise(nothing, len(index), 3, 0))


def test_scans_are_thinned_by_way_and_by_turn():
    rest = [Pose2()] * 5
    assert thinned(rest, CONFIG) == [0]
    turning = [Pose2(0, 0, 0.3 * k) for k in range(5)]
    assert thinned(turning, CONFIG) == [0, 2, 4]
    driving = [Pose2(0.4 * k, 0, 0) for k in range(7)]
    assert thinned(driving, CONFIG) == [0, 3, 6]
