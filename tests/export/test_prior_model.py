"""The model prior against the plant: alignment, quality, uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from export.prior import (
    COMMAND_LAG,
    PriorSettings,
    excited_flight,
    model_prior,
    multisine,
    regression,
)
from sim_bridge.conditions import NOMINAL, R1
from sim_bridge.plant import Plant
from task.config import convert
from task.errors import UserError
from task.model import DYNAMIC, embed_reduced, predict_increment
from task.state import ACTION, STATE

SETTINGS = PriorSettings(duration=20.0)
A = len(DYNAMIC) + 2
"""Row of theta where the commands begin."""


@pytest.fixture(scope="module")
def flight():
    return excited_flight(Plant(), np.random.default_rng(99), NOMINAL, SETTINGS)


def test_regression_recovers_a_known_system_at_its_lag():
    rng = np.random.default_rng(0)
    full = embed_reduced(0.3 * rng.normal(size=(11, 6)) / 4)
    for lag in (0, 1, 3):
        commands = rng.normal(size=(300, 3))
        states = [np.zeros(10), rng.normal(size=10)]
        for k in range(1, 300):
            da = commands[k - lag] - commands[k - lag - 1] if k > lag else np.zeros(3)
            dx = predict_increment(states[k], states[k] - states[k - 1], da, full, False)
            states.append(states[k] + dx)
        z, y = regression(np.array(states), commands, lag)
        theta = np.linalg.lstsq(z, y, rcond=None)[0]
        dynamic_rows = [*range(6), *range(A, 11)]  # phi and theta never move in this system
        np.testing.assert_allclose(embed_reduced(theta)[:6, :6], full[:6, :6], atol=1e-9)
        np.testing.assert_allclose(theta[dynamic_rows][6:], full[10:, :6], atol=1e-9)


def test_the_plant_has_the_stated_command_lag(flight):
    residual = {}
    for lag in (0, 1, 2):
        z, y = regression(*flight, lag)
        theta = np.linalg.lstsq(z, y, rcond=None)[0]
        residual[lag] = float(((y - z @ theta)[:, :3] ** 2).sum())
    assert min(residual, key=residual.get) == COMMAND_LAG


def test_prior_predicts_flights_that_it_has_not_seen(short_prior, flight):
    z, y = regression(*flight)
    unexplained = ((y - z @ short_prior.theta) ** 2).mean(axis=0) / y.var(axis=0)
    assert (unexplained < 0.01).all(), unexplained


def test_prior_flies_two_seconds_blind(short_prior, flight):
    """Open loop over 2 s of manoeuvring, with the commands of the flight: within 2 degrees of attitude."""
    states, commands = flight
    model = embed_reduced(short_prior.theta)
    errors = []
    for start in range(200, 1600, 100):
        x, dx = states[start].copy(), states[start] - states[start - 1]
        for k in range(start, start + 200):
            da = commands[k - COMMAND_LAG] - commands[k - COMMAND_LAG - 1]
            dx = predict_increment(x, dx, da, model, True)
            x = x + dx
        errors.append((x - states[start + 200])[[STATE.phi, STATE.theta, STATE.beta]])
    assert np.rad2deg(np.sqrt(np.square(errors).mean(axis=0))).max() < 2.0


def test_signs_of_the_control_effectiveness_are_the_aircraft_s(short_prior):
    effectiveness = short_prior.theta[A:]
    assert effectiveness[ACTION.de, STATE.q] < -0.05
    assert effectiveness[ACTION.da, STATE.p] < -0.1
    assert effectiveness[ACTION.dr, STATE.r] < -0.02


def test_p0_is_symmetric_positive_and_counts_for_the_stated_samples(short_prior):
    np.testing.assert_array_equal(short_prior.p0, short_prior.p0.T)
    assert (np.linalg.eigvalsh(short_prior.p0) > 0).all()
    doubled = model_prior(PriorSettings(flights=1, duration=20.0, samples=2000.0))
    np.testing.assert_allclose(2.0 * doubled.p0, short_prior.p0, rtol=1e-12)
    np.testing.assert_array_equal(doubled.theta, short_prior.theta)


def test_trims_are_pooled():
    pooled = model_prior(PriorSettings(conditions=(NOMINAL, R1), flights=1, duration=20.0))
    fast = model_prior(PriorSettings(conditions=(R1,), flights=1, duration=20.0))
    slow = model_prior(PriorSettings(conditions=(NOMINAL,), flights=1, duration=20.0))
    elevator = [p.theta[A + ACTION.de, STATE.q] for p in (fast, pooled, slow)]
    assert elevator == sorted(elevator)
    assert elevator[0] < 2.0 * elevator[2]  # 2.8 times the dynamic pressure


def test_excitation_has_the_stated_size_and_the_surfaces_are_orthogonal():
    signal = multisine(np.random.default_rng(0), 4000, PriorSettings())
    np.testing.assert_allclose(np.sqrt((signal**2).mean(axis=0)), PriorSettings().amplitude, rtol=1e-9)
    correlation = np.corrcoef(signal.T) - np.eye(3)
    assert np.abs(correlation).max() < 1e-9


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"flights": 0}, "got 0 - at `$.flights`"),
        ({"flights": -1}, "got -1 - at `$.flights`"),
        ({"conditions": []}, "got [] - at `$.conditions`"),
        ({"duration": 0.0}, "got 0.0 - at `$.duration`"),
        ({"duration": float("nan")}, "got nan - at `$.duration`"),
        ({"amplitude": -1.0}, "got -1.0 - at `$.amplitude`"),
        ({"samples": 0.0}, "got 0.0 - at `$.samples`"),
        ({"seed": -1}, "got -1 - at `$.seed`"),
        ({"band": [4.0, 0.1]}, "band: expected frequencies in order"),
        ({"band": [1.0, 1.01]}, "band: expected frequencies in order"),
    ],
)
def test_settings_that_no_flight_can_have_are_refused(wrong, said):
    with pytest.raises(UserError) as caught:
        convert(wrong, PriorSettings, "prior.toml")
    assert said in str(caught.value)
