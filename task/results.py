"""Measured figures: every number that README or docs claim is a row of a ``results/*.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from task.config import load_json, to_json
from task.files import atomic, make_folder

FOLDER = Path("results")


class Claim(msgspec.Struct, kw_only=True):
    """One figure, what it was meant to be, and whether it is."""

    claim: str
    value: float | int | str | bool | None
    unit: str = ""
    target: str = ""
    """In words or as a bound; empty for a figure that is only reported."""
    holds: bool | None = None


class Table(msgspec.Struct, kw_only=True):
    """A table that the page shows as it stands; cells are numbers or text."""

    title: str
    columns: list[str]
    rows: list[list[Any]]


class Result(msgspec.Struct, kw_only=True):
    """What one measuring command found."""

    title: str
    command: str
    """The command that measures it again, as typed in the repository's root."""
    seconds: float
    """Wall time that it took."""
    runs: int
    seeds: list[int]
    claims: list[Claim]
    tables: list[Table] = []
    notes: list[str] = []
    """What a reader must know to read the figures honestly, losing cases included."""


def write(name: str, result: Result, folder: Path = FOLDER) -> Path:
    """Write ``results/<name>.json`` whole and return its path; raise UserError when it cannot be written."""
    path = make_folder(folder) / f"{name}.json"
    with atomic(path) as file:
        file.write(to_json(result))
    return path


def read(path: Path) -> Result:
    """Read one result; raise UserError when it is malformed."""
    return load_json(path, Result, "result")
