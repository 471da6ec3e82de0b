"""Prior of the reduced incremental model: least squares on excited flights of the healthy plant."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from sim_bridge.conditions import NOMINAL, FlightCondition
from sim_bridge.plant import Plant
from task.config import Settings
from task.errors import UserError
from task.limits import ACTION_HIGH, ACTION_LOW, DEFLECTION_LIMIT, DT
from task.model import DYNAMIC, REDUCED_REGRESSORS
from task.observation import observation
from task.reference import FamilyName, random_reference
from task.reward import terminated
from task.scheduling import Condition
from task.state import ACTION, N_ACTION, N_IDENTIFIED, OBSERVATION, STATE

COMMAND_LAG = 1
"""Samples between a command and the increment that it moves, beyond eq. 8.2 (docs/architecture.md)."""


class PriorSettings(Settings, frozen=True):
    """How the model prior is made."""

    conditions: Annotated[tuple[FlightCondition, ...], Meta(min_length=1)] = (NOMINAL,)
    """Trims whose flights are pooled."""
    flights: Annotated[int, Meta(ge=1, le=1000)] = 6
    """Flights at each trim, each with its own random evaluation reference and excitation."""
    duration: Annotated[float, Meta(ge=5.0, le=600.0)] = 40.0
    """Length of each flight [s]."""
    amplitude: Annotated[float, Meta(gt=0.0, le=DEFLECTION_LIMIT)] = float(np.deg2rad(0.5))
    """Root mean square of the excitation on each surface [rad]."""
    band: tuple[float, float] = (0.1, 4.0)
    """Lowest and highest frequency of the excitation [Hz]."""
    family: FamilyName = "evaluation"
    """Family of references that the flights follow."""
    samples: Annotated[float, Meta(gt=0.0)] = 1000.0
    """How many samples of such flights the prior counts for: P0 = (samples E[z z'])^-1."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Of references and excitation."""

    def __post_init__(self) -> None:
        """Check what single fields cannot."""
        low, high = self.band
        if not 0.0 < low < high <= 0.5 / DT or math.floor(high * self.duration) - math.ceil(low * self.duration) < 2:
            raise ValueError(
                f"band: expected frequencies in order, up to {0.5 / DT:g} Hz, with one for each surface between them "
                f"in {self.duration:g} s, got [{low:g}, {high:g}]"
            )


class Prior(NamedTuple):
    """Prior of the reduced model: dx[k+1] = theta' z[k], uncertainty p0."""

    theta: np.ndarray
    """(11, 6): rows ``task.model.REDUCED_REGRESSORS``, columns ``task.model.DYNAMIC``."""
    p0: np.ndarray
    """(11, 11): (samples E[z z'])^-1, what eqs 8.5-8.7 start from."""
    learnt_at: Condition
    """Mean speed and altitude of the flights."""


def stabilising_law(s: np.ndarray, trim: np.ndarray) -> np.ndarray:
    """Return deflections (3,) [rad] that follow the reference loosely: attitude and rate feedback about trim.

    s: (7,) observation. Elevator down pitches down, positive aileron rolls left, positive rudder yaws left.
    """
    o = OBSERVATION
    action = trim.copy()
    action[ACTION.de] += -1.0 * s[o.theta_e] + 0.6 * s[o.q]
    action[ACTION.da] += -0.5 * s[o.phi_e] + 0.3 * s[o.p]
    action[ACTION.dr] += 0.5 * s[o.beta_e] + 0.5 * s[o.r]
    return action


def multisine(rng: np.random.Generator, samples: int, settings: PriorSettings, dt: float = DT) -> np.ndarray:
    """Return excitation (samples, 3) [rad]: on each surface its own frequencies, evenly spread, random phases."""
    time = np.arange(samples) * dt
    low, high = settings.band
    # Multiples of one fundamental, dealt to the surfaces in turn: the three signals are orthogonal over a flight.
    harmonics = np.arange(np.ceil(low * samples * dt), np.floor(high * samples * dt) + 1)
    signal = np.zeros((samples, N_ACTION))
    for surface in range(N_ACTION):
        own = harmonics[surface::N_ACTION] / (samples * dt)
        phase = rng.uniform(0.0, 2.0 * np.pi, own.size)
        wave = np.sin(2.0 * np.pi * own * time[:, None] + phase).sum(axis=1)
        signal[:, surface] = settings.amplitude * wave / np.sqrt(own.size / 2.0)
    return signal


def excited_flight(
    plant: Plant, rng: np.random.Generator, condition: FlightCondition, settings: PriorSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Fly one reference with the excitation added; return states (T + 1, 10) and commands (T, 3) [rad]."""
    state = plant.reset(condition)
    trim = plant.trim
    reference = random_reference(rng, settings.duration, float(trim.x[STATE.theta]), settings.family)
    excitation = multisine(rng, reference.shape[0], settings)
    states, commands = [state[:N_IDENTIFIED].copy()], []
    for target, extra in zip(reference, excitation, strict=True):
        command = stabilising_law(observation(state, target), trim.action) + extra
        commands.append(command.clip(ACTION_LOW, ACTION_HIGH))
        state = plant.step(commands[-1])
        states.append(state[:N_IDENTIFIED].copy())
        if terminated(state):
            raise UserError(f"prior: the healthy aircraft is lost at {condition}; fly the prior's flights elsewhere")
    return np.array(states), np.array(commands)


def regression(states: np.ndarray, commands: np.ndarray, lag: int = COMMAND_LAG) -> tuple[np.ndarray, np.ndarray]:
    """Return regressors z (N, 11) and outcomes (N, 6) of one flight.

    states: (T + 1, 10), the state x[k] that a[k] answers; commands: (T, 3). z[k] = [dx[k]; a[k - lag] - a[k - lag - 1]]
    explains dx[k + 1], where dx[k] = x[k] - x[k - 1].
    """
    dx = np.diff(states, axis=0)  # dx[k] of the docstring is dx[k - 1] here
    da = np.diff(commands, axis=0)  # a[k] - a[k - 1] is da[k - 1]
    k = np.arange(lag + 1, commands.shape[0])
    z = np.concatenate([dx[k - 1], da[k - lag - 1]], axis=1)
    return z[:, REDUCED_REGRESSORS], dx[k][:, DYNAMIC]


def model_prior(settings: PriorSettings | None = None, lag: int = COMMAND_LAG) -> Prior:
    """Fly the healthy plant and return the model prior."""
    settings = settings or PriorSettings()
    plant = Plant()
    rng = np.random.default_rng(settings.seed)
    flown = [
        excited_flight(plant, rng, condition, settings)
        for condition in settings.conditions
        for _ in range(settings.flights)
    ]
    flights = [regression(states, commands, lag) for states, commands in flown]
    V, h = np.mean([states[:, [STATE.V, STATE.h]].mean(axis=0) for states, _ in flown], axis=0).tolist()
    z = np.concatenate([f[0] for f in flights])
    y = np.concatenate([f[1] for f in flights])
    scale = np.sqrt((z**2).mean(axis=0))  # speed and angles differ by 1e3: solve in comparable units
    theta = np.linalg.lstsq(z / scale, y, rcond=None)[0] / scale[:, None]
    moment = (z / scale).T @ (z / scale) / z.shape[0]
    p0 = np.linalg.inv(moment) / np.outer(scale, scale) / settings.samples
    return Prior(theta, 0.5 * (p0 + p0.T), Condition(V, h))
