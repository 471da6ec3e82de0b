"""The model prior taken over the envelope: slopes, scaling, and what it is worth against the plant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from export.prior import COMMAND_LAG, PriorSettings, excited_flight
from runtime.population import load_population
from sim_bridge.conditions import NOMINAL, R1, R2
from sim_bridge.plant import Plant
from task.limits import DT
from task.model import embed_reduced, predict_increment
from task.rates import N_EFFECT, N_FEATURES, RateModel, dynamic_pressure, effect_terms, features
from task.scheduling import LEAST_SPEED, Condition, scheduled, slopes
from task.state import N_IDENTIFIED, STATE

CITATION = load_population(Path(__file__).parents[2] / "populations" / "citation")
HORIZON = 200
"""Of a prediction [samples]."""


def random_rates(seed: int = 0) -> RateModel:
    rng = np.random.default_rng(seed)
    return RateModel(1e-4 * rng.normal(size=(N_FEATURES, 3)), 1e-4 * rng.normal(size=(3, N_EFFECT, 3)))


def at(V: float = 90.0, alpha: float = 0.02, h: float = 2000.0) -> np.ndarray:
    x = np.zeros(N_IDENTIFIED)
    x[STATE.V], x[STATE.alpha], x[STATE.h] = V, alpha, h
    return x


def acceleration(rates: RateModel, x: np.ndarray, u: np.ndarray, washed: float) -> np.ndarray:
    p, q, r, V, alpha, beta = x[:6]
    qbar = dynamic_pressure(V, x[STATE.h])
    terms = np.array(effect_terms(V, alpha, qbar))
    effects = np.einsum("t,jtw->jw", terms, rates.effect)
    return np.array(features(p, q, r, V, alpha, beta, washed, qbar)) @ rates.drift + u @ effects


def test_slopes_are_those_of_the_acceleration():
    rates, x = random_rates(), at(alpha=0.03)
    x[[STATE.p, STATE.q, STATE.r, STATE.beta]] = 0.05, 0.02, -0.03, 0.04
    u = np.array([0.05, -0.02, 0.1])
    in_state, in_action = slopes(rates, x, u)
    for i in range(6):
        step = 1e-4
        up, down = x.copy(), x.copy()
        up[i] += step
        down[i] -= step
        washed = [each[STATE.r] - x[STATE.r] for each in (up, down)]
        expected = (acceleration(rates, up, u, washed[0]) - acceleration(rates, down, u, washed[1])) / (2 * step)
        np.testing.assert_allclose(in_state[i], expected, rtol=0.02, atol=2e-3 * np.abs(in_state).max())
    for j in range(3):
        expected = acceleration(rates, x, np.eye(3)[j], 0.0) - acceleration(rates, x, np.zeros(3), 0.0)
        np.testing.assert_allclose(in_action[j], expected, rtol=0.02, atol=1e-3 * np.abs(in_action).max())


def test_the_air_s_share_grows_with_density_and_speed_and_gravity_s_falls():
    theta = embed_reduced(np.random.default_rng(1).normal(size=(11, 6)))
    x = at(V=150.0, h=5000.0)
    local = scheduled(theta, Condition(90.0, 2000.0), random_rates(), x, np.zeros(3))
    air = dynamic_pressure(150.0, 5000.0) / 150.0 / (dynamic_pressure(90.0, 2000.0) / 90.0)
    for angle in (STATE.alpha, STATE.beta):
        assert local[angle, angle] - 1.0 == pytest.approx(air * (theta[angle, angle] - 1.0))
        np.testing.assert_allclose(local[N_IDENTIFIED:, angle], air * theta[N_IDENTIFIED:, angle])
        np.testing.assert_allclose(local[STATE.theta, angle], 0.6 * theta[STATE.theta, angle])
    assert local[STATE.p, STATE.beta] == pytest.approx(DT * x[STATE.alpha])
    np.testing.assert_array_equal(local[:, STATE.V], theta[:, STATE.V])
    np.testing.assert_array_equal(local[STATE.phi : N_IDENTIFIED, :3], theta[STATE.phi : N_IDENTIFIED, :3])


def test_where_nothing_flies_the_prior_stays():
    theta = embed_reduced(np.ones((11, 6)))
    for V in (0.0, LEAST_SPEED, np.nan):
        local = scheduled(theta, Condition(90.0, 2000.0), random_rates(), at(V=V), np.zeros(3))
        np.testing.assert_array_equal(local, theta)


def test_at_its_own_trim_the_shipped_prior_stays_what_it_was():
    theta = embed_reduced(CITATION.theta)
    local = scheduled(theta, CITATION.learnt_at, CITATION.rates, at(alpha=0.055), np.zeros(3))
    strong = np.abs(theta) > 0.02
    np.testing.assert_allclose(local[strong], theta[strong], rtol=0.03, atol=0.025)


def error_ahead(
    theta_at: Callable[[np.ndarray, np.ndarray], np.ndarray], flight: tuple[np.ndarray, np.ndarray]
) -> float:
    """Return the root mean square error of bank and pitch [deg], 2 s ahead with the commands of the flight."""
    states, commands = flight
    errors = []
    for k in range(200, len(commands) - HORIZON - 2, 100):
        model = theta_at(states[k], commands[k - COMMAND_LAG])
        x, dx = states[k].copy(), states[k] - states[k - 1]
        for t in range(k, k + HORIZON):
            da = commands[t - COMMAND_LAG] - commands[t - COMMAND_LAG - 1]
            dx = predict_increment(x, dx, da, model, True)
            x = x + dx
        errors.append((x - states[k + HORIZON])[[STATE.phi, STATE.theta]])
    return float(np.rad2deg(np.sqrt(np.square(errors).mean())))


@pytest.mark.parametrize("trim", [R1, R2], ids=["R1", "R2"])
def test_two_seconds_ahead_at_other_trims_it_errs_a_third_as_much(trim):
    theta = embed_reduced(CITATION.theta)
    flight = excited_flight(Plant(), np.random.default_rng(7), trim, PriorSettings(duration=20.0))
    fixed = error_ahead(lambda x, u: theta, flight)
    local = error_ahead(lambda x, u: scheduled(theta, CITATION.learnt_at, CITATION.rates, x, u), flight)
    assert local < fixed / 3.0, (local, fixed)


def test_two_seconds_ahead_at_the_trim_of_the_prior_it_errs_by_less_than_half_a_degree():
    theta = embed_reduced(CITATION.theta)
    flight = excited_flight(Plant(), np.random.default_rng(7), NOMINAL, PriorSettings(duration=20.0))
    assert error_ahead(lambda x, u: scheduled(theta, CITATION.learnt_at, CITATION.rates, x, u), flight) < 0.5
