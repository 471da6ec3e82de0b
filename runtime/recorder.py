"""What a flight leaves behind: the topics of its log, the resolved configuration and a summary beside it."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

import msgspec
import numpy as np

from runtime.advice import highest_alpha
from runtime.config import Configuration
from runtime.findings import describe
from runtime.hypotheses import hypotheses
from runtime.link import Severity
from runtime.structured import Effectiveness
from runtime.switching import Decision
from runtime.ulog import ULog
from task.config import to_json
from task.errors import UserError
from task.state import ACTION, REFERENCE, STATE


class Percentiles(msgspec.Struct, frozen=True):
    """Spread of a time."""

    count: int
    p50: float
    p99: float
    p999: float
    max: float


def percentiles(values: np.ndarray) -> Percentiles | None:
    """Return the spread of values (N,); None without any."""
    if not len(values):
        return None
    p50, p99, p999 = np.percentile(values, (50.0, 99.0, 99.9))
    return Percentiles(len(values), *(round(float(v), 3) for v in (p50, p99, p999, np.max(values))))


class Summary(msgspec.Struct, kw_only=True):
    """One flight in counts and times; what depends on the wall clock is here and not in the log."""

    outcome: str
    """over, lost, silent, stopped, replaced (the aircraft's side began another flight) or failed (the link, or the
    runtime itself)."""
    seconds: float
    """Simulated time from the first to the last state [s]."""
    wall_seconds: float
    cycles: int
    """States that were answered."""
    overruns: int
    """Cycles that took longer than a sample time."""
    missed: int
    """Samples that did not come in time (real time)."""
    skipped: int
    """States that were there but older than another (real time, or in one datagram with it)."""
    repeated: int
    """States that came again and were answered again."""
    gaps: int
    """Times that samples were missing between two states."""
    plays: int
    plays_skipped: int
    """Imaginations not asked for, because the last one was still under way."""
    plays_failed: int
    switches: int
    alarms: int = 0
    """Times that the surfaces' effectiveness was suspected to have changed."""
    pulses: int = 0
    """Times that a surface was moved only to see what it does."""
    health: dict[str, int]
    """Cycles in which each flag of ``runtime.guard.Health`` was up."""
    updates: int
    """Samples that the model learnt from."""
    updates_skipped: int
    restarts: int
    """Times that the recursion started again from its prior because it was no longer finite."""
    cycle_us: Percentiles | None
    """From a state at hand to its command on the way [us]."""
    imagination_ms: Percentiles | None
    real_time: list[str] = []
    """What was asked of the system for real time, and what it gave."""
    log_error: str = ""


CYCLE = [
    *(("float", signal.name) for table in (STATE, ACTION) for signal in table),
    *(("float", f"{signal.name}_ref") for signal in REFERENCE),
    ("float", "blend"),
    ("uint32_t", "tick"),
    ("int16_t", "member"),
    ("uint16_t", "health"),
]
"""Fields of the topic, type and name; what they mean is in docs/operations.md."""
PLAY = [
    ("float", "lead"),
    ("float", "age"),
    ("uint32_t", "tick_asked"),
    ("int16_t", "member"),
    ("uint8_t", "action"),
    ("uint8_t", "reason"),
]
"""The same, after the returns."""
EFFECTIVENESS = [
    *(("float", f"{kind}_{surface.name}") for kind in ("lambda", "sd") for surface in ACTION),
    *(("float", f"bias_{rate}") for rate in "pqr"),
    *(("float", f"{end}_{surface.name}") for end in ("low", "high") for surface in ACTION),
    ("float", "noise"),
    ("float", "unrest"),
    ("float", "surprise"),
    ("uint32_t", "alarms"),
    ("uint16_t", "delay"),
    ("uint8_t", "hypothesis"),
    ("float", "confidence"),
    ("uint8_t", "stuck"),
    ("uint8_t", "filtered"),
    ("uint8_t", "excited"),
    ("float", "alpha_highest"),
]
"""The same; docs/adaptation.md says what they mean."""

BESIDE = ("config", "summary")
"""What accompanies a log."""


def beside(log: Path, what: str) -> Path:
    """Return the path of a file that accompanies a log: flight.ulg -> flight.summary.json."""
    return log.with_suffix(f".{what}.json")


