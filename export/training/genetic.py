"""The operators of the genetic population as pure functions over stacked actors (thesis eqs 5-8).

Every operator treats all actors concerned in one pass; parameters are (P, K), states are already multiplied
by ``input_scale``, actions u are in units of their bound.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from export.network import Network
from export.training.networks import Stack, Trainable, unpack, views

Critic = Callable[[Tensor, Tensor], Tensor]
"""Q(s, u) -> (..., B, 1)."""


def act(network: Network, parameters: Tensor, states: Tensor) -> Tensor:
    """Return u (P, B, 3) of actors (P, K) on states (P, B, 7) or (B, 7)."""
    return Stack(network, views(network, parameters))(states)


def behavioural_distance(network: Network, parameters: Tensor, states: Tensor) -> Tensor:
    """Return d(x, y) = E_{s~P_x} ||mu_x - mu_y||^2 + E_{s~P_y} ||mu_x - mu_y||^2 (eq. 7), shape (P, P).

    states: (P, B, 7), those visited by each actor.
    """
    actors = Stack(network, views(network, parameters))
    one_way = torch.empty(len(states), len(states), device=states.device)
    for y, visited in enumerate(states):  # one actor's states at a time stay in a processor's cache
        u = actors(visited)
        one_way[:, y] = (u - u[y]).square().sum(-1).mean(-1)
    return one_way + one_way.T


def q_filter(network: Network, first: Tensor, second: Tensor, states: Tensor, q: Critic) -> tuple[Tensor, Tensor]:
    """Return the action of the better parent on each state, (C, B, 3), and where one is better, (C, B) bool.

    The indicators of eq. 6: mu_x where Q(s, mu_x) > Q(s, mu_y), mu_y where it is less, neither where equal.
    """
    targets, chosen = [], []
    for x, y, visited in zip(first, second, states, strict=True):  # pair by pair: all at once fall out of cache
        u_x, u_y = act(network, torch.stack([x, y]), visited)
        q_x, q_y = q(visited, u_x), q(visited, u_y)
        targets.append(torch.where(q_x > q_y, u_x, u_y))
        chosen.append((q_x != q_y)[..., 0])
    return torch.stack(targets), torch.stack(chosen)


def cloning_loss(u: Tensor, target: Tensor, chosen: Tensor) -> Tensor:
    """Return the cloning loss of eq. 6 of each child, shape (C,): imitation plus the mean squared action.

    u, target: (C, B, 3); chosen: (C, B), 1 where one parent is better.
    """
    imitation = ((u - target).square().sum(-1) * chosen).sum(-1)
    return imitation + u.square().sum(-1).mean(-1)


def cloning_gradient(u: Tensor, target: Tensor, chosen: Tensor) -> Tensor:
    """Return the gradient of :func:`cloning_loss` with respect to u, (C, B, 3)."""
    return 2.0 * ((u - target) * chosen[..., None] + u / u.shape[1])


def distil(
    network: Network,
    first: Tensor,
    second: Tensor,
    start: Tensor,
    memories: Tensor,
    sizes: Tensor,
    q: Critic,
    generator: torch.Generator,
    epochs: int,
    batch: int,
    learning_rate: float,
) -> Tensor:
    """Return children (C, K) that imitate the better of two parents on each state (eq. 6), all pairs at once.

    first, second: parents (C, K); start: (C, K) the parent that each child starts from; memories: (C, M, 7)
    the states inherited from both, of which the first sizes[c] count. Parents and critics stand still, so the
    Q-filter is computed once.
    """
    target, chosen = q_filter(network, first, second, memories, q)
    weight = chosen.to(memories.dtype)
    children = Trainable(network, start, learning_rate)
    count, size, _ = memories.shape
    rows = torch.arange(count, device=memories.device)[:, None]
    for _ in range(epochs * max(size // batch, 1)):
        draw = torch.rand(count, batch, generator=generator, device=memories.device)
        index = (draw * sizes[:, None]).long().clamp_(max=size - 1)
        u = children(memories[rows, index])
        children.backward(cloning_gradient(u, target[rows, index], weight[rows, index]))
        children.step()
    return children.parameters()


def sensitivity(network: Network, parameters: Tensor, states: Tensor) -> Tensor:
    """Return s = sqrt(sum_k (sum_i grad_theta mu(s_i)_k)^2) (eq. 8) of every parameter, shape (P, K).

    states: (P, B, 7). One backward pass for each output serves all actors.
    """
    actors = Trainable(network, parameters, 0.0)
    u = actors(states)
    squares = torch.zeros_like(actors.grad)
    for k in range(u.shape[-1]):
        one = torch.zeros_like(u)
        one[..., k] = 1.0
        actors.backward(one)
        squares += actors.grad.square()
    return unpack(network, squares).sqrt_()


def mutate(
    parameters: Tensor, magnitude: float, scaling: Tensor | None, mask: Tensor, floor: float, generator: torch.Generator
) -> Tensor:
    """Return theta_o ~ N(theta_p, (sigma_mut / s)^2): Gaussian (eq. 5) without ``scaling``, else eq. 8.

    scaling: (P, K) sensitivities; an exact zero counts as one, others are at least ``floor``.
    mask: (K,) bool, the parameters that mutate.
    """
    delta = magnitude * torch.randn(parameters.shape, generator=generator, device=parameters.device)
    if scaling is not None:
        delta /= torch.where(scaling == 0.0, 1.0, scaling.clamp_min(floor))
    return parameters + delta * mask
