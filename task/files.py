"""Where populations are, and where files are to go: asked before the work that fills them, not after it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from task.errors import UserError

ROOT = Path(__file__).resolve().parents[1]
"""Of the source tree, which brings populations along."""


def make_folder(folder: Path, what: str = "") -> Path:
    """Make a folder in which files can be written, and return it; raise UserError that begins with ``what``, if any.

    A file is what finds out: /proc and others let folders be asked, and asked for, that take none.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        where = f"{what}: {folder}" if what else str(folder)
        raise UserError(f"{where}: cannot be written: {error.strerror}; free it, or write elsewhere") from None
    return folder


@contextmanager
def atomic(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing so that a reader, or a crash, sees the old content or the new, never a part.

    Raises UserError when the disk does not take it; the old content is left.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        with partial.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UserError(
            f"{path}: cannot be written: {error.strerror or error}; make room or write elsewhere; the old one is kept"
        ) from None
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def find_population(name: str | Path) -> Path:
    """Return the folder of a population given by path or by its name under ``populations/``. Raises UserError."""
    places = [Path(name), Path("populations") / name, ROOT / "populations" / name]
    for place in places:
        if (place / "manifest.json").is_file():
            return place
    raise UserError(
        f"population {str(name)!r}: no such population; expected a folder with a manifest.json, looked in "
        f"{', '.join(dict.fromkeys(str(p) for p in places[:2]))}; train and export one, or give --population"
    )
