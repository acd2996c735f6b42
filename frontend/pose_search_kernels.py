"""Numba kernel of the search for a pose anywhere in a map."""

from __future__ import annotations

from slam.frontend.compiled import bare_kernel


@bare_kernel
def score_poses(field, positions, offsets, scores):
    """Mean likelihood of points at every position and heading.

    Args:
        field: (cells,) float32, row by row, so wide that no point falls outside.
        positions: (m,) int32 cells.
        offsets: (headings, n) int32 cells from a position to each point, turned by each heading.
        scores: (m, headings) float32, filled.
    """
    headings, count = offsets.shape
    for k in range(len(positions)):
        at = positions[k]
        for a in range(headings):
            total = field[0] * 0
            for i in range(count):
                total += field[at + offsets[a, i]]
            scores[k, a] = total / count
