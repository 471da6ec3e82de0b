"""Golden samples: small questions to the graphs of a population, and their answers in float64."""

from __future__ import annotations

import numpy as np

from export.network import forward, unflatten
from export.population import Population
from export.prior import COMMAND_LAG, Prior
from export.rollout import MAX_DELAY, rollout, rollout_laws
from task.actuators import HEALTHY
from task.config import Settings
from task.errors import UserError
from task.laws import N_MEMORY, N_SEEN, SEEN
from task.limits import DT
from task.model import embed_reduced
from task.reference import cosine_steps
from task.state import ACTION, N_ACTION, N_IDENTIFIED, N_OBSERVATION, N_REFERENCE, REFERENCE, STATE, TRACKED

GOLDEN_OBSERVATIONS = 4
ACTION_TOLERANCE = 2e-5
"""Between single and double precision [rad]."""
SMALLER, SMALLEST = 4.0, 4
"""Where the answers to them are at their bounds there are more observations, each time so much smaller; at most so many
times."""
FREE = 0.9
"""An answer below this share of its bound is free: what changes in the parameters is seen in it."""
GOLDEN_STEPS = 50
GOLDEN_DELAY = 3
GOLDEN_ACTUATORS = np.array([[-0.03, 0.042, 0.002], [-0.01, 0.05, 0.012], [0.3, 0.5, 0.1]], np.float32).astype(float)
"""Rows of ``task.actuators.ACTUATOR``; the golden laws reach every one of them."""


class GoldenActions(Settings, frozen=True):
    """What each member must answer; computed in float64 from the float32 parameters."""

    observations: list[list[float]]
    """(n, 7)."""
    actions: list[list[list[float]]]
    """(P, n, 3) [rad]."""
    tolerance: float
    """Largest absolute difference that float32 explains [rad]."""


class GoldenImagination(Settings, frozen=True):
    """One small imagination; computed in float64 from the model prior embedded in (13, 10), kinematics exact."""

    x: list[float]
    dx: list[float]
    commands: list[list[float]]
    delay: int
    """Of the commands, beyond ``command_lag`` [samples]."""
    reference: list[list[float]]
    actuators: list[list[float]]
    """(3, 3) of :mod:`task.actuators`, for ``limited_returns``; range and rate of every surface are felt."""
    incumbent: int
    """The member whose parameters are the incumbent's."""
    returns: list[float]
    """(P + 1,), surfaces healthy."""
    limited_returns: list[float]
    """(P + 1,), surfaces limited."""
    tolerance: float
    """Largest absolute difference that float32 explains."""


class GoldenLaws(Settings, frozen=True):
    """Laws of :mod:`task.laws` asked about in the golden imagination's question; computed like that."""

    maps: list[list[list[float]]]
    """(Q, 3 + N_MEMORY, N_MEMORY + N_SEEN)."""
    memory: list[list[float]]
    """(Q, N_MEMORY)."""
    returns: list[float]
    """(Q,), surfaces healthy."""
    limited_returns: list[float]
    """(Q,), surfaces limited."""
    tolerance: float
    """Largest absolute difference that float32 explains."""


def golden_actions(population: Population, seed: int = 0) -> GoldenActions:
    """Return observations of the size that flights bring, and every member's answer.

    Members with high gains answer these with full deflections, whatever their parameters: for them there are smaller
    ones besides.
    """
    rng = np.random.default_rng(seed)
    size = np.full(N_OBSERVATION, 0.2)
    asked = rng.uniform(-size, size, (GOLDEN_OBSERVATIONS, N_OBSERVATION)).astype(np.float32).astype(float)
    observations, actions = asked, _answers(population, asked)
    for _ in range(SMALLEST):
        if _free(population, actions).any(axis=1).all():
            break
        asked = (asked / SMALLER).astype(np.float32).astype(float)
        observations = np.concatenate([observations, asked])
        actions = np.concatenate([actions, _answers(population, asked)], axis=1)
    _check_precision(population, observations, actions)
    return GoldenActions(observations=observations.tolist(), actions=actions.tolist(), tolerance=ACTION_TOLERANCE)


def _check_precision(population: Population, observations: np.ndarray, actions: np.ndarray) -> None:
    """Raise UserError, naming the member, where its answers (P, n, 3) need more than the graphs' single precision."""
    tensors = unflatten(population.network, population.parameters)
    with np.errstate(all="ignore"):  # what overflows is found by the comparison
        single = np.stack([forward(population.network, tensors, s.astype(np.float32)) for s in observations], axis=1)
        difference = np.abs(single - actions).max(axis=(1, 2))
    if (wrong := ~(difference <= ACTION_TOLERANCE)).any():
        member = int(wrong.argmax())
        raise UserError(
            f"member {population.description.members[member].name!r}: in single precision it answers a golden sample "
            f"{difference[member]:.1e} rad off, tolerance {ACTION_TOLERANCE:.0e}: its largest parameter is "
            f"{np.abs(population.parameters[member]).max():.1e}; leave it out or train it again"
        )


def _answers(population: Population, observations: np.ndarray) -> np.ndarray:
    """Return every member's answer to observations (n, 7), (P, n, 3) [rad]."""
    tensors = unflatten(population.network, population.parameters.astype(float))
    return np.stack([forward(population.network, tensors, s) for s in observations], axis=1)


def _free(population: Population, actions: np.ndarray) -> np.ndarray:
    """Return which answers (P, n, 3) are away from their bounds."""
    network = population.network
    return np.abs(actions - np.array(network.action_offset)) < FREE * np.abs(network.action_scale)


