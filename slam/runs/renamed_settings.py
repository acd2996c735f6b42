"""Settings under their old names: they work for one more version, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from slam.runs.errors import ConfigError

# Old name -> new name, of settings or whole sections; the longest match counts.
RENAMED = {
    "lost_inflation": "odometry.lost_inflation",
    "scan.range_noise": "laser.range_noise",
    "scan.max_range": "laser.max_range",
    "scan.unbend": "scan.deskew",
    "matcher.range_noise": "laser.range_noise",
    "matcher.good_quality": "matcher.good_inlier_fraction",
    "matcher.min_explained": "matcher.min_pair_inlier_fraction",
    "keyframes.slack": "keyframes.tolerance",
    "odometry.max_speed": "robot.max_speed",
    "odometry.max_turn_rate": "robot.max_turn_rate",
    "tracking": "registration",
    "tracking.good_explained": "registration.good_pair_inlier_fraction",
    "tracking.good_quality": "registration.good_inlier_fraction",
    "tracking.min_quality": "registration.min_inlier_fraction",
    "loops.tight_m": "loops.narrow_prior_m",
    "loops.witnesses": "loops.supporting_closures",
    "loops.search.rival_ratio": "loops.search.ambiguity_ratio",
    "loops.search.min_explained": "loops.search.min_pair_inlier_fraction",
    "thinning": "pruning",
    "thinning.enough": "pruning.min_redundancy",
    "localise.min_explained": "localise.min_pair_inlier_fraction",
    "localise.min_quality": "localise.min_inlier_fraction",
    "localise.good_quality": "localise.good_inlier_fraction",
}
# Settings that are constants now, by old name: no user had a reason to change them.
FIXED = {
    "keyframes.shortest", "keyframes.slack_open", "keyframes.narrowest", "keyframes.widest_open",
    "matcher.coarse_beams", "matcher.tolerance", "matcher.point_gate", "matcher.ndt_cell",
    "matcher.lasting",
    "tracking.search", "tracking.search_reach", "tracking.search_turn", "tracking.search_score",
    "tracking.margin", "registration.margin",
    "loops.places_apart_m", "loops.least_gain",
    "graph.anchor_sigma_trans", "graph.anchor_sigma_rot", "graph.relinearise_trans",
    "graph.relinearise_rot", "graph.relinearise_skip",
    "thinning.at_once", "thinning.share",
    "localise.refine_passes", "localise.refine_neighbours", "localise.radius_m",
}  # fmt: skip


class OldSettingWarning(UserWarning):
    """A setting is used under a name of the version before."""


def use_new_names(kind: type[BaseModel], data: dict[str, Any], where: str) -> dict[str, Any]:
    """Settings under today's names; each old one is reported as a warning.

    Args:
        kind: the model that they are for; settings of a run may be in its section `slam`.
        data: nested tables as read.
        where: the file, or `--set`.

    Raises:
        ConfigError: an old and a new name, or two old ones, give one setting different values.
    """
    if "slam" in kind.model_fields and isinstance(data.get("slam"), dict):
        return {**data, "slam": _renewed(data["slam"], where, "slam.")}
    return _renewed(data, where, "") if "pruning" in kind.model_fields else data


def _renewed(data: dict[str, Any], where: str, prefix: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    from_old: dict[str, str] = {}
    for old, value in _leaves(data, ""):
        if any(f"{old}.".startswith(f"{fixed}.") for fixed in FIXED):
            _warn(f"{where}: {prefix}{old} is no longer a setting and is left out")
            continue
        new = _new_name(old)
        if new != old:
            _warn(f"{where}: {prefix}{old} is now called {prefix}{new}")
        if new in found and found[new] != value:
            other = from_old.get(new, new)
            raise ConfigError(f"{where}: {prefix}{old} and {prefix}{other} contradict each other")
        found[new], from_old[new] = value, old
    renewed: dict[str, Any] = {}
    for name, value in found.items():
        *sections, last = name.split(".")
        table = renewed
        for section in sections:
            table = table.setdefault(section, {})
            if not isinstance(table, dict):
                raise ConfigError(f"{where}: {prefix}{section} is a section")
        table[last] = value
    return renewed


def _leaves(table: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _new_name(old: str) -> str:
    parts = old.split(".")
    for n in range(len(parts), 0, -1):
        if new := RENAMED.get(".".join(parts[:n])):
            return ".".join([new, *parts[n:]])
    return old


def _warn(text: str) -> None:
    warnings.warn(text, OldSettingWarning, stacklevel=4)
