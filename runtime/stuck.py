"""Which sensors read the same number while the aircraft moves: a dead sensor is no dead surface."""

from __future__ import annotations

import math

from task.state import STATE

SIGNALS = (STATE.p, STATE.q, STATE.r, STATE.alpha, STATE.beta)
"""What the rate model needs of the state and a sensor may stop to tell."""
MOTIONS = ((0, 2, 4), (1, 3))
"""Those that move together: roll, yaw and sideslip; pitch and angle of attack."""


class Stuck:
    """Signals whose reading has not changed by a bit for some samples, though by now it should have.

    What a signal should have moved since its reading stands still: a rate what the model says, angle of attack and
    sideslip what the rates alone turn the body by (q and p alpha - r). Real sensors never repeat a number, ideal ones
    only where nothing moves, coarse ones while less than a step is due. Where all signals of a motion stand still it is
    the aircraft that does, as in exactly symmetric flight.
    """

    SAME = 3
    """A reading must have repeated so often; an alarm opens the filters no sooner."""
    ANGLE_DUE = 5e-3
    """Turn of the body by which angle of attack and sideslip must be due to change [rad]."""
    NOISES = 5.0
    """A rate must be due to change by so many standard deviations of the sensors' noise."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self.reset()

    def reset(self) -> None:
        """Start a new flight: nothing is stuck. Over a gap what is stuck stays so."""
        self._last: tuple[float, ...] = (float("nan"),) * len(SIGNALS)
        self._forget()

    def _forget(self) -> None:
        """Begin to count anew: no reading repeats."""
        self._quiet = False
        self._same = [0] * len(SIGNALS)
        self._due = [0.0] * len(SIGNALS)
        self.signals = [False] * len(SIGNALS)
        """Whether p, q, r, alpha, beta are stuck."""
        self.any = False
        self.blind = False, False, False
        """Whether nothing can be told of the surfaces from roll, pitch and yaw: no rate, or no angle for the model."""

    @property
    def mask(self) -> int:
        """Return which are stuck as bits: 1 for p, 2 for q, 4 for r, 8 for alpha, 16 for beta."""
        return sum(stuck << i for i, stuck in enumerate(self.signals)) if self.any else 0

    def look(self, x: list[float], step: list[float], noise: float) -> bool:
        """Take a state; return whether another signal is stuck from now on.

        x: (>= 10,); step: by how much the model moved p, q, r to it (3,) [rad/s]; noise: the sensors' [rad/s].
        """
        p, q, r, _, alpha, beta = x[: STATE.beta + 1]
        readings = p, q, r, alpha, beta
        repeated = [now == before for now, before in zip(readings, self._last, strict=True)]
        self._last = readings
        if True not in repeated:  # nearly always
            if self._quiet:
                self._forget()
            return False
        self._quiet = True
        same = self._same
        enough = self.NOISES * noise
        moves = (*step, q * self._dt, (p * alpha - r) * self._dt)
        for i, (again, move) in enumerate(zip(repeated, moves, strict=True)):
            if again:
                same[i] += 1
                self._due[i] += move
            else:
                same[i], self._due[i], self.signals[i] = 0, 0.0, False
        found = False
        for motion in MOTIONS:
            if all(same[i] for i in motion):
                for i in motion:
                    self._due[i] = 0.0
            for i in motion:
                due = enough if i < len(step) else self.ANGLE_DUE
                if same[i] >= self.SAME and not self.signals[i] and abs(self._due[i]) > due:
                    self.signals[i] = found = True
        self.any = True in self.signals
        p, q, r, alpha, beta = self.signals
        self.blind = p or beta, q or alpha, r or beta
        return found


def turning(before: list[float], x: list[float], rates: list[float], dt: float) -> tuple[float, float, float]:
    """Return p, q, r [rad/s] as roll, pitch and yaw angle say that changed from one state (>= 10,) to the next.

    Each from its own angle's kinematics, with the filtered rates (3,) for the others.
    """
    _, q, r = rates
    phi, theta = x[STATE.phi], x[STATE.theta]
    sin_phi, cos_phi = math.sin(phi), math.cos(phi)
    cos_phi = math.copysign(max(abs(cos_phi), 0.1), cos_phi)
    phi_dot, theta_dot, psi_dot = (
        math.remainder(x[angle] - before[angle], 2.0 * math.pi) / dt for angle in (STATE.phi, STATE.theta, STATE.psi)
    )
    return (
        phi_dot - (q * sin_phi + r * cos_phi) * math.tan(theta),
        (theta_dot + r * sin_phi) / cos_phi,
        (psi_dot * math.cos(theta) - q * sin_phi) / cos_phi,
    )
