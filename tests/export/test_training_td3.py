"""TD3 against a direct transcription with autograd, module by module as a textbook writes it."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from export.network import Network
from export.training.config import ActorSettings, TD3Settings
from export.training.memory import Replay
from export.training.networks import actor_network, critic_network, unpack, views
from export.training.td3 import GROUPS, TD3, bellman_target, caps_gradient, caps_loss, target_action

CPU = torch.device("cpu")
SCALE = (8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0)


def settings(**changes: object) -> TD3Settings:
    base = {"batch": 6, "critic_layers": (8, 5), "buffer": 64, "learning_rate": 1e-2, "tau": 0.1}
    return TD3Settings(**(base | changes))


def filled(count: int = 64) -> Replay:
    replay = Replay(64, 7, 3, CPU)
    rows = torch.randn(count, 19, generator=torch.Generator().manual_seed(5))
    rows[:, 7:10].clamp_(-1.0, 1.0)
    rows[:, -1] = (rows[:, -1] > -1.0).float()
    replay.add(rows)
    return replay


def net(network: Network, tensors: list[torch.Tensor], x: torch.Tensor) -> torch.Tensor:
    parts = iter(tensors)
    for layer in network.layers:
        x = functional.linear(x, next(parts), next(parts))
        if layer.layer_norm == "standard":
            x = functional.layer_norm(x, (layer.units,), next(parts), next(parts), 1e-5)
        x = {"tanh": torch.tanh, "relu": torch.relu, "linear": lambda z: z}[layer.activation](x)
    return x


class Transcription:
    """Equations 1, 2, 3 and 15, one network at a time."""

    def __init__(self, learner: TD3, s: TD3Settings) -> None:
        self.s, self.actor_shape, self.critic_shape = s, learner.actor.network, learner.critics.network
        self.actor = [t[0].clone().requires_grad_() for t in views(self.actor_shape, learner.actor.parameters())]
        critics = views(self.critic_shape, learner.critics.parameters())
        self.critics = [[t[i].clone().requires_grad_() for t in critics] for i in range(2)]
        self.actor_target = [t.detach().clone() for t in self.actor]
        self.critics_target = [[t.detach().clone() for t in critic] for critic in self.critics]
        self.actor_adam = torch.optim.Adam(self.actor, lr=s.learning_rate)
        self.critic_adam = torch.optim.Adam([t for c in self.critics for t in c], lr=s.learning_rate)

    def critic_step(self, s, u, r, s_next, continues, noise) -> None:
        with torch.no_grad():
            noise = noise.clamp(-self.s.noise_clip, self.s.noise_clip)
            u_next = (net(self.actor_shape, self.actor_target, s_next) + noise).clamp(-1.0, 1.0)
            q = [net(self.critic_shape, c, torch.cat([s_next, u_next], 1)) for c in self.critics_target]
            y = r + self.s.gamma * continues * torch.min(*q)
        loss = sum(functional.mse_loss(net(self.critic_shape, c, torch.cat([s, u], 1)), y) for c in self.critics)
        self.critic_adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_([t for c in self.critics for t in c], self.s.gradient_clip)
        self.critic_adam.step()

    def actor_step(self, s, s_next, near) -> None:
        u = net(self.actor_shape, self.actor, s)
        loss = -net(self.critic_shape, self.critics[0], torch.cat([s, u], 1)).mean()
        loss = loss + self.s.lambda_s * functional.mse_loss(u, net(self.actor_shape, self.actor, near))
        loss = loss + self.s.lambda_t * functional.mse_loss(u, net(self.actor_shape, self.actor, s_next))
        self.actor_adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.actor, self.s.gradient_clip)
        self.actor_adam.step()
        pairs = [*zip(self.actor_target, self.actor, strict=True)]
        for target, critic in zip(self.critics_target, self.critics, strict=True):
            pairs += zip(target, critic, strict=True)
        for target, value in pairs:
            target.mul_(1.0 - self.s.tau).add_(self.s.tau * value.detach())


@pytest.mark.parametrize("clip", [10.0, 0.05])
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_learning_equals_the_transcription(activation: str, clip: float) -> None:
    s = settings(critic_activation=activation, gradient_clip=clip)
    network = actor_network(ActorSettings(width=9, hidden=1, input_scale=SCALE))
    learner = TD3(network, s, torch.Generator().manual_seed(0), CPU)
    slow = Transcription(learner, s)
    replay = filled()
    groups = 4
    learner.learn(replay, groups * s.policy_delay, torch.Generator().manual_seed(9))

    same = torch.Generator().manual_seed(9)
    block = replay.sample(groups, s.policy_delay * s.batch, same)
    noise = s.sigma * torch.randn(block.action.shape, generator=same)
    near = torch.randn((groups, s.batch, 7), generator=same) * s.caps_sigma * torch.tensor(SCALE)
    for i in range(groups):
        for k in range(s.policy_delay):
            rows = slice(k * s.batch, (k + 1) * s.batch)
            batch = [t[i, rows] for t in (block.state, block.action, block.reward, block.next_state, block.continues)]
            slow.critic_step(*batch, noise[i, rows])
        slow.actor_step(batch[0], batch[3], batch[0] + near[i])

    for got, expected in zip(views(network, learner.actor.parameters()), slow.actor, strict=True):
        torch.testing.assert_close(got[0], expected.detach(), rtol=2e-3, atol=2e-4)
    critic = critic_network(network, s)
    for i in range(2):
        for got, expected in zip(views(critic, learner.critics.parameters()), slow.critics[i], strict=True):
            torch.testing.assert_close(got[i], expected.detach(), rtol=2e-3, atol=2e-4)
        followed = views(critic, unpack(critic, learner.critics_target))
        for got, expected in zip(followed, slow.critics_target[i], strict=True):
            torch.testing.assert_close(got[i], expected, rtol=2e-3, atol=2e-4)


def test_target_action_clips_noise_then_action() -> None:
    u = torch.tensor([[0.9, -0.9, 0.0]])
    noise = torch.tensor([[2.0, 0.1, -2.0]])
    torch.testing.assert_close(target_action(u, noise, 0.5), torch.tensor([[1.0, -0.8, -0.5]]))


def test_bellman_target_takes_the_lesser_critic_and_stops_at_a_loss() -> None:
    q = torch.tensor([[[3.0], [5.0]], [[4.0], [1.0]]])
    y = bellman_target(torch.tensor([[1.0], [1.0]]), torch.tensor([[1.0], [0.0]]), q, 0.5)
    torch.testing.assert_close(y, torch.tensor([[2.5], [1.0]]))


def test_caps_gradient_is_that_of_the_loss() -> None:
    u = torch.randn(1, 12, 3, generator=torch.Generator().manual_seed(1)).double().requires_grad_()
    caps_loss(u[:, :4], u[:, 4:8], u[:, 8:], 0.5, 0.1).backward()
    with torch.no_grad():
        got = caps_gradient(u[:, :4], u[:, 4:8], u[:, 8:], 0.5, 0.1)
    torch.testing.assert_close(got, u.grad)


def test_learning_without_caps_is_learning_with_zero_weights() -> None:
    network = actor_network(ActorSettings(width=9, hidden=1))
    learners = []
    for changes in ({"lambda_s": 0.0, "lambda_t": 0.0}, {"lambda_s": 1e-12, "lambda_t": 0.0}):
        learner = TD3(network, settings(**changes), torch.Generator().manual_seed(0), CPU)
        learner.learn(filled(), 12, torch.Generator().manual_seed(1))
        learners.append(learner.actor.parameters())
    torch.testing.assert_close(*learners, rtol=1e-4, atol=1e-5)


def test_learns_a_one_step_task() -> None:
    """Reward -|u - target|^2 without a future: the actor must find the target."""
    s = settings(batch=64, sigma=0.0, lambda_s=0.0, lambda_t=0.0, learning_rate=3e-3, critic_layers=(32, 32))
    network = actor_network(ActorSettings(width=16, hidden=1))
    learner = TD3(network, s, torch.Generator().manual_seed(0), CPU)
    generator = torch.Generator().manual_seed(2)
    state = 0.5 * torch.randn(4096, 7, generator=generator)
    u = torch.rand(4096, 3, generator=generator) * 2.0 - 1.0
    goal = torch.tensor([0.3, -0.4, 0.1])
    reward = -(u - goal).square().sum(1, keepdim=True)
    replay = Replay(4096, 7, 3, CPU)
    replay.add(torch.cat([state, u, reward, state, torch.zeros(4096, 1)], 1))
    learner.learn(replay, 1500, generator)
    assert (learner.actor(state[:256])[0] - goal).abs().max() < 0.15


def test_counts_updates_in_whole_groups() -> None:
    network = actor_network(ActorSettings(width=4, hidden=1))
    learner = TD3(network, settings(), torch.Generator().manual_seed(0), CPU)
    learner.learn(filled(), 3 * (GROUPS + 1) + 2, torch.Generator().manual_seed(1))
    assert learner.updates == 3 * (GROUPS + 1)


def test_state_restores_bit_for_bit() -> None:
    network = actor_network(ActorSettings(width=4, hidden=1))
    first = TD3(network, settings(), torch.Generator().manual_seed(0), CPU)
    first.learn(filled(), 6, torch.Generator().manual_seed(1))
    second = TD3(network, settings(), torch.Generator().manual_seed(8), CPU)
    second.restore({k: v.clone() for k, v in first.state().items()})
    for learner in (first, second):
        learner.learn(filled(), 6, torch.Generator().manual_seed(2))
    for name, value in first.state().items():
        assert torch.equal(value, second.state()[name]), name