def golden_imagination(population: Population, prior: Prior, lag: int = COMMAND_LAG) -> GoldenImagination:
    """Return a disturbed start, a gentle reference and every member's return in the prior model."""
    start = np.zeros(N_IDENTIFIED)
    start[[STATE.p, STATE.q, STATE.r]] = 0.02, -0.01, 0.01
    start[[STATE.V, STATE.h]] = 90.0, 2000.0
    start[[STATE.alpha, STATE.beta, STATE.phi, STATE.theta, STATE.psi]] = 0.06, 0.01, 0.1, 0.05, 0.3
    x = start.astype(np.float32).astype(float)
    dx = np.float32(1e-4 * np.sin(np.arange(N_IDENTIFIED))).astype(float)
    sent = N_ACTION * (lag + 1 + MAX_DELAY)
    commands = np.float32(np.linspace(-0.02, 0.01, sent).reshape(-1, N_ACTION)).astype(float)
    steps = np.zeros((GOLDEN_STEPS + 1, N_REFERENCE))
    duration = (GOLDEN_STEPS + 1) * DT
    steps[:, REFERENCE.theta] = cosine_steps(np.array([0.1, 0.0]), duration, duration)
    steps[:, REFERENCE.phi] = cosine_steps(np.array([-0.1, 0.0]), duration, duration)
    reference = steps.astype(np.float32).astype(float)
    model = embed_reduced(prior.theta.astype(np.float32).astype(float))
    parameters = np.concatenate([population.parameters, population.parameters[population.champion, None]])
    question = x, dx, commands, GOLDEN_DELAY, model, True, reference
    healthy, limited = (
        rollout(population.network, parameters, *question, actuators).returns.tolist()
        for actuators in (HEALTHY, GOLDEN_ACTUATORS)
    )
    return GoldenImagination(
        x=x.tolist(),
        dx=dx.tolist(),
        commands=commands.tolist(),
        delay=GOLDEN_DELAY,
        reference=reference.tolist(),
        actuators=GOLDEN_ACTUATORS.tolist(),
        incumbent=population.champion,
        returns=healthy,
        limited_returns=limited,
        tolerance=1e-3,
    )


def golden_laws(play: GoldenImagination, prior: Prior) -> GoldenLaws:
    """Return stable laws by hand, which together read all of y and of c, and their returns in ``play``'s question."""
    maps = np.stack([_proportional(), _integral(), _dense()]).astype(np.float32).astype(float)
    memory = np.zeros((3, N_MEMORY))
    memory[1, :N_REFERENCE] = 1.0 / 32.0
    memory[2] = np.round(16.0 * np.cos(np.arange(N_MEMORY))) / 8.0
    x, dx, commands, reference = (np.array(part) for part in (play.x, play.dx, play.commands, play.reference))
    model = embed_reduced(prior.theta.astype(np.float32).astype(float))
    question = x, dx, commands, play.delay, model, True, reference
    healthy, limited = (
        rollout_laws(maps, memory, *question, actuators).returns.tolist()
        for actuators in (HEALTHY, np.array(play.actuators))
    )
    return GoldenLaws(
        maps=maps.tolist(), memory=memory.tolist(), returns=healthy, limited_returns=limited, tolerance=1e-4
    )


def _proportional() -> np.ndarray:
    """Return maps of attitude and rate feedback about a trimmed elevator."""
    maps = np.zeros((N_ACTION + N_MEMORY, N_MEMORY + N_SEEN))
    y = maps[:N_ACTION, N_MEMORY:]
    y[ACTION.de, SEEN.one] = -1.0 / 32.0
    error = np.diag([-1.0, -0.5, 0.5])  # each surface its own error, theta, phi, beta
    y[:, SEEN.reference] = error
    y[:, SEEN.x][:, TRACKED] = -error
    y[:, SEEN.x][:, [STATE.q, STATE.p, STATE.r]] = np.diag([0.5, 0.25, 0.5])
    return maps


def _integral() -> np.ndarray:
    """Return maps of the same with the errors' integrals in memory, and the reference's rate fed forward."""
    maps = _proportional()
    law, memory = maps[:N_ACTION], maps[N_ACTION:]
    of_reference = N_MEMORY + SEEN.reference.start + np.arange(N_REFERENCE)
    of_state = N_MEMORY + SEEN.x.start + np.array(TRACKED)
    integrals = np.arange(N_REFERENCE)
    memory[integrals, integrals] = 1.0
    memory[integrals, of_reference], memory[integrals, of_state] = DT, -DT
    law[:, :N_REFERENCE] = law[:, of_reference]
    law[:, N_MEMORY:][:, SEEN.rate] = 0.5 * law[:, of_reference]
    return maps


def _dense() -> np.ndarray:
    """Return maps without a zero, so that no column can be taken for another; each column moves the surfaces alike."""
    rows, columns = N_ACTION + N_MEMORY, N_MEMORY + N_SEEN
    maps = np.round(16.0 * np.sin(np.arange(rows * columns, dtype=float).reshape(rows, columns))) / 1024.0
    y = maps[:, N_MEMORY:]
    y[:, SEEN.x][:, STATE.V] /= 256.0
    y[:, SEEN.dx] *= 256.0
    y[:, SEEN.dx][:, [STATE.p, STATE.q, STATE.r]] /= 4.0
    y[:, SEEN.acted] *= 8.0
    maps[N_ACTION:, :N_MEMORY] += 15.0 / 16.0 * np.eye(N_MEMORY)
    maps[:N_ACTION] += _proportional()[:N_ACTION]
    return maps
