"""Each genetic operator against a slow direct transcription of its equation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn import functional

from export.training.config import ActorSettings, GeneticSettings
from export.training.genetic import (
    act,
    behavioural_distance,
    cloning_gradient,
    cloning_loss,
    distil,
    mutate,
    q_filter,
    sensitivity,
)
from export.training.networks import actor_network, initialise, views, weight_mask
from export.training.population import Population
from export.training.selection import plan_generation

NETWORK = actor_network(ActorSettings(width=6, hidden=1))
CPU = torch.device("cpu")


def actors(count: int, seed: int = 0) -> torch.Tensor:
    return initialise(NETWORK, count, torch.Generator().manual_seed(seed))


def states(*shape: int, seed: int = 1) -> torch.Tensor:
    return torch.randn(*shape, 7, generator=torch.Generator().manual_seed(seed))


def one(parameters: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """A single actor (K,) as written in the thesis, for autograd."""
    w1, b1, w2, b2, gain, shift, w3, b3 = (v[0] for v in views(NETWORK, parameters[None]))
    h = torch.tanh(functional.linear(x, w1, b1))
    h = torch.tanh(functional.layer_norm(functional.linear(h, w2, b2), (6,), gain, shift, 1e-5))
    return torch.tanh(functional.linear(h, w3, b3))


def q(s: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """A critic that likes the action's first component where the first state is positive."""
    return (s[..., :1] * u[..., :1]) - 0.1 * u[..., 1:2].square()


def test_distance_is_eq_7() -> None:
    parameters, visited = actors(4), states(4, 5)
    got = behavioural_distance(NETWORK, parameters, visited)
    for x in range(4):
        for y in range(4):
            expected = 0.0
            for own in (x, y):
                for s in visited[own]:
                    expected += float((one(parameters[x], s) - one(parameters[y], s)).square().sum()) / 5
            assert float(got[x, y]) == pytest.approx(expected, abs=1e-5)


def test_q_filter_takes_the_better_parent_state_by_state() -> None:
    first, second, seen = actors(2), actors(2, seed=7), states(2, 9)
    seen[0, 0] = 0.0
    target, chosen = q_filter(NETWORK, first, second, seen, lambda s, u: s[..., :1] * u[..., :1])
    for c in range(2):
        for i in range(9):
            u_x, u_y = one(first[c], seen[c, i]), one(second[c], seen[c, i])
            q_x, q_y = float(seen[c, i, 0] * u_x[0]), float(seen[c, i, 0] * u_y[0])
            assert bool(chosen[c, i]) == (q_x != q_y)
            if q_x != q_y:
                torch.testing.assert_close(target[c, i], u_x if q_x > q_y else u_y, atol=1e-5, rtol=1e-5)


def test_cloning_loss_is_eq_6_and_its_gradient() -> None:
    u = torch.rand(2, 4, 3, generator=torch.Generator().manual_seed(3)).double().requires_grad_()
    target, chosen = torch.rand(2, 4, 3).double(), torch.tensor([[1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]]).double()
    loss = cloning_loss(u, target, chosen)
    loss.sum().backward()
    v = u.detach()
    torch.testing.assert_close(cloning_gradient(v, target, chosen), u.grad)
    for c in range(2):
        expected = sum(float(chosen[c, i]) * float((v[c, i] - target[c, i]).square().sum()) for i in range(4))
        expected += sum(float(v[c, i].square().sum()) for i in range(4)) / 4
        assert float(loss[c].detach()) == pytest.approx(expected)


