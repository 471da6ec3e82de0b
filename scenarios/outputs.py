"""Where a command writes: seen to before anything flies, and claimed by one command at a time."""

from __future__ import annotations

import fcntl
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sim_bridge.truth import write_whole
from task.errors import UserError
from task.files import make_folder

LOCK = ".flying"
"""A file in the folder of a scenario that the command which flies there keeps locked; the lock ends with it."""


def file_name(mode: str) -> str:
    """Return a mode as the name of a file or folder: a law of one's own may name a file in a folder."""
    return re.sub(r"[^\w.-]", "_", mode)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the system says of a file that cannot be written into a UserError."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror}; free it, or write elsewhere") from None


def prepare_file(path: Path) -> None:
    """Make the folder of an output and see that a file of its name can be there. Raises UserError."""
    if path.is_dir():
        raise UserError(f"{path}: is a folder; expected the name of a file to write")
    make_folder(path.parent)


def copy(source: Path, path: Path) -> None:
    """Copy a file, whole or not at all. Raises UserError."""
    write_whole(path, lambda file: file.write(source.read_bytes()))


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep a folder of flights to this command. Raises UserError while another flies there."""
    make_folder(folder)
    with writing(folder):
        lock = (folder / LOCK).open("w")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{folder}: another command flies there now; wait for it, or fly elsewhere with --out"
            ) from None
        yield
