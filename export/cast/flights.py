"""Flights in which something happens: each trial is a case, a reference, an onset, and who flies until the handover."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from export.cast.cases import Case
from export.network import Network
from export.training.acting import Cast
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from sim_bridge.sensors import Sensors
from task.limits import DT
from task.metrics import nmae, smoothness
from task.observation import observation, tracking_error
from task.reward import terminated
from task.state import N_ACTION, N_OBSERVATION, N_REFERENCE


class Trial(NamedTuple):
    """One flight that every policy under test is put through."""

    case: Case
    reference: np.ndarray
    """(T, 3) [rad]."""
    onset: float = 0.0
    """When the case's faults begin [s]."""
    handover: float = 0.0
    """From when on the policy under test flies [s]; before, the opening policy does."""
    seed: int = 0
    """Of the sensors' noise, the same for every policy."""


class Flown(NamedTuple):
    """What P policies made of E trials; nothing after ``length`` means anything."""

    error: np.ndarray
    """(T, P, E, 3) float32 true tracking errors [rad]."""
    action: np.ndarray
    """(T, P, E, 3) float32 commands [rad]."""
    length: np.ndarray
    """(P, E) samples flown."""
    lost: np.ndarray
    """(P, E) bool: the flight ended before its time."""

    def nmae(self, since: np.ndarray) -> np.ndarray:
        """Return the nMAE [%] of each flight, (P, E), from ``since`` (E,) samples to the end or the loss."""
        result = np.full(self.length.shape, np.nan)
        for (p, e), n in np.ndenumerate(self.length):
            if n > since[e]:
                result[p, e] = nmae(self.error[since[e] : n, p, e].astype(float))
        return result

    def smoothness(self, since: np.ndarray) -> np.ndarray:
        """Return Sm of each flight (eq. 16) [rad Hz], (P, E), from ``since`` (E,) samples to the end or the loss."""
        result = np.zeros(self.length.shape)
        for (p, e), n in np.ndenumerate(self.length):
            result[p, e] = smoothness(self.action[since[e] : n, p, e].astype(float))
        return result


class Stage:
    """Aircraft that fly side by side in one thread; made once, used for every trial."""

    def __init__(self) -> None:
        """Start with one aircraft; others are added as trials ask for them."""
        self.plants = [Plant()]
        self.frames = 0
        """Samples simulated so far."""

    def fly(
        self, network: Network, parameters: np.ndarray, trials: Sequence[Trial], opening: np.ndarray | None = None
    ) -> Flown:
        """Fly P policies (P, K) through E trials of equal length, P * E aircraft in step.

        opening: (K,) parameters of the policy that flies until each trial's handover; without one the policies
        under test fly from the start. Commands are limited to the network's action_offset +- action_scale.
        """
        P, E, T = parameters.shape[0], len(trials), trials[0].reference.shape[0]
        N = P * E
        self.plants += [Plant() for _ in range(N - len(self.plants))]
        flights = [trials[i % E] for i in range(N)]
        steps = [plant.step for plant in self.plants[:N]]
        x = np.stack([plant.reset(t.case.condition) for plant, t in zip(self.plants, flights, strict=False)])
        wanted = np.tile(np.stack([t.reference for t in trials], axis=1), (1, P, 1))  # (T, N, 3): policy by policy
        breaking = [
            (i, plant, FaultSchedule(t.case.begun(t.onset)))
            for i, (plant, t) in enumerate(zip(self.plants, flights, strict=False))
            if t.case.faults
        ]
        sensing = [
            (i, Sensors(t.case.sensors, np.random.default_rng(t.seed)))
            for i, t in enumerate(flights)
            if t.case.sensors.noise or t.case.sensors.bias or t.case.sensors.delay
        ]
        cast = Cast(network, np.ascontiguousarray(parameters, dtype=np.float32), E)
        handover = np.array([round(t.handover / DT) if opening is not None else 0 for t in trials])
        opener = Cast(network, np.asarray(opening, np.float32)[None], N) if opening is not None else None
        scale, offset = np.array(network.action_scale), np.array(network.action_offset)

        error = np.zeros((T, N, N_REFERENCE), dtype=np.float32)
        action = np.zeros((T, N, N_ACTION), dtype=np.float32)
        s = np.zeros((P, E, N_OBSERVATION), dtype=np.float32)
        length, lost = np.full(N, T), np.zeros(N, dtype=bool)
        flying = list(range(N))
        before = x.copy()
        for k in range(T):
            t = k * DT
            for i, plant, schedule in breaking:
                if not lost[i]:
                    schedule.apply(plant, t)
            error[k] = tracking_error(x, wanted[k])
            measured = x
            if sensing:
                measured = x.copy()
                for i, sensors in sensing:
                    measured[i] = sensors.measure(x[i])
            observation(measured, wanted[k], out=s.reshape(N, N_OBSERVATION))
            u = cast(s)
            if opener is not None and k < handover.max():
                first = opener(s.reshape(1, N, N_OBSERVATION)).reshape(P, E, N_ACTION)
                u = np.where((k < handover)[None, :, None], first, u)
            a = offset + scale * np.clip(u.reshape(N, N_ACTION), -1.0, 1.0)
            action[k] = a
            for i in flying:
                x[i] = steps[i](a[i])
            newly = terminated(x) & ~lost
            if newly.any():  # what is lost stands still from here on
                lost |= newly
                length[newly] = k + 1
                flying = np.flatnonzero(~lost).tolist()
                broken = ~np.isfinite(x).all(axis=1)
                x[broken] = before[broken]
                if not flying:
                    break
            np.copyto(before, x)
        self.frames += int(length.sum())
        shape = (P, E)
        return Flown(
            error.reshape(T, P, E, N_REFERENCE), action.reshape(T, P, E, N_ACTION),
            length.reshape(shape), lost.reshape(shape),
        )  # fmt: skip
