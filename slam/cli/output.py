"""How every command talks, and how it says that data was lost."""

from __future__ import annotations

from collections.abc import Mapping

import typer

LOSS = 3  # exit code: finished, but data was lost or skipped


def say(text: str) -> None:
    """Talk goes to stderr, so that stdout holds results alone."""
    typer.echo(text, err=True)


def exit_on_loss(lost: Mapping[str, int], word: str) -> None:
    """Name each cause with its count, and end the command with LOSS if there is any."""
    for cause, count in lost.items():
        say(f"  {word}: {count} {cause}")
    if lost:
        raise typer.Exit(LOSS)
