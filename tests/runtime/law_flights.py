"""Classical laws flown on the plant, for the tests of what they are told."""

import numpy as np

from runtime.laws.catalogue import load_settings
from sim_bridge.plant import NOMINAL, Plant
from task.reference import base_reference
from task.reward import terminated

ROWS = base_reference(40.0, 0.056)
SETTINGS = load_settings()


def flight(
    law,
    ticks,
    effect=lambda tick, sent: sent[-1],
    told=lambda tick, law: None,
    look=lambda *seen: None,
    hears=False,
    rows=ROWS,
):
    """Fly a law on the plant; ``effect``: what reaches the surfaces, ``hears``: and the law. Return the states."""
    plant = Plant()
    x = plant.reset(NOMINAL).copy()
    states, sent = [x], []
    for tick in range(ticks):
        told(tick, law)
        before = law.linear() if sent else None
        action = law.steer(x, rows[tick]).copy()
        look(tick, before, states, sent, action)
        sent.append(action)
        reached = effect(tick, sent)
        law.sent(reached if hears else action)
        x = plant.step(reached).copy()
        states.append(x)
        if terminated(x):
            break
    return np.array(states)


def reversed_elevator(tick, sent):
    return sent[-1] * [-1.0 if tick >= 500 else 1.0, 1.0, 1.0]


def reversed_by_now(tick, law):
    if tick >= 515:  # a filter needs some samples
        law.inform([-1.0, None, 1.0], tick < 700)
