"""Fit of the rate model (task.rates): least squares on excited flights of the healthy plant over its envelope."""

from __future__ import annotations

import numpy as np

from export.prior import COMMAND_LAG, PriorSettings, excited_flight
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.plant import Plant
from task.config import Settings
from task.limits import DT
from task.rates import N_FEATURES, RateModel, dynamic_pressure, effect_terms, features, shapes, washout
from task.reference import FamilyName
from task.state import N_IDENTIFIED, STATE


class RateSettings(Settings, frozen=True):
    """How the rate model is made."""

    conditions: tuple[FlightCondition, ...] = (
        NOMINAL,
        R1,
        R2,
        FlightCondition(altitude=2000.0, speed=120.0),
        FlightCondition(altitude=6000.0, speed=90.0),
        FlightCondition(altitude=6000.0, speed=120.0),
    )
    """Trims whose flights are pooled: the corners of the envelope and between them."""
    families: tuple[FamilyName, ...] = ("evaluation", "aggressive")
    """Families of references. Without the aggressive ones a hard manoeuvre leaves what the fit has seen, and looks like
    a fault there."""
    flights: int = 2
    """Flights of each family at each trim, each with its own random reference and excitation."""
    duration: float = 40.0
    """Length of each flight [s]."""
    amplitude: float = float(np.deg2rad(0.7))
    """Root mean square of the excitation on each surface [rad]."""
    whitening: float = 0.97
    """Pole a of the whitening filter 1 - a z^-1 on regressors and outcome alike. What the features leave out, the
    thrust's moment above all, varies slowly, and without it is taken for control effectiveness."""
    seed: int = 1
    """Of references and excitation."""


def regression(states: np.ndarray, commands: np.ndarray, lag: int = COMMAND_LAG) -> tuple[np.ndarray, np.ndarray]:
    """Return regressors z (N, 45) and accelerations (N, 3) [rad/s2] of one flight; z = [phi(x); effect terms * u].

    states: (T + 1, 10), the state x[k] that a[k] answers; commands: (T, 3). z[k] is of x[k] and a[k - lag] and explains
    (w[k + 1] - w[k]) / dt.
    """
    r = states[:, STATE.r]
    low_passed = np.zeros(r.size)
    for i in range(r.size - 1):
        low_passed[i + 1] = washout(float(low_passed[i]), float(r[i]), DT)
    p, q, _, V, alpha, beta = states[:, : STATE.beta + 1].T
    qbar = dynamic_pressure(V, states[:, STATE.h])
    phi = np.stack(features(p, q, r, V, alpha, beta, r - low_passed, qbar), axis=1)
    terms = np.stack(effect_terms(V, alpha, qbar), axis=1)
    k = np.arange(lag, states.shape[0] - 1)
    effect = commands[k - lag, :, None] * terms[k, None, :]
    z = np.concatenate([phi[k], effect.reshape(k.size, -1)], axis=1)
    return z, np.diff(states[:, : STATE.V], axis=0)[k] / DT


def whitened(flights: list[tuple[np.ndarray, np.ndarray]], whitening: float) -> tuple[np.ndarray, np.ndarray]:
    """Return z and y of all flights in a row, each flight through 1 - whitening z^-1, which costs its first sample."""

    def white(a: np.ndarray) -> np.ndarray:
        return a[1:] - whitening * a[:-1]

    return np.concatenate([white(z) for z, _ in flights]), np.concatenate([white(y) for _, y in flights])


def fit(flights: list[tuple[np.ndarray, np.ndarray]], whitening: float) -> RateModel:
    """Return the rate model of flights, pairs as :func:`regression` returns them."""
    z, y = whitened(flights, whitening)
    scale = np.sqrt((z**2).mean(axis=0))  # qbar beside p q: solve in comparable units
    scale[scale == 0.0] = 1.0  # a term that no flight reached, as those beyond the knee: coefficient zero
    theta = np.linalg.lstsq(z / scale, y, rcond=None)[0] / scale[:, None]
    return RateModel(theta[:N_FEATURES], theta[N_FEATURES:].reshape(shapes()["effect"]))


def fitting_flights(plant: Plant, settings: RateSettings) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the excited flights that the model is fitted on: states (T + 1, 10) and commands (T, 3) [rad] of each."""
    rng = np.random.default_rng(settings.seed)
    flights = []
    for family in settings.families:
        flying = PriorSettings(duration=settings.duration, amplitude=settings.amplitude, family=family)
        for condition in settings.conditions:
            for _ in range(settings.flights):
                states, commands = excited_flight(plant, rng, condition, flying)
                flights.append((states[:, :N_IDENTIFIED], commands))
    return flights


def rate_model(settings: RateSettings | None = None, lag: int = COMMAND_LAG) -> RateModel:
    """Fly the healthy plant over the envelope and return its rate model."""
    settings = settings or RateSettings()
    flights = fitting_flights(Plant(), settings)
    return fit([regression(states, commands, lag) for states, commands in flights], settings.whitening)
