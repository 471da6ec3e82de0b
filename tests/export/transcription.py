"""Policies and imagined flights once more, in torch and float64: modules as anybody would write them.

numpy = torch = ONNX is what the tests of parity show with them.
"""

from __future__ import annotations

import numpy as np
import onnx
import onnxruntime
import torch
from torch import nn

from export.network import Layer, Network, unflatten
from export.rollout import MAX_DELAY, Imagined, rollout
from task.actuators import HEALTHY
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.reference import random_reference
from task.reward import CRASH_COST_PER_FRAME, REWARD_SCALE

ACTION_TOLERANCE = 2e-6
"""One step of a policy in float32 [rad]."""
STATE_TOLERANCE = 3e-4
"""One step of the model in float32: the spacing of float32 at 2000 m is 1.2e-4 [m]; angles and rates are below 1e-6."""
RETURN_TOLERANCE = {1: 1e-6, 50: 2e-5, 200: 2e-4, 400: 1e-3}
"""Return over a horizon [steps] in float32; returns are about -0.1 to -1 a step."""


def hidden(width: int, *norms: str, activation: str = "tanh") -> tuple[Layer, ...]:
    return tuple(Layer(units=width, layer_norm=norm, activation=activation) for norm in norms)


NETWORKS = {
    "thesis": Network(layers=(*hidden(32, "none", *["unbiased"] * 3), Layer(units=3)), layer_norm_eps=1e-6),
    "thesis-standard": Network(layers=(*hidden(24, "none", *["standard"] * 3), Layer(units=3))),
    "td3-relu": Network(layers=(*hidden(48, "none", "none", "none", activation="relu"), Layer(units=3))),
    "leaky": Network(layers=(*hidden(16, "standard", "unbiased", activation="leaky_relu"), Layer(units=3))),
    "scaled": Network(
        layers=(*hidden(8, "none"), Layer(units=3)),
        input_scale=(3.0, 2.0, 5.0, 0.5, 0.5, 0.5, 1.0),
        action_scale=(0.1, 0.05, -0.08),
        action_offset=(-0.025, 0.0, 0.01),
    ),
    "linear-law": Network(layers=(Layer(units=3, activation="linear"),), action_scale=(0.3, 0.3, 0.3)),
    "normalised-output": Network(layers=(*hidden(8, "none"), Layer(units=3, layer_norm="unbiased"))),
    "normalised-output-standard": Network(layers=(*hidden(8, "none"), Layer(units=3, layer_norm="standard"))),
}


class UnbiasedLayerNorm(nn.Module):
    """LayerNorm of the published code: unbiased standard deviation, eps added to it."""

    def __init__(self, units: int, eps: float) -> None:
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.ones(units)), nn.Parameter(torch.zeros(units))
        self.eps = eps

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        mean, std = x.mean(-1, keepdim=True), x.std(-1, keepdim=True)
        return self.weight * (x - mean) / (std + self.eps) + self.bias


class TorchActor(nn.Module):
    """One actor of a network, as plain modules in float64."""

    def __init__(self, network: Network, parameters: np.ndarray) -> None:
        super().__init__()
        self.network = network
        tensors = {k: torch.tensor(v, dtype=torch.float64) for k, v in unflatten(network, parameters).items()}
        modules: list[nn.Module] = []
        inputs = network.observation
        for i, layer in enumerate(network.layers):
            linear = nn.Linear(inputs, layer.units)
            linear.weight, linear.bias = (nn.Parameter(tensors[f"layers.{i}.{k}"]) for k in ("weight", "bias"))
            modules.append(linear)
            if layer.layer_norm != "none":
                unbiased = layer.layer_norm == "unbiased"
                norm = (UnbiasedLayerNorm if unbiased else nn.LayerNorm)(layer.units, eps=network.layer_norm_eps)
                norm.weight, norm.bias = (nn.Parameter(tensors[f"layers.{i}.{k}"]) for k in ("gain", "shift"))
                modules.append(norm)
            modules.append(
                {
                    "tanh": nn.Tanh(),
                    "relu": nn.ReLU(),
                    "leaky_relu": nn.LeakyReLU(network.leaky_slope),
                    "linear": nn.Identity(),
                }[layer.activation]
            )
            inputs = layer.units
        self.net = nn.Sequential(*modules)

    def forward(self, s: torch.Tensor) -> torch.Tensor:
        n = self.network
        scales = (torch.tensor(v, dtype=torch.float64) for v in (n.input_scale, n.action_scale, n.action_offset))
        input_scale, action_scale, action_offset = scales
        return action_offset + action_scale * self.net(input_scale * s)


