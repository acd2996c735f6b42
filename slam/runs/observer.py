"""What a run hands to those who watch it; nothing comes back."""

from __future__ import annotations

from typing import Protocol

from slam.logs.messages import Message, StatusMessage
from slam.mapping.slam import Slam
from slam.runs.offline import Result
from slam.runs.status import Status


class Observer(Protocol):
    """Looks on in the pipeline's thread: it copies what it wants to keep, and returns at once."""

    def show(self, slam: Slam, message: Message) -> None:
        """Called when the pipeline is done with a message."""
        ...

    def tell(self, status: Status) -> None:
        """Called with the state of devices and losses, about once a second on a robot."""
        ...

    def note(self, message: StatusMessage) -> None:
        """Called with what the run writes into its log about devices."""
        ...

    def stage(self, name: str) -> None:
        """Called when something else than tracking begins, in words."""
        ...

    def finish(self, result: Result) -> None:
        """Called with the results before they are written."""
        ...


class NullObserver:
    """Does not look."""

    def show(self, slam: Slam, message: Message) -> None:
        """Nothing."""

    def tell(self, status: Status) -> None:
        """Nothing."""

    def note(self, message: StatusMessage) -> None:
        """Nothing."""

    def stage(self, name: str) -> None:
        """Nothing."""

    def finish(self, result: Result) -> None:
        """Nothing."""
