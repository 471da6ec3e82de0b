"""The plan of a generation, and the memories that it moves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from export.training.memory import Recollections, Replay
from export.training.selection import least_fit, pair, plan_generation, tournament

CPU = torch.device("cpu")


def test_tournament_wins_as_often_as_it_should() -> None:
    """The best of three draws is rank 0 with probability 1 - (1 - 1/N)^3."""
    rng = np.random.default_rng(0)
    rank = np.array([4, 2, 0, 1, 3])
    won = np.mean([4 in tournament(rank, 1, 3, rng) for _ in range(4000)])
    assert won == pytest.approx(1.0 - 0.8**3, abs=0.03)


@given(
    fitness=st.lists(st.floats(-4000.0, 0.0), min_size=2, max_size=20),
    elite_fraction=st.floats(0.0, 1.0),
    seed=st.integers(0, 1000),
    synchronising=st.booleans(),
)
def test_plan_holds_its_promises(fitness: list[float], elite_fraction: float, seed: int, synchronising: bool) -> None:
    scores = np.array(fitness)
    reserved = least_fit(scores, elite_fraction) if synchronising else None
    plan = plan_generation(scores, elite_fraction, 3, 0.9, reserved, np.random.default_rng(seed))
    touched = [slot for _, slot in plan.clones] + plan.children + plan.mutants
    assert not set(plan.elites) & set(touched)
    assert reserved not in plan.elites + touched + plan.parents
    assert len(plan.elites) == max(int(elite_fraction * len(scores)), 1)
    assert min(scores[plan.elites]) >= max(np.delete(scores, plan.elites), default=-np.inf)
    written = [slot for _, slot in plan.clones] + plan.children
    assert len(set(written)) == len(written)
    assert set(plan.elites) >= {source for source, _ in plan.clones}
    assert not set(plan.children) & set(plan.parents)


def test_every_actor_but_elites_mutates_about_nine_times_in_ten() -> None:
    rng = np.random.default_rng(1)
    counts = np.zeros(10)
    for _ in range(600):
        plan = plan_generation(np.arange(10.0), 0.2, 3, 0.9, None, rng)
        counts[plan.mutants] += 1
    assert not counts[8:].any()
    assert counts[:8].mean() / 600 == pytest.approx(0.9, abs=0.02)


def test_the_td3_actor_takes_the_least_fit_never_an_elite() -> None:
    assert least_fit(np.array([-5.0, -1.0, -9.0, -2.0]), 0.25) == 2
    assert least_fit(np.array([-5.0]), 0.2) is None
    assert least_fit(np.array([-5.0, -3.0]), 1.0) is None


def test_pairs_are_bred_in_the_order_of_their_score() -> None:
    score = np.zeros((4, 4))
    score[0, 2] = score[2, 0] = 3.0
    score[0, 3] = score[3, 0] = 2.0
    score[2, 3] = score[3, 2] = 1.0
    assert pair([0, 2, 3], score, 4) == [(0, 2), (0, 3), (2, 3), (0, 2)]
    assert pair([1], score, 2) == []


def rows(start: int, count: int) -> torch.Tensor:
    return torch.arange(start, start + count, dtype=torch.float32)[:, None].expand(count, 19).contiguous()


def test_shared_memory_keeps_the_latest_and_splits_its_rows() -> None:
    replay = Replay(10, 7, 3, CPU)
    replay.add(rows(0, 6))
    assert (replay.filled, replay.head) == (6, 6)
    replay.add(rows(6, 7))
    assert sorted(replay.rows[:, 0].tolist()) == list(range(3, 13))
    replay.add(rows(100, 25))
    assert sorted(replay.rows[:, 0].tolist()) == list(range(115, 125))
    replay.rows.copy_(torch.arange(19.0).expand(10, 19))
    block = replay.sample(4, 5, torch.Generator().manual_seed(0))
    assert block.state_action.shape == (4, 5, 10)
    assert block.state[0, 0].tolist() == list(range(7))
    assert block.action[0, 0].tolist() == [7.0, 8.0, 9.0]
    assert block.reward[0, 0].tolist() == [10.0]
    assert block.next_state[0, 0].tolist() == list(range(11, 18))
    assert block.continues[0, 0].tolist() == [18.0]


def test_shared_memory_is_sampled_evenly_from_what_is_filled() -> None:
    replay = Replay(100, 7, 3, CPU)
    replay.add(rows(0, 20))
    drawn = replay.sample(100, 100, torch.Generator().manual_seed(0)).state[..., 0].flatten()
    counts = torch.bincount(drawn.long(), minlength=20)
    assert len(counts) == 20
    assert counts.min() > 350
    assert counts.max() < 650


def test_recollections_keep_the_latest_of_each_actor() -> None:
    memory = Recollections(3, 10, 19, CPU)
    memory.add(1, rows(0, 6))
    memory.add(1, rows(6, 7))
    assert memory.latest(1, 4)[:, 0].tolist() == [9.0, 10.0, 11.0, 12.0]
    assert memory.latest(1, 99)[:, 0].tolist() == [float(i) for i in range(3, 13)]
    assert len(memory.latest(0, 5)) == 0
    memory.copy(1, 2)
    memory.add(1, rows(50, 3))
    assert memory.latest(2, 1)[0, 0] == 12.0
    memory.clear(2)
    assert len(memory.latest(2, 5)) == 0


def test_recollections_sample_each_actor_from_its_own() -> None:
    memory = Recollections(2, 10, 19, CPU)
    memory.add(0, rows(0, 4))
    memory.add(1, rows(100, 10))
    drawn = memory.sample([1, 0], 200, torch.Generator().manual_seed(0))[..., 0]
    assert set(drawn[0].tolist()) == {float(i) for i in range(100, 110)}
    assert set(drawn[1].tolist()) == {0.0, 1.0, 2.0, 3.0}
