"""Loop searches that may run beside the step: all they need is taken along when they begin."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from gtsam import Pose2

from slam.frontend.correlative import LikelihoodField
from slam.frontend.loop_search import Closure, LoopSearchConfig, Matrix, close_loop, target_field
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.scan import PreparedScan

Submit = Callable[..., Future[Any]]  # as `Executor.submit`
Submap = Sequence[tuple[Pose2, PreparedScan]]


@dataclass(frozen=True, eq=False, slots=True)
class PlaceCandidate:
    """Is the newest keyframe at this old place?  Nothing in it changes any more."""

    anchor: int  # keyframe in the middle of the old place
    old: Submap  # keyframes of the place, in the anchor's frame
    query: Submap  # latest keyframes, in the newest's frame
    predicted: Pose2  # anchor_T_newest as the graph has it
    covariance: Matrix  # (3, 3) of that, in the newest's frame


Answer = tuple[PlaceCandidate, Closure]


class LoopWorker:
    """Answers one set of questions at a time; its maps of old places are kept for the next one."""

    def __init__(self, config: LoopSearchConfig, matcher: MatchConfig, submit: Submit) -> None:
        self._config, self._matcher, self._submit = config, matcher, submit
        self._fields: dict[int, LikelihoodField] = {}  # by anchor; the search's own while it runs
        self._searching: Future[list[Answer]] | None = None

    @property
    def running(self) -> bool:
        """Whether a search is at work; of interest to those who measure, not to the graph."""
        return self._searching is not None and not self._searching.done()

    def begin(self, ask: Callable[[], Sequence[PlaceCandidate]] | None) -> None:
        """Search for the answers, which must be taken before the next begin; None: nothing.

        The questions are put by the search itself, for that takes time too: what they are
        made of must not change until then.
        """
        self._searching = self._submit(self._search, ask) if ask else None

    def answers(self) -> Iterable[Answer]:
        """Each question with its answer, in the order asked; waits for a search that runs."""
        if self._searching is None:
            return ()
        found, self._searching = self._searching.result(), None
        return found

    def forget(self) -> None:
        """Old places have moved within: make new maps of them."""
        self._fields.clear()

    def _search(self, ask: Callable[[], Sequence[PlaceCandidate]]) -> list[Answer]:
        kept, self._fields = self._fields, {}  # megabytes each: an hour's would not fit
        return [(asked, self._answer(asked, kept)) for asked in ask()]

    def _answer(self, place: PlaceCandidate, kept: dict[int, LikelihoodField]) -> Closure:
        field = kept.get(place.anchor)
        if field is None:
            field = target_field(place.old, self._config.correlative)
        self._fields[place.anchor] = field
        references = [Reference(pose, scan) for pose, scan in place.old]
        return close_loop(
            field, references, place.query, place.predicted, place.covariance,
            self._config, self._matcher,
        )  # fmt: skip


def run_inline(search: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """Do it here and now: for replays, which have no sensor to keep up with."""
    done: Future[Any] = Future()
    done.set_result(search(*arguments))
    return done
