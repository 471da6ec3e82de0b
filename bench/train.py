"""Training speed beside a straightforward loop in the published style, in one run: ``make bench-train``.

The straightforward loop is what one writes first: one actor as a torch module, one aircraft, a forward pass of
batch one a frame, a deque as memory, one sampled batch and one autograd update at a time. Same aircraft, same
networks, same equations, one thread.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable

import click
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import nn
from torch.nn import functional

from export.training.config import TD3Settings, TrainingConfig, load
from export.training.flights import Fleet, draw_references
from export.training.memory import Replay
from export.training.networks import actor_network, initialise
from export.training.td3 import TD3
from sim_bridge.plant import Plant
from task import results
from task.limits import DEFLECTION_LIMIT
from task.observation import observation
from task.reward import terminated, tracking_reward
from understudy import run

SEED = 0
TARGET = 20.0
"""Times faster a stored frame than the published style."""
PUBLISHED_FLIGHTS = 3
"""Flights of an actor in a generation of the published runs, of which one is stored."""


class PlainActor(nn.Module):
    """The thesis's actor as a module."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Linear(7, width), nn.Tanh()]
        for _ in range(hidden):
            layers += [nn.Linear(width, width), nn.LayerNorm(width), nn.Tanh()]
        self.net = nn.Sequential(*layers, nn.Linear(width, 3), nn.Tanh())

    def forward(self, s: torch.Tensor) -> torch.Tensor:
        """Return u (B, 3)."""
        return self.net(s)


class PlainCritic(nn.Module):
    """One critic as a module."""

    def __init__(self, settings: TD3Settings) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        inputs = 10
        for width in settings.critic_layers:
            norm = [nn.LayerNorm(width)] if settings.critic_layer_norm != "none" else []
            layers += [
                nn.Linear(inputs, width),
                *norm,
                nn.Tanh() if settings.critic_activation == "tanh" else nn.ReLU(),
            ]
            inputs = width
        self.net = nn.Sequential(*layers, nn.Linear(inputs, 1))

    def forward(self, s: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """Return Q (B, 1)."""
        return self.net(torch.cat([s, u], dim=1))


class PlainTD3:
    """Equations 1, 2, 3 and 15 with autograd, module by module, update by update."""

    def __init__(self, config: TrainingConfig) -> None:
        s = self.settings = config.td3
        shape = (config.actor.width, config.actor.hidden)
        self.actor, self.actor_target = PlainActor(*shape), PlainActor(*shape)
        self.critics = nn.ModuleList(PlainCritic(s) for _ in range(2))
        self.critics_target = nn.ModuleList(PlainCritic(s) for _ in range(2))
        self.actor_adam = torch.optim.Adam(self.actor.parameters(), lr=s.learning_rate)
        self.critic_adam = torch.optim.Adam(self.critics.parameters(), lr=s.learning_rate)
        self.memory: deque[tuple[np.ndarray, np.ndarray, float, np.ndarray, float]] = deque(maxlen=100_000)
        self.updates = 0

    def fly(self, plant: Plant, reference: np.ndarray) -> int:
        """Fly one flight, remember it, return its frames."""
        x = plant.reset()
        s = observation(x, reference[0]).astype(np.float32)
        for k in range(len(reference) - 1):
            with torch.no_grad():
                u = self.actor(torch.from_numpy(s)[None]).numpy().flatten()
            x = plant.step(DEFLECTION_LIMIT * u)
            following = observation(x, reference[k + 1]).astype(np.float32)
            lost = bool(terminated(x))
            self.memory.append((s, u, float(tracking_reward(following[:3])), following, float(lost)))
            s = following
            if lost:
                break
        return k + 1

    def update(self) -> None:
        """Take one update."""
        c = self.settings
        batch = random.sample(self.memory, c.batch)
        s, u, r, s_next, lost = (torch.as_tensor(np.array(part, dtype=np.float32)) for part in zip(*batch, strict=True))
        with torch.no_grad():
            noise = (c.sigma * torch.randn_like(u)).clamp(-c.noise_clip, c.noise_clip)
            u_next = (self.actor_target(s_next) + noise).clamp(-1.0, 1.0)
            q_next = torch.min(*(critic(s_next, u_next) for critic in self.critics_target))
            y = c.reward_scale * r[:, None] + c.gamma * (1.0 - lost[:, None]) * q_next
        loss = sum(functional.mse_loss(critic(s, u), y) for critic in self.critics)
        self.critic_adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.critics.parameters(), c.gradient_clip)
        self.critic_adam.step()
        self.updates += 1
        if self.updates % c.policy_delay:
            return
        u = self.actor(s)
        policy_loss = -self.critics[0](s, u).mean()
        if c.lambda_s > 0.0 or c.lambda_t > 0.0:
            near = functional.mse_loss(u, self.actor(s + c.caps_sigma * torch.randn_like(s)))
            policy_loss = policy_loss + c.reward_scale * c.lambda_s * near
            policy_loss = policy_loss + c.reward_scale * c.lambda_t * functional.mse_loss(u, self.actor(s_next))
        self.actor_adam.zero_grad()
        policy_loss.backward()
        nn.utils.clip_grad_norm_(self.actor.parameters(), c.gradient_clip)
        self.actor_adam.step()
        for target, source in ((self.actor_target, self.actor), (self.critics_target, self.critics)):
            for a, b in zip(target.parameters(), source.parameters(), strict=True):
                a.data.mul_(1.0 - c.tau).add_(c.tau * b.data)


