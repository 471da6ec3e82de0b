"""One step of the incremental model (eq. 8.2) as one matrix and a few products, for the imagination's loop.

The loop carries L, (M, rows, A) for M models and A actors, rows in this order:

    one (1)
    base (20)    what is linear of [x; dx]
    product (6)  products of rates and trigonometry, not yet weighted
    acted (3)    the command that acted in the last step
    acting (3)   the one that acts now, and behind it those that wait for their turn, the newest last

and [x; dx] = E L: the weights of the products are in E, so that no node of the loop adds them up. One product W L gives
all that a step needs. Angle sums turn products of sines into sums of sines, whose arguments are linear too.

Altitude and heading do not feed back into the rest when kinematics are exact; altitude is integrated after the loop, at
once for all steps (:mod:`export.scoring`), and heading is nobody's business.
"""

from __future__ import annotations

import numpy as np
import onnx

from export.builder import Builder
from export.network import Network
from task.limits import DT
from task.model import N_REGRESSORS
from task.observation import observation
from task.state import N_ACTION, N_IDENTIFIED, N_OBSERVATION, N_REFERENCE, STATE

N_BASE = 2 * N_IDENTIFIED

PRODUCTS: tuple[tuple[STATE, float, STATE, tuple[int, int, int], int], ...] = (
    (STATE.theta, 1.0, STATE.q, (1, 0, 1), 0),  # q cos phi
    (STATE.theta, -1.0, STATE.r, (1, 0, 0), 0),  # r sin phi
    (STATE.phi, 0.5, STATE.q, (1, -1, 1), 1),  # q sin phi sin theta / cos theta
    (STATE.phi, -0.5, STATE.q, (1, 1, 1), 1),
    (STATE.phi, 0.5, STATE.r, (1, 1, 0), 1),  # r cos phi sin theta / cos theta
    (STATE.phi, -0.5, STATE.r, (1, -1, 0), 1),
)
"""theta' and phi' - p of ``task.model.kinematic_rates``: state, weight, rate, sine of (a phi + b theta + c pi/2), and
whether it is divided by cos theta."""

N_PRODUCTS = len(PRODUCTS)
ONE = 0
PRODUCT = 1 + N_BASE
ACTED = PRODUCT + N_PRODUCTS
ACTING = ACTED + N_ACTION
N_LINEAR = ACTING + N_ACTION
"""Rows of L without what waits."""

N_FLOWN = N_IDENTIFIED + N_ACTION
"""Rows of a step that are kept: x now, and the increment of the command that acts now [rad]."""
MOVES = (N_FLOWN, PRODUCT, N_PRODUCTS, 2 * N_PRODUCTS)
"""Rows of a step: what is kept, the next one and base, rates, arguments of the sines (numerators, denominators)."""


def _switched(g: Builder, always: np.ndarray, exact: np.ndarray, name: str) -> str:
    """Return ``always``, plus ``exact`` when kinematics are exact."""
    return g.op("Add", g.op("Mul", "exact", g.constant(exact, f"{name}_exact")), g.constant(always, name), name=name)


