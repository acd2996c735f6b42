"""What an online run leaves behind: its recording in any case, and the results if there are any."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import tomli_w

from slam.logs.atomic_write import atomic_write
from slam.logs.file_lock import hold_folder, is_held
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.parts import Recording
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError
from slam.runs.offline import Result
from slam.runs.run_directory import write_results

RECORDING = "recording.mcap"  # becomes part of run.mcap; of several files, all stay
UNFINISHED = ".recording"  # suffix of the folder; not `.partial`, which a replay may remove
SETTINGS = "slam.toml"  # as `slam replay --config` takes them


@contextmanager
def online_run(out: Path, config: SlamConfig) -> Iterator[Path]:
    """A folder that takes the name `out` once it holds a closed file, whatever else fails.

    Without one it stays as it is, for `slam recover`, or is removed if nothing is in it.  The
    settings are written first, so that what a crash leaves can be replayed with them.  The
    folder is locked meanwhile: who finds it can tell whether its program still runs.

    Raises:
        RunError: `out` or its unfinished folder exists already, or cannot be made.
    """
    folder = out.with_name(out.name + UNFINISHED)
    if out.exists():
        raise RunError(f"{out}: exists already; choose another --out or remove it first")
    if folder.exists():
        raise RunError(_what_is_there(folder))
    try:
        folder.mkdir(parents=True)
        handle = hold_folder(folder)
        atomic_write(folder / SETTINGS, tomli_w.dumps(config.model_dump(exclude_none=True)))
    except OSError as error:
        raise RunError(
            f"{out}: cannot be written: {error.strerror or error}; choose another --out"
        ) from error
    try:
        yield folder
    finally:
        try:
            _settle(folder, out)
        finally:
            if handle is not None:
                os.close(handle)


def _what_is_there(folder: Path) -> str:
    """Say what to do about an unfinished folder; a live recording must not be removed."""
    left = sorted(folder.glob("*.partial"))
    if is_held(folder) or any(is_held(path) for path in left):
        return (
            f"{folder}: another `slam online` is recording there at this moment: "
            "choose another --out, and leave that folder alone"
        )
    whole = "".join(f", keep {path.name}" for path in sorted(folder.glob("*.mcap")))
    saves = " and ".join(f"`slam recover {path} --out FILE`" for path in left)
    what = f"holds an unfinished recording: save it with {saves}{whole}" if left else (
        f"is left of a run that did not end well{whole}"
    )  # fmt: skip
    return f"{folder}: {what}, then remove it, or choose another --out"


def _settle(folder: Path, out: Path) -> None:
    if (folder / RECORDING).exists():
        if (folder / "run.mcap").exists():
            (folder / RECORDING).unlink()
        else:
            os.replace(folder / RECORDING, folder / "run.mcap")
    if any(folder.glob("*.mcap")):
        os.replace(folder, out)
    else:
        if {path.name for path in folder.iterdir()} == {SETTINGS}:
            (folder / SETTINGS).unlink()
        with suppress(OSError):  # an unfinished recording is in it
            folder.rmdir()


def log_name(files: Sequence[Path]) -> str:
    """What to replay in a RUN whose recording has these files."""
    return files[0].name if files and files[0].name != RECORDING else "run.mcap"


def add_results(
    recording: Recording, result: Result, identity: Mapping[str, str], config: SlamConfig
) -> None:
    """Write the results beside the recording, and both into one log if it is a single file.

    Raises:
        LogError: the disk fails; the recording stays as it was.
    """

    def copy(log: LogWriter) -> None:
        with open_log(folder / RECORDING) as recorded:
            for name, values in recorded.metadata().items():
                if name != "run":
                    log.add_metadata(name, values)
            for receipt_ns, message in recorded.receipts():
                log.write(message, receipt_ns)
            for attachment in recorded.attachments():
                if attachment.name != "config.json":
                    log.add_attachment(attachment.name, attachment.data, attachment.media_type)
            result.lost.update(recorded.skipped)

    folder = recording.path.parent
    single = recording.path.name == RECORDING
    if not single:
        result.lost.update(recording.skipped)
    made = folder / "results"
    made.mkdir()
    try:
        settings = config.model_dump_json(indent=2).encode()
        write_results(made, result, identity, settings, copy if single else None)
        for path in made.iterdir():
            os.replace(path, folder / path.name)
    finally:
        shutil.rmtree(made, ignore_errors=True)