def flown_per_stored(config: TrainingConfig) -> float:
    """Return how many frames are flown for each that is stored."""
    genetic, more = config.genetic, config.td3.exploring_flights
    flown = (genetic.population + 1) * genetic.evaluations + more
    stored = (round(genetic.stored_share * genetic.population) + 1) * genetic.stored_evaluations + more
    return flown / stored


def rate(work: Callable[[], int], seconds: float) -> float:
    """Return units of work a second: the best of five spells, as others share the machine."""
    work()
    best = 0.0
    for _ in range(5):
        done, began = 0, time.perf_counter()
        while time.perf_counter() - began < seconds / 5.0:
            done += work()
        best = max(best, done / (time.perf_counter() - began))
    return best


@click.command()
@click.option("--config", "name", default="serl50", show_default=True)
@click.option(
    "--seconds",
    type=click.FloatRange(0.1, 3600.0),
    default=20.0,
    show_default=True,
    help="Spent on each of the four measurements.",
)
def main(name: str, seconds: float) -> None:
    """Measure frames and updates a second, ours and in the published style; write results/bench_train.json."""
    torch.set_num_threads(1)
    torch.manual_seed(SEED)
    random.seed(SEED)
    began = time.perf_counter()
    config = load(name)
    generator = torch.Generator().manual_seed(SEED)
    network = actor_network(config.actor)
    fleet = Fleet()
    references = draw_references(
        np.random.default_rng(SEED), config.genetic.evaluations, 5.0, fleet.theta_trim, "training"
    )
    parameters = 0.1 * initialise(network, config.genetic.population + 1, generator).numpy()
    learner = TD3(network, config.td3, generator, torch.device("cpu"))
    replay = Replay(20_000, network.observation, network.action, torch.device("cpu"))
    replay.add(torch.randn(20_000, 19, generator=generator))
    plain, plant = PlainTD3(config), Plant()
    with torch.no_grad():
        for parameter in plain.actor.parameters():
            parameter.mul_(0.1)

    def our_flights() -> int:
        return int(fleet.fly(network, parameters, references).length.sum())

    def our_updates() -> int:
        before = learner.updates
        learner.learn(replay, 96, generator)
        return learner.updates - before

    def plain_update() -> int:
        plain.update()
        return 1

    plain.fly(plant, references[0])
    frames = rate(our_flights, seconds)
    plain_frames = rate(lambda: plain.fly(plant, references[0]), seconds)
    updates = rate(our_updates, seconds)
    plain_updates = rate(plain_update, seconds)

    ratio = config.td3.updates_per_frame
    flown = flown_per_stored(config)
    published = PUBLISHED_FLIGHTS / plain_frames + 1.0 / plain_updates
    same_work = PUBLISHED_FLIGHTS / frames + 1.0 / updates
    as_configured = flown / frames + ratio / updates
    table = results.Table(
        title=f"{config.name}, one thread",
        columns=["", "published style", "ours", "times"],
        rows=[
            ["frames simulated a second", round(plain_frames), round(frames), round(frames / plain_frames, 2)],
            ["critic updates a second", round(plain_updates), round(updates), round(updates / plain_updates, 2)],
            [
                f"a frame stored as published: {PUBLISHED_FLIGHTS} flown, 1 update, in us",
                round(1e6 * published),
                round(1e6 * same_work),
                round(published / same_work, 2),
            ],
            [
                f"a frame stored as configured: {flown:.2f} flown, {ratio:g} updates, in us",
                round(1e6 * published),
                round(1e6 * as_configured),
                round(published / as_configured, 2),
            ],
        ],
    )
    claims = [
        results.Claim(claim="frames simulated a second", value=round(frames), unit="1/s"),
        results.Claim(claim="critic updates a second", value=round(updates), unit="1/s"),
        results.Claim(
            claim="speed-up a stored frame over the published style, same work",
            value=round(published / same_work, 2),
            unit="x",
        ),
        results.Claim(
            claim="speed-up a stored frame over the published style, as configured",
            value=round(published / as_configured, 2),
            unit="x",
            target=f">= {TARGET:g}",
            holds=published / as_configured >= TARGET,
        ),
    ]
    results.write(
        "bench_train",
        results.Result(
            title="Training speed",
            command=f"python -m bench.train --config {name}",
            seconds=round(time.perf_counter() - began, 1),
            runs=5,
            seeds=[SEED],
            claims=claims,
            tables=[table],
            notes=[
                "Best of five spells each, one thread, on a machine shared with other work.",
                "'Same work': three frames flown and one critic update a frame stored, as published, on both sides;"
                " 'as configured': ours by the shipped configuration against the published work.",
                "Flights and updates on one thread, without breeding and without the overlap of the two on two cores.",
            ],
        ),
    )
    shown = Table(title=table.title)
    for column in table.columns:
        shown.add_column(column, justify="right")
    for row in table.rows:
        shown.add_row(*map(str, row))
    Console().print(shown)


if __name__ == "__main__":
    run(main)
