"""Where the logs of a batch are: paths, globs, and whatever addresses fsspec understands."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from slam.runs.errors import ReportError

_TRUTHS = (".relations", ".tum", ".csv")


def expand(addresses: Sequence[str]) -> list[str]:
    """Every log once, sorted; a pattern that fits nothing stays as it is, for its row to say so."""
    found: set[str] = set()
    for address in addresses:
        found.update(_matches(address) or [address])
    return sorted(found)


def _matches(address: str) -> list[str]:
    if not glob.has_magic(address) or Path(address).exists():
        return [address]
    if "://" not in address:
        return glob.glob(address, recursive=True)
    # What can go wrong depends on the file system; the row of the pattern will say it.
    with suppress(Exception):
        system, pattern = url_to_fs(address)
        return [system.unstrip_protocol(path) for path in system.glob(pattern)]
    return []


def absolute(address: str) -> str:
    """The address as a worker with another working directory understands it."""
    return address if "://" in address else str(Path(address).absolute())


def stem(address: str) -> str:
    """Name of a log without folders and suffix."""
    return PurePosixPath(address).stem


@contextmanager
def local_copy(address: str, scratch: Path | None = None) -> Iterator[Path]:
    """The log as a file of this machine, fetched for as long as the block lasts if need be.

    Raises:
        OSError: it is not there or cannot be fetched (the kind depends on the file system).
    """
    system, path = url_to_fs(address)
    if isinstance(system, LocalFileSystem):
        yield Path(path)
        return
    with TemporaryDirectory(dir=scratch) as folder:
        target = Path(folder) / PurePosixPath(path).name
        system.get_file(path, str(target))
        yield target


def find_truth(folder: Path | None, address: str) -> Path | None:
    """The truth of a log: the file in `folder` that has its name; None if there is none.

    Raises:
        ReportError: there are several.
    """
    if folder is None:
        return None
    found = [p for suffix in _TRUTHS if (p := folder / f"{stem(address)}{suffix}").is_file()]
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise ReportError(f"{folder}: several truths of {stem(address)}: keep one of {names}")
    return found[0].absolute() if found else None
