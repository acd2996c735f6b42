"""`slam tune`: settings that do best on training logs, judged on others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Client

from slam.experiments.batch.run_batch import (
    Echo,
    failure,
    hash_logs,
    make_folder,
    make_task,
    run_all,
)
from slam.experiments.batch.sources import expand
from slam.experiments.batch.task import Task
from slam.experiments.tune.objective import Objective, Score, score, value
from slam.experiments.tune.space import Number, values_of, with_values
from slam.experiments.tune.study import Search, Values, best, open_study, search
from slam.mapping.config import SlamConfig
from slam.runs.errors import ConfigError, RunError
from slam.runs.run_directory import version


@dataclass(frozen=True, slots=True)
class Tuning:
    """What is asked of `slam tune`."""

    train: Sequence[str]  # addresses and patterns
    scoring: Sequence[str]
    objective: Objective
    config: SlamConfig  # where the search begins
    reference: SlamConfig  # what the result is compared with
    plan: Search
    out: Path
    truth: Path | None = None
    storage: str | None = None  # address of the study's database; in `out` if not said


@dataclass(frozen=True, slots=True)
class LogScore:
    """A log under the reference and under what was found."""

    log: str
    sha256: str
    reference: Score
    found: Score


@dataclass(frozen=True, slots=True)
class Tuned:
    """What came out."""

    tuning: Tuning
    values: Values
    config: SlamConfig
    trial: int  # number of the best
    value: float
    trials: tuple[tuple[Values, float | None], ...]  # None: interrupted while it was chosen
    train: tuple[LogScore, ...]
    scoring: tuple[LogScore, ...]
    question: dict[str, Any]


def tune(tuning: Tuning, client: Client, echo: Echo) -> Tuned:
    """Search for the best settings; goes on where an earlier run in the same folder was cut short.

    Raises:
        RunError: a training log fails as things are or lacks the truth, a log is on both
            sides, or the folder holds another study.
    """
    make_folder(tuning.out / "results")
    judge = _Judge(tuning, client, echo)
    reference = judge.training([tuning.reference])[0]
    judge.require_truth(reference)
    question = _question(tuning, judge)
    storage = tuning.storage or f"sqlite:///{(tuning.out / 'study.db').absolute()}"
    study = open_study(storage, question)

    def judge_round(proposed: Sequence[Values]) -> list[float]:
        configs = [_config(tuning.config, values) for values in proposed]
        scores = iter(judge.training([c for c in configs if c is not None]))
        found = [
            math.inf if c is None else value(tuning.objective, next(scores), reference)
            for c in configs
        ]
        echo(f"{len(found)} trials: {', '.join(f'{v:.4g}' for v in found)}")
        return found

    search(study, tuning.plan, values_of(tuning.config, tuning.plan.parameters), judge_round)
    winner = best(study)
    config = with_values(tuning.config, winner.params)
    assert winner.value is not None
    return Tuned(
        tuning, dict(winner.params), config, winner.number, winner.value,
        tuple((dict(t.params), t.value) for t in study.get_trials(deepcopy=False)),
        judge.compare(judge.train, tuning.reference, config),
        judge.compare(judge.scoring, tuning.reference, config),
        question,
    )  # fmt: skip


class _Judge:
    """Runs configurations over the logs of both sides."""

    def __init__(self, tuning: Tuning, client: Client, echo: Echo) -> None:
        self._tuning, self._client, self._echo = tuning, client, echo
        self.train, self.scoring = expand(tuning.train), expand(tuning.scoring)
        self.hashes: dict[str, str] = {}
        for log, found in hash_logs(client, [*self.train, *self.scoring]).items():
            if isinstance(found, Exception):
                raise RunError(failure(found, log)["reason"])
            self.hashes[log] = found
        for log in self.scoring:
            for other in self.train:
                if self.hashes[log] == self.hashes[other]:
                    raise RunError(
                        f"{log}: scores what {other} trained: the two must be different logs"
                    )

    def training(self, configs: Sequence[SlamConfig]) -> list[list[Score]]:
        """Scores of each configuration on each training log."""
        return self._scores(self.train, configs, "training")

    def compare(
        self, logs: Sequence[str], reference: SlamConfig, found: SlamConfig
    ) -> tuple[LogScore, ...]:
        """Both configurations on some logs."""
        before, after = self._scores(logs, [reference, found], "judging")
        return tuple(
            LogScore(log, self.hashes[log], b, a)
            for log, b, a in zip(logs, before, after, strict=True)
        )

    def task(self, log: str, config: SlamConfig) -> Task:
        """The task of a log."""
        results = self._tuning.out / "results"
        return make_task(log, self.hashes[log], config, self._tuning.truth, results)

    def require_truth(self, scores: Sequence[Score]) -> None:
        """Refuse training logs that cannot tell good from bad (RunError)."""
        for log, found in zip(self.train, scores, strict=True):
            if not math.isfinite(found.error_m):
                raise RunError(
                    f"{log}: fails under the reference, or has no truth for the objective "
                    f"{self._tuning.objective}: try `slam replay` and `slam report` on it"
                )

    def _scores(
        self, logs: Sequence[str], configs: Sequence[SlamConfig], what: str
    ) -> list[list[Score]]:
        tasks = [[self.task(log, config) for log in logs] for config in configs]
        flat = [task for row in tasks for task in row]
        records = run_all(self._client, flat, lambda _: None, what)
        return [[score(records[t.key], self._tuning.objective) for t in row] for row in tasks]


def _config(config: SlamConfig, values: Values) -> SlamConfig | None:
    """The configuration of a trial; None if its values do not go together."""
    try:
        return with_values(config, values)
    except ConfigError:
        return None


def _question(tuning: Tuning, judge: _Judge) -> dict[str, Any]:
    """All that the outcome of a trial depends on; of the number of trials it does not."""
    plan = tuning.plan

    def bounds(low: Number, high: Number, log: bool) -> list[Any]:
        return [low, high, "log" if log else "linear"]

    return {
        "objective": str(tuning.objective),
        "parameters": {p.name: bounds(p.low, p.high, p.log) for p in plan.parameters},
        "training logs": sorted(judge.hashes[log] for log in judge.train),
        "truth": sorted(judge.task(log, tuning.config).truth_sha256 for log in judge.train),
        "configuration": tuning.config.sha256(),
        "reference": tuning.reference.sha256(),
        "seed": plan.seed,
        "together": plan.together,
        "version": version(),
    }
