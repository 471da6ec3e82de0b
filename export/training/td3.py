"""Twin-delayed deep deterministic policy gradient with CAPS (thesis eqs 1-3 and 15).

u is the action in units of its bound, in [-1, 1]; observations are already multiplied by ``input_scale``.
"""

from __future__ import annotations

import torch
from torch import Tensor

from export.network import Network
from export.training.config import TD3Settings
from export.training.memory import Block, Replay
from export.training.networks import Stack, Trainable, critic_network, initialise, pieces

GROUPS = 32
"""Actor steps whose transitions and noise are drawn at once."""


def target_action(u: Tensor, noise: Tensor, clip: float) -> Tensor:
    """Return clip(mu_targ(s') + clip(noise, -c, c), -1, 1) (eq. 3)."""
    return (u + noise.clamp(-clip, clip)).clamp_(-1.0, 1.0)


def bellman_target(reward: Tensor, continues: Tensor, q_next: Tensor, gamma: float) -> Tensor:
    """Return y = r + gamma min_i Q_targ,i(s', u') (eq. 1), nothing beyond a lost flight.

    q_next: (2, B, 1) of the twin target critics, or (1, B, 1) of a single one; result (B, 1).
    """
    return reward + gamma * continues * q_next.amin(0)


def caps_loss(u: Tensor, u_near: Tensor, u_next: Tensor, lambda_s: float, lambda_t: float) -> Tensor:
    """Return lambda_S L_S + lambda_T L_T (eq. 15), as mean squares as in the published runs."""
    return lambda_s * (u - u_near).square().mean() + lambda_t * (u - u_next).square().mean()


def caps_gradient(u: Tensor, u_near: Tensor, u_next: Tensor, lambda_s: float, lambda_t: float) -> Tensor:
    """Return the gradient of :func:`caps_loss` with respect to [u, u_near, u_next], each (1, B, 3), in a row."""
    near = (u - u_near) * (2.0 * lambda_s / u.numel())
    following = (u - u_next) * (2.0 * lambda_t / u.numel())
    return torch.cat([near + following, -near, -following], 1)


