"""Incremental nonlinear dynamic inversion, with a fixed effectiveness or one that is found in flight."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from runtime.hypotheses import STRAIGHT
from runtime.laws.effectiveness import MOTIONS, Effectiveness
from runtime.laws.law import Airframe, Law, Positive, Row
from runtime.laws.pace import Pace
from runtime.laws.slip import BankHold
from runtime.lowpass import LowPass
from task.config import Settings
from task.laws import N_MEMORY, N_SEEN, SEEN, LinearLaw
from task.limits import ACTION_HIGH, ACTION_LOW, DEFLECTION_LIMIT, DT
from task.state import ACTION, N_ACTION, REFERENCE, STATE

_MOTION = [int(i) for i in (STATE.p, STATE.q, STATE.r, STATE.alpha, STATE.beta)]
MAX_DELAY = 20
"""Longest delay that the law can be matched to [samples]."""
_Q, _R, _ALPHA, _BETA = 1, 2, 3, 4
"""Places of alpha and beta among the filtered signals; p, q, r come first, the commands last."""


_ONE, _X, _DX, _ACTED, _ASKED, _RATE = (
    N_MEMORY + part.start for part in (SEEN.one, SEEN.x, SEEN.dx, SEEN.acted, SEEN.reference, SEEN.rate)
)
"""Columns of the linear law's maps: where each part of what is seen begins."""


class INDIGains(Settings, frozen=True, kw_only=True):
    """Gains of the two outer loops, and the filter of the inner one."""

    attitude: Row
    """Rate asked for over error, of theta, phi and beta [1/s]."""
    rate: Row
    """Angular acceleration asked for over error, of p, q and r [1/s]."""
    cutoff: Positive
    """Of the second-order low-pass on rates, alpha, beta and commands alike [Hz]."""


