"""What a match will know: foreseen from one scan, held against matches that were made."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LASERS, LaserConfig, take_scan
from slam.drivers.simulators.robot import drive
from slam.drivers.simulators.world import World
from slam.drivers.simulators.worlds import scenario
from slam.frontend.information import (
    CHAIN_CORRELATION,
    PredictionModel,
    best_distance,
    best_turn,
    distance_of_overlap,
    informations,
)
from slam.frontend.keyframes import KeyframeConfig
from slam.frontend.match_types import MatchConfig, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

from benchmarks.keyframe_interval.drives import permuted
from slam.mapping.odometry import OdometryConfig

MOUNT = LaserExtrinsics(0, 0.0, 0.0, 0.0)
SCAN, MATCH, ODOMETRY = ScanConfig(), MatchConfig(), OdometryConfig()
PLAIN = World(np.array([[-40.0, 1.5, 40.0, 1.5], [-40.0, -1.5, 40.0, -1.5]]))
ONE_WALL = World(PLAIN.segments[:1])
GLASS = World(PLAIN.segments[:1], panes=PLAIN.segments[1:])
SPEED = 0.6  # m/s
SLACK = KeyframeConfig().open.tolerance


def odometry(metres, radians=0.0):
    seconds = metres / SPEED if metres else np.inf
    return ODOMETRY.covariance(metres, radians, seconds)


def model(scale=1.0):
    unit = np.diag([scale, scale, 1.0])
    return PredictionModel(
        lambda metres, radians: unit @ odometry(metres / scale, radians) @ unit,
        6,
        scale * MATCH.range_noise,
        CHAIN_CORRELATION,
        SCAN.gap_ratio,
        SLACK,
    )


def laser_of(beams, field=np.pi, **settings):
    step = field / (beams - 1)
    return LaserConfig(beams=beams, angle_min=-0.5 * field, angle_step=step, **settings)


def seen(world, pose=None, laser=LASERS["hokuyo-181"], seed=0):
    raw = take_scan(world, pose or Pose2(), laser, np.random.default_rng(seed))
    return prepare(raw, MOUNT, SCAN)


def places(name, count, seed=0):
    """Scans on the way through a world, and where they were taken."""
    place = scenario(name, seed)
    track = drive(place.path)
    poses = [Pose2(*p) for p in track.at(np.linspace(0.05, 0.9, count) * track.duration_s)]
    return place.world, [(pose, seen(place.world, pose, seed=k)) for k, pose in enumerate(poses)]


def distance(scan, direction=0.0, ahead=None, shortest=0.1, longest=3.0):
    return best_distance(scan, direction, shortest, longest, ahead or model()).distance


@pytest.mark.parametrize("name", ["office", "clutter"])
@pytest.mark.parametrize("metres", [0.1, 0.4, 1.0])
def test_what_is_foreseen_is_what_matches_achieve(name, metres):
    world, scans = places(name, 12)
    ratios, beams = [], []
    for k, (pose, scan) in enumerate(scans):
        step = Pose2(metres, 0.0, 0.0)
        later = seen(world, pose * step, seed=100 + k)
        prior = Prior(step, odometry(metres))
        made = match([Reference(Pose2(), scan)], later, step, MATCH, prior)
        known, pairs = informations(scan, np.array([[metres, 0.0, 0.0]]), model())
        known = known[0] + np.linalg.inv(prior.covariance)
        ratios.append(np.sqrt(np.diag(np.linalg.inv(known))) / made.sigmas)
        beams.append(pairs[0] / (made.overlap * later.valid))
    np.testing.assert_allclose(np.median(ratios, axis=0), 1.0, atol=0.2)
    assert np.median(beams) == pytest.approx(1.0, abs=0.1)


def test_normals_of_other_beams_foresee_nothing():
    """The counter-test: what the foresight knows, it knows from each point's own normal."""
    world, scans = places("mixed", 40)
    rng, metres = np.random.default_rng(0), 0.8
    step, prior = Pose2(metres, 0.0, 0.0), Prior(Pose2(metres, 0.0, 0.0), odometry(metres))
    made, own, shuffled = [], [], []
    for k, (pose, scan) in enumerate(scans):
        later = seen(world, pose * step, seed=100 + k)
        made.append(match([Reference(Pose2(), scan)], later, step, MATCH, prior).sigmas)
        for kept, used in ((own, scan), (shuffled, permuted(scan, rng))):
            known = informations(used, np.array([[metres, 0.0, 0.0]]), model())[0][0]
            total = known + np.linalg.inv(prior.covariance)
            kept.append(np.sqrt(np.diag(np.linalg.inv(total))))
    made, own, shuffled = (np.log(np.array(values)) for values in (made, own, shuffled))
    for axis in range(3):
        right = np.median(np.abs(own[:, axis] - made[:, axis]))
        wrong = np.median(np.abs(shuffled[:, axis] - made[:, axis]))
        assert right < 0.2
        assert wrong > 1.5 * right


