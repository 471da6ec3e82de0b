"""The imagination of a whole population as one ONNX graph (thesis eqs 8.2, 11, 12).

``export.rollout`` is the same in plain numpy, and its reference.

Inside the loop a node costs about as much to dispatch as to compute, so that the loop holds as few as possible:

- states are columns, (10, A) for A actors, so that every linear map of them is one Gemm and a row is contiguous;
- what is linear in [x; dx; commands; action] is one matrix, made from ``model`` before the loop;
- the kinematics are a table of monomials in sines and rates: one Gather, one product, one Gemm;
- centring of a LayerNorm is linear, so that it moves into the weights before the loop;
- reward and termination are taken from the whole trajectory after the loop.
"""

from __future__ import annotations

import numpy as np
import onnx

from export.behaviour import activation
from export.builder import Builder, value
from export.network import Layer, Network, exceeds_limits, layout, unflatten
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.model import DYNAMIC, N_REGRESSORS
from task.observation import observation
from task.reward import ALTITUDE_LIMIT, CRASH_COST_PER_FRAME, PHI_LIMIT, REWARD_SCALE, THETA_LIMIT
from task.state import N_ACTION, N_IDENTIFIED, N_OBSERVATION, N_REFERENCE, STATE, TRACKED

BOOL = onnx.TensorProto.BOOL
_HUGE = float(np.finfo(np.float32).max)

KINEMATICS: tuple[tuple[STATE, float, str], ...] = (
    (STATE.phi, 1.0, "p"),
    (STATE.phi, 1.0, "q sin_phi sin_theta sec_theta"),
    (STATE.phi, 1.0, "r cos_phi sin_theta sec_theta"),
    (STATE.theta, 1.0, "q cos_phi"),
    (STATE.theta, -1.0, "r sin_phi"),
    (STATE.psi, 1.0, "q sin_phi sec_theta"),
    (STATE.psi, 1.0, "r cos_phi sec_theta"),
    (STATE.h, 1.0, "V cos_alpha cos_beta sin_theta"),
    (STATE.h, -1.0, "V sin_beta sin_phi cos_theta"),
    (STATE.h, -1.0, "V sin_alpha cos_beta cos_phi cos_theta"),
)
"""``task.model.kinematic_rates`` as monomials: which rate, sign, factors."""

_ANGLES = (STATE.phi, STATE.theta, STATE.alpha, STATE.beta)
_RATES = (STATE.p, STATE.q, STATE.r, STATE.V)
_FACTORS = (
    *(s.name for s in _RATES),
    *(f"sin_{a.name}" for a in _ANGLES),
    *(f"cos_{a.name}" for a in _ANGLES),
    "sec_theta",
    "1",
)


class _Carry:
    """Rows of [x; dx; commands; action], the columns of everything that is linear in them."""

    def __init__(self, lag: int) -> None:
        self.x = 0
        self.dx = N_IDENTIFIED
        self.commands = 2 * N_IDENTIFIED
        self.n_commands = N_ACTION * (lag + 1)
        self.size = self.commands + self.n_commands + N_ACTION


def _weights(g: Builder, network: Network, parameters: np.ndarray) -> list[dict[str, str]]:
    """Return, per layer, the tensors of all actors, the incumbent last.

    Hidden layers: weight (A, inputs, units), others (A, 1, units), for one product per actor. Output layer: weight
    (3, A, inputs), others (3, A), so that actions come out as columns. The members are initialisers; the incumbent
    is cut from its flat vector.
    """
    tensors = layout(network)
    sizes = g.integers(*(int(np.prod(t.shape)) for t in tensors))
    pieces = g.ops("Split", "incumbent", sizes, names=[f"incumbent.{t.name}" for t in tensors], axis=0)
    stacked = unflatten(network, parameters)
    layers: list[dict[str, str]] = [{} for _ in network.layers]
    for tensor, piece in zip(tensors, pieces, strict=True):
        _, index, kind = tensor.name.split(".")
        members = stacked[tensor.name]
        if int(index) == len(network.layers) - 1:
            units, *inputs = tensor.shape
            own, axis = g.op("Reshape", piece, g.integers(units, 1, *inputs)), 1
            members = members.swapaxes(0, 1)
        elif kind == "weight":
            own, axis = g.op("Transpose", g.op("Reshape", piece, g.integers(1, *tensor.shape)), perm=[0, 2, 1]), 0
            members = members.swapaxes(1, 2)
        else:
            own, axis = g.op("Reshape", piece, g.integers(1, 1, *tensor.shape)), 0
            members = members[:, None, :]
        stack = g.op("Concat", g.constant(members, tensor.name), own, axis=axis, name=f"all.{tensor.name}")
        layers[int(index)][kind] = stack
    for i, layer in enumerate(network.layers):
        if layer.layer_norm != "none":
            _fold_layer_norm(g, layers[i], layer, output=i == len(network.layers) - 1)
    return layers


