"""What a campaign keeps: a journal of flights while it goes on, and the Parquet file that the report is made of."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from scenarios.campaign.scores import Record
from sim_bridge.truth import write_whole
from task.errors import UserError
from task.files import make_folder

_KINDS = {str: pa.string(), int: pa.int32(), float: pa.float32(), bool: pa.bool_(),
          list[float]: pa.list_(pa.float32()), list[str]: pa.list_(pa.string())}  # fmt: skip
SCHEMA = pa.schema([(f.encode_name, _KINDS[f.type]) for f in msgspec.structs.fields(Record)])
"""One row for each flight; the columns are the fields of :class:`scenarios.campaign.scores.Record`."""


_NEEDED = {f.encode_name for f in msgspec.structs.fields(Record) if f.required}


INFORMATION = ("population", "champion", "half", "command")
"""What is known of all flights together."""


class Entry(msgspec.Struct, kw_only=True):
    """One line of the journal: a task that was flown."""

    key: str
    """What was flown: cell, row and population."""
    code: str
    """With which program."""
    seconds: float
    """Wall time that it took."""
    records: list[dict[str, Any]]
    """Its flights."""


class Journal:
    """One line for each task, written as it is finished: what was killed goes on where it was."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> dict[str, list[Entry]]:
        """Return what was flown, by key, the newest last; a line torn by a kill is passed over."""
        found: dict[str, list[Entry]] = {}
        if not self.path.exists():
            return found
        for line in self.path.read_bytes().splitlines():
            try:
                entry = msgspec.json.decode(line, type=Entry)
            except msgspec.DecodeError:
                continue
            found.setdefault(entry.key, []).append(entry)
        return found

    def write(self, entry: Entry) -> None:
        """Append one task. Raises UserError."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab+") as file:
                if file.tell():
                    file.seek(-1, 2)
                    torn = file.read(1) != b"\n"
                    file.write(b"\n" * torn)
                file.write(msgspec.json.encode(entry) + b"\n")
        except OSError as error:
            raise UserError(
                f"{self.path}: cannot be written: {error.strerror or error}; make room, and give the command again: "
                "what is in it is kept"
            ) from None


def plain(record: Record) -> dict[str, Any]:
    """Return a record as the journal holds it: what is not known is left out."""
    return {key: value for key, value in msgspec.to_builtins(record).items() if value == value}


def from_plain(data: dict[str, Any]) -> Record:
    """Return a record of the journal."""
    return msgspec.convert(data, Record)


def write_parquet(records: Iterable[Record], path: Path, information: dict[str, str]) -> Path:
    """Write the flights in a fixed order, so that equal flights give an equal file, byte by byte; whole or not at all.

    Raises UserError.
    """
    ordered = sorted(records, key=lambda r: (r.suite, r.fault, r.index, r.row, r.member))
    columns = [
        pa.array([getattr(r, field.name) for r in ordered], type=field.type, from_pandas=False) for field in SCHEMA
    ]
    table = pa.Table.from_arrays(columns, schema=SCHEMA.with_metadata(information))
    make_folder(path.parent)
    write_whole(
        path, lambda file: pq.write_table(table, file, compression="zstd", compression_level=19, use_dictionary=True)
    )
    return path


class Stored(NamedTuple):
    """A Parquet file."""

    records: list[Record]
    information: dict[str, str]
    """Population, half, command."""


def read_parquet(path: Path) -> Stored:
    """Read what :func:`write_parquet` wrote, now or before a column was added, which is then not known.

    Raises UserError.
    """
    if not path.exists():
        raise UserError(f"{path}: no such file; give the Parquet file that a campaign wrote")
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise UserError(f"{path}: cannot be read as Parquet: {' '.join(str(error).split())[:160]}") from None
    if not _NEEDED <= set(table.schema.names) <= set(SCHEMA.names):
        raise UserError(f"{path}: not flights of this campaign: its columns are {', '.join(table.schema.names[:6])}...")
    metadata = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    return Stored([_record(row) for row in table.to_pylist()], metadata)


def _record(row: dict[str, Any]) -> Record:
    """Return a row of a table as the record that was written."""
    return Record(**{key: _as_written(value) for key, value in row.items()})


def _as_written(value: Any) -> Any:
    """Return the shortest number that float32 keeps as this one: 0.4, not 0.4000000059604645, which is more than it."""
    if isinstance(value, list):
        return [_as_written(v) for v in value]
    return float(str(np.float32(value))) if isinstance(value, float) else value


def read_campaign(path: Path) -> Stored:
    """Read the flights of a campaign, of which there are some and it is known what they are of. Raises UserError."""
    stored = read_parquet(path)
    if missing := [name for name in INFORMATION if name not in stored.information]:
        raise UserError(f"{path}: not a file of this campaign: it does not say its {', '.join(missing)}; fly it again")
    if not stored.records:
        raise UserError(f"{path}: holds no flights; give the Parquet file of a campaign that was flown")
    return stored