@pytest.mark.parametrize("turn", [0.7, np.pi / 2, 3.0])
@pytest.mark.parametrize("name", ["office", "clutter"])
def test_a_turned_world_changes_nothing(name, turn):
    """The laser is mounted askew by `turn` and the robot drives where the laser looks."""
    round_odometry = PredictionModel(
        lambda metres, radians: np.diag([0.05, 0.05, 0.03]) ** 2 * metres, 6, MATCH.range_noise,
        CHAIN_CORRELATION, SCAN.gap_ratio, SLACK,
    )  # fmt: skip
    world, scans = places(name, 4)
    for k, (pose, scan) in enumerate(scans):
        raw = take_scan(world, pose, LASERS["hokuyo-181"], np.random.default_rng(k))
        askew = prepare(raw, LaserExtrinsics(0, 0.0, 0.0, turn), SCAN)
        straight = distance(scan, 0.0, round_odometry)
        assert distance(askew, turn, round_odometry) == pytest.approx(straight, rel=1e-6)


@pytest.mark.parametrize("name", ["office", "clutter", "mixed"])
def test_a_mirrored_world_changes_nothing(name):
    """Lines are fitted from one end of a scan to the other, so each may differ a little."""
    world, scans = places(name, 12)
    ratios, mirror = [], np.array([1.0, -1.0, -1.0])
    for k, (pose, scan) in enumerate(scans):
        raw = take_scan(world, pose, LASERS["hokuyo-181"], np.random.default_rng(k))
        last = raw.angle_min + raw.angle_step * (len(raw.ranges) - 1)
        swapped = LaserScan(raw.stamp_ns, -last, raw.angle_step, raw.ranges[::-1].copy())
        poses = np.array([[0.5, 0.1, 0.05]])
        there = informations(scan, poses, model())[0][0]
        here = informations(prepare(swapped, MOUNT, SCAN), poses * mirror, model())[0][0]
        ratios.append(np.diag(np.linalg.inv(here)) / np.diag(np.linalg.inv(there)))
    np.testing.assert_allclose(np.median(ratios, axis=0), 1.0, atol=0.05)


@pytest.mark.parametrize("scale", [0.25, 4.0])
@pytest.mark.parametrize("name", ["office", "clutter"])
def test_a_larger_world_with_larger_noise_has_longer_intervals(name, scale):
    world, scans = places(name, 4)
    for k, (pose, scan) in enumerate(scans):
        raw = take_scan(world, pose, LASERS["hokuyo-181"], np.random.default_rng(k))
        larger = LaserScan(0, raw.angle_min, raw.angle_step, raw.ranges * np.float32(scale))
        config = SCAN.model_copy(
            update={"range_noise": scale * SCAN.range_noise, "max_range": 1000.0}
        )
        found = distance(
            prepare(larger, MOUNT, config), 0.0, model(scale), 0.1 * scale, 3.0 * scale
        )
        assert found == pytest.approx(scale * distance(scan), rel=1e-6)


@pytest.mark.parametrize("name", ["office", "testbed"])
def test_the_number_of_beams_hardly_matters(name):
    """More beams know more, but lose it at the same distance, once they resolve what is there."""
    place = scenario(name, 0)
    track = drive(place.path)
    poses = track.at(np.linspace(0.1, 0.8, 12) * track.duration_s)
    found = {}
    for beams in (361, 721, 1081):
        scans = [seen(place.world, Pose2(*pose), laser_of(beams)) for pose in poses]
        found[beams] = np.exp(np.mean([np.log(distance(scan)) for scan in scans]))
    assert max(found.values()) / min(found.values()) < 1.35