def test_distillation_equals_one_child_at_a_time() -> None:
    first, second, seen = actors(2), actors(2, seed=7), states(2, 40)
    sizes, start = torch.tensor([40, 25]), first.clone()
    epochs, batch, rate = 2, 8, 1e-2
    got = distil(NETWORK, first, second, start, seen, sizes, q, torch.Generator().manual_seed(4), epochs, batch, rate)
    generator = torch.Generator().manual_seed(4)
    draws = [torch.rand(2, batch, generator=generator) for _ in range(epochs * (40 // batch))]
    for c in range(2):
        child = start[c].clone().requires_grad_()
        adam = torch.optim.Adam([child], lr=rate)
        for draw in draws:
            loss = torch.zeros(())
            for i in (draw[c] * sizes[c]).long():
                s = seen[c, i]
                u = one(child, s)
                with torch.no_grad():
                    u_x, u_y = one(first[c], s), one(second[c], s)
                if q(s, u_x) > q(s, u_y):
                    loss = loss + (u - u_x).square().sum()
                elif q(s, u_y) > q(s, u_x):
                    loss = loss + (u - u_y).square().sum()
                loss = loss + u.square().sum() / batch
            adam.zero_grad()
            loss.backward()
            adam.step()
        torch.testing.assert_close(got[c], child.detach(), rtol=5e-3, atol=5e-4)


def test_distillation_brings_a_child_to_its_parents() -> None:
    first, second, seen = actors(1), actors(1, seed=7), states(1, 256)
    stranger = actors(1, seed=9)
    child = distil(
        NETWORK, first, second, stranger, seen, torch.tensor([256]), q, torch.Generator().manual_seed(0), 60, 64, 1e-2
    )
    target, _ = q_filter(NETWORK, first, second, seen, q)
    before = (act(NETWORK, stranger, seen) - target).square().mean()
    assert (act(NETWORK, child, seen) - target).square().mean() < 0.1 * before


def test_sensitivity_is_eq_8() -> None:
    parameters, seen = actors(3), states(3, 5)
    got = sensitivity(NETWORK, parameters, seen)
    for p in range(3):
        squares = torch.zeros(parameters.shape[1])
        for k in range(3):
            leaf = parameters[p].clone().requires_grad_()
            sum(one(leaf, s)[k] for s in seen[p]).backward()
            squares += leaf.grad.square()
        torch.testing.assert_close(got[p], squares.sqrt(), rtol=1e-3, atol=1e-4)


def test_mutation_is_scaled_floored_and_masked() -> None:
    parameters = torch.zeros(2, 5)
    scaling = torch.tensor([[0.0, 1e-5, 0.01, 2.0, 2.0], [1.0, 1.0, 1.0, 1.0, 1.0]])
    mask = torch.tensor([True, True, True, True, False])
    noise = 0.1 * torch.randn(2, 5, generator=torch.Generator().manual_seed(6))
    got = mutate(parameters, 0.1, scaling, mask, 0.01, torch.Generator().manual_seed(6))
    torch.testing.assert_close(got[0], noise[0] / torch.tensor([1.0, 0.01, 0.01, 2.0, torch.inf]))
    torch.testing.assert_close(got[1, :4], noise[1, :4])
    gaussian = mutate(parameters, 0.1, None, mask, 0.01, torch.Generator().manual_seed(6))
    torch.testing.assert_close(gaussian[:, :4], noise[:, :4])
    assert not gaussian[:, 4].any()


def population(**changes: object) -> Population:
    base = {"population": 4, "memory": 40, "mutation_batch": 8, "pairing_batch": 16, "crossover_batch": 8}
    made = Population(NETWORK, GeneticSettings(**(base | changes)), torch.Generator().manual_seed(0), CPU)
    for actor in range(5):
        made.memory.add(actor, states(30, seed=actor))
    return made


def mutants(p: Population) -> torch.Tensor:
    p.mutate_slots([0, 1, 2, 3], torch.Generator().manual_seed(3))
    return p.parameters


def test_safe_mutation_needs_more_critical_states_than_a_batch() -> None:
    none, few, enough = population(), population(), population()
    few.critical.add(0, states(8, seed=20))
    enough.critical.add(0, states(9, seed=20))
    by_memory, by_few, by_many = mutants(none), mutants(few), mutants(enough)
    assert torch.equal(by_few[0], by_memory[0])
    assert not torch.equal(by_many[0], by_memory[0])


def test_mutants_are_least_changed_where_they_are_most_sensitive() -> None:
    p = population()
    before = p.parameters.clone()
    s = sensitivity(NETWORK, before, p.memory.states[:4, :30])
    change = (mutants(p) - before).abs()
    mask = weight_mask(NETWORK)
    sensitive = s > s[:, mask].median()
    assert change[sensitive & mask].mean() < 0.75 * change[~sensitive & mask].mean()


def test_child_remembers_the_latest_half_of_both_parents() -> None:
    fitness = np.array([3.0, 2.0, 1.0, 0.0])

    def one_child_of_two(seed: int) -> bool:
        plan = plan_generation(fitness, 0.25, 3, 0.0, None, np.random.default_rng(seed))
        return len(plan.children) == 1 and len(plan.parents) == 2

    seed = next(seed for seed in range(100) if one_child_of_two(seed))
    plan = plan_generation(fitness, 0.25, 3, 0.0, None, np.random.default_rng(seed))
    p = population(mutation_probability=0.0, elite_fraction=0.25)
    p.evolve(fitness, False, q, np.random.default_rng(seed), torch.Generator().manual_seed(0))
    expected = torch.cat([p.memory.latest(parent, 20) for parent in plan.parents])
    torch.testing.assert_close(p.memory.latest(plan.children[0], 40), expected, rtol=0, atol=0)


def test_injection_brings_the_actor_and_what_it_remembers() -> None:
    p = population()
    stranger = actors(1, seed=30)
    p.inject(2, stranger)
    assert torch.equal(p.parameters[2], stranger[0])
    assert torch.equal(p.memory.latest(2, 30), p.memory.latest(4, 30))