def _fold_layer_norm(g: Builder, tensors: dict[str, str], layer: Layer, output: bool) -> None:
    """Centre weight and bias over the units and scale the gain, so that the loop need only divide by a norm.

    With c centred, gain * c / sqrt(c'c / n + eps) = gain sqrt(n) * c / sqrt(c'c + n eps), and
    gain * c / (sqrt(c'c / (n - 1)) + eps) = gain sqrt(n - 1) * c / (sqrt(c'c) + sqrt(n - 1) eps).
    """
    axis = g.integers(0 if output else -1)
    for kind in ("weight", "bias"):
        mean = g.op("ReduceMean", tensors[kind], axis, keepdims=1)
        tensors[kind] = g.op("Sub", tensors[kind], mean, name=f"centred.{kind}")
    tensors["gain"] = g.op("Mul", tensors["gain"], g.constant(np.array(_root(layer)), "root"), name="scaled.gain")


def _root(layer: Layer) -> float:
    return float(np.sqrt(layer.units if layer.layer_norm == "standard" else layer.units - 1))


def _layer_norm(g: Builder, x: str, layer: Layer, eps: float, tensors: dict[str, str], axis: int) -> str:
    """Add what is left of a LayerNorm after :func:`_fold_layer_norm`."""
    if layer.layer_norm == "standard":
        energy = g.op("ReduceSumSquare", x, g.integers(axis), keepdims=1)
        norm = g.op("Sqrt", g.op("Add", energy, g.constant(np.array(_root(layer) ** 2 * eps), "n_eps")), name="norm")
    else:
        length = g.op("ReduceL2", x, g.integers(axis), keepdims=1)
        norm = g.op("Add", length, g.constant(np.array(_root(layer) * eps), "root_eps"), name="norm")
    return g.op("Add", g.op("Mul", g.op("Div", x, norm), tensors["gain"]), tensors["shift"], name="normalised")


def _policy(g: Builder, s: str, network: Network, layers: list[dict[str, str]]) -> str:
    """Add all actors at once: scaled observations (7, A) -> actions (3, A) [rad]."""
    x = g.op("Unsqueeze", g.op("Transpose", s, perm=[1, 0]), g.integers(1), name="s_rows")
    for i, (layer, tensors) in enumerate(zip(network.layers, layers, strict=True)):
        output = i == len(layers) - 1
        if output:
            # three units: a product and a sum are cheaper than one matrix product per actor
            weighted = g.op("Mul", tensors["weight"], g.op("Squeeze", x, g.integers(1)))
            x = g.op("ReduceSum", weighted, g.integers(-1), keepdims=0)
        else:
            x = g.op("MatMul", x, tensors["weight"])
        x = g.op("Add", x, tensors["bias"])
        if layer.layer_norm != "none":
            x = _layer_norm(g, x, layer, network.layer_norm_eps, tensors, 0 if output else -1)
        x = activation(g, x, layer, network)
    action = g.op("Mul", x, g.constant(np.array(network.action_scale)[:, None], "action_scale"))
    if any(network.action_offset):
        action = g.op("Add", action, g.constant(np.array(network.action_offset)[:, None], "action_offset"))
    if exceeds_limits(network):
        action = g.op("Max", action, g.constant(ACTION_LOW[:, None], "action_low"))
        action = g.op("Min", action, g.constant(ACTION_HIGH[:, None], "action_high"))
    return action


