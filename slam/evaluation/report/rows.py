"""Charts with a named row for each thing: bars with whiskers, and events along a path."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from slam.evaluation.report.svg import WIDTH, Values, figure, ticks

_LEFT, _RIGHT, _TOP, _BOTTOM = 190, 14, 8, 40  # px; names stand left of the axis
_ROW = 24  # px
_LONGEST = 26  # letters of a name


def bar_chart(names: Sequence[str], values: Values, halves: Values, x_label: str) -> Markup:
    """Draw a bar for each name, with a whisker where half the width of an interval is known."""
    good = np.isfinite(values)
    if not good.any():
        return Markup("")
    reach = np.where(np.isfinite(halves), values + halves, values)
    axis = _Axis(len(names), 0.0, 1.05 * float(reach[good].max()) or 1.0)
    parts = axis.frame(x_label)
    for k, (name, value, half) in enumerate(zip(names, values, halves, strict=True)):
        parts.append(axis.name(k, name))
        if math.isfinite(value):
            parts.append(
                Markup('<path class="bars" d="M{} {:.1f}H{:.1f}v{:.1f}H{}z"/>').format(
                    _LEFT, axis.y(k, 0.15), axis.x(value), 0.7 * _ROW, _LEFT
                )
            )
        if math.isfinite(half):
            low, high = axis.x(max(value - half, 0.0)), axis.x(value + half)
            parts.append(
                Markup(
                    '<path class="whisker" d="M{0:.1f} {2:.1f}v8M{1:.1f} {2:.1f}v8'
                    'M{0:.1f} {3:.1f}H{1:.1f}"/>'
                ).format(low, high, axis.y(k, 0.5) - 4, axis.y(k, 0.5))
            )
    return figure(parts, axis.height)


def strip_chart(rows: Sequence[tuple[str, Values]], end: float, x_label: str) -> Markup:
    """Draw when each kind of event happened, from 0 to `end`."""
    if not rows or end <= 0.0:
        return Markup("")
    axis = _Axis(len(rows), 0.0, end)
    parts = axis.frame(x_label)
    for k, (name, at) in enumerate(rows):
        places = np.unique(np.round([axis.x(value) for value in at], 1))
        d = "".join(f"M{x:g} {axis.y(k, 0.2):g}v{0.6 * _ROW:g}" for x in places)
        parts += [axis.name(k, name), Markup('<path class="events" d="{}"/>').format(d)]
    return figure(parts, axis.height)


class _Axis:
    """Rows from the top, values from `low` to `high` across."""

    def __init__(self, rows: int, low: float, high: float) -> None:
        self._rows, self._low, self._high = rows, low, high
        self.height = _TOP + _ROW * rows + _BOTTOM

    def x(self, value: float) -> float:
        share = (value - self._low) / (self._high - self._low)
        return _LEFT + share * (WIDTH - _LEFT - _RIGHT)

    def y(self, row: int, share: float) -> float:
        return _TOP + _ROW * (row + share)

    def name(self, row: int, name: str) -> Markup:
        short = name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "\N{HORIZONTAL ELLIPSIS}"
        return Markup('<text class="y" x="{}" y="{:.1f}"><title>{}</title>{}</text>').format(
            _LEFT - 6, self.y(row, 0.68), name, short
        )

    def frame(self, label: str) -> list[Markup]:
        base, end = self.y(self._rows, 0.0), WIDTH - _RIGHT
        parts = [
            Markup(
                '<path class="tick" d="M{0:.1f} {1}v4"/>'
                '<text class="x" x="{0:.1f}" y="{2}">{3:g}</text>'
            ).format(self.x(value), base, base + 16, value)
            for value in ticks((self._low, self._high), 5)
        ]
        parts.append(
            Markup(
                '<path class="axis" d="M{} {}H{}"/><text class="x label" x="{}" y="{}">{}</text>'
            ).format(_LEFT, base, end, (_LEFT + end) / 2, self.height - 6, label)
        )
        return parts
