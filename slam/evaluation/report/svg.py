"""Charts as inline SVG: no library, crisp in print, coloured by the page's own style sheet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

Values = NDArray[np.float64]

WIDTH, _HEIGHT = 560, 220
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 26, 40
_MOST_POINTS = 600  # of a curve: about one a pixel, each with its low and high


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """One line of a chart; `style` names a colour of the style sheet."""

    name: str
    style: str  # "a", "b", "c"
    x: Values
    y: Values


def line_chart(curves: Sequence[Curve], x_label: str, y_label: str) -> Markup:
    """Draw curves over common axes from y = 0 (or lower, where a curve is)."""
    curves = [_thinned(curve) for curve in curves]
    curves = [curve for curve in curves if len(curve.x)]
    if not curves:
        return Markup("")
    x_range = _range([curve.x for curve in curves], zero=False)
    y_range = _range([curve.y for curve in curves], zero=True)
    parts = [_axes(x_range, y_range, x_label, y_label)]
    for curve in curves:
        x, y = _to_pixels(curve.x, x_range, y_range, curve.y)
        parts.append(Markup('<path class="curve {}" d="{}"/>').format(curve.style, svg_path(x, y)))
    if len(curves) > 1:
        parts.append(_legend(curves))
    return figure(parts)


def histogram(values: Values, x_label: str, bins: int = 40) -> Markup:
    """Draw a histogram up to the 99th percentile; what lies beyond is counted in the label."""
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return Markup("")
    end = float(np.percentile(values, 99.0)) or 1e-9
    counts, edges = np.histogram(values, bins=bins, range=(0.0, end))
    beyond = int(np.count_nonzero(values > end))
    label = f"{x_label}   ({beyond} beyond, up to {values.max():.3g})" if beyond else x_label
    x_range, y_range = (0.0, end), (0.0, float(counts.max()) * 1.05 + 1e-9)
    parts = [_axes(x_range, y_range, label, "count")]
    x, top = _to_pixels(edges[:-1], x_range, y_range, counts.astype(np.float64))
    width = (WIDTH - _LEFT - _RIGHT) / bins
    bars = "".join(
        f"M{a:.1f} {_HEIGHT - _BOTTOM}V{b:.1f}h{width - 1:.1f}V{_HEIGHT - _BOTTOM}z"
        for a, b, n in zip(x, top, counts, strict=True)
        if n
    )
    parts.append(Markup('<path class="bars" d="{}"/>').format(bars))
    return figure(parts)


def _thinned(curve: Curve) -> Curve:
    """Keep the lowest and highest point of each stretch, so that no spike is lost."""
    good = np.isfinite(curve.x) & np.isfinite(curve.y)
    x, y = curve.x[good], curve.y[good]
    if len(x) > 2 * _MOST_POINTS:
        edges = np.linspace(0, len(x), _MOST_POINTS + 1).astype(int)
        stretches = [slice(a, b) for a, b in itertools.pairwise(edges)]
        lows = [s.start + int(np.argmin(y[s])) for s in stretches]
        highs = [s.start + int(np.argmax(y[s])) for s in stretches]
        rows = np.unique(lows + highs)
        x, y = x[rows], y[rows]
    return Curve(curve.name, curve.style, x, y)


def _range(arrays: Sequence[Values], zero: bool) -> tuple[float, float]:
    low = min(float(array.min()) for array in arrays)
    high = max(float(array.max()) for array in arrays)
    if zero:
        low, high = min(low, 0.0), high + 0.05 * (high - min(low, 0.0))
    return (low, high) if high - low > 1e-12 else (low, low + 1.0)


def _to_pixels(
    x: Values, x_range: tuple[float, float], y_range: tuple[float, float], y: Values
) -> tuple[Values, Values]:
    across, up = WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    return (
        _LEFT + (x - x_range[0]) / (x_range[1] - x_range[0]) * across,
        _HEIGHT - _BOTTOM - (y - y_range[0]) / (y_range[1] - y_range[0]) * up,
    )


def _axes(
    x_range: tuple[float, float], y_range: tuple[float, float], x_label: str, y_label: str
) -> Markup:
    x_ticks, y_ticks = ticks(x_range, 7), ticks(y_range, 5)
    x, _ = _to_pixels(x_ticks, x_range, y_range, np.zeros_like(x_ticks))
    _, y = _to_pixels(np.zeros_like(y_ticks), x_range, y_range, y_ticks)
    base, end = _HEIGHT - _BOTTOM, WIDTH - _RIGHT
    parts = [
        Markup(
            '<path class="grid" d="M{} {:.1f}H{}"/><text class="y" x="{}" y="{:.1f}">{:g}</text>'
        ).format(_LEFT, at, end, _LEFT - 6, at + 4, value)
        for at, value in zip(y, y_ticks, strict=True)
    ]
    parts += [
        Markup(
            '<path class="tick" d="M{0:.1f} {1}v4"/>'
            '<text class="x" x="{0:.1f}" y="{2}">{3:g}</text>'
        ).format(at, base, base + 16, value)
        for at, value in zip(x, x_ticks, strict=True)
    ]
    parts.append(
        Markup(
            '<path class="axis" d="M{} {}H{}"/><text class="x label" x="{}" y="{}">{}</text>'
            '<text class="x label" transform="translate(13 {}) rotate(-90)">{}</text>'
        ).format(
            _LEFT, base, end, (_LEFT + end) / 2, _HEIGHT - 6, x_label, (_TOP + base) / 2, y_label
        )
    )
    return Markup("").join(parts)


def ticks(limits: tuple[float, float], about: int) -> Values:
    """Return about so many round numbers within the limits."""
    step = nice_step((limits[1] - limits[0]) / about)
    first, last = math.ceil(limits[0] / step - 1e-9), math.floor(limits[1] / step + 1e-9)
    return np.array([float(f"{k * step:.12g}") for k in range(first, last + 1)])


def nice_step(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, near and not far below the value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-12)))
    return float(f"{next(m for m in (1, 2, 5, 10) if m * power >= value * 0.75) * power:.12g}")


def _legend(curves: Sequence[Curve]) -> Markup:
    parts: list[Markup] = []
    x = float(_LEFT + 8)
    for curve in curves:
        parts.append(
            Markup(
                '<path class="curve {}" d="M{:.0f} {}h18"/>'
                '<text class="key" x="{:.0f}" y="{}">{}</text>'
            ).format(curve.style, x, 11, x + 23, 15, curve.name)
        )
        x += 40 + 7 * len(curve.name)
    return Markup("").join(parts)


def svg_path(x: Values, y: Values, digits: int = 1) -> str:
    """Return the `d` of a line through the points."""
    points = [f"{a:.{digits}f} {b:.{digits}f}" for a, b in zip(x, y, strict=True)]
    return "M" + "L".join(points) if points else ""


def figure(parts: Sequence[Markup], height: float = _HEIGHT) -> Markup:
    """Return the drawing of these parts."""
    return Markup('<svg class="chart" role="img" viewBox="0 0 {} {}">{}</svg>').format(
        WIDTH, height, Markup("").join(parts)
    )
