"""Where files are to go: asked before the work that fills them, not after it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from task.errors import UserError


def make_folder(folder: Path, what: str) -> Path:
    """Make a folder in which files can be written, and return it; raise UserError that begins with ``what``."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UserError(f"{what}: {folder}: cannot write there: {error.strerror}; choose another folder") from None
    return folder
