"""The fixed-rate cycle: read, identify, decide, act, write."""

from __future__ import annotations

import time
from array import array
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from runtime.clock import Clock
from runtime.config import Operation
from runtime.continuity import Continuity
from runtime.excitation import Excitation
from runtime.findings import Findings
from runtime.guard import DOUBTFUL, NAMES, UNUSABLE, Guard, Health, describe
from runtime.identification import IncrementalModel
from runtime.laws.solo import NoPlays
from runtime.link import Link, Sample, Severity
from runtime.plays import Played, Plays
from runtime.policy import Policy
from runtime.recorder import Recorder
from runtime.reference import RecordedReference, Reference
from runtime.structured import Effectiveness
from runtime.switching import Action, Cast
from task.state import N_ACTION, N_REFERENCE, N_STATE


class Outcome(StrEnum):
    """How a flight ended."""

    OVER = "over"
    LOST = "lost"
    SILENT = "silent"
    STOPPED = "stopped"
    REPLACED = "replaced"
    FAILED = "failed"


def in_words(error: Exception) -> str:
    """Return an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


class Answer(NamedTuple):
    """What a cycle answers to a state."""

    command: np.ndarray
    reference: np.ndarray
    health: int
    played: Played | None = None


class Loop:
    """Flies one flight from its first state to its end. In flight nothing raises and nothing blocks without bound.

    A link that the system fails (OSError) ends it; what else a link raises is a defect of its own, and passes.

    The parts are fresh or reset. ``stopped`` is asked between samples whether somebody wants to end the flight.
    """

    SHOWN = 10
    """Most missing states that whoever flies is shown as foretold, and goes on from [samples]."""
    SAY_AGAIN = 500
    """A health flag is said at most once in this many cycles."""

    def __init__(
        self,
        link: Link,
        clock: Clock,
        policy: Policy,
        cast: Cast,
        model: IncrementalModel,
        plays: Plays | NoPlays,
        reference: Reference,
        guard: Guard,
        recorder: Recorder,
        excitation: Excitation,
        operation: Operation,
        members: list[str],
        say: Callable[[str], None] = lambda line: None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self.link, self.clock, self.policy, self.cast = link, clock, policy, cast
        self.model, self.plays, self.reference = model, plays, reference
        self.guard, self.recorder, self.excitation = guard, recorder, excitation
        self.operation, self.members = operation, members
        self.say_here, self.stopped = say, stopped
        self.cycles = self.gaps = self.overruns = self.switches = 0
        self.health_counts: Counter[str] = Counter()
        self.cycle_us = array("f")
        self.next_flight: Sample | None = None
        """The first state of the flight that took this one's place."""
        self._dt_us = round(operation.dt * 1e6)
        self._said_at: dict[int, int] = {}
        self._findings = Findings(model.effectiveness, operation.dt) if model.effectiveness else None
        self._alarms = 0
        self._continuity = Continuity()
        self._sent = np.zeros(N_ACTION)
        """The last command [rad]."""
        self._lost_track = False
        """Whether the model has stood in for states for as long as it can."""
        self.failure = ""
        """Why the link failed, where that ended the flight."""

    def fly(self, first: Sample) -> Outcome:
        """Fly from the first state until the flight ends, and say how it ended."""
        try:
            self.begin(first)
            with np.errstate(all="ignore"):
                return self.until_it_ends(first)
        except OSError as error:  # nothing else in here asks the system for anything: records keep their own errors
            self.failure = in_words(error)
            return Outcome.FAILED

    def until_it_ends(self, first: Sample) -> Outcome:
        """Answer one state after the other; return why there is no next one."""
        heard = time.monotonic()
        sample: Sample | None = first
        while True:
            if sample is not None:
                self.cycle(sample)
                heard = time.monotonic()
            elif self.link.ended:
                return Outcome(self.link.ended)
            elif time.monotonic() - heard > self.operation.patience:
                return Outcome.SILENT
            elif self.clock.overdue():
                self.miss()
            if self.stopped():
                return Outcome.STOPPED
            sample = self.link.read(self.clock.wait())
            if sample is not None and self.replaces(sample):
                self.next_flight = sample
                return Outcome.REPLACED

    def begin(self, first: Sample) -> None:
        """Set the times that the flight is counted from."""
        self.first = self.last = first
        self._zero_usec = 0 if self.operation.reference_from == "zero" else first.time_usec
        self.clock.arrived()
        t = 1e-6 * (first.time_usec - self._zero_usec)
        if isinstance(self.reference, RecordedReference) and 0.0 < self.reference.duration < t:
            self.say(
                first,
                Severity.WARNING,
                f"the reference ended at {self.reference.duration:g} s: its last row is held; where its t = 0 is the "
                "first state, --set reference_from=first_state",
            )

    def cycle(self, sample: Sample) -> None:
        """Answer one state: read, identify, decide, act, write."""
        began = time.perf_counter_ns()
        try:
            answer = self.answer(sample)
        except Exception as error:  # whatever it is, the aircraft needs a command
            answer = self.recover(sample, error)
        if answer.health & (UNUSABLE | Health.DEFECT) and not self.guard.has_command:
            self.report(sample, answer.health)
            self.last = sample
            return
        self.link.write(answer.command, sample.time_usec)
        self.cycle_us.append(1e-3 * (time.perf_counter_ns() - began))
        self.clock.arrived()
        failed = False
        np.copyto(self._sent, answer.command)
        try:
            self.model.command(answer.command)
            self.policy.sent(answer.command)
        except Exception as error:
            self.recover(sample, error)
            failed = True
        try:
            self.account(sample, answer)
        except Exception as error:  # what cannot be recorded was learnt all the same
            self.confess(sample, error)
            failed = True
        if failed:
            self.health_counts[NAMES[Health.DEFECT]] += 1
        self.cycles += 1
        self.last = sample
        self.overruns += time.perf_counter_ns() - began > 1000 * self._dt_us

    def answer(self, sample: Sample) -> Answer:
        """Return what to send for a state that has come."""
        x, t = sample.x, 1e-6 * (sample.time_usec - self._zero_usec)
        health, missed = self.check(sample)
        foretold = self.stand_in(health, missed)
        if foretold is not None:
            reference = self.reference.at(t)
            self.cast.step()
            command, why = self.guard.command(self.policy.steer(foretold, reference))
            return Answer(command, reference, health | why | Health.COASTING)
        if health & UNUSABLE:
            self.restart_histories(missed=0)
            command, why = self.guard.fallback()
            return Answer(command, self.reference.at(t), health | why)
        if not self.guard.has_command:  # the flight begins here: its first states may have been garbage
            self.reference.start(x)
        reference = self.reference.at(t)
        if health & DOUBTFUL:  # flown on, for want of better, and not learnt from
            self.model.restart_history(missed=0)
            command, why = self.guard.command(self.policy.steer(x, reference))
            return Answer(command, reference, health | why)
        self.model.observe(x)
        played = self.plays.step(self.tick(sample), t)
        if played is not None:
            self.cast.take(played.decision)
        self.cast.step()
        action = self.policy.steer(self.model.answered(x), reference)
        command, why = self.guard.command(self.excitation.add(action))
        return Answer(command, reference, health | why, played)

    def stand_in(self, health: int, missed: int | None) -> np.ndarray | None:
        """Return the state (12,) that the model foretells where that of a sample cannot be relied upon, or None.

        missed: samples that are missing before it; None where it follows the last. None is returned where the state can
        be relied upon, and once the model can no longer stand in: until one follows the last, states are then taken as
        they come.
        """
        shown = self.bridge(missed) if missed else 0
        bridged = shown == (missed or 0)
        if health & DOUBTFUL and not self._lost_track and bridged:
            foretold = self.model.coast()
            if foretold is not None:
                return _whole(foretold)
        self._lost_track = bool(health & DOUBTFUL)
        if self.model.coasting or missed is not None:
            coasted = self.model.coasting
            self.model.restart_history((missed or 0) - shown)
            if not (bridged and 0 < coasted <= self.SHOWN):
                self.policy.restart_history()
        return None

    def bridge(self, missed: int) -> int:
        """Show whoever flies the states that the model foretells for so many that are missing; return how many it can.

        The last command was held meanwhile. Filters of laws, which a gap would start anew, go on.
        """
        if missed > self.SHOWN:
            return 0
        for shown in range(missed):
            foretold = self.model.coast()
            if foretold is None:
                return shown
            usec = self.last.time_usec - self._zero_usec + (shown + 1) * self._dt_us
            self.policy.steer(_whole(foretold), self.reference.at(1e-6 * usec))
            self.model.command(self._sent)
            self.policy.sent(self._sent)
        return missed

    def recover(self, sample: Sample, error: Exception) -> Answer:
        """Go on after a defect of the runtime: say it, forget what was learnt, hold the last good command."""
        self.confess(sample, error)
        self.model.reset()
        self.policy.restart_history()
        command, why = self.guard.fallback()
        return Answer(command, np.zeros(N_REFERENCE), why | Health.DEFECT)

    def confess(self, sample: Sample, error: Exception) -> None:
        """Say the flight's first defect of the runtime."""
        if not self.health_counts[NAMES[Health.DEFECT]]:
            with suppress(Exception):  # it may be what failed
                self.say(sample, Severity.CRITICAL, f"the runtime failed: {type(error).__name__}: {error}")

    def tick(self, sample: Sample) -> int:
        """Return how many samples after the first one this is."""
        return round((sample.time_usec - self.first.time_usec) / self._dt_us)

    def restart_histories(self, missed: int) -> None:
        """Forget the samples before a gap of ``missed`` samples, not what was learnt from them."""
        self.model.restart_history(missed)
        self.policy.restart_history()

    def check(self, sample: Sample) -> tuple[int, int | None]:
        """Return what is wrong with a state, and how many are missing before it; None where it follows the last."""
        health, missed = self.guard.check_state(sample.x), None
        step = sample.time_usec - self.last.time_usec
        if sample is not self.first and not self._dt_us < 2 * step < 3 * self._dt_us:
            missed = max(round(step / self._dt_us) - 1, 0)
            self.gaps += 1
            health |= Health.GAP
        if not health & UNUSABLE and self._continuity.broken(sample.x.tolist(), sample.time_usec):
            health |= Health.STATE_JUMPS
        return health, missed

    def replaces(self, sample: Sample) -> bool:
        """Return whether a state belongs to another flight than the last one."""
        return sample.flight != self.last.flight or sample.time_usec < self.last.time_usec

    def miss(self) -> None:
        """No state came in time: send what the last gate has for that, once there was a good command."""
        if self.guard.has_command:
            command, _ = self.guard.fallback()
            self.link.write(command, self.last.time_usec)
        self.report(self.last, Health.STATE_MISSING)

    def account(self, sample: Sample, answer: Answer) -> None:
        """Record and count what the cycle did, and say what is worth a line."""
        command, reference, health, played = answer
        time_usec, rls, cast = sample.time_usec, self.model.rls, self.cast
        self.recorder.cycle(time_usec, self.tick(sample), sample.x, command, reference, cast.blend, cast.flying, health)
        self.recorder.innovation(time_usec, rls.innovation, rls.trace)
        if self.model.effectiveness is not None:
            found, observed = self.model.effectiveness, not health & Health.COASTING
            pulsed = self.excitation.surface if observed else -1
            self.recorder.effectiveness(time_usec, found, pulsed, self.model.filtered)
            if observed:  # else there is no news, and an alarm of the last sample was told of
                self.tell(sample, found)
        if played is not None:
            self.recorder.play(time_usec, played.returns, played.age, played.tick_asked, played.decision)
            if played.error:
                self.say(sample, Severity.WARNING, f"imagination failed: {played.error}")
            if played.decision.action is not Action.KEEP:
                self.switches += 1
                self.say(sample, Severity.INFO, played.describe(self.members))
        if trouble := self.recorder.trouble():
            self.say(sample, Severity.WARNING, trouble)
        if health:
            self.report(sample, health)

    def tell(self, sample: Sample, found: Effectiveness) -> None:
        """Say an alarm, another hypothesis that is believed from now on, and what has been found and holds."""
        findings, lines = self._findings, []
        if findings is None:
            return
        with suppress(Exception):  # no words are worth a flight
            if found.alarmed:
                counted = found.alarms != self._alarms
                lines.append("alarm: the aircraft answers otherwise than known" if counted else findings.suspected())
            if news := findings.look():
                lines.append(news)
        self._alarms = found.alarms
        for line in lines:
            self.say(sample, Severity.WARNING, line)

    def report(self, sample: Sample, health: int) -> None:
        """Count the flags that are up, and say those that were not said lately."""
        news = Health.OK
        for flag, name in NAMES.items():
            if not flag & health:
                continue
            self.health_counts[name] += 1
            if self.cycles - self._said_at.get(flag, -self.SAY_AGAIN) >= self.SAY_AGAIN:
                self._said_at[flag] = self.cycles
                news |= flag
        if news:
            self.say(sample, Severity.WARNING, describe(news))

    def say(self, sample: Sample, severity: int, text: str) -> None:
        """Say a line here, on the link and in the log."""
        self.say_here(f"{1e-6 * sample.time_usec:.2f} s: {text}")
        self.link.say(text, severity)
        self.recorder.message(sample.time_usec, severity, text)


def _whole(foretold: np.ndarray) -> np.ndarray:
    """Return a state (12,) from the foretold one (10,); positions are not foretold: they are zero."""
    return np.concatenate([foretold, np.zeros(N_STATE - len(foretold))])
