"""Networks and classical laws in one cast: all laws are kept up to date, and who flies is the cast's affair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from runtime.advice import highest_alpha, sure_signs
from runtime.identification import IncrementalModel
from runtime.laws.law import Law
from runtime.population import BehaviouralPolicy
from runtime.stuck import SIGNALS
from runtime.switching import Cast
from task.actuators import ACTUATOR
from task.laws import LinearLaw
from task.state import N_ACTION, STATE


class Ensemble:
    """A :class:`runtime.policy.Policy`: the live network and the laws, of which one flies.

    Every law sees every state and every command that was sent, so that its filters and estimates are right when its
    turn comes. Parameters of a law cannot be averaged with a network's: a soft change is one of actions,

        u = u_new + (1 - rho)^k (u_sent - u_new)[at the moment of the change],

    k samples after it, so that no command steps; it needs nobody but the one that flies from then on.
    """

    def __init__(self, network: BehaviouralPolicy, laws: Sequence[Law], cast: Cast, model: IncrementalModel) -> None:
        self._network, self._laws, self._cast, self._model = network, tuple(laws), cast, model
        self.parameters = network.parameters
        self._actions = [np.zeros(N_ACTION) for _ in laws]
        self._foretold = 0
        """How far ahead the states are that the laws see [samples]."""
        self._sent, self._offset, self._action = np.zeros(N_ACTION), np.zeros(N_ACTION), np.zeros(N_ACTION)

    def reset(self) -> None:
        """Start a new flight."""
        self._sent[:], self._foretold = 0.0, 0
        for law in self._laws:
            law.reset()

    def restart_history(self) -> None:
        """Forget the last samples, not what the laws have learnt."""
        for law in self._laws:
            law.restart_history()

    def linear(self) -> list[LinearLaw]:
        """Return how each law goes on from the last state."""
        return [law.linear() for law in self._laws]

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] of whoever flies."""
        self._tell()
        for law, action in zip(self._laws, self._actions, strict=True):
            np.copyto(action, law.steer(x, reference))
        law_number = self._cast.law
        wanted = self._network.steer(x, reference) if law_number is None else self._actions[law_number]
        np.copyto(self._action, wanted)
        if self._cast.handing_over:
            if self._cast.taken:
                np.subtract(self._sent, self._action, out=self._offset)
                self._cast.taken = False
            self._action += self._cast.blend * self._offset
        return self._action

    def _tell(self) -> None:
        """Tell the laws what is believed of their commands, where surfaces end and which of them are reversed."""
        found = self._model.effectiveness
        if found is None:
            return
        believed = found.hypotheses[found.evidence.believed]
        low, high = found.actuators[[ACTUATOR.low, ACTUATOR.high]].tolist()
        sure, news = sure_signs(found, low, high), found.searching or found.slow
        highest = highest_alpha(found, self._model.settings.elevator_reserve)
        seen = not found.stuck.signals[SIGNALS.index(STATE.alpha)]
        before, self._foretold = self._foretold, self._model.foretold
        for law in self._laws:
            if self._foretold != before:  # what it saw last was another moment
                law.restart_history()
            law.match(believed.delay - self._foretold, believed.order, believed.rate)
            law.limit_alpha(highest, seen)
            law.limit_range(low, high)
            law.inform(sure, news)

    def sent(self, command: np.ndarray) -> None:
        """Take what was sent; a law is told what of it is believed to act."""
        np.copyto(self._sent, command)
        found = self._model.effectiveness
        acts = command if found is None else found.followed()[-1]
        for law in self._laws:
            law.sent(acts)
