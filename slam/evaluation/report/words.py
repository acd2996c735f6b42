"""Words for the keys of summaries and figures, as the page shows them."""

from __future__ import annotations

from collections.abc import Mapping

# The rows of the table of consistency: what it is, where it is, decimals, unit
CONSISTENCY = (
    ("closures against the finished graph, median", "closure_residual_median_m", 4, " m"),
    ("closures against the finished graph, largest", "closure_residual_max_m", 4, " m"),
    ("closures in heading, median", "closure_residual_median_deg", 3, "°"),
    ("odometry against ICP per keyframe, median", "odometry_against_icp_median_m", 4, " m"),
    ("odometry against ICP per keyframe, 95 % below", "odometry_against_icp_p95_m", 4, " m"),
    ("odometry against ICP in heading, median", "odometry_against_icp_median_deg", 3, "°"),
    ("share of keyframes whose odometry was rejected", "odometry_refused_share", 4, ""),
    ("odometry against trajectory, per metre", "odometry_disagreement_per_m", 4, " m"),
    ("thickness of walls in the map, median RMS", "wall_thickness_median_m", 4, " m"),
    ("thickness of walls in the map, 90 % below", "wall_thickness_p90_m", 4, " m"),
    ("places where thickness was measured", "wall_cells", 0, ""),
)

TIMING = {
    "wall_s": "wall clock [s]",
    "cpu_s": "processor time [s]",
    "realtime_factor": "times faster than real time",
    "match_us_median": "one match, median [µs]",
    "step_ms_p50": "step of one scan, median [ms]",
    "step_ms_p99": "step of one scan, 99 % below [ms]",
}

STAGES = {
    "closing": "loop closing [s]",
    "localising": "localising every scan [s]",
    "map": "map [s]",
    "matching": "scan matching [s]",
    "optimising": "graph optimisation [s]",
    "reading": "reading the log [s]",
    "thinning": "pruning keyframes [s]",
    "pruning": "pruning keyframes [s]",
    "writing": "writing the run [s]",
}

PROVENANCE = {
    "log": "log",
    "log_sha256": "SHA-256 of the log",
    "version": "version of the program",
    "config_sha256": "SHA-256 of the settings",
    "host": "computer",
    "peak_rss_mb": "most memory used [MB]",
    "scans": "scans",
}


def words(known: Mapping[str, str], key: str) -> str:
    """Return the words for a key, or else the key without its underscores."""
    return known.get(key, key.replace("_", " "))
