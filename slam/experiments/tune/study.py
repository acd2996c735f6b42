"""The search of `slam tune`: an optuna study that gives the same trials after any interruption."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from slam.experiments.tune.space import Number, Parameter
from slam.runs.errors import RunError

Values = dict[str, Number]
Judge = Callable[[Sequence[Values]], Sequence[float]]  # inf for settings that do not work

_NAME = "slam tune"


@dataclass(frozen=True, slots=True)
class Search:
    """How the space is searched."""

    parameters: tuple[Parameter, ...]
    trials: int
    together: int  # trials that are chosen before any of them is known
    seed: int


def open_study(storage: str, question: Mapping[str, Any]) -> optuna.Study:
    """The study in a database, new or as it was left.

    Raises:
        RunError: the database cannot be used, or its study answers another question.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        study = optuna.create_study(storage=storage, study_name=_NAME, load_if_exists=True)
        before = study.user_attrs.get("question")
        if before is None:
            study.set_user_attr("question", dict(question))
    except Exception as error:  # SQLAlchemy's many, all of them about the address
        raise RunError(
            f"{storage}: cannot be used for the study: {str(error).splitlines()[0]}"
        ) from error
    asked = json.loads(json.dumps(question))
    if before is not None and before != asked:
        other = ", ".join(key for key in asked if before.get(key) != asked[key])
        raise RunError(
            f"{storage}: holds a study of other {other}: take another --out, or go on as before"
        )
    return study


def search(study: optuna.Study, plan: Search, start: Values, judge: Judge) -> None:
    """Make trials until there are as many as planned; the first takes the values in `start`.

    A trial follows from the seed, its number and the trials of earlier rounds, so neither the
    number of workers nor an interruption changes what is tried.
    """
    if not study.get_trials(deepcopy=False) and _within(start, plan.parameters):
        study.enqueue_trial(start)
    while pending := _next_round(study, plan):
        found = judge([dict(trial.params) for trial in pending])
        for trial, value in zip(pending, found, strict=True):
            study.tell(trial.number, value, skip_if_finished=True)


def best(study: optuna.Study) -> FrozenTrial:
    """The trial with the smallest value, the first of equals.

    Raises:
        RunError: no trial worked.
    """
    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    good = [(t.value, t.number, t) for t in done if t.value is not None and math.isfinite(t.value)]
    if not good:
        raise RunError("no trial worked on all training logs: narrow the bounds of --param")
    return min(good, key=lambda item: item[:2])[2]


def _next_round(study: optuna.Study, plan: Search) -> list[FrozenTrial]:
    """Trials to be judged: what an interruption left, filled up to a whole round."""
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        if len(trial.params) < len(plan.parameters):  # killed while it was being chosen
            study.tell(trial.number, state=TrialState.FAIL)
    while (made := _made(study)) < plan.trials:
        if made % plan.together == 0 and _running(study):
            break
        _ask(study, plan, made)
        if (made + 1) % plan.together == 0:
            break
    return _running(study)


def _ask(study: optuna.Study, plan: Search, number: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study.sampler = optuna.samplers.TPESampler(
            seed=(plan.seed * 1_000_003 + number) % 2**32, constant_liar=True, multivariate=True
        )
    trial = study.ask()
    for parameter in plan.parameters:
        parameter.suggest(trial)


def _running(study: optuna.Study) -> list[FrozenTrial]:
    return study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))


def _made(study: optuna.Study) -> int:
    return sum(t.state != TrialState.WAITING for t in study.get_trials(deepcopy=False))


def _within(values: Values, parameters: Sequence[Parameter]) -> bool:
    return all(p.low <= values[p.name] <= p.high for p in parameters)
