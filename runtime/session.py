"""A run of the runtime: what is made once, flight after flight on it, and how it ends."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from runtime.clock import Clock, RateKeeper, SteppedClock, hardened
from runtime.config import Adaptation, Configuration
from runtime.ensemble import Ensemble
from runtime.excitation import Excitation
from runtime.guard import UNUSABLE, Guard, describe
from runtime.identification import IncrementalModel
from runtime.imagination import Imagination, Imagines, Snapshot
from runtime.laws.catalogue import load_settings, make_law
from runtime.laws.solo import NoPlays, Solo
from runtime.link import Link, Sample, Severity
from runtime.loop import Loop, Outcome, in_words
from runtime.plays import Plays
from runtime.policy import Policy
from runtime.population import BehaviouralPolicy, Population, probe
from runtime.recorder import BESIDE, Recorder, Summary, beside, check_writable, percentiles
from runtime.reference import LiveReference, Reference
from runtime.switching import Cast, opposed
from task.errors import UserError
from task.law_names import own_digest
from task.state import N_REFERENCE, N_STATE, STATE


class Flown(NamedTuple):
    """One flight that was flown: how it ended, its log (None without one), its summary, and what of them is lost."""

    outcome: Outcome
    log: Path | None
    summary: Summary
    lost: tuple[str, ...] = ()
    """What of its record could not be written, and why."""
    failure: str = ""
    """Why the link failed, where that ended the flight."""


def log_path(log: Path, number: int) -> Path:
    """Return the name of log ``number``: flight.ulg, flight.2.ulg, ...; where it has no suffix flight, flight-2, ..."""
    if number == 1:
        return log
    return log.with_name(f"{log.stem}.{number}{log.suffix}" if log.suffix else f"{log.name}-{number}")


def free_log(log: Path, number: int = 1) -> Path:
    """Return the first log from ``number`` on of which nothing is there yet, so that no flight is lost.

    What is no file of its own, as /dev/null, is no flight, and taken as it is.
    """
    while True:
        path = log_path(log, number)
        if not any(part.is_file() for part in (path, *(beside(path, what) for what in BESIDE))):
            return path
        number += 1


def members_of(population: Population, adaptation: Adaptation) -> list[str]:
    """Return the names of all members, networks before laws. Raises UserError when they do not fit together."""
    names = [*population.members, *adaptation.laws]
    if twice := [name for name in adaptation.laws if name in population.members]:
        others = msgspec.json.encode([name for name in adaptation.laws if name not in population.members]).decode()
        raise UserError(f"laws: {twice[0]}: the population has a member of this name; --set 'laws={others}'")
    if adaptation.first and adaptation.first not in names:
        raise UserError(
            f"first: expected one of {', '.join(names)}, got {adaptation.first!r}; --set first=NAME, "
            "or --set first= for the population's champion"
        )
    return names


class Session:
    """Everything that outlives a flight. Use it as a context manager.

    ``population`` is the cast, or one law that flies alone.
    ``say`` takes one line at a time; ``stopped`` is asked whether somebody wants to end the flight. A log that is
    there already is kept, and the next free name taken; with ``overwrite`` it is not.
    """

    def __init__(
        self,
        link: Link,
        population: Population | Solo,
        reference: Reference,
        configuration: Configuration,
        log: Path,
        say: Callable[[str], None] = lambda line: None,
        stopped: Callable[[], bool] = lambda: False,
        information: dict[str, str] | None = None,
        overwrite: bool = False,
    ) -> None:
        adaptation, operation = configuration.adaptation, configuration.operation
        check_writable(log)
        if not isinstance(population, Solo) and operation.dt != population.manifest.dt:
            raise UserError(
                f"dt: population {population.name} flies with {population.manifest.dt:g} s, got {operation.dt:g} s; "
                "leave dt out"
            )
        self._link, self._population, self._reference = link, population, reference
        self._configuration, self._log, self._overwrite = configuration, log, overwrite
        self._say, self._stopped = say, stopped
        own = {name: digest for name in adaptation.laws if (digest := own_digest(name))}
        told = {"laws_sha256": msgspec.json.encode(own).decode()} if own else {}
        self._information = {"population_sha256": population.sha256, **told, **(information or {})}
        self._policy: Policy = population.law if isinstance(population, Solo) else BehaviouralPolicy(population)
        cast = None if isinstance(population, Solo) else population
        self._members = population.members if cast is None else members_of(cast, adaptation)
        self._cast = Cast(
            self._policy.parameters, population.parameters,
            self._members.index(adaptation.first) if cast and adaptation.first else population.champion,
            adaptation.rho, opposed(probe(cast)) if cast else None,
        )  # fmt: skip
        self._model = IncrementalModel(
            adaptation, population.command_lag, population.theta, population.p0, operation.dt,
            cast.rates if cast else None, cast.max_delay if cast else 0, cast.learnt_at if cast else None,
        )  # fmt: skip
        self._guard = Guard(operation)
        self._horizon = round(adaptation.horizon / operation.dt)
        self._ensemble: Ensemble | None = None
        if isinstance(self._policy, BehaviouralPolicy) and adaptation.laws:
            settings = load_settings()
            laws = [make_law(name, settings, operation.dt, member=True) for name in adaptation.laws]
            self._policy = self._ensemble = Ensemble(self._policy, laws, self._cast, self._model)
        self._imagination: Imagines | None = (
            None if cast is None else Imagination(cast, self._horizon, len(adaptation.laws))
        )
        self._real_time: list[str] = []
        self._told = 0, 0
        """States skipped and repeated, as the link counts them, that summaries have told of."""
        self._rehearse()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._imagination is not None:
            self._imagination.close()

    def _rehearse(self) -> None:
        """Run every part once, so that nothing is slow the first time that it matters."""
        x = np.zeros(N_STATE)
        x[[STATE.V, STATE.h]] = 90.0, 2000.0  # somebody's law may divide by them
        self._policy.steer(x, np.zeros(N_REFERENCE))
        if self._imagination is None:
            return
        identified = self._model.snapshot()
        reference = np.zeros((self._horizon + 1, N_REFERENCE), dtype=np.float32)
        laws = self._ensemble.linear() if self._ensemble else ()
        self._imagination.request(
            Snapshot(**identified._asdict(), reference=reference, incumbent=self._cast.live, laws=laws), 0
        )
        self._imagination.wait(0)

    def imagine_in(self, make: Callable[[Policy, Cast, IncrementalModel, Guard], Imagines]) -> None:
        """Ask somebody else than the population's graphs, made from what flies, what comes of the members.

        A yardstick for them: they are what there is on board. Only before :meth:`fly`, and where there is a cast.
        """
        if self._imagination is None:
            raise ValueError("imagine_in: a law that flies alone imagines nothing")
        self._imagination.close()
        self._imagination = make(self._policy, self._cast, self._model, self._guard)

    def fly(self) -> list[Flown]:
        """Wait for the first state, and fly until there is no next flight; return every flight flown.

        A link that fails in flight (OSError) ends it, as its outcome says. Raises UserError when no usable state comes
        within ``start_patience``, or the link fails before one came.
        """
        operation = self._configuration.operation
        with ExitStack() as stack:
            if operation.real_time:
                self._real_time = stack.enter_context(hardened(operation.core))
            for line in self._real_time:
                self._say(line)
            return self._fly_all()

    def _fly_all(self) -> list[Flown]:
        sample = self._first_state()
        flown: list[Flown] = []
        while sample is not None:
            number = len(flown) + 1
            path = log_path(self._log, number) if self._overwrite else free_log(self._log, number)
            began = "first state" if number == 1 else "a new flight"
            self._say(f"{began} at {1e-6 * sample.time_usec:.2f} s; flying, log in {path}")
            flight, sample = self._fly_one(sample, path)
            flown.append(flight)
        return flown

    def _first_state(self) -> Sample | None:
        """Return the first usable state; None when stopped before it."""
        deadline = time.monotonic() + self._configuration.operation.start_patience
        unusable = ""
        while time.monotonic() < deadline:
            try:
                sample = self._link.read(0.2)
            except OSError as error:
                raise UserError(
                    f"the link failed before any state that could be flown came: {in_words(error)}"
                ) from None
            if self._stopped():
                return None
            if sample is None:
                continue
            health = self._guard.check_state(sample.x)
            if not health & UNUSABLE:
                return sample
            if not unusable:
                unusable = describe(health)
                self._say(f"not flying yet: {unusable}")
        heard = f"states came, but {unusable}" if unusable else self._link.diagnosis()
        raise UserError(f"no state within {self._configuration.operation.start_patience:g} s: {heard}")

    def _fly_one(self, first: Sample, path: Path) -> tuple[Flown, Sample | None]:
        """Fly one flight from its first state; return it, and the first state of the one that replaced it."""
        began = time.monotonic()
        adaptation, operation = self._configuration.adaptation, self._configuration.operation
        self._cast.reset()
        self._policy.reset()
        self._model.reset()
        self._guard.reset()
        clock: Clock = RateKeeper(operation.dt, operation.missed_factor) if operation.real_time else SteppedClock()
        plays = NoPlays() if self._imagination is None else Plays(
            self._imagination, self._model, self._cast, self._reference, adaptation, operation.dt,
            not operation.real_time, self._ensemble,
        )  # fmt: skip
        members = self._members
        recorder = Recorder(
            path, self._configuration, self._population.name, members, self._model.outputs, self._information,
            threaded=operation.real_time,
        )  # fmt: skip
        excitation = Excitation(adaptation, self._model.effectiveness, operation.dt)
        loop = Loop(
            self._link, clock, self._policy, self._cast, self._model, plays, self._reference, self._guard, recorder,
            excitation, operation, members, self._say, self._stopped,
        )  # fmt: skip
        outcome = Outcome.FAILED
        try:
            outcome = loop.fly(first)
        finally:  # whatever ended it, what was flown is on record
            if isinstance(self._reference, LiveReference):
                self._reference.release()
            summary = self._summarise(loop, plays, clock, outcome, time.monotonic() - began)
            if loop.failure:
                recorder.message(loop.last.time_usec, Severity.CRITICAL, f"the link failed: {loop.failure}")
            recorder.message(loop.last.time_usec, Severity.INFO, f"flight ends: {outcome}")
            recorder.close(summary)
            for line in recorder.lost:
                self._say(line)
        return Flown(outcome, path, summary, tuple(recorder.lost), loop.failure), loop.next_flight

    def _summarise(
        self, loop: Loop, plays: Plays | NoPlays, clock: Clock, outcome: Outcome, wall_seconds: float
    ) -> Summary:
        rls, link = self._model.rls, self._link
        (skipped_before, repeated_before), self._told = self._told, (link.skipped, link.repeated)
        return Summary(
            outcome=str(outcome),
            seconds=round(1e-6 * (loop.last.time_usec - loop.first.time_usec), 6),
            wall_seconds=round(wall_seconds, 3),
            cycles=loop.cycles,
            overruns=loop.overruns,
            missed=clock.missed,
            skipped=link.skipped - skipped_before,
            repeated=link.repeated - repeated_before,
            gaps=loop.gaps,
            plays=plays.asked,
            plays_skipped=plays.skipped,
            plays_failed=plays.failed,
            switches=loop.switches,
            alarms=self._model.effectiveness.alarms if self._model.effectiveness else 0,
            pulses=loop.excitation.pulses,
            health=dict(loop.health_counts),
            updates=rls.updates,
            updates_skipped=rls.skipped,
            restarts=rls.restarts,
            cycle_us=percentiles(np.frombuffer(loop.cycle_us, dtype=np.float32)),
            imagination_ms=percentiles(1e3 * np.array(plays.seconds)),
            real_time=self._real_time,
        )
