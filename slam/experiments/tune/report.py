"""What `slam tune` leaves behind: a configuration that says where it comes from, and figures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import tomli_w

from slam.experiments.batch.sources import stem
from slam.experiments.tune.objective import Score, together
from slam.experiments.tune.space import values_of
from slam.experiments.tune.tune import LogScore, Tuned
from slam.logs.atomic_write import atomic_write
from slam.mapping.config import SlamConfig
from slam.runs.run_directory import version


def write_tuned(tuned: Tuned) -> None:
    """Write `config.toml` and `tune.json` (RunError if that fails)."""
    out = tuned.tuning.out
    atomic_write(out / "config.toml", config_text(tuned))
    atomic_write(out / "tune.json", json.dumps(document(tuned), indent=2) + "\n")


def summary_lines(tuned: Tuned) -> Iterator[str]:
    """For people: what was found, on training and on scoring logs apart."""
    tuning = tuned.tuning
    yield (
        f"best of {len(tuned.trials)} trials is number {tuned.trial}: "
        f"{tuning.objective} {tuned.value:.4g}"
    )
    before = values_of(tuning.config, tuning.plan.parameters)
    for name, found in tuned.values.items():
        yield f"  {name:<28} {before[name]:.4g} -> {found:.4g}"
    yield from _table("training logs", tuned.train)
    if tuned.scoring:
        yield from _table("scoring logs, which the search never saw", tuned.scoring)


def config_text(tuned: Tuned) -> str:
    """The configuration as TOML, with its origin as comments."""
    tuning, plan = tuned.tuning, tuned.tuning.plan
    lines = [
        f"Found by `slam tune`, version {version()}: objective {tuning.objective}, "
        f"value {tuned.value:.6g},",
        f"best of {len(tuned.trials)} trials (number {tuned.trial}), seed {plan.seed}.",
        "Searched: " + ", ".join(
            f"{p.name} {p.low:g} to {p.high:g}{' (log)' if p.log else ''}" for p in plan.parameters
        ),
        *_table("training logs", tuned.train),
        *_table("scoring logs, not used for the search", tuned.scoring),
        "Hashes of the logs (SHA-256):",
        *(f"  {entry.sha256}  {stem(entry.log)}" for entry in (*tuned.train, *tuned.scoring)),
    ]  # fmt: skip
    head = "".join(f"# {line}\n" for line in lines)
    names = [p.name.split(".")[:2] for p in plan.parameters]
    return f"{head}\n{tomli_w.dumps(_differences(tuned.config, names))}"


def document(tuned: Tuned) -> dict[str, Any]:
    """The content of `tune.json`."""
    return {
        "question": tuned.question,
        "best": {"trial": tuned.trial, "value": tuned.value, "parameters": tuned.values},
        "config_sha256": tuned.config.sha256(),
        "training": [_entry(entry) for entry in tuned.train],
        "scoring": [_entry(entry) for entry in tuned.scoring],
        "trials": [{"parameters": p, "value": _finite(v)} for p, v in tuned.trials],
    }


def _table(title: str, entries: Sequence[LogScore]) -> Iterator[str]:
    if not entries:
        return
    yield f"{title}: error in m and matches, reference -> found"
    for entry in entries:
        yield f"  {stem(entry.log):<28} {_change(entry.reference, entry.found)}"
    if len(entries) > 1:
        means = (together([getattr(e, side) for e in entries]) for side in ("reference", "found"))
        yield f"  {'geometric mean':<28} {_change(*means)}"


def _change(before: Score, after: Score) -> str:
    return (
        f"{before.error_m:.4f} -> {after.error_m:.4f}   {before.matches:.0f} -> {after.matches:.0f}"
    )


def _entry(entry: LogScore) -> dict[str, Any]:
    sides = {"reference": entry.reference, "found": entry.found}
    return {"log": entry.log, "sha256": entry.sha256} | {
        name: {"error_m": _finite(s.error_m), "matches": _finite(s.matches)}
        for name, s in sides.items()
    }


def _finite(number: float | None) -> float | None:
    return number if number is not None and abs(number) < float("inf") else None


def _differences(config: SlamConfig, named: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Settings that are not the default, and those that were searched."""
    found = _changed(config.model_dump(), SlamConfig().model_dump())
    for path in named:
        value: Any = config.model_dump()
        holder = found
        for part in path[:-1]:
            value, holder = value[part], holder.setdefault(part, {})
        holder[path[-1]] = value[path[-1]]
    return found


def _changed(ours: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in ours.items():
        if isinstance(value, Mapping):
            if inner := _changed(value, default[key]):
                out[key] = inner
        elif value != default[key]:
            out[key] = value
    return out
