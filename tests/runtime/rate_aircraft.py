"""An aircraft that is the rate model itself, for the tests of what is found of its surfaces."""

import math

import numpy as np

from runtime.presets import PRESETS
from task.limits import DT
from task.rates import N_EFFECT, N_FEATURES, RateModel, dynamic_pressure, effect_terms, features
from task.state import N_IDENTIFIED, STATE

SETTINGS = PRESETS["structured"]
EFFECT = np.zeros((3, N_EFFECT, 3))
EFFECT[0, 0, 1], EFFECT[1, 0, 0], EFFECT[2, 0, 2] = -6e-3, -3.5e-3, -1e-3
DRIFT = np.zeros((N_FEATURES, 3))
DRIFT[[13, 14, 15], [0, 1, 2]] = -0.05, -0.03, -0.01
MODEL = RateModel(DRIFT, EFFECT)


def state(w=(0.0, 0.0, 0.0), V=90.0, alpha=0.05, beta=0.0, h=2000.0):
    x = np.zeros(N_IDENTIFIED)
    x[:3], x[STATE.V], x[STATE.alpha], x[STATE.beta], x[STATE.h] = w, V, alpha, beta, h
    return x


class Aircraft:
    """The rate model itself, with effectiveness and gyro noise to choose, driven by its own commands."""

    def __init__(self, seed=0, noise=0.0):
        self.rng, self.noise = np.random.default_rng(seed), noise
        self.w, self.effect, self.sent = np.zeros(3), np.ones(3), [np.zeros(3)]
        self.tick, self.delay, self.order = 0, 0, [0, 1, 2]
        self.attitude, self.stuck = np.zeros(3), {}
        self.rate, self.share, self.acting = np.inf, 1.0, np.zeros(3)
        self.swing, self.hz = np.zeros(3), 1.0
        self.low, self.high = np.full(3, -np.inf), np.full(3, np.inf)

    def read(self):
        x = state(
            self.w + self.noise * self.rng.standard_normal(3), alpha=0.05 + 1e-9 * self.tick, beta=1e-9 * self.tick
        )
        held = [i for i, value in self.stuck.items() if value is not None]
        x[held] = [self.stuck[i] for i in held]
        self.stuck.update({i: x[i] for i in self.stuck})
        x[STATE.phi], x[STATE.theta], x[STATE.psi] = self.attitude
        return x

    def step(self, u):
        """One sample: the command of before acts now (command lag 1), or an older one."""
        asked = self.sent[max(-1 - self.delay, -len(self.sent))][self.order]
        reach = self.rate * DT
        wanted = self.acting + self.share * (asked.clip(self.low, self.high) - self.acting)
        acting = self.acting = wanted.clip(self.acting - reach, self.acting + reach)
        qbar = dynamic_pressure(90.0, 2000.0)
        phi = np.array(features(*self.w, 90.0, 0.05, 0.0, 0.0, qbar))
        terms = np.array(effect_terms(90.0, 0.05, qbar))
        acceleration = phi @ DRIFT + np.einsum("t,jta,j->a", terms, EFFECT, self.effect * (acting + self.moved()))
        self.w = self.w + DT * acceleration
        p, q, r = self.w
        phi, theta, _ = self.attitude
        turning = q * np.sin(phi) + r * np.cos(phi)
        self.attitude = self.attitude + DT * np.array(
            [p + turning * np.tan(theta), q * np.cos(phi) - r * np.sin(phi), turning / np.cos(theta)]
        )
        self.sent = [*self.sent[-20:], u]
        self.tick += 1

    def moved(self):
        """What the surfaces add to their commands: an oscillation of amplitude ``swing`` (3,) [rad] and ``hz``."""
        return self.swing * math.sin(2.0 * math.pi * self.hz * self.tick * DT)

    def lag(self, hz):
        """Let every surface follow by a first-order lag of this corner frequency [Hz]."""
        self.share = 1.0 - math.exp(-2.0 * math.pi * hz * DT)

    def command(self):
        t = self.tick * DT
        wave = np.sin(2.0 * np.pi * np.array([0.5, 0.7, 0.9]) * t)
        return 0.03 * wave - np.array([0.02, 0.0, 0.0])


def watch(found, aircraft, samples):
    """Feed ``samples``; return the times of the alarms, in samples from now."""
    alarms = []
    for k in range(samples):
        found.observe(aircraft.read())
        if found.alarmed:
            alarms.append(k)
        u = aircraft.command()
        found.command(u)
        aircraft.step(u)
    return alarms
