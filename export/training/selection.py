"""Who survives, who breeds and who is overwritten: the generation's plan, decided before anything changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Plan(NamedTuple):
    """What happens to the N slots of the population."""

    elites: list[int]
    """Slots kept untouched, fittest first."""
    clones: list[tuple[int, int]]
    """(elite, slot): the slot becomes a copy of the elite."""
    parents: list[int]
    """Slots, after cloning, of which pairs are bred: the elites' copies and the tournament's winners."""
    children: list[int]
    """Slots that crossover fills."""
    mutants: list[int]
    """Slots that mutate, after crossover."""


def tournament(rank: np.ndarray, winners: int, size: int, rng: np.random.Generator) -> list[int]:
    """Return the distinct winners of ``winners`` tournaments: the best of ``size`` drawn with replacement.

    rank: slots, fittest first.
    """
    best = rng.integers(len(rank), size=(winners, size)).min(axis=1)
    return sorted({int(rank[i]) for i in best})


def plan_generation(
    fitness: np.ndarray,
    elite_fraction: float,
    tournament_size: int,
    mutation_probability: float,
    reserved: int | None,
    rng: np.random.Generator,
) -> Plan:
    """Plan one generation (thesis section II.B, in the order of PDERL).

    Elites stay as they are, and a copy of each takes the place of an unselected actor (of a winner when
    none is left). Crossover fills the other unselected slots. Everyone but the elites mutates with the
    given probability. ``reserved`` is the slot that the TD3 actor is about to take: nothing is bred for it.
    """
    rank = np.argsort(-fitness, kind="stable")
    elites = [int(i) for i in rank[: max(int(elite_fraction * len(rank)), 1)]]
    winners = [i for i in tournament(rank, len(rank) - len(elites), tournament_size, rng) if i not in elites]
    free = [i for i in range(len(rank)) if i not in winners and i not in elites and i != reserved]
    free = [free[i] for i in rng.permutation(len(free))]
    winners = [i for i in winners if i != reserved]
    clones: list[tuple[int, int]] = []
    for elite in elites:
        slots = free or winners
        if slots:
            clones.append((elite, slots.pop(0)))
    mutants = [i for i in range(len(rank)) if i not in elites and i != reserved and rng.random() < mutation_probability]
    return Plan(elites, clones, [slot for _, slot in clones] + winners, free, mutants)


def least_fit(fitness: np.ndarray, elite_fraction: float) -> int | None:
    """Return the slot that the TD3 actor takes: the least fit; None where all are elites."""
    elites = max(int(elite_fraction * len(fitness)), 1)
    rank = np.argsort(-fitness, kind="stable")
    return int(rank[-1]) if elites < len(rank) else None


def pair(parents: list[int], score: np.ndarray, children: int) -> list[tuple[int, int]]:
    """Return a pair of parents for each child: the pairs of highest score first, over again when they run out.

    score: (N, N) symmetric, behavioural distance (eq. 7) or summed fitness.
    """
    pairs = [(i, j) for n, i in enumerate(parents) for j in parents[n + 1 :] if i != j]
    pairs.sort(key=lambda ij: -score[ij])
    return [pairs[c % len(pairs)] for c in range(children)] if pairs else []
