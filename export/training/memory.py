"""What was lived through, in preallocated tensors: the shared memory D and each actor's own memories.

Observations are stored already multiplied by the network's ``input_scale``: learning needs no other form.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Block(NamedTuple):
    """Transitions sampled together, each (..., n); ``state_action`` is [s, u] side by side, as a critic sees it."""

    state_action: Tensor
    state: Tensor
    action: Tensor
    reward: Tensor
    next_state: Tensor
    continues: Tensor
    """1 where the flight went on, 0 where it was lost."""


class Replay:
    """The shared memory D: a ring of rows [s, u, r, s', continues]."""

    def __init__(self, capacity: int, observation: int, action: int, device: torch.device) -> None:
        """Allocate ``capacity`` transitions."""
        self.observation, self.action = observation, action
        self.rows = torch.zeros(capacity, 2 * observation + action + 2, device=device)
        self.filled = 0
        self.head = 0

    def add(self, rows: Tensor) -> None:
        """Append rows (n, columns), oldest first; the oldest of all are overwritten."""
        rows = rows[-self.rows.shape[0] :].to(self.rows.device)
        capacity, count = self.rows.shape[0], rows.shape[0]
        first = min(count, capacity - self.head)
        self.rows[self.head : self.head + first] = rows[:first]
        self.rows[: count - first] = rows[first:]
        self.head = (self.head + count) % capacity
        self.filled = min(self.filled + count, capacity)

    def sample(self, updates: int, batch: int, generator: torch.Generator) -> Block:
        """Return one block for several updates, every tensor (updates, batch, n), drawn with replacement."""
        device = self.rows.device
        index = torch.randint(self.filled, (updates * batch,), generator=generator, device=device)
        rows = self.rows[index].view(updates, batch, -1)
        n, m = self.observation, self.action
        state_action = rows[..., : n + m].contiguous()
        return Block(
            state_action,
            state_action[..., :n],
            state_action[..., n:],
            rows[..., n + m : n + m + 1].contiguous(),
            rows[..., n + m + 1 : 2 * n + m + 1].contiguous(),
            rows[..., -1:].contiguous(),
        )

    def state(self) -> dict[str, Tensor]:
        """Return what a checkpoint needs."""
        return {"rows": self.rows[: self.filled], "marks": torch.tensor([self.filled, self.head])}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take up a checkpoint."""
        self.filled, self.head = state["marks"].tolist()
        self.rows[: self.filled] = state["rows"].to(self.rows.device)


class Recollections:
    """The last kappa states of each of P actors: a genetic memory D^G or a critical buffer D_C each.

    The operators read states alone (eqs 6, 7, 8), so no other part of a transition is kept.
    """

    def __init__(self, actors: int, kappa: int, observation: int, device: torch.device) -> None:
        """Allocate kappa states for each of ``actors``."""
        self.states = torch.zeros(actors, kappa, observation, device=device)
        self.filled = torch.zeros(actors, dtype=torch.long)
        self.head = torch.zeros(actors, dtype=torch.long)

    def add(self, actor: int, states: Tensor) -> None:
        """Append states (n, observation) of one actor, oldest first."""
        kappa = self.states.shape[1]
        states = states[-kappa:].to(self.states.device)
        head, count = int(self.head[actor]), states.shape[0]
        first = min(count, kappa - head)
        self.states[actor, head : head + first] = states[:first]
        self.states[actor, : count - first] = states[first:]
        self.head[actor] = (head + count) % kappa
        self.filled[actor] = min(int(self.filled[actor]) + count, kappa)

    def latest(self, actor: int, count: int) -> Tensor:
        """Return the ``count`` latest states of one actor (fewer where it has fewer), oldest first."""
        count = min(count, int(self.filled[actor]))
        index = (int(self.head[actor]) - count + torch.arange(count)) % self.states.shape[1]
        return self.states[actor, index.to(self.states.device)]

    def copy(self, source: int, target: int) -> None:
        """Give ``target`` the whole memory of ``source``."""
        self.states[target] = self.states[source]
        self.filled[target] = self.filled[source]
        self.head[target] = self.head[source]

    def clear(self, actor: int) -> None:
        """Forget all of one actor."""
        self.filled[actor] = 0
        self.head[actor] = 0

    def sample(self, actors: list[int], batch: int, generator: torch.Generator) -> Tensor:
        """Return (len(actors), batch, observation) states, drawn with replacement from each actor's own."""
        device = self.states.device
        filled = self.filled[actors].to(device)
        draw = torch.rand(len(actors), batch, generator=generator, device=device)
        index = (draw * filled[:, None]).long().clamp_(max=self.states.shape[1] - 1)
        return self.states[torch.tensor(actors, device=device)[:, None], index]

    def state(self) -> dict[str, Tensor]:
        """Return what a checkpoint needs."""
        return {"states": self.states, "filled": self.filled, "head": self.head}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take up a checkpoint."""
        self.states.copy_(state["states"])
        self.filled.copy_(state["filled"])
        self.head.copy_(state["head"])
