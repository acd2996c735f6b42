"""The figures of `summary.json`."""

from __future__ import annotations

from typing import Any

from slam.logs.trajectory import path_length
from slam.mapping.config import SlamConfig
from slam.runs.machine import peak_memory_mb
from slam.runs.offline import Result
from slam.runs.run_directory import version


def summarise(
    result: Result, log: str, timing: dict[str, Any], config: SlamConfig
) -> dict[str, Any]:
    """The keys of `summary.json`."""
    slam, stamps = result.slam, result.trajectory.stamps_ns
    closure_results = slam.loops.closure_results
    gone = slam.records.pruned_counts
    accepted = sum(v.accepted for v in closure_results) + gone["accepted"]
    candidates = len(closure_results) + gone["accepted"] + gone["rejected"]
    return {
        "log": log,
        "scans": len(stamps),
        "keyframes": len(slam.keyframes),
        "pruned": gone["keyframes"],
        "matches": slam.matches,
        "scan_matches": result.matches - slam.matches,
        "loops": {
            "candidates": candidates,
            "accepted": accepted,
            "rejected": candidates - accepted,
        },
        "distance_m": round(
            float(path_length(slam.place_history(result.keyframes.poses)[1])[-1]), 3
        ),
        "duration_s": round(float(stamps[-1] - stamps[0]) * 1e-9, 3),
        "timing": timing,
        "peak_rss_mb": peak_memory_mb(),
        "laser_only": slam.laser_only,
        "lost": dict(sorted(result.lost.items())),
        "noted": dict(sorted(slam.noted.items())),
        "odometry_faults": dict(sorted(slam.odometry_faults.items())),
        "odometry_refused": gone["odometry refused"]
        + sum(not f.used and f.kind == "odometry" for f in slam.records.factors),
        "lost_keyframes": sum(e.lost for e in slam.records.estimates),
        "version": version(),
        "config_sha256": config.sha256(),
    }
