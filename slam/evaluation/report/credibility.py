"""What an ANEES says about a run's covariances, in words that cannot be misread."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from slam.evaluation.metrics import Credibility


def credibility_figures(found: Credibility) -> dict[str, Any]:
    """The band and the verdict as `report.json` has them."""
    known = found.n > 0 and found.anees > 0.0
    return {
        "n": found.n,
        "low": found.low if known else None,
        "high": found.high if known else None,
        "verdict": verdict(found) if known else None,
        "error_over_sigma": math.sqrt(found.anees) if known else None,
    }


def verdict(found: Credibility) -> str:
    """`over-confident`, `cautious` or `honest`."""
    if found.anees > found.high:
        return "over-confident"
    return "cautious" if found.anees < found.low else "honest"


def explanation(found: Credibility, config: Mapping[str, Any]) -> str:
    """Say which way the sigmas are wrong and by how much, and what makes them so.

    Args:
        found: of the run.
        config: its settings; the cause is not named where they are unknown.
    """
    if found.n == 0 or not found.anees > 0.0:
        return ""
    ratio = math.sqrt(found.anees)
    if found.anees > found.high:
        return (
            f"Over-confident: the errors are about {ratio:.2g} times as large as the sigmas claim. "
            "Do not rely on them."
        )
    if found.anees >= found.low:
        return "Honest: the errors are as large as the sigmas claim."
    text = f"Cautious: the sigmas claimed are about {1.0 / ratio:.2g} times as large as the errors."
    return f"{text} {_widening(config)}".strip()


def _widening(config: Mapping[str, Any]) -> str:
    graph = config.get("graph")
    if not isinstance(graph, Mapping):
        return ""
    trans, rot = graph.get("match_sigma_trans", 0.0), graph.get("match_sigma_rot", 0.0)
    if not (trans or rot):
        return ""
    return (
        f"Each match was widened by {1e3 * trans:.3g} mm and {math.degrees(rot):.2g} degrees "
        "(graph.match_sigma_trans, graph.match_sigma_rot) for uneven walls, people and a tilting "
        "laser in real buildings. A simulated world has none of these, so there the figure "
        "is far below 1; it says nothing about a real one."
    )
