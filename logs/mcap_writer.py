"""How every MCAP file of ours begins, be it recorded, recovered, or recompressed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import IO

from mcap.writer import CompressionType, Writer

CHUNK_BYTES = 256 * 1024
"""A chunk is the unit of loss and of reading: 256 KiB compresses within 3 % of 1 MiB."""


def library_name() -> str:
    """Return what the files say they were written by."""
    try:
        return f"sdp-slam/{version('sdp-slam')}"
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "sdp-slam/unknown"


def new_writer(stream: IO[bytes], chunk_bytes: int, profile: str = "", library: str = "") -> Writer:
    """Start an MCAP file as all of ours are: zstd, every checksum, no profile but a copy's."""
    writer = Writer(
        stream,
        chunk_size=chunk_bytes,
        compression=CompressionType.ZSTD,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start(profile=profile, library=library or library_name())
    return writer
