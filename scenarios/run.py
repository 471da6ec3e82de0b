"""Flies a scenario: every mode on every reference, two processes a flight, finished flights not flown again."""

from __future__ import annotations

import functools
import hashlib
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Protocol

import msgspec

from scenarios.outputs import file_name, writing
from scenarios.processes import Process, StoppedError, free_port, supervise
from scenarios.references import NamedReference, csv_bytes
from scenarios.schema import Mode, to_toml
from scenarios.score import Score, score_flight
from scenarios.trace import AdaptationTrace, FlightTrace, read_log, read_truth
from sim_bridge.flight import Flight
from sim_bridge.truth import write_whole
from task.config import load_json, to_json
from task.errors import UserError
from task.files import make_folder
from task.law_names import own_digest
from task.reference import n_samples

ROOT = Path(__file__).resolve().parents[1]
SUMMARY = "truth.summary.json"
"""The bridge's summary in the folder of a flight."""
LEFT = (
    "finished.json", "flight.toml", "reference.csv", "runtime.log", "bridge.log", "truth.npz", SUMMARY,
    "flight.ulg", "flight.config.json", "flight.summary.json",
    "flight.[0-9]*.ulg", "flight.[0-9]*.config.json", "flight.[0-9]*.summary.json",
)  # fmt: skip
"""What a flight leaves in its folder, logs of a runtime that began anew among them."""
BYTES_A_SAMPLE = 145
"""About what one sample of the flight log takes; for the progress bar alone."""


@dataclass(frozen=True)
class Job:
    """One flight that is to be flown."""

    flight: Flight
    """The bridge's side."""
    mode: Mode
    """The runtime's side."""
    reference: NamedReference
    """What it is to follow."""
    population: Path
    """The cast."""
    folder: Path
    """Where everything about it goes."""
    realtime: bool = False
    """Wall clock instead of lockstep."""

    @property
    def name(self) -> str:
        """How it is called on the screen."""
        return f"{self.mode.name}, {self.reference.name}"


class Finished(msgspec.Struct, kw_only=True):
    """``finished.json``: a flight that ended well, and what it was made from."""

    inputs: str
    """SHA-256 of everything that decides the flight."""
    seconds: float
    """Wall time that it took, both processes' start included."""


class _LinkCounts(msgspec.Struct):
    late: int


class _BridgeSummary(msgspec.Struct):
    """What is needed of the bridge's summary."""

    outcome: str
    link: _LinkCounts


@dataclass(frozen=True)
class Result:
    """One flight that was flown."""

    job: Job
    flight: FlightTrace
    adaptation: AdaptationTrace
    score: Score
    seconds: float
    """Wall time that it took when it was flown [s]."""
    reused: bool
    """True when it was flown before."""


class Observer(Protocol):
    """Who is told how the flights go; called from several threads."""

    def started(self, job: Job) -> None:
        """A flight begins."""

    def moved(self, job: Job, fraction: float) -> None:
        """A flight is about this far, 0 to 1."""

    def finished(self, job: Job, result: Result) -> None:
        """A flight has ended well."""


class Silent:
    """Nobody."""

    def started(self, job: Job) -> None:
        """Do nothing."""

    def moved(self, job: Job, fraction: float) -> None:
        """Do nothing."""

    def finished(self, job: Job, result: Result) -> None:
        """Do nothing."""


def plan(
    flight: Flight,
    references: Sequence[NamedReference],
    modes: Iterable[Mode],
    population: Path,
    out: Path,
    realtime: bool = False,
) -> list[Job]:
    """Return the flights of every mode on every reference, those of one reference together.

    Each reference has its own seed for noise and turbulence, the same one in every mode.
    """
    modes = list(modes)
    return [
        Job(
            flight=msgspec.structs.replace(flight, seed=flight.seed + i),
            mode=mode,
            reference=reference,
            population=population,
            folder=out / file_name(mode.name) / reference.name,
            realtime=realtime,
        )
        for i, reference in enumerate(references)
        for mode in modes
    ]


@functools.cache
def source_digest() -> str:
    """Return the SHA-256 of the code and data that fly: another version flies every flight again."""
    digest = hashlib.sha256()
    for package in ("task", "runtime", "sim_bridge"):
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix in {".py", ".xml", ".json", ".toml"} and "__pycache__" not in path.parts:
                digest.update(path.relative_to(ROOT).as_posix().encode())
                digest.update(path.read_bytes())
    for package in ("numpy", "onnxruntime", "jsbsim"):
        digest.update(f"{package} {metadata.version(package)}".encode())
    return digest.hexdigest()


def inputs_digest(job: Job) -> str:
    """Return the SHA-256 of everything that decides a flight; the manifest holds the hashes of its population."""
    digest = hashlib.sha256(source_digest().encode())
    digest.update(to_toml(job.flight).encode())
    digest.update(csv_bytes(job.reference.rows))
    digest.update(repr((tuple(job.mode), job.realtime)).encode())
    digest.update(own_digest(job.mode.law).encode())
    digest.update((job.population / "manifest.json").read_bytes())
    return digest.hexdigest()