def _products(row: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how rate and arguments of product ``row`` follow from x (3, 10), and the arguments' constants (3,)."""
    _, _, rate, (of_phi, of_theta, quarters), divided = PRODUCTS[row]
    of_x, constant = np.zeros((3, N_IDENTIFIED)), np.zeros(3)
    of_x[0, rate] = 1.0
    of_x[1, [STATE.phi, STATE.theta]] = of_phi, of_theta
    of_x[2, STATE.theta] = divided
    constant[1:] = 0.5 * np.pi * quarters, 0.5 * np.pi
    return of_x, constant


class Step:
    """The matrices of a step, made before the loop from ``model`` (M, 13, 10) and ``exact_kinematics``.

    ``moves`` (M, 52, 33), of L; ``x_and_dx`` (20, 33): E; ``state`` (10, 30): x. ``unit`` (3,) [rad]: what a command of
    one means.
    """

    def __init__(self, g: Builder, unit: np.ndarray) -> None:
        g.op("Cast", "exact_kinematics", to=onnx.TensorProto.FLOAT, name="exact")
        weights = np.zeros((N_BASE, N_LINEAR))
        for column, (state, weight, *_) in enumerate(PRODUCTS, start=PRODUCT):
            weights[[state, N_IDENTIFIED + state], column] = DT * weight
        self.x_and_dx = of_linear = _switched(g, np.eye(N_BASE, N_LINEAR, k=1), weights, "x_and_dx")

        # Theta' [dx; da], da the increment of the command that acts
        acting = np.zeros((N_REGRESSORS, N_LINEAR))
        acting[N_IDENTIFIED:, ACTING:], acting[N_IDENTIFIED:, ACTED:ACTING] = np.diag(unit), -np.diag(unit)
        moved = np.eye(N_REGRESSORS, N_BASE, k=N_IDENTIFIED)
        z = g.op("Add", g.op("MatMul", g.constant(moved, "dx_of"), of_linear), g.constant(acting, "da_of"), name="z")
        increment = g.op("MatMul", g.op("Transpose", "model", perm=[0, 2, 1]), z, name="increment")

        of_x, of_increment, constant = self._maps()
        from_state = g.op("MatMul", _switched(g, *of_x, "of_x"), of_linear)
        from_increment = g.op("MatMul", _switched(g, *of_increment, "of_increment"), increment)
        constant[N_IDENTIFIED:N_FLOWN] = acting[N_IDENTIFIED:]
        linear = g.op("Add", from_state, g.constant(constant, "constants"))
        self.moves = g.op("Add", linear, from_increment, name="moves")
        carried = g.op("Slice", of_linear, g.integers(0), g.integers(ACTING), g.integers(1))
        self.state = g.op("Slice", carried, g.integers(0), g.integers(N_IDENTIFIED), g.integers(0), name="state")

    @staticmethod
    def _maps() -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray], np.ndarray]:
        """Return what a step takes of [x; dx] and of the increment, (always, exact) each, and of the one."""
        size = sum(MOVES)
        of_x, of_x_exact = np.zeros((size, N_BASE)), np.zeros((size, N_BASE))
        of_increment, of_increment_exact = np.zeros((size, N_IDENTIFIED)), np.zeros((size, N_IDENTIFIED))
        constant = np.zeros((size, N_LINEAR))
        now, (one, *base), rates, sines = np.split(np.arange(size), np.cumsum(MOVES)[:-1])
        constant[one, ONE] = 1.0
        x, identity = np.arange(N_IDENTIFIED), np.eye(N_IDENTIFIED)
        of_x[now[:N_IDENTIFIED], x] = of_x[base[:N_IDENTIFIED], x] = 1.0
        # dynamic states take the model's increment; with exact kinematics phi takes DT p from here, the rest is product
        fixed = np.diag([float(state >= STATE.phi) for state in x])
        fixed[STATE.phi, STATE.p] = -0.5 * DT
        for rows in (base[:N_IDENTIFIED], base[N_IDENTIFIED:]):
            of_increment[rows], of_increment_exact[rows] = identity, -fixed
            of_x_exact[rows[STATE.phi], STATE.p] = DT
        for row in range(N_PRODUCTS):
            of_state, quarter = _products(row)
            places = [rates[row], sines[row], sines[N_PRODUCTS + row]]
            of_x[places, :N_IDENTIFIED], constant[places, ONE] = of_state, quarter
            of_increment[places[0]] = 0.5 * of_state[0]  # rates half a step on, angles at the old attitude
        return (of_x, of_x_exact), (of_increment, of_increment_exact), constant


def _observed(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """Return S (8, 10) and R (3, 8) with [input_scale * s; 1] = S x + R' reference + (0, ..., 0, 1)."""
    scale = np.array([*network.input_scale, 0.0])
    of_state = np.zeros((N_OBSERVATION + 1, N_IDENTIFIED))
    of_state[:-1] = observation(np.eye(N_IDENTIFIED), np.zeros((N_IDENTIFIED, N_REFERENCE))).T
    of_reference = np.zeros((N_REFERENCE, N_OBSERVATION + 1))
    of_reference[:, :-1] = observation(np.zeros((N_REFERENCE, N_IDENTIFIED)), np.eye(N_REFERENCE))
    return scale[:, None] * of_state, of_reference * scale


def observed_state(g: Builder, step: Step, network: Network) -> str:
    """Add the map of L to the scaled observation without its reference, and a row for the one: (8, 30)."""
    return g.op("MatMul", g.constant(_observed(network)[0], "observed_of_x"), step.state, name="observed")


def observed_reference(g: Builder, reference: str, network: Network) -> str:
    """Add what the reference (H, 3) gives to the observations, with the constant one: (H, 8, 1)."""
    one = np.eye(N_OBSERVATION + 1)[-1]
    rows = g.op("MatMul", reference, g.constant(_observed(network)[1], "of_reference"))
    return g.op("Unsqueeze", g.op("Add", rows, g.constant(one, "one_row")), g.integers(2), name="observed_reference")


def products(g: Builder, rates: str, arguments: str) -> str:
    """Add rate * sine / sine: rates (M, 6, A), arguments (M, 12, A) -> (M, 6, A)."""
    sines = g.op("Sin", arguments)
    above, below = g.ops("Split", sines, names=["above", "below"], axis=1, num_outputs=2)
    return g.op("Div", g.op("Mul", rates, above), below, name="products")
