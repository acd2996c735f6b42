"""How every command talks, and how it says that data was lost."""

from __future__ import annotations

from collections.abc import Mapping

import typer

_talk = {"quiet": False, "verbose": False}  # as the command line has it
LOSS = 3  # exit code: finished, but data was lost or skipped


def echo(text: str) -> None:
    """Talk goes to stderr, so that stdout holds results alone; with --quiet there is none."""
    if not _talk["quiet"]:
        typer.echo(text, err=True)


def set_talk(*, quiet: bool, verbose: bool) -> None:
    """Take what the command line says of talk.

    Raises:
        BadParameter: both at once.
    """
    if quiet and verbose:
        raise typer.BadParameter("--quiet and --verbose cannot both be meant")
    _talk.update(quiet=quiet, verbose=verbose)


def is_quiet() -> bool:
    """Whether there shall be no talk."""
    return _talk["quiet"]


def is_verbose() -> bool:
    """Whether an error shall be shown with where it came from."""
    return _talk["verbose"]


def print_version(wanted: bool) -> None:
    """Print the version and end the command, if that is wanted."""
    if wanted:
        from slam.logs.mcap_log import library_name

        typer.echo(library_name().replace("/", " "))
        raise typer.Exit


def exit_on_loss(lost: Mapping[str, int], word: str) -> None:
    """Name each cause with its count, and end the command with LOSS if there is any."""
    for cause, count in lost.items():
        echo(f"  {word}: {count} {cause}")
    if lost:
        raise typer.Exit(LOSS)
