"""Messages in, scans out, each with where the odometry has the robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from slam.frontend.deskew import deskew
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry
from slam.mapping.calibration import Corrector
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Preparer
from slam.mapping.laser_odometry import LaserOdometry
from slam.mapping.scan_checks import BeamTiming, NothingCode
from slam.mapping.scan_sync import ScanSync, ScanWithOdometry, StampedScan, next_stamped_scan
from slam.mapping.sweep_timing import SweepTiming


class ScanFeed:
    """Pairs scans with odometry as mapping does; without any, the laser alone stands in for it.

    Of a drive however long it holds what waits and the last scan.
    """

    def __init__(self, config: SlamConfig, prepare: Preparer) -> None:
        self._config, self._prepare = config, prepare
        self._corrected = Corrector(config.calibration)
        self._timing, self._nothing_code = BeamTiming(), NothingCode()
        self._sweeps = SweepTiming(config.matcher, prepare)
        self._sync = ScanSync(config.scan.deskew)
        use = config.odometry.use
        self._laser_odometry = None if use else LaserOdometry(config, prepare)
        self._last: StampedScan | None = None
        self._count = 0
        self.extrinsics = config.calibration.mount(LaserExtrinsics(0, 0.0, 0.0, 0.0))
        self.lost: Counter[str] = Counter()  # data that could not be used, per cause

    @property
    def laser_only(self) -> bool:
        """The motion comes from the scans alone."""
        return self._laser_odometry is not None

    def take(self, message: Message) -> Iterator[StampedScan]:
        """Take in one message, in the order of the log; yield the scans that are ready now."""
        message = self._corrected(message)
        if isinstance(message, LaserScan):
            scan = self._timing.checked(message) if self._config.scan.deskew else message
            self._sync.add_scan(self._nothing_code.removed(scan))
        elif isinstance(message, WheelOdometry):
            if self._laser_odometry is None and not self._sync.add_odometry(message):
                self.lost["odometry with a stamp that runs backwards"] += 1
        elif isinstance(message, LaserExtrinsics):
            self.extrinsics = message
        else:
            return
        yield from self._ready(wait=True)

    def finish(self) -> Iterator[StampedScan]:
        """No more messages will come: yield the scans that still wait."""
        self._sync.finish()
        yield from self._ready(wait=False)

    def _ready(self, wait: bool) -> Iterator[StampedScan]:
        while (paired := self._next(wait)) is not None:
            if paired.late:
                self.lost["scan without odometry in time"] += 1
            if self._last is not None and paired.scan.stamp_ns <= self._last.scan.stamp_ns:
                self.lost["scan with a stamp that runs backwards"] += 1
                continue
            scan = paired.scan
            if self._config.scan.deskew:
                self._sweeps.watch(scan, self.extrinsics, paired.odom_T_base, paired.moved)
                scan = deskew(scan, self.extrinsics, paired.moved, self._sweeps.order)
            self._last = next_stamped_scan(
                scan, paired.odom_T_base, self._count, self._last, paired.unknown_s,
                paired.broken_s,
            )  # fmt: skip
            self._count += 1
            yield self._last

    def _next(self, wait: bool) -> ScanWithOdometry | None:
        if self._laser_odometry is None:
            paired = self._sync.next(wait)
            if paired is None or self._sync.has_odometry:
                return paired
            self._laser_odometry = LaserOdometry(self._config, self._prepare)
            scan: LaserScan | None = paired.scan
        else:
            scan = self._sync.pop()
        if scan is None:
            return None
        return self._laser_odometry.place(scan, self.extrinsics, self._sweeps.order)
