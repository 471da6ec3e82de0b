"""Flies what has not been flown yet, a core for each process; what is done is on disk at once."""

from __future__ import annotations

import functools
import hashlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec

from runtime.config import Operation
from runtime.population import load_population
from scenarios.campaign.design import Cell
from scenarios.campaign.flying import Flyer
from scenarios.campaign.rows import Row
from scenarios.campaign.scores import Record
from scenarios.campaign.store import Entry, Journal, from_plain, plain
from task.errors import UserError
from task.law_names import own_digest

ROOT = Path(__file__).resolve().parents[2]
AIRCRAFT_SOURCES = ("sim_bridge", "task", *(f"scenarios/campaign/{name}.py" for name in ("design", "trace", "scores")))
"""What decides every flight, beside its cell and the population."""
MEMBER_SOURCES = (*AIRCRAFT_SOURCES, "scenarios/campaign/members.py", "runtime/population.py", "runtime/guard.py")
LAW_SOURCES = (
    *AIRCRAFT_SOURCES, "scenarios/campaign/alone.py", "runtime/laws", "runtime/guard.py", "runtime/lowpass.py",
    "runtime/identification.py",
)  # fmt: skip
"""The laws' recursive least squares and low pass are the runtime's own."""
ROW_SOURCES = (*AIRCRAFT_SOURCES, "scenarios/campaign/flying.py", "scenarios/campaign/mirrored.py", "runtime")
"""What decides the flight of a row."""
PERFECT_SOURCES = (*ROW_SOURCES, "scenarios/campaign/perfect.py")
"""The same where the cast is imagined in the aircraft itself."""


class Task(NamedTuple):
    """What one process does at a time: a cell in one row, or with every member."""

    cell: Cell
    row: Row | Literal["members"]

    @property
    def row_name(self) -> str:
        """How the row is called."""
        return self.row if isinstance(self.row, str) else self.row.name

    def key(self, population: str) -> str:
        """Return what names this task and everything that decides it but the program.

        A law that flies alone is the same whatever the population is.
        """
        row = self.row.encode() if isinstance(self.row, str) else msgspec.json.encode(self.row)
        alone = not isinstance(self.row, str) and self.row.alone is not None
        parts = (msgspec.json.encode(self.cell), row, b"" if alone else population.encode())
        return hashlib.sha256(b"\0".join(parts)).hexdigest()[:20]


class Done(NamedTuple):
    """One task that was flown."""

    task: Task
    records: list[Record]
    seconds: float
    reused: bool


@functools.cache
def code_hash(places: tuple[str, ...]) -> str:
    """Return a hash of the program's files below ``places``, and of the last gate's times, which every flight has."""
    total = hashlib.sha256(msgspec.json.encode(Operation()))
    for place in places:
        path = ROOT / place
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix in (".py", ".xml", ".json"):
                total.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes())
    return total.hexdigest()[:16]


def code_of(task: Task) -> str:
    """Return the hash of the program that flies a task."""
    if isinstance(task.row, str):
        return code_hash(MEMBER_SOURCES)
    sources = PERFECT_SOURCES if task.row.model == "aircraft" else ROW_SOURCES
    ours, theirs = code_hash(LAW_SOURCES if task.row.alone else sources), own_code(task.row)
    return hashlib.sha256((ours + theirs).encode()).hexdigest()[:16] if theirs else ours


@functools.cache
def own_code(row: Row) -> str:
    """Return a hash of the laws of one's own that fly in a row; empty where there are none."""
    return "".join(map(own_digest, [row.law] if row.law else row.configuration(True).adaptation.laws))


def plan(cells: Iterable[Cell], rows: Sequence[Row | Literal["members"]]) -> list[Task]:
    """Return the tasks, first flights of every fault first: what stops early is as balanced as it can be."""
    return [Task(cell, row) for cell in sorted(cells, key=lambda c: c.index) for row in rows]


def fly_all(
    tasks: Sequence[Task],
    population: Path,
    sha256: str,
    journal: Journal,
    jobs: int,
    any_version: bool = False,
) -> Iterator[Done]:
    """Fly what the journal does not have; yield every task as it is done, those flown before first.

    ``sha256``: of the population. ``any_version``: take flights of another program too. Raises UserError when a flight
    fails, after all others.
    """  # fmt: skip
    flown = journal.read()
    waiting = []
    for task in tasks:
        entries = [e for e in flown.get(task.key(sha256), []) if any_version or e.code == code_of(task)]
        before = _flown_before(task, entries[-1]) if entries else None
        if before is not None:
            yield before
        else:
            waiting.append(task)
    errors = []
    for task, records, seconds, error in _flights(waiting, population, jobs):
        if error:
            errors.append(f"{task.row_name}, {task.cell.name}: {error}")
            continue
        kept = [plain(record) for record in records]
        journal.write(Entry(key=task.key(sha256), code=code_of(task), seconds=round(seconds, 3), records=kept))
        yield Done(task, records, seconds, False)
    if errors:
        raise UserError(f"{len(errors)} of {len(tasks)} tasks failed, the others are kept; first: {errors[0]}")


def _flown_before(task: Task, entry: Entry) -> Done | None:
    """Return a task as the journal has it; None when its records, of another version, lack what is asked now."""
    try:
        return Done(task, [from_plain(r) for r in entry.records], entry.seconds, True)
    except msgspec.ValidationError:
        return None


_Answer = tuple[Task, list[Record], float, str]


def _flights(tasks: Sequence[Task], population: Path, jobs: int) -> Iterator[_Answer]:
    if jobs == 1:
        if tasks:
            with Flyer(load_population(population)) as flyer:
                for task in tasks:
                    yield _answer(flyer, task)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, max(len(tasks), 1)), context, _begin, (population,))
    try:
        for future in as_completed([pool.submit(_work, task) for task in tasks]):
            yield future.result()
    except BrokenProcessPool:
        raise UserError(
            "a process was ended from outside, for want of memory perhaps; give the command again, with --jobs 1"
        ) from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _answer(flyer: Flyer, task: Task) -> _Answer:
    began = time.perf_counter()
    try:
        records = flyer.fly_members(task.cell) if isinstance(task.row, str) else [flyer.fly(task.cell, task.row)]
    except Exception as error:  # one flight must not end a night's campaign; it is named at the end
        return task, [], 0.0, f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return task, records, time.perf_counter() - began, ""


_FLYERS: list[Flyer] = []
"""The one flyer of a process of the pool."""


def _begin(population: Path) -> None:
    """Prepare a process: Ctrl-C is for the one that started it, with which it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    _FLYERS.append(Flyer(load_population(population)))


def end_with_parent() -> None:
    """End this process when the one that started it is gone: after a kill -9 nobody else would end it."""
    if (parent := multiprocessing.parent_process()) is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def _work(task: Task) -> _Answer:
    return _answer(_FLYERS[0], task)