def fly(job: Job, stop: threading.Event | None = None, fresh: bool = False, observer: Observer | None = None) -> Result:
    """Fly one flight, or take it as it was flown before from the same inputs.

    Raises UserError in one line when it cannot be flown, StoppedError when ``stop`` is set.
    """
    observer = observer or Silent()
    inputs = inputs_digest(job)
    done = job.folder / "finished.json"
    before = None if fresh else _before(done)
    if before is not None and before.inputs == inputs:
        result = load_result(job, before.seconds, reused=True)
        observer.finished(job, result)
        return result
    make_folder(job.folder)
    _clear(job.folder)
    observer.started(job)
    began = time.monotonic()
    try:
        _fly_processes(job, stop or threading.Event(), functools.partial(observer.moved, job))
    except UserError as error:
        raise UserError(f"{job.name}: {error}") from None
    seconds = round(time.monotonic() - began, 3)
    result = load_result(job, seconds, reused=False)
    write_whole(done, lambda file: file.write(to_json(Finished(inputs=inputs, seconds=seconds))))
    observer.finished(job, result)
    return result


def _before(done: Path) -> Finished | None:
    """Return the record of an earlier flight, or None when there is none that can be read: it is flown again."""
    try:
        return load_json(done, Finished, "record of a flight") if done.is_file() else None
    except UserError:
        return None


def _clear(folder: Path) -> None:
    """Remove what an earlier flight left, its record first, and nothing else. Raises UserError before it removes."""
    old = [path for pattern in LEFT for path in sorted(folder.glob(pattern))]
    for path in old:
        if path.is_dir() and not path.is_symlink():
            raise UserError(f"{path}: is a folder where a flight writes a file; move it away")
    with writing(folder):
        for path in old:
            path.unlink()


def _fly_processes(job: Job, stop: threading.Event, moved: Callable[[float], None]) -> None:
    """Start runtime and bridge in the flight's folder and see them through."""
    folder = job.folder
    flight, reference = folder / "flight.toml", folder / "reference.csv"
    log, truth, summary = folder / "flight.ulg", folder / "truth.npz", folder / SUMMARY
    with writing(folder):
        flight.write_text(to_toml(job.flight))
        reference.write_bytes(csv_bytes(job.reference.rows))
    port = free_port()
    who = ["--law", job.mode.law] if job.mode.law else ["--population", str(job.population)]
    clock = ["--realtime"] if job.realtime else []
    runtime = Process(
        "runtime",
        "runtime",
        [
            *("--link", f"udpin:127.0.0.1:{port}", *who, "--reference", str(reference)),
            *("--preset", job.mode.preset, "--switch", job.mode.switch, "--log", str(log), *clock),
        ],
        folder / "runtime.log",
    )
    try:
        bridge = Process(
            "bridge",
            "sim_bridge",
            [
                *("--flight", str(flight), "--link", f"udpout:127.0.0.1:{port}"),
                *("--truth", str(truth), "--summary", str(summary), *clock),
            ],
            folder / "bridge.log",
        )
    except BaseException:
        runtime.end()
        raise
    expected = BYTES_A_SAMPLE * n_samples(job.flight.duration)

    def size() -> float:
        return log.stat().st_size / expected if log.exists() else 0.0

    supervise(runtime, bridge, stop, size, lambda far: moved(min(far, 1.0)))


def load_result(job: Job, seconds: float, reused: bool) -> Result:
    """Read what a flight left and score it. Raises UserError when something is missing."""
    flight = read_truth(job.folder / "truth.npz", job.reference.rows)
    adaptation = read_log(job.folder / "flight.ulg")
    try:
        summary = load_json(job.folder / SUMMARY, _BridgeSummary, "summary of the bridge")
    except UserError as error:
        raise UserError(f"{error}; fly it again with --fresh") from None
    score = score_flight(flight, adaptation, summary.link.late)
    return Result(job=job, flight=flight, adaptation=adaptation, score=score, seconds=seconds, reused=reused)


def fly_all(
    jobs: Sequence[Job], at_once: int = 1, fresh: bool = False, observer: Observer | None = None
) -> list[Result]:
    """Fly all flights, ``at_once`` of them side by side, and return their results in the order of ``jobs``.

    The first flight that fails stops the others; so does KeyboardInterrupt. No process is left behind.
    """
    stop = threading.Event()
    with ThreadPoolExecutor(max_workers=max(at_once, 1), thread_name_prefix="flight") as pool:
        futures: list[Future[Result]] = [pool.submit(_guarded, job, stop, fresh, observer) for job in jobs]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            if any(not f.done() or f.exception() is not None for f in futures):
                stop.set()
                for future in futures:
                    future.cancel()
    failures = [e for f in futures if not f.cancelled() and (e := f.exception()) is not None]
    # Those that were merely stopped say nothing; the one that failed says why.
    for error in sorted(failures, key=lambda e: isinstance(e, StoppedError)):
        raise error
    return [f.result() for f in futures]


def _guarded(job: Job, stop: threading.Event, fresh: bool, observer: Observer | None) -> Result:
    if stop.is_set():
        raise StoppedError
    return fly(job, stop, fresh, observer)
