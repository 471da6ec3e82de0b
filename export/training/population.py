"""The genetic population: N actors, what each remembers, and one generation's change of them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from export.network import Network
from export.training.config import GeneticSettings
from export.training.flights import Flights
from export.training.genetic import Critic, behavioural_distance, distil, mutate, sensitivity
from export.training.memory import Recollections
from export.training.networks import initialise, weight_mask
from export.training.selection import Plan, least_fit, pair, plan_generation


class Population:
    """Actors 0..N-1 and their memories; the memories of the TD3 actor are the last ones, at index N."""

    def __init__(
        self, network: Network, settings: GeneticSettings, generator: torch.Generator, device: torch.device
    ) -> None:
        """Draw the actors from ``generator`` (on the CPU)."""
        self.network = network
        self.settings = settings
        count = settings.population
        self.parameters = initialise(network, count, generator).to(device)
        self.memory = Recollections(count + 1, settings.memory, network.observation, device)
        self.critical = Recollections(count + 1, settings.memory, network.observation, device)
        self.mask = weight_mask(network).to(device)

    def remember(self, flights: Flights, stored: int, input_scale: np.ndarray) -> None:
        """Add the states of each actor's last ``stored`` flights to its memory, the unsafe ones to its critical buffer.

        A state enters the critical buffer for the state that follows it (eq. 14).
        """
        for p, e in np.ndindex(flights.length.shape):
            if e < flights.length.shape[1] - stored:
                continue
            n = int(flights.length[p, e])
            states = torch.from_numpy(flights.observation[:n, p, e] * input_scale)
            self.memory.add(p, states)
            self.critical.add(p, states[torch.from_numpy(flights.unsafe[:n, p, e])])

    def evolve(
        self,
        fitness: np.ndarray,
        synchronising: bool,
        q: Critic,
        rng: np.random.Generator,
        generator: torch.Generator,
        magnitude: float | None = None,
    ) -> int | None:
        """Breed the next generation from ``fitness`` (N,); return the slot kept for the TD3 actor, if any.

        magnitude: sigma_mut of this generation, the settings' when not given.
        """
        s = self.settings
        reserved = least_fit(fitness, s.elite_fraction) if synchronising else None
        plan = plan_generation(fitness, s.elite_fraction, s.tournament, s.mutation_probability, reserved, rng)
        for source, slot in plan.clones:
            self._copy(source, slot)
        self._cross(plan, fitness, q, rng, generator)
        self.mutate_slots(plan.mutants, generator, magnitude)
        return reserved

    def inject(self, slot: int, parameters: Tensor) -> None:
        """Put the TD3 actor (1, K), with what it remembers, in place of ``slot``."""
        self.parameters[slot] = parameters[0]
        self.memory.copy(self.settings.population, slot)
        self.critical.copy(self.settings.population, slot)

    def _copy(self, source: int, slot: int) -> None:
        self.parameters[slot] = self.parameters[source]
        self.memory.copy(source, slot)
        self.critical.copy(source, slot)

    def _cross(
        self, plan: Plan, fitness: np.ndarray, q: Critic, rng: np.random.Generator, generator: torch.Generator
    ) -> None:
        """Fill the children's slots by distillation; a child remembers the latest half of both parents."""
        s = self.settings
        if not plan.children:
            return
        if s.pairing == "distance":
            states = self.memory.sample(plan.parents, s.pairing_batch, generator)
            distance = behavioural_distance(self.network, self.parameters[plan.parents], states)
            score = np.zeros((s.population, s.population))
            score[np.ix_(plan.parents, plan.parents)] = distance.cpu().numpy()
        else:
            score = fitness[:, None] + fitness
        pairs = pair(plan.parents, score, len(plan.children))
        if not pairs:
            return
        starts = [pairs[c][i] for c, i in enumerate(rng.integers(2, size=len(pairs)))]
        inherited = [
            torch.cat([self.memory.latest(x, s.memory // 2), self.memory.latest(y, s.memory // 2)]) for x, y in pairs
        ]
        first, second = zip(*pairs, strict=True)
        children = distil(
            self.network,
            self.parameters[list(first)],
            self.parameters[list(second)],
            self.parameters[starts],
            torch.nn.utils.rnn.pad_sequence(inherited, batch_first=True),
            torch.tensor([len(states) for states in inherited], device=self.parameters.device),
            q,
            generator,
            s.crossover_epochs,
            s.crossover_batch,
            s.crossover_learning_rate,
        )
        for child, slot, states in zip(children, plan.children, inherited, strict=True):
            self.parameters[slot] = child
            for memory in (self.memory, self.critical):
                memory.clear(slot)
            self.memory.add(slot, states)

    def mutate_slots(self, slots: list[int], generator: torch.Generator, magnitude: float | None = None) -> None:
        """Disturb the actors in ``slots`` with the operator of the settings (eq. 5 or 8) and ``magnitude``.

        magnitude: sigma_mut, the settings' when not given.
        """
        s = self.settings
        if not slots:
            return
        scaling = None
        if s.mutation != "gaussian":
            states = self.memory.sample(slots, s.mutation_batch, generator)
            if s.mutation == "safe":
                # Fewer critical states than a batch say too little about safety (thesis section 6.1).
                enough = self.critical.filled[slots] > s.mutation_batch
                critical = self.critical.sample(slots, s.mutation_batch, generator)
                states = torch.where(enough.to(states.device)[:, None, None], critical, states)
            scaling = sensitivity(self.network, self.parameters[slots], states)
        self.parameters[slots] = mutate(
            self.parameters[slots],
            s.mutation_magnitude if magnitude is None else magnitude,
            scaling,
            self.mask,
            s.sensitivity_floor,
            generator,
        )

    def state(self) -> dict[str, Tensor]:
        """Return what a checkpoint needs."""
        parts = {f"memory.{k}": v for k, v in self.memory.state().items()}
        parts |= {f"critical.{k}": v for k, v in self.critical.state().items()}
        return parts | {"parameters": self.parameters}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take up a checkpoint."""
        for name, part in (("memory.", self.memory), ("critical.", self.critical)):
            part.restore({k.removeprefix(name): v for k, v in state.items() if k.startswith(name)})
        self.parameters.copy_(state["parameters"])