def session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(model.SerializeToString(), options)


class Case:
    """One imagination's inputs, in float64 values that float32 holds exactly."""

    def __init__(
        self, horizon: int, lag: int, model: np.ndarray, exact: bool, delay: int = 0, seed: int = 3,
        actuators: np.ndarray = HEALTHY,
    ) -> None:  # fmt: skip
        self.delay, self.actuators = delay, self._exact(actuators)
        rng = np.random.default_rng(seed)
        x = np.zeros(10)
        x[:3] = rng.normal(0.0, 0.01, 3)
        x[3:10] = 90.0, 0.06, 0.01, 0.1, 0.06, 0.5, 2000.0
        reference = random_reference(rng, 20.0, 0.06)[: horizon + 1]
        self.x, self.dx = self._exact(x), self._exact(1e-4 * rng.normal(size=10))
        self.commands = self._exact(rng.uniform(-0.02, 0.02, (lag + 1 + MAX_DELAY, 3)))
        self.model, self.reference, self.exact = self._exact(model), self._exact(reference), exact

    @staticmethod
    def _exact(array: np.ndarray) -> np.ndarray:
        return array.astype(np.float32).astype(float)

    def imagined(self, network: Network, parameters: np.ndarray, kind: type = np.float64) -> Imagined:
        x, dx, commands, model = (a.astype(kind) for a in (self.x, self.dx, self.commands, self.model))
        reference = self.reference.astype(kind)
        return rollout(network, parameters, x, dx, commands, self.delay, model, self.exact, reference, self.actuators)

    def by_numpy(self, network: Network, parameters: np.ndarray, kind: type = np.float64) -> np.ndarray:
        return self.imagined(network, parameters, kind).returns

    def feeds(self, incumbent: np.ndarray) -> dict[str, np.ndarray]:
        feeds = {k: getattr(self, k).astype(np.float32) for k in ("x", "dx", "commands", "reference", "actuators")}
        return {
            **feeds,
            "delay": np.array(self.delay),
            "model": np.atleast_3d(self.model.T).T.astype(np.float32),
            "exact_kinematics": np.array(self.exact),
            "incumbent": incumbent,
        }

    def by_torch(self, network: Network, parameters: np.ndarray) -> float:
        """One member's return, one number at a time, straight from the equations."""
        actor = TorchActor(network, parameters)
        low, high = torch.tensor(ACTION_LOW), torch.tensor(ACTION_HIGH)
        x, dx = torch.tensor(self.x), torch.tensor(self.dx)
        theta = torch.tensor(self.model)
        sent = [torch.tensor(c) for c in self.commands[MAX_DELAY - self.delay :]]
        total, alive = 0.0, True
        for now, following in zip(self.reference[:-1], self.reference[1:], strict=True):
            p, q, r, V, alpha, beta, phi, pitch, *_ = x
            errors = torch.stack([now[0] - pitch, now[1] - phi, now[2] - beta])
            sent.append(torch.clamp(actor(torch.cat([errors, torch.stack([p, q, r, alpha])])), low, high))
            dx = theta.T @ torch.cat([dx, sent[1] - sent[0]])
            sent.pop(0)
            if self.exact:
                p, q, r, V, alpha, beta = (x + 0.5 * dx)[:6]
                sin, cos = torch.sin, torch.cos
                turn = (q * sin(phi) + r * cos(phi)) / cos(pitch)
                climb = V * (
                    cos(alpha) * cos(beta) * sin(pitch)
                    - sin(beta) * sin(phi) * cos(pitch)
                    - sin(alpha) * cos(beta) * cos(phi) * cos(pitch)
                )
                rates = torch.stack([p + turn * sin(pitch), q * cos(phi) - r * sin(phi), turn, climb])
                dx = torch.cat([dx[:6], DT * rates])
            x = x + dx
            alive = alive and bool(x[7].abs() <= np.deg2rad(60) and x[6].abs() <= np.deg2rad(75) and x[9] >= 50)
            error = torch.tensor(following) - x[[7, 6, 5]]
            reward = -(torch.tensor(REWARD_SCALE) * error).clamp(-1, 1).abs().sum() / 3
            total += float(reward) if alive else -CRASH_COST_PER_FRAME
        return total