def check_writable(log: Path) -> None:
    """Make the log's folder; raise UserError when no log can be written there."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        device = log.exists() and not log.is_file()  # such as /dev/null; a file that is there is left as it is
        writable = os.access(log if device else log.parent, os.W_OK) and not log.is_dir()
        if not device and writable:
            tempfile.TemporaryFile(dir=log.parent).close()  # not every folder that may be written takes files: /proc
    except OSError:
        writable = False
    if not writable:
        raise UserError(f"--log {log}: cannot be written; choose another file or folder")


class Recorder:
    """Writes one flight; topics and fields as in docs/operations.md."""

    def __init__(
        self,
        path: Path,
        configuration: Configuration,
        population: str,
        members: list[str],
        outputs: tuple[STATE, ...],
        information: dict[str, str],
        threaded: bool = False,
    ) -> None:
        self.path = path
        self._log = ULog(path, threaded)
        self._head(configuration, population, members, information)
        log, structured = self._log, configuration.adaptation.effectiveness == "structured"
        self._cycle = log.topic("cycle", CYCLE)
        self._innovation = log.topic(
            "innovation", [("double", "trace_P"), *(("float", signal.name) for signal in outputs)]
        )
        self._play = log.topic("play", [(f"float[{len(members) + 1}]", "returns"), *PLAY])
        self._effectiveness = log.topic("effectiveness", EFFECTIVENESS) if structured else None
        self._log.begin()
        self.lost: list[str] = []
        """What of the record could not be written, and why, a line each."""
        self._reserve = configuration.adaptation.elevator_reserve
        self._flush_ticks = configuration.operation.flush_ticks
        self._unflushed = 0
        self._dropping = False
        self._write_beside("config", configuration)

    def _head(
        self, configuration: Configuration, population: str, members: list[str], information: dict[str, str]
    ) -> None:
        """Write who flies and how, before the topics."""
        log, adaptation, dt = self._log, configuration.adaptation, configuration.operation.dt
        log.info("sys_name", "Understudy")
        log.info("population", population)
        log.info("members", msgspec.json.encode(members).decode())  # a list: names may hold commas
        if adaptation.effectiveness == "structured":  # what the field ``hypothesis`` counts
            names = [describe(choice, dt) for choice in hypotheses(adaptation, dt)]
            log.info("hypotheses", msgspec.json.encode(names).decode())
        for key, text in information.items():
            log.info(key, text)
        self._parameters(msgspec.to_builtins(configuration))

    def _write_beside(self, what: str, value: object) -> None:
        """Write a file that accompanies the log; one that the disk does not take whole is no file.

        What is no file of its own, as /dev/null, is accompanied by nothing.
        """
        if not self.path.is_file():
            return
        path = beside(self.path, what)
        try:
            path.write_bytes(to_json(value))
        except OSError as error:
            self.lost.append(f"{path}: cannot be written: {error.strerror}")
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)

    def _parameters(self, tree: dict[str, object], prefix: str = "") -> None:
        """Write the configuration: numbers as parameters, words as information."""
        for key, value in tree.items():
            if isinstance(value, dict):
                self._parameters(value, f"{prefix}{key}.")
            elif isinstance(value, (bool, int)):
                self._log.parameter(prefix + key, int(value))
            elif isinstance(value, float):
                self._log.parameter(prefix + key, value)
            else:
                self._log.info(prefix + key, str(value))

    def cycle(
        self,
        time_usec: int,
        tick: int,
        x: np.ndarray,
        action: np.ndarray,
        reference: np.ndarray,
        blend: float,
        member: int,
        health: int,
    ) -> None:
        """Record one cycle, and hand the log over every so often."""
        self._log.write(self._cycle, time_usec, *x, *action, *reference, blend, tick, member, health)
        self._unflushed += 1
        if self._unflushed >= self._flush_ticks:
            self._unflushed = 0
            self._log.flush()

    def innovation(self, time_usec: int, innovation: np.ndarray, trace: float) -> None:
        """Record what the model did not foresee (eq. 8.7) and trace(P)."""
        self._log.write(self._innovation, time_usec, trace, *innovation)

    def effectiveness(self, time_usec: int, found: Effectiveness, excited: int, filtered: int) -> None:
        """Record what is known of the surfaces and sensors.

        excited: the surface that has a pulse in this sample (-1: none); filtered: which states are, as bits.
        """
        if self._effectiveness is not None:
            low, high, _ = found.actuators.tolist()
            self._log.write(
                self._effectiveness, time_usec, *found.effectiveness, *found.sd, *found.bias, *low, *high,
                found.unrest.noise_variance**0.5, max(found.unrest.levels), found.surprise, found.alarms,
                found.delay_samples, found.evidence.believed, found.evidence.confidence, found.stuck.mask, filtered,
                1 << excited if excited >= 0 else 0, highest_alpha(found, self._reserve),
            )  # fmt: skip

    def play(self, time_usec: int, returns: np.ndarray, age: float, tick_asked: int, decision: Decision) -> None:
        """Record an imagination at the moment that it decides."""
        self._log.write(
            self._play, time_usec, *returns, decision.lead, age, tick_asked,
            decision.member, int(decision.action), int(decision.reason),
        )  # fmt: skip

    def message(self, time_usec: int, severity: int, text: str) -> None:
        """Record a line, and hand the log over when it is more than information."""
        self._log.message(time_usec, severity, text)
        if severity < Severity.INFO:
            self._log.flush()

    def trouble(self) -> str:
        """Return what is to be said of the log from now on; empty when nothing is, or it was said."""
        before, self._dropping = self._dropping, self._log.dropping
        if self._dropping == before:
            return ""
        return "the disk is too slow: the log has a gap from here on" if self._dropping else "the log goes on"

    def close(self, summary: Summary) -> None:
        """Close the log and write the summary beside it."""
        self._log.close()
        summary.log_error = self._log.error
        if self._log.hangs:
            self.lost.append(f"{beside(self.path, 'summary')}: not written to a disk that hangs")
        else:
            self._write_beside("summary", summary)
        if self._log.error:
            self.lost.insert(0, self._log.error)
