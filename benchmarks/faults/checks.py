"""What every run with faults must satisfy; each function returns what is wrong, in words."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from slam.drivers.simulators.drive import EPOCH_NS
from slam.logs.mcap_log import open_log
from slam.logs.messages import LaserScan, WheelOdometry

from benchmarks.faults.drive import STARTS_S, FaultyDrive
from slam.mapping.slam import Slam
from slam.online.sequencer import MessageSequencer
from slam.runs.offline import Result

SCAN_S = 0.025
SPEED = 0.6  # m/s, the fastest that the simulated robot drives
LATE_S = 0.25  # a report can be stamped so late: delay, merging and its time on the line


def differences(live: Slam, again: Slam) -> list[str]:
    """In what a live run and the replay of its log differ; they must not, by a single bit."""
    pairs = {
        "stamps": (live.scans.stamps_ns.tobytes(), again.scans.stamps_ns.tobytes()),
        "odometry": (live.scans.odom_poses.tobytes(), again.scans.odom_poses.tobytes()),
        "decisions": (repr(live.records.decisions), repr(again.records.decisions)),
        "factors": (repr(live.records.factors), repr(again.records.factors)),
        "closure results": (repr(live.loops.closure_results), repr(again.loops.closure_results)),
        "live poses": (repr(live.records.estimates), repr(again.records.estimates)),
        "graph": (_graph_bytes(live), _graph_bytes(again)),
        "losses": (live.lost, again.lost),
    }
    return [f"{name}: differ in the replay" for name, (a, b) in pairs.items() if a != b]


def _graph_bytes(slam: Slam) -> bytes:
    """All numbers of the graph."""
    if slam.graph is None:
        return b""
    edges = [
        np.array([e.i, e.j, e.i_T_j.x(), e.i_T_j.y(), e.i_T_j.theta(), *e.information.ravel()])
        for e in slam.graph.edges
    ]
    return slam.graph.poses.tobytes() + b"".join(edge.tobytes() for edge in edges)


def wrong_scans(drive: FaultyDrive) -> list[str]:
    """Scans that the sensor has never measured."""
    scans = drive.laser.messages(LaserScan)
    bad = sum(scan.ranges.tobytes() not in drive.sweeper.sent for scan in scans)
    return [f"{bad} scans were never measured"] if bad else []


def wrong_odometry(drive: FaultyDrive) -> list[str]:
    """Steps of the odometry that the wheels did not make.

    A report may come late, so it may differ by what the robot drives meanwhile.  When the
    robot's own count starts again, its motion since is unknown: that step is missing.
    """
    odometry = drive.robot.messages(WheelOdometry)
    bad = 0
    for a, b in pairwise(odometry):
        begin, end = ((m.stamp_ns - EPOCH_NS) * 1e-9 for m in (a, b))
        x0, y0, _ = drive.motion.odometry(begin)
        x1, y1, _ = drive.motion.odometry(end)
        reported, true = np.hypot(b.x - a.x, b.y - a.y), np.hypot(x1 - x0, y1 - y0)
        restarted = reported == 0.0 and drive.robot.counters["odometry_restarts"]
        bad += bool(abs(reported - true) > SPEED * LATE_S and not restarted)
    return [f"{bad} steps of odometry that the wheels did not make"] if bad else []


def scans_lost(counters: Mapping[str, int]) -> int:
    """All scans that a laser's counters count as lost."""
    return sum(
        n for cause, n in counters.items()
        if cause.startswith("lost_") or cause in ("missing_scans", "outage_scans")
    )  # fmt: skip


def wrong_counts(drive: FaultyDrive, sequencer: MessageSequencer, log: Path) -> list[str]:
    """Counters that differ from what has happened on the wires."""
    laser, robot = drive.laser, drive.robot
    scans = laser.messages(LaserScan)
    found = []
    lost = scans_lost(laser.counters)
    measured = [drive.sweeper.sent.get(scan.ranges.tobytes(), 0.0) for scan in scans]
    due = round((measured[-1] - measured[0]) * drive.head.build.clock_rate / SCAN_S) + 1
    if abs(len(scans) + lost - due) > laser.counters["clock_restarts"] - 1:
        found.append(f"{len(scans)} scans came and {lost} count as lost, but {due} were due")
    if laser.counters["scans"] != len(scans) or sequencer.scans != len(scans):
        found.append("scans: counted otherwise than handed over")
    if robot.counters["reports"] != len(robot.messages(WheelOdometry)):
        found.append("reports: counted otherwise than handed over")
    if robot.counters["reports"] > drive.base.reports:
        found.append("reports: more than were sent")
    with open_log(log) as opened:
        counts = opened.counts()
    if counts.get("/scan", 0) != len(scans) or sequencer.unrecorded.total():
        found.append("scans: not all of them are in the log")
    for name, reading in (("laser", laser), ("robot", robot)):
        skipped = reading.counters["skipped_bytes"] + reading.counters.get("bad_checksums", 0)
        if skipped and not reading.line.damaged_bytes and not reading.line.dropped_bytes:
            found.append(f"{name}: {skipped} damages counted on a sound line")
        if reading.outages > reading.connections:
            found.append(f"{name}: more outages than connections")
    return found


def stamp_errors_ms(drive: FaultyDrive) -> NDArray[np.float64]:
    """By how much the scans' stamps are late, (n,) ms."""
    scans = drive.laser.messages(LaserScan)
    measured = np.array([drive.sweeper.sent.get(scan.ranges.tobytes(), 0.0) for scan in scans])
    late = np.array([scan.stamp_ns - EPOCH_NS for scan in scans]) * 1e-9 - measured
    return np.asarray(1e3 * late, np.float64)


def longest_outage_s(drive: FaultyDrive) -> float:
    """The longest time without odometry, or without scans, while the robot drove."""
    gaps = []
    for times in (
        [r.receipt_ns for r in drive.robot.received if isinstance(r.message, WheelOdometry)],
        [r.receipt_ns for r in drive.laser.received if isinstance(r.message, LaserScan)],
    ):
        seconds = (np.array(times) - EPOCH_NS) * 1e-9
        before, after = seconds[seconds < STARTS_S], seconds[seconds >= STARTS_S]
        begin = before[-1] if len(before) else STARTS_S
        gaps.append(np.diff([begin, *after, drive.until_s]).max())
    return float(max(gaps))


def hang_s(drive: FaultyDrive) -> float:
    """How long the slower thread went on after it should have ended."""
    return max(drive.robot.ended_s, drive.laser.ended_s) - drive.until_s


def error_m(drive: FaultyDrive, result: Result) -> float:
    """Root mean square distance from the truth after the best rigid fit, over all scans, m."""
    stamps, poses = result.trajectory.stamps_ns, result.trajectory.poses
    seconds = (stamps - EPOCH_NS).astype(np.float64) * 1e-9
    truth = drive.motion.truth(seconds)[:, :2]
    here, there = poses[:, :2] - poses[:, :2].mean(0), truth - truth.mean(0)
    u, _, v = np.linalg.svd(here.T @ there)
    turn = u @ np.diag([1.0, np.sign(np.linalg.det(u @ v))]) @ v
    return float(np.sqrt(((here @ turn - there) ** 2).sum(1).mean()))
