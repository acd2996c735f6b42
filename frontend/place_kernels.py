"""Numba kernels of place recognition: drawing a submap in polar bins, comparing many at once."""

from __future__ import annotations

import math

import numpy as np
from slam.frontend.compiled import bare_kernel

OCCUPIED = 2
FREE = 1


@bare_kernel
def draw_scan(points, beam_stride, origin_x, origin_y, x, y, theta, cell, free, occupied):
    """Draw one scan of a submap, standing at (x, y, theta) in the frame of the centre.

    `free` is a square grid (n, n) of `cell` metres about the centre, marked where each
    `beam_stride`-th beam passed; `occupied` (rings, sectors) is marked where beams ended, with
    rings as wide as a cell.
    """
    c, s = math.cos(theta), math.sin(theta)
    left, top = x + c * origin_x - s * origin_y, y + s * origin_x + c * origin_y
    size, half = len(free), len(free) // 2
    rings, sectors = occupied.shape
    per_radian = sectors / (2 * math.pi)
    for k in range(len(points)):
        if math.isnan(points[k, 0]):
            continue
        px = x + c * points[k, 0] - s * points[k, 1]
        py = y + s * points[k, 0] + c * points[k, 1]
        r = int(math.hypot(px, py) / cell)
        if r < rings:
            sector = math.floor(math.atan2(py, px) * per_radian) % sectors
            occupied[r, sector] = 1
        if k % beam_stride:
            continue
        steps = int(math.hypot(px - left, py - top) / cell)
        dx, dy = (px - left) / (steps + 1) / cell, (py - top) / (steps + 1) / cell
        column, row = left / cell + half, top / cell + half
        for _ in range(steps):
            if column >= 0.0 and row >= 0.0 and column < size and row < size:
                free[int(row), int(column)] = 1
            column += dx
            row += dy


@bare_kernel
def centred_bins(free, occupied, bins):
    """What was seen of each polar bin (rings, sectors), with mean 0 over each ring; 0: unseen.

    The mean goes so that what two submaps have in common counts by how much it exceeds chance;
    rings count by their area, so that a square metre far off is worth one nearby.
    """
    size, half = len(free), len(free) // 2
    rings, sectors = occupied.shape
    for r in range(rings):
        seen, hit = 0, 0
        for a in range(sectors):
            angle = (a + 0.5) * 2 * math.pi / sectors
            column = math.floor((r + 0.5) * math.cos(angle)) + half
            row = math.floor((r + 0.5) * math.sin(angle)) + half
            inside = 0 <= column < size and 0 <= row < size
            bins[r, a] = 0.0
            if occupied[r, a]:
                bins[r, a] = OCCUPIED
                hit += 1
                seen += 1
            elif inside and free[row, column]:
                bins[r, a] = FREE
                seen += 1
        mean = hit / seen if seen else 0.0
        weight = math.sqrt((r + 0.5) / rings)
        for a in range(sectors):
            if bins[r, a] == OCCUPIED:
                bins[r, a] = weight * (1.0 - mean)
            elif bins[r, a] == FREE:
                bins[r, a] = -weight * mean


@bare_kernel
def compare(
    query_real, query_imaginary, real, imaginary, cosines, sines, work, curve, scores, turns
):
    """Best circular correlation over the heading with each of n places, and the turn it is at.

    Spectra are (rings, harmonics) of the query and (n, rings, harmonics) of the places; the
    tables of the inverse transform are (harmonics, turns); `work` (2, harmonics) and `curve`
    (turns,) are scratch.  Sums are taken in a fixed order: equal inputs give equal bits.
    """
    rings, harmonics = query_real.shape
    for k in range(len(scores)):
        for h in range(harmonics):
            work[0, h] = 0.0
            work[1, h] = 0.0
        for r in range(rings):
            for h in range(harmonics):
                a, b = real[k, r, h], imaginary[k, r, h]
                c, d = query_real[r, h], query_imaginary[r, h]
                work[0, h] += a * c + b * d
                work[1, h] += b * c - a * d
        for t in range(len(curve)):
            curve[t] = 0.0
        for h in range(harmonics):
            u, v = work[0, h], work[1, h]
            for t in range(len(curve)):
                curve[t] += u * cosines[h, t] - v * sines[h, t]
        best = 0
        for t in range(1, len(curve)):
            if curve[t] > curve[best]:
                best = t
        scores[k] = curve[best]
        turns[k] = best


def tables(harmonics, sectors):
    """Cosines and sines (harmonics, sectors) of the inverse transform, constant term left out."""
    angles = np.outer(np.arange(1, harmonics + 1), np.arange(sectors)) * (2 * np.pi / sectors)
    return np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
