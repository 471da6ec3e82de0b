"""The imagination: a worker thread that plays the whole cast in the identified model, one ONNX call per question.

Laws that are members are played in a graph of their own, in a second call.

onnxruntime releases the interpreter while it plays, so that the control thread never waits for it. It asks with
:meth:`Imagination.request` and looks with :meth:`Imagination.result`, or waits, in lockstep, with
:meth:`Imagination.wait`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from runtime.population import (
    IMAGINATION,
    IMAGINATION_INPUTS,
    IMAGINATION_OUTPUTS,
    LAWS,
    LAWS_INPUTS,
    Population,
    make_session,
)
from task.actuators import HEALTHY
from task.laws import N_MEMORY, N_SEEN, LinearLaw
from task.model import N_REGRESSORS
from task.state import N_ACTION, N_IDENTIFIED, N_REFERENCE

WAIT_BOUND = 60.0
"""Longest wait for one imagination in lockstep [s of wall clock]; such a flight has gone wrong for other reasons."""


class Snapshot(NamedTuple):
    """What an imagination starts from."""

    x: np.ndarray
    """(10,) state."""
    dx: np.ndarray
    """(10,) its last increment."""
    commands: np.ndarray
    """(command_lag + 1 + max_delay, 3) the last commands sent [rad], oldest first."""
    delay: int
    """How many samples later than ``command_lag`` says every command acts, 0 to ``max_delay``."""
    model: np.ndarray
    """(13, 10) Theta of the incremental model, :mod:`task.model`, or (M, 13, 10) of M models to imagine in."""
    exact_kinematics: bool
    """Whether attitude and altitude follow from their kinematics instead of the model."""
    reference: np.ndarray
    """(H + 1, 3) [rad], row t is t samples after x; H is the horizon of this question."""
    incumbent: np.ndarray
    """(K,) the behavioural policy's own parameters."""
    laws: Sequence[LinearLaw] = ()
    """The Q laws that are members."""
    law: int | None = None
    """Which of them flies, and so is the incumbent; None when a network does."""
    actuators: np.ndarray = HEALTHY
    """(3, 3) range [rad] and rate [rad/s] of the surfaces, :mod:`task.actuators`. They limit the commands to come and
    those that wait; the one that acted last and the one that acts now are what ``commands`` says."""


class Prediction(NamedTuple):
    """What an imagination found."""

    returns: np.ndarray
    """(M, P + Q + 1) predicted return of each member, laws after networks, and, last, of the incumbent in each model;
    all NaN when it failed."""
    unsafe: np.ndarray
    """(M, P + Q + 1) samples in which each imagined flight is unsafe (thesis eq. 14) and not yet lost."""
    travel: np.ndarray
    """(M, P + Q + 1) how far the surfaces are moved in it until it is lost [rad], all surfaces together."""
    tick_requested: int
    """The tick of the state that it started from."""
    seconds: float
    """Wall time that it took."""
    error: str = ""
    """Why it failed, in one line; empty when it did not."""


class Imagines(Protocol):
    """Whom a session asks what comes of each member; the newest question counts."""

    def request(self, snapshot: Snapshot, tick: int) -> None:
        """Take a question about the state of ``tick``."""

    def result(self, tick: int) -> Prediction | None:
        """Return the answer to the question asked at ``tick`` if it is there; never waits."""

    def wait(self, tick: int) -> Prediction | None:
        """Wait for the answer to the question asked at ``tick``; None when there is none."""

    def close(self) -> None:
        """End what was begun."""


