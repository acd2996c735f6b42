"""The files of one ROS recording: a single file, or the parts in a folder, by their content."""

from __future__ import annotations

import re
import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import zstandard
from slam.logs.errors import LogError, shown
from slam.logs.importers.bag import sqlite
from slam.logs.importers.bag.channels import Account, BagMessage, Container, Wanted
from slam.logs.importers.bag.mcap import McapBag
from slam.logs.importers.bag.ros1 import Ros1Bag
from slam.logs.importers.bag.sqlite import SqliteBag
from slam.logs.mcap_file import MAGIC as MCAP_MAGIC

ROS1_MAGICS = (b"#ROSBAG", b"#ROSRECORD")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MAGICS = (*ROS1_MAGICS, sqlite.MAGIC, MCAP_MAGIC)
_SUFFIXES = (".mcap", ".db3", ".bag", ".zstd", ".zst", ".active")
_LISTED = re.compile(r"^\s*-\s+['\"]?([^'\"\s]+\.(?:mcap|db3)(?:\.zstd)?)['\"]?\s*$", re.MULTILINE)
UNPACKED_LIMIT = 1 << 30
"""Bytes that all packed parts of a bag may take on the disk: what is packed can grow 10000-fold."""

_UNPACK_BLOCK = 1 << 20
_NUMBER = re.compile(r"(\d+)")


class Bag:
    """A recording that can be read again and again, part after part."""

    def __init__(self, path: Path) -> None:
        """Find the parts.

        Raises:
            LogError: there is none, or they are not of one recording.
        """
        self.path = path
        self.missing: Counter[str] = Counter()
        self._unpacked = ""  # folder of parts that were compressed as a whole
        self._unpacked_bytes = 0
        files = self._parts() if path.is_dir() else [path]
        self.parts = [self._container(file) for file in files]

    @property
    def lonely(self) -> bool:
        """Whether it is one part of several that lie beside it."""
        if self.path.is_dir() or not (match := re.fullmatch(r"(.*_)\d+(\..*)", self.path.name)):
            return False
        numbered = re.compile(re.escape(match[1]) + r"\d+" + re.escape(match[2]))
        return any(
            numbered.fullmatch(other.name) and other.name != self.path.name
            for other in self.path.parent.iterdir()
        )

    def messages(self, wanted: Wanted, account: Account) -> Iterator[BagMessage]:
        """Yield the wanted messages of all parts in file order."""
        account.skipped.update(self.missing)
        for part in self.parts:
            yield from part.messages(wanted, account)

    def _parts(self) -> list[Path]:
        listed = _listed(self.path)
        found = [self.path / name for name in listed if (self.path / name).is_file()]
        for name in set(listed) - {file.name for file in found}:
            self.missing[f"part {shown(name)} that metadata.yaml names is not there"] = 1
        if not found:
            found = sorted(
                (f for f in self.path.iterdir() if f.suffix in _SUFFIXES and f.is_file()),
                key=_natural,
            )
        if len({_NUMBER.sub("#", file.name) for file in found}) > 1:
            names = ", ".join(shown(file.name) for file in found[:5])
            raise LogError(f"{self.path}: holds several recordings ({names}): name one of them")
        if not found:
            raise LogError(f"{self.path}: is a folder without a recording: name a file to import")
        return found

    def _container(self, file: Path) -> Container:
        try:
            with file.open("rb") as stream:
                start = stream.read(16)
            if start.startswith(ZSTD_MAGIC):
                file, start = self._unpack(file)
        except OSError as error:
            raise LogError(f"{file}: cannot be read: {error.strerror}") from error
        if start.startswith(ROS1_MAGICS):
            return Ros1Bag(file)
        if start.startswith(sqlite.MAGIC):
            return SqliteBag(file)
        if start.startswith(MCAP_MAGIC[:6]):
            return McapBag(file)
        raise LogError(f"{file}: is no ROS bag: its first bytes are none of MCAP, sqlite or ROS 1")

    def _unpack(self, file: Path) -> tuple[Path, bytes]:
        """Unpack a part that was compressed as a whole, into a folder that goes with this bag."""
        if not self._unpacked:
            self._unpacked = tempfile.mkdtemp()
            weakref.finalize(self, shutil.rmtree, self._unpacked, True)
        target = Path(self._unpacked) / file.stem
        try:
            with file.open("rb") as packed, target.open("wb") as plain:
                for block in zstandard.ZstdDecompressor().read_to_iter(
                    packed, write_size=_UNPACK_BLOCK
                ):
                    self._unpacked_bytes += len(block)
                    if self._unpacked_bytes > UNPACKED_LIMIT:
                        raise LogError(
                            f"{file}: unpacks to more than {UNPACKED_LIMIT >> 20} MB: unpack the "
                            "parts with `zstd -d` first"
                        )
                    plain.write(block)
        except zstandard.ZstdError as error:
            raise LogError(f"{file}: cannot be unpacked: {error}") from error
        with target.open("rb") as stream:
            return target, stream.read(16)


def is_bag(path: Path, start: bytes) -> bool:
    """Return whether a path may be a ROS recording, by the first bytes of the file."""
    if path.is_dir():
        return any(file.suffix in _SUFFIXES for file in path.iterdir())
    return start.startswith((*ROS1_MAGICS, sqlite.MAGIC, ZSTD_MAGIC))


def _listed(folder: Path) -> list[str]:
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    return list(dict.fromkeys(Path(name).name for name in _LISTED.findall(text)))


def _natural(file: Path) -> list[tuple[int, int, str]]:
    """Order `_2` before `_10`."""
    return [
        (1, int(part), "") if part.isdigit() else (0, 0, part) for part in _NUMBER.split(file.name)
    ]
