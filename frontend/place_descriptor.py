"""Recognises places by their shape, whatever the robot's estimate of its own pose.

A place is a submap: the keyframes along a stretch of path, seen from one of them.  It is drawn
in polar bins about that centre (Scan Context, Kim and Kim 2018, has a single scan's heights in
them; here a bin is occupied, free or never seen).  Two places are compared by the circular
correlation of their bins over the heading, all headings at once through the Fourier transform.
A bin that one of them has not seen adds nothing, so that a robot that comes back the other way,
with a laser that looks ahead only, is compared over what both stretches have seen.

The submap reaches beyond what one scan sees, and lies on both sides of its centre: the place is
described once the robot is `ahead` metres further.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.place_kernels import centred_bins, compare, draw_scan, tables
from slam.frontend.scan import PreparedScan

Spectrum = NDArray[np.float32]  # (2, rings, harmonics) real and imaginary parts

ROOM = 64  # places that an empty index has room for
TRACED_SPACING = 0.05  # rad between beams that mark free space: half a bin, about


class PlaceConfig(NamedTuple):
    """What a place is; the figures follow from the reach of a laser and the length of its view."""

    radius: float = 20.0  # m about the centre; as far as the path behind it and a scan reach
    rings: int = 20  # of the radius: as wide as places are apart
    sectors: int = 64  # of the full turn: 1 m wide at half the radius
    harmonics: int = 20  # of the sectors that are compared
    behind: float = 14.0  # m of path before the centre in a submap
    ahead: float = 6.0  # m of path after the centre in a submap
    every_m: float = 1.0  # m of path between two places
    scan_m: float = 1.2  # m between two scans of a submap
    scan_turn: float = 0.5  # rad between two scans of a submap


class Recognised(NamedTuple):
    """A place that resembles the query."""

    place: int  # in the order in which they were added
    turn: float  # rad, heading of the query in the place's frame, within half a turn
    score: float  # correlation, 1 for the same bins


def thinned(poses: Sequence[Pose2], config: PlaceConfig) -> list[int]:
    """The scans of a stretch that a submap is drawn from: the first, and each that adds to it."""
    kept: list[int] = []
    for k, pose in enumerate(poses):
        if kept:
            moved = poses[kept[-1]].between(pose)
            way = math.hypot(moved.x(), moved.y()) / config.scan_m
            if way + abs(moved.theta()) / config.scan_turn < 1.0:
                continue
        kept.append(k)
    return kept


def describe(scans: Sequence[tuple[Pose2, PreparedScan]], config: PlaceConfig) -> Spectrum:
    """Descriptor of a submap; poses are centre_T_scan."""
    ring = config.radius / config.rings
    half = int(np.ceil(config.radius / ring)) + 1
    free = np.zeros((2 * half, 2 * half), dtype=np.uint8)
    occupied = np.zeros((config.rings, config.sectors), dtype=np.uint8)
    for pose, scan in scans:
        stride = max(1, int(TRACED_SPACING / scan.geometry[1]))
        draw_scan(
            scan.points, stride, scan.geometry[2], scan.geometry[3],
            pose.x(), pose.y(), pose.theta(), ring, free, occupied,
        )  # fmt: skip
    bins = np.empty((config.rings, config.sectors))
    centred_bins(free, occupied, bins)
    spectrum = np.fft.rfft(bins, axis=1)[:, 1 : config.harmonics + 1]
    # Both halves of the spectrum make up the correlation, of which only one is kept.
    length = np.sqrt(2.0 * np.sum(spectrum.real**2 + spectrum.imag**2))
    if length > 0.0:
        spectrum /= length
    return np.stack([spectrum.real, spectrum.imag]).astype(np.float32)


@lru_cache(maxsize=8)
def _tables(harmonics: int, sectors: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    cosines, sines = tables(harmonics, sectors)
    return 2 * cosines, 2 * sines


class PlaceIndex:
    """Descriptors of all places so far, compared with one at a time."""

    def __init__(self, config: PlaceConfig) -> None:
        self.config = config
        self._count = 0
        self._spectra = self._room(ROOM)

    def __len__(self) -> int:
        return self._count

    def _room(self, places: int) -> NDArray[np.float32]:
        return np.zeros((2, places, self.config.rings, self.config.harmonics), dtype=np.float32)

    def add(self, descriptor: Spectrum) -> None:
        """Append a place."""
        if self._count == self._spectra.shape[1]:
            larger = self._room(2 * self._count)
            larger[:, : self._count] = self._spectra
            self._spectra = larger
        self._spectra[:, self._count] = descriptor
        self._count += 1

    def descriptor(self, place: int) -> Spectrum:
        """The descriptor of a place."""
        return self._spectra[:, place]

    def correlate(
        self, query: Spectrum, first: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Score and turn (in sectors) of the first so many places against a query."""
        cosines, sines = _tables(self.config.harmonics, self.config.sectors)
        scores, turns = np.empty(first, dtype=np.float32), np.empty(first, dtype=np.int64)
        work = np.empty((2, self.config.harmonics), dtype=np.float32)
        curve = np.empty(self.config.sectors, dtype=np.float32)
        real, imaginary = self._spectra[0, :first], self._spectra[1, :first]
        compare(query[0], query[1], real, imaginary, cosines, sines, work, curve, scores, turns)
        return scores, turns

    def recognise(self, query: Spectrum, first: int, count: int, apart: int) -> list[Recognised]:
        """The best `count` of the first so many places, the best first; ties go to the older.

        Neighbours of one already taken, up to `apart` places off, are left out.
        """
        if first <= 0:
            return []
        scores, turns = self.correlate(query, first)
        found: list[Recognised] = []
        taken = np.zeros(first, dtype=bool)
        step = 2 * np.pi / self.config.sectors
        for k in np.argsort(-scores, kind="stable").tolist():
            if taken[k]:
                continue
            turn = float(np.remainder(turns[k] * step + np.pi, 2 * np.pi) - np.pi)
            found.append(Recognised(k, turn, float(scores[k])))
            taken[max(0, k - apart) : k + apart + 1] = True
            if len(found) == count:
                break
        return found
