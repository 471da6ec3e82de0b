"""Flights in which something happens: each trial is a case, a reference, an onset, and who flies until the handover."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from export.cast.cases import Case
from export.network import Network, exceeds_limits, unflatten
from export.training.acting import Cast
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from sim_bridge.sensors import Sensors
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.metrics import nmae, smoothness
from task.observation import observation, tracking_error
from task.reward import terminated
from task.state import N_ACTION, N_REFERENCE, N_STATE

CHECK = 10
"""Samples between two looks at whether the flight is lost."""
FAST = ("tanh", "linear")
"""Activations that :class:`Pilot` flies."""


OF_STATE = observation(np.eye(N_STATE), np.zeros((N_STATE, N_REFERENCE))).T
"""(7, 12): the observation's part that is linear in the state, as ``task.observation`` has it."""
OF_REFERENCE = observation(np.zeros((N_REFERENCE, N_STATE)), np.eye(N_REFERENCE)).T
"""(7, 3): its part that is linear in the reference."""


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


class Steers(Protocol):
    """Whatever can fly a trial."""

    def brief(self, reference: np.ndarray) -> None:
        """Begin a flight along a reference (T, 3) [rad]."""

    def __call__(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] at sample k and measured state x (12,), within the task's limits."""


class Pilot:
    """One policy of plain layers, one sample at a time: what :func:`export.network.forward` says, faster.

    The observation is linear in state and reference, so that it moves into the first layer, and the reference's part
    is computed for the whole flight at once.
    """

    def __init__(self, network: Network, parameters: np.ndarray) -> None:
        """Take parameters (K,)."""
        tensors = unflatten(network, np.asarray(parameters, dtype=np.float32).astype(float))
        first = tensors["layers.0.weight"] * np.array(network.input_scale)
        self._of_state, self._of_reference = first @ OF_STATE, first @ OF_REFERENCE
        self._first_bias = tensors["layers.0.bias"]
        self._inner = [
            (tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"]) for i in range(1, len(network.layers))
        ]
        self._tanh = [layer.activation == "tanh" for layer in network.layers]
        self._scale, self._offset = np.array(network.action_scale), np.array(network.action_offset)
        self._shifted, self._limited = any(network.action_offset), exceeds_limits(network)
        self._asked = np.zeros((0, 0))

    def brief(self, reference: np.ndarray) -> None:
        """Begin a flight along a reference (T, 3) [rad]."""
        self._asked = reference @ self._of_reference.T + self._first_bias

    def __call__(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] at sample k and state x (12,), within the task's limits."""
        h = self._of_state @ x
        h += self._asked[k]
        if self._tanh[0]:
            np.tanh(h, out=h)
        for (weight, bias), tanh in zip(self._inner, self._tanh[1:], strict=True):
            h = weight @ h
            h += bias
            if tanh:
                np.tanh(h, out=h)
        h *= self._scale
        if self._shifted:
            h += self._offset
        return np.clip(h, ACTION_LOW, ACTION_HIGH, out=h) if self._limited else h


class BatchOfOne:
    """One policy of any layers, one sample at a time; otherwise as :class:`Pilot`."""

    def __init__(self, network: Network, parameters: np.ndarray) -> None:
        """Take parameters (K,)."""
        self._cast = Cast(network, np.asarray(parameters, dtype=np.float32)[None], 1)
        self._scale, self._offset = np.array(network.action_scale), np.array(network.action_offset)
        self._reference = np.zeros((0, N_REFERENCE))

    def brief(self, reference: np.ndarray) -> None:
        """Begin a flight along a reference (T, 3) [rad]."""
        self._reference = reference

    def __call__(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] at sample k and state x (12,), within the task's limits."""
        s = observation(x, self._reference[k])
        u = self._cast(s.astype(np.float32)[None, None])[0, 0]
        return np.clip(self._offset + self._scale * u, ACTION_LOW, ACTION_HIGH)


def make_pilot(network: Network, parameters: np.ndarray) -> Pilot | BatchOfOne:
    """Return the faster one that can fly this network."""
    plain = all(layer.layer_norm == "none" and layer.activation in FAST for layer in network.layers)
    return Pilot(network, parameters) if plain else BatchOfOne(network, parameters)


class Stage:
    """One aircraft that flies flight after flight.

    A flight at a time, not all in step: JSBSim's working memory of one aircraft stays in the cache, which saves more
    time than one forward pass for all policies would.
    """

    def __init__(self) -> None:
        """Make the aircraft."""
        self.plant = Plant()
        self.frames = 0
        """Samples simulated so far."""

    def fly(
        self, network: Network, parameters: np.ndarray, trials: Sequence[Trial], opening: np.ndarray | None = None
    ) -> Flown:
        """Fly P policies (P, K) through E trials of equal length.

        opening: (K,) parameters of the policy that flies until each trial's handover; without one the policies
        under test fly from the start.
        """
        pilots = [make_pilot(network, row) for row in parameters]
        return self.fly_pilots(pilots, trials, None if opening is None else make_pilot(network, opening))

    def fly_pilots(self, pilots: Sequence[Steers], trials: Sequence[Trial], opener: Steers | None = None) -> Flown:
        """Fly P pilots of any kind through E trials of equal length, as :meth:`fly` does."""
        P, E, T = len(pilots), len(trials), trials[0].reference.shape[0]
        flown = Flown(
            np.zeros((T, P, E, N_REFERENCE), dtype=np.float32), np.zeros((T, P, E, N_ACTION), dtype=np.float32),
            np.zeros((P, E), dtype=int), np.zeros((P, E), dtype=bool),
        )  # fmt: skip
        for p, pilot in enumerate(pilots):
            for e, trial in enumerate(trials):
                error, action, lost = self._fly_one(pilot, trial, opener)
                flown.length[p, e], flown.lost[p, e] = len(error), lost
                flown.error[: len(error), p, e], flown.action[: len(error), p, e] = error, action
        self.frames += int(flown.length.sum())
        return flown

    def _fly_one(self, pilot: Steers, trial: Trial, opener: Steers | None) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return errors (n, 3) and commands (n, 3) of one flight of n samples, and whether it was lost."""
        plant, case, reference = self.plant, trial.case, trial.reference
        x = plant.reset(case.condition)
        schedule = FaultSchedule(case.begun(trial.onset)) if case.faults else None
        ideal = not (case.sensors.noise or case.sensors.bias or case.sensors.delay)
        sensors = None if ideal else Sensors(case.sensors, np.random.default_rng(trial.seed))
        handover = 0 if opener is None else round(trial.handover / DT)
        states = np.empty((len(reference), N_STATE))
        action = np.empty((len(reference), N_ACTION))
        pilot.brief(reference)
        if opener is not None:
            opener.brief(reference)
        lost, n = False, len(reference)
        for k in range(len(reference)):
            if k % CHECK == 0 and terminated(x):
                lost, n = True, max(k, 1)
                break
            states[k] = x
            if schedule is not None:
                schedule.apply(plant, k * DT)
            measured = x if sensors is None else sensors.measure(x)
            a = opener(k, measured) if opener is not None and k < handover else pilot(k, measured)
            action[k] = a
            x = plant.step(a)
        error = np.nan_to_num(tracking_error(states[:n], reference[:n]), nan=0.0)
        return error, action[:n], lost