@pytest.mark.parametrize("name", ["office", "clutter", "plain-corridor"])
def test_the_more_slack_the_longer_the_intervals(name):
    _, scans = places(name, 8)
    found = [
        np.array([distance(s, ahead=replace(model(), tolerance=tolerance)) for _, s in scans])
        for tolerance in (0.0, 0.05, 0.1, 0.5)
    ]
    for shorter, longer in pairwise(found):
        assert (longer >= shorter).all()
        assert longer.mean() > shorter.mean()


def test_a_corridor_names_the_axis_that_it_does_not_tell():
    _, scans = places("plain-corridor", 8)
    found = [best_distance(scan, 0.0, 0.1, 3.0, model()) for _, scan in scans]
    assert {prediction.axis for prediction in found} == {"x"}
    assert all(f.sigmas[0] > 5.0 * f.sigmas[1] for f in found)


@pytest.mark.parametrize("world", [PLAIN, ONE_WALL, GLASS, World()])
@pytest.mark.parametrize("direction", [0.0, np.pi])
def test_the_distance_stays_within_its_limits_whatever_is_seen(world, direction):
    scan = seen(world)
    found = best_distance(scan, direction, 0.1, 3.0, model())
    assert 0.1 <= found.distance <= 3.0 + 1e-9
    assert np.isfinite(found.sigmas).all()
    assert 0.1 <= best_turn(scan, 0.1, 1.0, model()) <= 1.0 + 1e-9
    assert 0.1 <= distance_of_overlap(scan, direction, 0.1, 3.0, 0.7, model()) <= 3.0 + 1e-9


def test_the_overlap_shrinks_the_farther_one_goes_and_reversing_loses_it_sooner():
    _, scans = places("office", 6)
    for _, scan in scans:
        reach = [distance_of_overlap(scan, 0.0, 0.05, 6.0, s, model()) for s in (0.9, 0.7, 0.5)]
        assert reach == sorted(reach)


@pytest.mark.parametrize("name", ["office", "clutter"])
def test_a_narrower_view_is_turned_away_from_sooner(name):
    place = scenario(name, 0)
    track = drive(place.path)
    found = {}
    for field in (0.5 * np.pi, np.pi, 1.5 * np.pi):
        laser = laser_of(round(1 + field / 0.0175), field)
        poses = track.at(np.linspace(0.1, 0.8, 12) * track.duration_s)
        turns = [best_turn(seen(place.world, Pose2(*p), laser), 0.1, 2.0, model()) for p in poses]
        found[field] = np.exp(np.mean(np.log(turns)))
    assert sorted(found, key=found.__getitem__) == sorted(found)


def test_the_side_where_less_is_known_decides_how_far_to_turn():
    """All stands on one side: mirrored, the same turn is chosen; with both sides, a wider one."""
    corner = World(np.array([[0.5, 2.0, 6.0, 2.0], [6.0, 2.0, 6.0, 0.5]]))
    mirrored = World(corner.segments * np.array([1.0, -1.0, 1.0, -1.0]))
    both = World.joined([corner, mirrored])
    one, other, wide = (best_turn(seen(w), 0.1, 2.0, model()) for w in (corner, mirrored, both))
    assert one == pytest.approx(other, rel=0.1)
    assert wide > 1.1 * one


def test_a_full_turn_of_beams_wraps_around():
    """The wall behind, where the scan begins and ends, is seen as well as the one ahead."""
    room = World.from_polygon([(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0)])
    laser = LaserConfig(beams=360, angle_min=-np.pi, angle_step=np.pi / 180)
    ahead, behind = (
        informations(seen(room, laser=laser), np.array([[x, 0.0, 0.0]]), model())
        for x in (0.5, -0.5)
    )
    assert ahead[1][0] == pytest.approx(360, abs=12)
    np.testing.assert_allclose(np.diag(ahead[0][0]), np.diag(behind[0][0]), rtol=0.1)