class _Buffers:
    """One place for a question's arrays, made once for the longest horizon."""

    def __init__(self, population: Population, horizon: int, laws: int) -> None:
        self.x = np.zeros(N_IDENTIFIED, dtype=np.float32)
        self.dx = np.zeros(N_IDENTIFIED, dtype=np.float32)
        self._max_delay = population.max_delay
        self.commands = np.zeros((population.command_lag + 1 + self._max_delay, N_ACTION), dtype=np.float32)
        self.delay = np.zeros((), dtype=np.int64)
        self.model = np.zeros((1, N_REGRESSORS, N_IDENTIFIED), dtype=np.float32)
        self.exact_kinematics = np.zeros((), dtype=bool)
        self.actuators = np.zeros(HEALTHY.shape, dtype=np.float32)
        self.incumbent = np.zeros(population.manifest.n_parameters, dtype=np.float32)
        self.longest = np.zeros((horizon + 1, N_REFERENCE), dtype=np.float32)
        self.reference = self.longest
        self.maps = np.zeros((laws, N_ACTION + N_MEMORY, N_MEMORY + N_SEEN), dtype=np.float32)
        self.memory = np.zeros((laws, N_MEMORY), dtype=np.float32)
        self.law: int | None = None
        self.tick = 0
        self.serial = 0

    def fill(self, snapshot: Snapshot, tick: int, serial: int) -> None:
        """Copy a question in; a reference longer than the horizon is cut."""
        self.x[:] = snapshot.x
        self.dx[:] = snapshot.dx
        self.commands[:] = snapshot.commands
        self.delay[()] = min(max(snapshot.delay, 0), self._max_delay)
        self.model = np.array(snapshot.model, dtype=np.float32).reshape(-1, N_REGRESSORS, N_IDENTIFIED)
        self.exact_kinematics[()] = snapshot.exact_kinematics
        self.actuators[:] = snapshot.actuators
        self.incumbent[:] = snapshot.incumbent
        self.reference = self.longest[: len(snapshot.reference)]
        self.reference[:] = snapshot.reference[: len(self.longest)]
        for law, maps, memory in zip(snapshot.laws, self.maps, self.memory, strict=True):
            maps[:], memory[:] = law.maps, law.memory
        self.law = snapshot.law
        self.tick, self.serial = tick, serial

    def feeds(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return inputs of a graph, where they lie."""
        return {name: getattr(self, name) for name in names}


class Imagination:
    """Plays the cast in its own thread and session. The newest question counts: what it replaces has no answer.

    The same question always has the same answer, bit for bit. A play that fails has returns that are all NaN and says
    why; it does not end the thread. Use it as a context manager, or :meth:`close` it.
    """

    def __init__(self, population: Population, horizon: int, laws: int = 0) -> None:
        """Start the thread. horizon: the most steps H that a question may ask for; laws: Q.

        Raises UserError when there are laws and the population brings no graph for them.
        """
        self.failures = 0
        """Plays that failed so far."""
        self._session = make_session(population.imagination, IMAGINATION)
        self._laws_session = make_session(population.laws_graph(), LAWS) if laws else None
        self._actors = len(population.members) + laws + 1
        # One pair of hands fills the question to come while the other's is being played.
        self._next = _Buffers(population, horizon, laws)
        self._playing = _Buffers(population, horizon, laws)
        self._serial = 0
        self._asked = False
        self._closed = False
        self._answer: tuple[int, Prediction] | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="imagination", daemon=True)
        self._thread.start()

    def request(self, snapshot: Snapshot, tick: int) -> None:
        """Copy a question about the state of ``tick`` and return at once."""
        with self._changed:
            self._serial += 1
            self._next.fill(snapshot, tick, self._serial)
            self._asked = True
            self._answer = None
            self._changed.notify_all()

    def result(self, tick: int) -> Prediction | None:
        """Return the answer to the question asked at ``tick`` if it is there; never waits."""
        answer = self._answer
        if answer is None or answer[0] != self._serial or answer[1].tick_requested != tick:
            return None
        return answer[1]

    def wait(self, tick: int, timeout: float = WAIT_BOUND) -> Prediction | None:
        """Wait for the answer to the question asked at ``tick``; None when there is no such question, or at the bound.

        timeout: bound of the wait [s of wall clock].
        """
        with self._changed:
            self._changed.wait_for(lambda: self._answer is not None or self._serial == 0 or self._closed, timeout)
            return self.result(tick)

    def close(self) -> None:
        """End the thread; a play under way is finished first."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def __enter__(self) -> Imagination:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._asked or self._closed)
                if self._closed:
                    return
                self._asked = False
                self._next, self._playing = self._playing, self._next
            prediction = self._play(self._playing)
            with self._changed:
                if self._playing.serial == self._serial:
                    self._answer = self._serial, prediction
                    self._changed.notify_all()

    def _play(self, question: _Buffers) -> Prediction:
        start = time.perf_counter()
        error = ""
        try:
            found = self._session.run(IMAGINATION_OUTPUTS, question.feeds(IMAGINATION_INPUTS))
            if self._laws_session is not None:
                of_laws = self._laws_session.run(IMAGINATION_OUTPUTS, question.feeds(LAWS_INPUTS))
                found = [_joined(networks, laws, question.law) for networks, laws in zip(found, of_laws, strict=True)]
        except Exception as failure:  # onnxruntime's errors share no base; none of them may end the flight
            found = [np.full((len(question.model), self._actors), np.nan, dtype=np.float32)] * len(IMAGINATION_OUTPUTS)
            error = " ".join(str(failure).split())[:200]
            self.failures += 1
        returns, unsafe, travel = found
        return Prediction(returns, unsafe, travel, question.tick, time.perf_counter() - start, error)


def _joined(networks: np.ndarray, laws: np.ndarray, flying: int | None) -> np.ndarray:
    """Return what came of networks (M, P + 1, incumbent last) and of laws (M, Q) as (M, P + Q + 1)."""
    incumbent = networks[:, -1:] if flying is None else laws[:, flying : flying + 1]
    return np.concatenate([networks[:, :-1], laws, incumbent], axis=1)