class TD3:
    """The gradient learner: one actor, twin critics, their targets.

    With a single critic, no noise on the targets and no policy delay it is DDPG.
    """

    def __init__(
        self, network: Network, settings: TD3Settings, generator: torch.Generator, device: torch.device
    ) -> None:
        """Draw actor and critics from ``generator`` (on the CPU); learning draws from a stream of its own."""
        self.settings = settings
        critic = critic_network(network, settings)
        self.actor = Trainable(network, initialise(network, 1, generator).to(device), settings.learning_rate)
        critics = initialise(critic, 2 if settings.twin else 1, generator)
        self.critics = Trainable(critic, critics.to(device), settings.learning_rate)
        self.actor_target = self.actor.packed.clone()
        self.critics_target = self.critics.packed.clone()
        self._actor_target = Stack(network, pieces(network, self.actor_target))
        self._critics_target = Stack(critic, pieces(critic, self.critics_target))
        self._first_critic = Stack(critic, [piece[:1] for piece in pieces(critic, self.critics.packed)])
        self.input_scale = torch.tensor(network.input_scale, device=device)
        self.updates = 0

    def q(self, state: Tensor, u: Tensor) -> Tensor:
        """Return min_i Q_i(s, u), shape (..., B, 1), of the current critics."""
        flat = torch.cat([state, u], dim=-1).flatten(0, -2)
        return self.critics(flat).amin(0).view(*state.shape[:-1], 1)

    def learn(self, replay: Replay, updates: int, generator: torch.Generator) -> dict[str, float]:
        """Take ``updates`` critic steps, and one actor step for every ``policy_delay``; return mean losses.

        The targets move with the actor, so Bellman's target of all critic steps between two actor steps is
        one pass. Updates beyond a whole number of such groups are left out.
        """
        s = self.settings
        device = replay.rows.device
        td_sum, q_sum = torch.zeros((), device=device), torch.zeros((), device=device)
        groups = updates // s.policy_delay
        for start in range(0, groups, GROUPS):
            count = min(GROUPS, groups - start)
            block = replay.sample(count, s.policy_delay * s.batch, generator)
            noise = (s.sigma if s.target_noise else 0.0) * _normal(block.action, generator)
            near = s.caps_sigma * self.input_scale * _normal(block.state[:, : s.batch], generator)
            for i in range(count):
                group = Block(*(tensor[i] for tensor in block))
                y = self._targets(group, noise[i])
                for k in range(s.policy_delay):
                    rows = slice(k * s.batch, (k + 1) * s.batch)
                    td_sum += self._critic_step(group.state_action[rows], y[rows])
                q_sum += self._actor_step(group.state[rows], group.next_state[rows], near[i])
                self._follow()
        self.updates += groups * s.policy_delay
        return {"td_loss": float(td_sum) / max(groups * s.policy_delay, 1), "q": float(q_sum) / max(groups, 1)}

    def _targets(self, batch: Block, noise: Tensor) -> Tensor:
        """Return y of eq. 1, shape (B, 1), with clipped target actions (eq. 3)."""
        s = self.settings
        u = target_action(self._actor_target(batch.next_state)[0], noise, s.noise_clip)
        q = self._critics_target(torch.cat([batch.next_state, u], 1))
        return bellman_target(s.reward_scale * batch.reward, batch.continues, q, s.gamma)

    def _critic_step(self, state_action: Tensor, y: Tensor) -> Tensor:
        """Descend the sum of both critics' mean squared Bellman errors (eq. 1); return it."""
        error = self.critics(state_action) - y
        self.critics.backward(error * (2.0 / error.shape[1]))
        self.critics.step(self.settings.gradient_clip)
        return error.square().mean() * error.shape[0]

    def _actor_step(self, state: Tensor, next_state: Tensor, noise: Tensor) -> Tensor:
        """Ascend Q_1(s, mu(s)) (eq. 2, with the first critic as in TD3) less CAPS (eq. 15); return mean Q."""
        s = self.settings
        count, smooth = state.shape[0], s.lambda_s > 0.0 or s.lambda_t > 0.0
        u = self.actor(torch.cat([state, state + noise, next_state]) if smooth else state)
        q = self._first_critic(torch.cat([state, u[0, :count]], 1))
        to_q = self._first_critic.backward(torch.full_like(q, -1.0 / count), to_parameters=False, to_input=True)
        grad = to_q[..., state.shape[1] :]
        if smooth:
            weights = s.reward_scale * s.lambda_s, s.reward_scale * s.lambda_t
            caps = caps_gradient(u[:, :count], u[:, count : 2 * count], u[:, 2 * count :], *weights)
            caps[:, :count] += grad
            grad = caps
        self.actor.backward(grad)
        self.actor.step(s.gradient_clip)
        return q.mean()

    def _follow(self) -> None:
        """Let the targets follow by Polyak averaging."""
        self.actor_target.lerp_(self.actor.packed, self.settings.tau)
        self.critics_target.lerp_(self.critics.packed, self.settings.tau)

    def state(self) -> dict[str, Tensor]:
        """Return what a checkpoint needs."""
        parts = {f"actor.{k}": v for k, v in self.actor.state().items()}
        parts |= {f"critics.{k}": v for k, v in self.critics.state().items()}
        return parts | {
            "actor_target": self.actor_target,
            "critics_target": self.critics_target,
            "updates": torch.tensor(self.updates),
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take up a checkpoint."""
        for name, part in (("actor.", self.actor), ("critics.", self.critics)):
            part.restore({k.removeprefix(name): v for k, v in state.items() if k.startswith(name)})
        self.actor_target.copy_(state["actor_target"])
        self.critics_target.copy_(state["critics_target"])
        self.updates = int(state["updates"])


def _normal(like: Tensor, generator: torch.Generator) -> Tensor:
    return torch.randn(like.shape, generator=generator, device=like.device)