def _step_matrix(g: Builder, carry: _Carry) -> tuple[str, str]:
    """Return (W, size) and (W, 1): everything that a step needs of [x; dx; commands; action], as one linear map.

    Rows: the increment of the 10 states (eq. 8.2); p, q, r, V half a step on; phi, theta, alpha and beta half a
    step on, each once for its sine and once shifted by pi/2 for its cosine. ``task.model.predict_increment`` takes
    the mean of the old and the new value for the dynamic states and the old value for phi and theta.
    """
    # z = pick @ [x; dx; commands; action] (13, size): dx and the increment of the command that acts now
    pick = np.zeros((N_REGRESSORS, carry.size))
    pick[:N_IDENTIFIED, carry.dx : carry.dx + N_IDENTIFIED] = np.eye(N_IDENTIFIED)
    pick[N_IDENTIFIED:, carry.commands : carry.commands + N_ACTION] = -np.eye(N_ACTION)
    pick[N_IDENTIFIED:, carry.commands + N_ACTION : carry.commands + 2 * N_ACTION] = np.eye(N_ACTION)

    wanted = [*_RATES, *_ANGLES, *_ANGLES]
    of_state = np.zeros((N_IDENTIFIED + len(wanted), carry.size))
    of_increment = np.zeros((N_IDENTIFIED + len(wanted), N_IDENTIFIED))
    of_increment[:N_IDENTIFIED] = np.eye(N_IDENTIFIED)
    for row, state in enumerate(wanted, start=N_IDENTIFIED):
        of_state[row, carry.x + state] = 1.0
        if state in DYNAMIC:
            of_increment[row, state] = 0.5
    constant = np.zeros((N_IDENTIFIED + len(wanted), 1))
    constant[-len(_ANGLES) :] = 0.5 * np.pi

    increment = g.op("MatMul", g.op("Transpose", "model", perm=[1, 0]), g.constant(pick, "pick"), name="increment_map")
    matrix = g.op(
        "Gemm", g.constant(of_increment, "of_increment"), increment, g.constant(of_state, "of_state"), name="step_map"
    )
    return matrix, g.constant(constant, "step_constant")


def _kinematics(g: Builder, rates: str, angles: str) -> str:
    """Add the increments of phi, theta, psi [rad] and h [m], (4, A), from rates (4, A) and angles (8, A)."""
    trig = g.op("Sin", angles, name="trig")
    cos_theta = _FACTORS.index("cos_theta") - len(_RATES)
    secant = g.op("Reciprocal", g.op("Gather", trig, g.integers(cos_theta), axis=0), name="sec_theta")
    factors = g.op("Concat", rates, trig, secant, "ones", axis=0, name="factors")
    depth = max(len(m.split()) for _, _, m in KINEMATICS)
    table = np.full((depth, len(KINEMATICS)), _FACTORS.index("1"))
    signs = np.zeros((N_IDENTIFIED - STATE.phi, len(KINEMATICS)))
    for column, (rate, sign, monomial) in enumerate(KINEMATICS):
        for row, factor in enumerate(monomial.split()):
            table[row, column] = _FACTORS.index(factor)
        signs[rate - STATE.phi, column] = sign
    chosen = g.op("Gather", factors, g.integers(*table.ravel().tolist()), axis=0)
    parts = g.ops("Split", chosen, names=["factor"] * depth, axis=0, num_outputs=depth)
    product = parts[0]
    for part in parts[1:]:
        product = g.op("Mul", product, part, name="monomials")
    return g.op("MatMul", g.constant(DT * signs, "kinematics"), product, name="kinematic_increment")