class INDI(Law):
    """Attitude -> rate -> angular acceleration -> increment of the deflections.

    The rates asked for, of theta and phi by exact kinematics and of beta with the side force as it is measured:

        theta_dot = d(theta_ref)/dt + k e    q = (theta_dot + r sin phi) / cos phi
        phi_dot   = d(phi_ref)/dt + k e      p = phi_dot - (q sin phi + r cos phi) tan theta
        beta_dot  = d(beta_ref)/dt + k e     r = (beta_dot_f + r_f cos alpha - beta_dot) / cos alpha

    and from them, with index f for low-passed and B the effectiveness at the actual dynamic pressure:

        u = u_f + B^-1 (k_rate ((p, q, r) - omega) - omega_dot_f)

    omega_dot_f spans the last two states, which the command two samples back moved (the link's command lag): u_f is
    delayed and filtered alike, so that the two belong together. ``estimate`` replaces the columns of B by multiples of
    the nominal ones that are found in flight; without it B is fixed.

    A member of a cast is told what becomes of its commands (:meth:`match`): then u_f is the older command that acts, of
    the surface that it moves, and the loops ask for no more than that lets them (:mod:`runtime.laws.pace`). And it is
    told when a surface works the other way round (:meth:`inform`), until it has found that out itself. It is told how
    high an angle of attack the elevator can hold (:meth:`limit_alpha`), and asks for no pitch rate that would go beyond
    it, or beyond the one that it is made with:

        q <= q_f - alpha_dot_f + PROTECTION (alpha_highest - alpha)

    And it is told where surfaces end (:meth:`limit_range`), so that the others make up for what is not done.

    With a ``bank_error_limit`` the rudder rolls, by sideslip, when the aileron is at its end and bank is further than
    that from its reference (:mod:`runtime.laws.slip`).
    """

    LEAST, MOST = 0.1, 5.0
    """Bounds of the magnitude that is believed when told [-]: the law divides by it."""
    SLIP = 1.0
    """Largest gain of the sideslip loop while it rolls [1/s]: before the sideslip comes, the rudder rolls the other
    way."""
    ROOM = math.radians(0.5)
    """An aileron with less of its range left is at its end [rad]."""
    PROTECTION = 2.0
    """Approach of the highest angle of attack over what is left to it [1/s]."""

    def __init__(
        self,
        airframe: Airframe,
        gains: INDIGains,
        estimate: Effectiveness | None,
        name: str = "indi",
        dt: float = DT,
        alpha_limit: float = math.inf,
        bank_error_limit: float = math.inf,
    ) -> None:
        """alpha_limit: angle of attack that is never asked for; bank_error_limit: what sideslip rolls back to [rad]."""
        super().__init__(airframe, dt)
        self.name = name
        self.estimate = estimate
        self._gains = gains
        B = np.array(airframe.effectiveness)
        self._inverse = np.linalg.inv(B).tolist()
        self._without_rudder = np.linalg.inv(B[: ACTION.dr, : ACTION.dr]) @ np.eye(ACTION.dr, N_ACTION)
        """Elevator and aileron (2, 3) for p and q, where the rudder adds nothing."""
        n = len(_MOTION) + N_ACTION
        self._filter = LowPass(gains.cutoff, dt, n)
        self._start = np.zeros(n)
        self._signal, self._last, self._moved = np.zeros(n), np.zeros(n), np.zeros(n)
        self._moved_before = np.zeros(n)
        self._acceleration, self._acceleration_before = np.zeros(3), np.zeros(3)
        self._before_first, self._before_second = np.zeros(n), np.zeros(n)
        self._commands = [np.zeros(N_ACTION) for _ in range(3 + MAX_DELAY)]
        self._delay, self._order, self._rate = 0, STRAIGHT, math.inf
        self._pace = Pace(gains.attitude, gains.rate, dt)
        self._ratio, self._cos_alpha, self._cos_phi = 1.0, 1.0, 1.0
        self._commanded = False
        self._told: list[float | None] = [None] * N_ACTION
        """Effectiveness over nominal, where the law goes by what it was told [-]."""
        self._sure = [1.0] * N_ACTION
        """What was last known for sure of it [-]."""
        self._highest = self._alpha_limit = alpha_limit
        self._bank = BankHold(bank_error_limit, dt) if bank_error_limit < math.inf else None
        self._low: Sequence[float] = ACTION_LOW.tolist()
        self._high: Sequence[float] = ACTION_HIGH.tolist()
        """Least and greatest deflection that each surface is believed to reach [rad]."""
        self._samples = 0

    def reset(self) -> None:
        """Start a new flight: trim, nothing learnt."""
        super().reset()
        self._commanded = False
        self._told, self._sure = [None] * N_ACTION, [1.0] * N_ACTION
        if self._bank is not None:
            self._bank.reset()
        self._highest, self._rate = self._alpha_limit, math.inf
        self._low, self._high = ACTION_LOW.tolist(), ACTION_HIGH.tolist()
        self._delay, self._order = 0, STRAIGHT
        self._pace.reset()
        if self.estimate is not None:
            self.estimate.reset()

    def restart_history(self) -> None:
        """Forget the last samples; the filter starts again from the next."""
        super().restart_history()
        self._samples = 0

    def sent(self, command: np.ndarray) -> None:
        """Take what was sent: the next increment starts from it."""
        oldest = self._commands.pop(0)
        np.copyto(oldest, command)
        self._commands.append(oldest)
        self._commanded = True

    def match(self, delay: int, order: tuple[int, int, int], rate: float = math.inf) -> None:
        """Take how late the commands act beyond the link's lag [samples], whose acts on which surface, and how fast."""
        delay = min(delay, MAX_DELAY)
        if (delay, order, rate) == (self._delay, self._order, self._rate):
            self._pace.follow(self._action.tolist(), self._commands[-1].tolist())
            return
        if order != self._order or rate != self._rate:  # what was learnt was learnt from what did not act
            self._samples = 0
            if self.estimate is not None:
                self.estimate.reset()
        self._delay, self._order, self._rate = delay, order, rate
        self._pace.match(delay, rate)

    def inform(self, sure: Sequence[float | None], news: bool) -> None:
        """Take what is known for sure of the surfaces; it counts where its sign is not the one that the law finds.

        While there is news, or since the surface was last sure to be the other way round, until the two agree or nobody
        is sure any more. Else the law is left to what it found itself: a surface that stands still is known for sure as
        it was.
        """
        for surface, (found, own) in enumerate(zip(sure, self._own, strict=True)):
            told = None
            if found is not None:
                turned = found * self._sure[surface] < 0.0
                self._sure[surface] = found
                if found * own < 0.0 and (news or turned or self._told[surface] is not None):
                    told = found
            self._told[surface] = told

    def limit_alpha(self, highest: float, seen: bool) -> None:
        """Take the highest angle of attack that the elevator can hold [rad], infinite for any.

        An angle of attack that cannot be believed limits nothing: where it stands still above the limit, the nose would
        be lowered without end.
        """
        self._highest = min(highest, self._alpha_limit) if seen else math.inf

    def limit_range(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Take least and greatest deflection of each surface (3,) [rad], as they are believed.

        Surfaces are asked for as much as ever, or nobody would learn of a range that comes back; but the others make up
        for what they really do.
        """
        self._low, self._high = low, high

    @property
    def _own(self) -> list[float]:
        """Effectiveness over nominal as the law found it (3,) [-]."""
        return [1.0] * N_ACTION if self.estimate is None else self.estimate.multipliers

    @property
    def _multipliers(self) -> list[float]:
        """Effectiveness over nominal that the law goes by (3,) [-]."""
        return [
            own if told is None else math.copysign(min(max(abs(told), self.LEAST), self.MOST), told)
            for own, told in zip(self._own, self._told, strict=True)
        ]

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad], within the limits of the task."""
        now, asked = x.tolist(), reference.tolist()
        ratio = self._ratio = self.pressure_ratio(now)
        wanted = self.reference_rates(asked)
        if self._samples == 0:
            return self._begin(x, ratio)
        self._measure(x, ratio)
        p, q, r, phi, theta = now[STATE.p], now[STATE.q], now[STATE.r], now[STATE.phi], now[STATE.theta]
        sin_phi, cos_phi = math.sin(phi), math.cos(phi)
        cos_alpha = math.cos(now[STATE.alpha])
        self._cos_alpha, self._cos_phi = cos_alpha, math.copysign(max(abs(cos_phi), 0.1), cos_phi)
        k_theta, k_phi, k_beta = self._pace.attitude
        turn = (q * sin_phi + r * cos_phi) * math.tan(theta)
        theta_rate = wanted[REFERENCE.theta] + k_theta * (asked[REFERENCE.theta] - theta)
        phi_rate = wanted[REFERENCE.phi] + k_phi * (asked[REFERENCE.phi] - phi)
        slip = self._slip(asked[REFERENCE.phi] - phi, turn, p, asked[REFERENCE.beta])
        if self._bank is not None and (slip != 0.0 or self._bank.closed):
            k_beta = min(k_beta, self.SLIP)
        beta_rate = wanted[REFERENCE.beta] + k_beta * (asked[REFERENCE.beta] + slip - now[STATE.beta])
        side = self._moved[_BETA] / self._dt + (self._signal[STATE.r] + self._start[STATE.r]) * cos_alpha
        rates = (
            phi_rate - turn,
            (theta_rate + r * sin_phi) / self._cos_phi,
            (side - beta_rate) / cos_alpha,
        )
        if self._highest < math.inf:
            p_wanted, q_wanted, r_wanted = rates
            turning = self._signal.item(_Q) + self._start.item(_Q) - self._moved.item(_ALPHA) / self._dt
            rates = p_wanted, min(q_wanted, turning + self.PROTECTION * (self._highest - now[STATE.alpha])), r_wanted
        missing = [
            k * (rate - measured) - acceleration
            for k, rate, measured, acceleration in zip(
                self._pace.rate, rates, (p, q, r), self._acceleration.tolist(), strict=True
            )
        ]
        self._allocate(missing, ratio)
        return self._action

    def _slip(self, error: float, turn: float, p: float, reference: float) -> float:
        """Return the sideslip, beyond its reference, that rolls where the aileron does not [rad]."""
        if self._bank is None:
            return 0.0
        u = self._action.item(self._order[ACTION.da])
        low, high = max(self._low[ACTION.da], -DEFLECTION_LIMIT), min(self._high[ACTION.da], DEFLECTION_LIMIT)
        at = min(max(u, low), high)
        down, up = at - low > self.ROOM, high - at > self.ROOM
        rolls_right = self._airframe.effectiveness[0][ACTION.da] * self._multipliers[ACTION.da] > 0.0
        right, left = (up, down) if rolls_right else (down, up)
        beta = self._start.item(_BETA) + self._signal.item(_BETA) - reference
        effect = self._airframe.dihedral * self._ratio
        return self._bank.sideslip(error, turn, p, self._acceleration.item(0), beta, effect, right, left)

    def _allocate(self, missing: list[float], ratio: float) -> None:
        """Set the action that makes up for the missing acceleration (3,) [rad/s2].

        The rudder comes first, and what its limit takes away is not asked of elevator and aileron: a jammed rudder then
        costs sideslip, and not bank as well. Where one of those is at its limit, the rudder is asked anew, for the yaw
        that is missing with what they really do: its part in a roll that does not come would be sideslip.
        """
        multipliers = self._multipliers
        B, row = self._airframe.effectiveness, self._inverse[ACTION.dr]
        rudder = self._limited(
            ACTION.dr, row[0] * missing[0] + row[1] * missing[1] + row[2] * missing[2], ratio, multipliers
        )
        roll, pitch = missing[0] - B[0][ACTION.dr] * rudder, missing[1] - B[1][ACTION.dr] * rudder
        (a, b), (c, d) = B[0][: ACTION.dr], B[1][: ACTION.dr]
        determinant = a * d - b * c
        elevator = self._limited(ACTION.de, (d * roll - b * pitch) / determinant, ratio, multipliers)
        aileron = self._limited(ACTION.da, (a * pitch - c * roll) / determinant, ratio, multipliers)
        if self._ends(ACTION.da) or self._ends(ACTION.de):
            yaw = missing[2] - B[2][ACTION.de] * elevator - B[2][ACTION.da] * aileron
            self._limited(ACTION.dr, yaw / B[2][ACTION.dr], ratio, multipliers)

    def _limited(self, surface: int, increment: float, ratio: float, multipliers: list[float]) -> float:
        """Move a surface by what equals an increment [rad] at nominal effect; return what of it is done."""
        scale = ratio * multipliers[surface]
        now = float(self._start[MOTIONS + surface] + self._signal[MOTIONS + surface])
        u = min(max(now + increment / scale, -DEFLECTION_LIMIT), DEFLECTION_LIMIT)
        self._action[self._order[surface]] = u
        return (min(max(u, self._low[surface]), self._high[surface]) - now) * scale

    def _ends(self, surface: int) -> bool:
        """Return whether a surface is asked for all that it can do, or for more."""
        u = self._action[self._order[surface]]
        return not max(self._low[surface], -DEFLECTION_LIMIT) < u < min(self._high[surface], DEFLECTION_LIMIT)

    def _begin(self, x: np.ndarray, ratio: float) -> np.ndarray:
        """Start the filter at a state, and return the command that goes on: the last one, or trim."""
        if not self._commanded:
            for command in self._commands:
                command[:] = self.trim(ratio), 0.0, 0.0
        for command in self._commands[:-1]:
            np.copyto(command, self._commands[-1])
        np.take(x, _MOTION, out=self._start[:MOTIONS])
        np.take(self._commands[-1], self._order, out=self._start[MOTIONS:])
        for signal in (self._last, self._moved, self._acceleration):
            signal[:] = 0.0
        self._filter.reset()
        self._samples = 1
        np.copyto(self._action, self._commands[-1])
        return self._action

    def _measure(self, x: np.ndarray, ratio: float) -> None:
        """Filter what was measured and what was sent, difference it, and learn from it."""
        np.copyto(self._moved_before, self._moved)
        np.copyto(self._acceleration_before, self._acceleration)
        np.take(x, _MOTION, out=self._signal[:MOTIONS])
        np.take(self._commands[-2 - self._delay], self._order, out=self._signal[MOTIONS:])
        np.subtract(self._signal, self._start, out=self._signal)
        np.copyto(self._before_first, self._filter.first)
        np.copyto(self._before_second, self._filter.second)
        self._filter.filter(self._signal)
        np.subtract(self._signal, self._last, out=self._moved)
        np.copyto(self._last, self._signal)
        np.divide(self._moved[:3], self._dt, out=self._acceleration)
        self._samples += 1
        if self.estimate is not None and self._samples > 3:
            np.subtract(self._acceleration, self._acceleration_before, out=self._acceleration_before)
            self.estimate.update(self._moved_before[:MOTIONS], self._moved[MOTIONS:], ratio, self._acceleration_before)

    def linear(self) -> LinearLaw:
        """Return the law with its filters as memory; highest angle of attack and rolling by sideslip are not seen.

        A surface that is at its end now stays there; limits that are reached later make nobody else do more.

        Of the two filtered signals, B^-1 omega_dot - u of each surface and beta_dot + r cos alpha, the memory holds the
        low-pass's two states. Bank and pitch rates, of which the law forms its errors, are those of the attitude:
        phi_dot_ref - phi_dot is p_ref - p, theta_dot_ref - theta_dot is cos phi (q_ref - q).
        """
        maps, memory = np.zeros((N_ACTION + N_MEMORY, N_MEMORY + N_SEEN)), np.zeros(N_MEMORY)
        order, rows = list(self._order), np.arange(3)
        if self._samples == 0:  # the filters start again: until then the last command goes on
            maps[rows, _ONE] = self._commands[-1]
            return LinearLaw(maps, memory)
        inverse = self._inverse_as_imagined()
        first = (self._filter.first - self._before_first) / self._dt
        second = (self._filter.second - self._before_second) / self._dt
        memory[:3] = inverse @ first[:3] - self._filter.first[MOTIONS:]
        memory[3:6] = inverse @ second[:3] - self._filter.second[MOTIONS:]
        memory[6] = first[_BETA] + self._cos_alpha * self._filter.first[_R]
        memory[7] = second[_BETA] + self._cos_alpha * self._filter.second[_R]

        heard = self._heard(inverse)
        remembered = np.eye(N_MEMORY, N_MEMORY + N_SEEN)
        was, older = remembered[[0, 1, 2, 6]], remembered[[3, 4, 5, 7]]
        b0, a1, a2 = self._filter.b0, self._filter.a1, self._filter.a2
        passed = b0 * heard + was
        maps[N_ACTION + np.array([0, 1, 2, 6])] = 2.0 * b0 * heard - a1 * passed + older
        maps[N_ACTION + np.array([3, 4, 5, 7])] = b0 * heard - a2 * passed

        wanted = self._wanted(passed[3])
        surfaces = inverse @ (np.array(self._pace.rate)[:, None] * wanted) - passed[:3]
        surfaces[:, _ONE] += self._start[MOTIONS:]
        maps[order] = surfaces
        return LinearLaw(maps, memory)

    def _inverse_as_imagined(self) -> np.ndarray:
        """Return B^-1 (3, 3) as it is now: a rudder or an aileron at its end stays there, and the others do without."""
        inverse = np.array(self._inverse)
        if self._ends(ACTION.dr):
            inverse[: ACTION.dr] = self._without_rudder
        if self._ends(ACTION.da):
            inverse[ACTION.dr] = 0.0, 0.0, 1.0 / self._airframe.effectiveness[2][ACTION.dr]
        inverse /= self._ratio * np.array(self._multipliers)[:, None]
        return inverse

    def _heard(self, inverse: np.ndarray) -> np.ndarray:
        """Return what is filtered (4, 38), of memory and what is seen: three surfaces, and the side force."""
        heard = np.zeros((4, N_MEMORY + N_SEEN))
        heard[:3, _DX + np.array([STATE.p, STATE.q, STATE.r])] = inverse / self._dt
        heard[np.arange(3), _ACTED + np.array(self._order)] = -1.0
        heard[:3, _ONE] = self._start[MOTIONS:]
        heard[3, [_DX + STATE.beta, _X + STATE.r, _ONE]] = (
            1.0 / self._dt,
            self._cos_alpha,
            -self._cos_alpha * self._start[_R],
        )
        return heard

    def _wanted(self, side: np.ndarray) -> np.ndarray:
        """Return the errors of p, q, r (3, 38), of memory and what is seen; side (38,): the filtered side force."""
        wanted = np.zeros((3, N_MEMORY + N_SEEN))
        k_theta, k_phi, k_beta = self._pace.attitude
        for row, state, column, k in (
            (0, STATE.phi, REFERENCE.phi, k_phi), (1, STATE.theta, REFERENCE.theta, k_theta),
        ):  # fmt: skip
            wanted[row, [_RATE + column, _ASKED + column, _X + state, _DX + state]] = 1.0, k, -k, -1.0 / self._dt
        wanted[1] /= self._cos_phi
        wanted[2] = side
        wanted[2, _ONE] += self._cos_alpha * self._start[_R]
        beta = [_RATE + REFERENCE.beta, _ASKED + REFERENCE.beta, _X + STATE.beta]
        wanted[2, beta] -= 1.0, k_beta, -k_beta
        wanted[2] /= self._cos_alpha
        wanted[2, _X + STATE.r] -= 1.0
        return wanted