def _observation_maps(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """Return S (7, 10) and R (3, 7) with input_scale * s = S x + R' reference: ``task.observation`` is linear."""
    scale = np.array(network.input_scale)
    of_state = observation(np.eye(N_IDENTIFIED), np.zeros((N_IDENTIFIED, N_REFERENCE))).T
    of_reference = observation(np.zeros((N_REFERENCE, N_IDENTIFIED)), np.eye(N_REFERENCE))
    return scale[:, None] * of_state, of_reference * scale


def _returns(g: Builder, states: str, reference: str) -> str:
    """Add ``task.reward`` over a trajectory: states (H, 10, A), reference (H, 3) [rad] -> returns (A,)."""
    channels = g.op("Gather", states, g.integers(*TRACKED), axis=1, name="tracked")
    error = g.op("Sub", g.op("Unsqueeze", reference, g.integers(2)), channels, name="error")
    scaled = g.op("Mul", error, g.constant(REWARD_SCALE[:, None], "reward_scale"))
    clipped = g.op(
        "Abs", g.op("Clip", scaled, g.constant(np.array(-1.0), "minus_one"), g.constant(np.array(1.0), "one"))
    )
    reward = g.op("Mul", g.op("ReduceSum", clipped, g.integers(1), keepdims=0), g.constant(np.array(-1 / 3), "mean"))

    high, low = np.full((N_IDENTIFIED, 1), _HUGE), np.full((N_IDENTIFIED, 1), -_HUGE)
    high[[STATE.theta, STATE.phi], 0] = THETA_LIMIT, PHI_LIMIT
    low[STATE.h] = ALTITUDE_LIMIT
    # A comparison with NaN is false, one with infinity fails against the largest float: not finite is outside.
    bounded = g.op("LessOrEqual", g.op("Abs", states), g.constant(high, "bound"))
    inside = g.op("And", bounded, g.op("GreaterOrEqual", states, g.constant(low, "lower_bound")), name="inside")
    all_inside = g.op("ReduceMin", g.op("Cast", inside, to=onnx.TensorProto.FLOAT), g.integers(1), keepdims=0)
    # lost once, lost for good: alive while the product of all "inside" so far is one
    outside_so_far = g.op(
        "CumSum", g.op("Sub", g.constant(np.array(1.0), "one"), all_inside), g.constant(np.array(0), "first_axis")
    )
    alive = g.op("Less", outside_so_far, g.constant(np.array(0.5), "half"), name="alive")
    earned = g.op("Where", alive, reward, g.constant(np.array(-CRASH_COST_PER_FRAME), "crash"), name="earned")
    return g.op("ReduceSum", earned, g.integers(0), keepdims=0)


def imagination(network: Network, parameters: np.ndarray, lag: int) -> onnx.ModelProto:
    """Return the rollout of all members and of the incumbent as one graph.

    parameters: (P, K) float32, the members; lag: samples between a command and the increment that it moves, beyond
    that of eq. 8.2. Inputs and output as in docs/architecture.md: ``x``, ``dx``, ``commands``, ``model``,
    ``exact_kinematics``, ``reference``, ``incumbent`` -> ``returns`` (P + 1,).
    """
    actors = parameters.shape[0] + 1
    carry = _Carry(lag)
    g = Builder()
    layers = _weights(g, network, parameters)
    step_map, step_constant = _step_matrix(g, carry)
    of_state, of_reference = _observation_maps(network)

    before = g.op("Slice", "reference", g.integers(0), g.integers(-1), g.integers(0), name="reference_now")
    after = g.op(
        "Slice", "reference", g.integers(1), g.integers(np.iinfo(np.int64).max), g.integers(0), name="reference_next"
    )
    rows = g.op("MatMul", before, g.constant(of_reference, "of_reference"))
    observed_reference = g.op("Unsqueeze", rows, g.integers(2), name="observed_reference")

    def columns(flat: str, length: int, name: str) -> str:
        column = g.op("Reshape", flat, g.integers(length, 1))
        return g.op("Expand", column, g.integers(length, actors), name=name)

    start = [
        columns("x", N_IDENTIFIED, "x_start"),
        columns("dx", N_IDENTIFIED, "dx_start"),
        columns("commands", carry.n_commands, "commands_start"),
    ]
    g.initializers.append(onnx.numpy_helper.from_array(np.ones((1, actors), dtype=np.float32), "ones"))

    b = Builder(outer=g, prefix="step/")
    x, dx, commands = "step/x", "step/dx", "step/commands"
    s = b.op("Gemm", b.constant(of_state, "of_state"), x, "step/observed_reference", name="s")
    action = _policy(b, s, network, layers)
    linear = b.op("Concat", x, dx, commands, action, axis=0, name="linear")
    moved = b.op("Gemm", step_map, linear, step_constant, name="moved")
    parts = b.integers(STATE.phi, N_IDENTIFIED - STATE.phi, len(_RATES), 2 * len(_ANGLES))
    dynamic, modelled, rates, angles = b.ops(
        "Split", moved, parts, names=["dynamic", "modelled", "rates", "angles"], axis=0
    )
    kinematic = b.op("Where", "exact_kinematics", _kinematics(b, rates, angles), modelled)
    dx_next = b.op("Concat", dynamic, kinematic, axis=0, name="dx_next")
    x_next = b.op("Add", x, dx_next, name="x_next")
    kept = b.integers(carry.commands + N_ACTION), b.integers(carry.size)
    commands_next = b.op("Slice", linear, *kept, b.integers(0), name="commands_next")
    b.result(x_next, "step/flown")

    state = (N_IDENTIFIED, actors)
    body = b.body(
        "step",
        [value(x, state), value(dx, state), value(commands, (carry.n_commands, actors)),
         value("step/observed_reference", (N_OBSERVATION, 1))],
        [value(x_next, state), value(dx_next, state), value(commands_next, (carry.n_commands, actors)),
         value("step/flown", state)],
    )  # fmt: skip
    *_, flown = g.ops(
        "Scan", *start, observed_reference, names=["x_end", "dx_end", "commands_end", "flown"],
        body=body, num_scan_inputs=1,
    )  # fmt: skip
    g.result(_returns(g, flown, after), "returns")
    return g.model(
        "imagination",
        [
            value("x", (N_IDENTIFIED,)),
            value("dx", (N_IDENTIFIED,)),
            value("commands", (lag + 1, N_ACTION)),
            value("model", (N_REGRESSORS, N_IDENTIFIED)),
            value("exact_kinematics", (), BOOL),
            value("reference", ("samples", N_REFERENCE)),
            value("incumbent", (parameters.shape[1],)),
        ],
        [value("returns", (actors,))],
        "Predicted return of every member and, last, of the incumbent.",
    )
