"""A bank of Kalman filters on body rates that differ in what they take to have reached the surfaces.

The model is :mod:`task.rates`. Each filter's state: rates w (3), signed effectiveness lambda (3), bias b (3) and
what two slopes have changed by (2): of q' in alpha, of r' in beta. Only p, q, r are measured; nothing is
differentiated, so that gyro noise is smoothed by the filter's own integration. All filters are stepped at once: at
eleven states, what costs is the number of array operations, not their size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from task.limits import DT
from task.rates import (
    N_EFFECT,
    RATES,
    SIDESLIP,
    RateModel,
    dynamic_pressure,
    effect_terms,
    features,
    sideslip_slopes,
)
from task.state import N_ACTION

N = RATES + N_ACTION + RATES + 2
"""States of a filter."""
W, LAMBDA, B, SLOPES = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 11)
"""Where rates, effectiveness, bias and slopes lie among them."""
ALPHA_MID = 0.05
"""Angle of attack about which a change of the pitching moment's slope turns [rad]: it adds little to the bias there."""
MOTION = N - 1
"""Where a filter in which a surface moves by itself has how fast that is, instead of the second slope."""


class Motion(NamedTuple):
    """Where K filters have how far a surface has moved by itself, and how fast it does: views of their s and P."""

    place: np.ndarray
    """Of s (K,): in the place of that surface's lambda."""
    speed: np.ndarray
    """Of s (K,): in the place of :data:`MOTION`."""
    rows: tuple[np.ndarray, np.ndarray]
    """Of P, the rows (K, 11) of place and speed."""
    columns: tuple[np.ndarray, np.ndarray]
    """Of P, the columns (K, 11) of place and speed."""
    slope: np.ndarray
    """Of F_rates (K,): what the speed does to r, where other filters have a slope."""


class RateFilters:
    """M Kalman filters, s = [w; lambda; b; slopes], s+ = F s + dt (A phi + B known), w measured with independent noise.

    ``s`` (M, 11) and ``P`` (M, 11, 11) are changed in place. After :meth:`update`, lists of M have for each filter:
    ``nis`` the normalised innovation squared (mean 3) and ``log_likelihood`` that of the measurement, less a constant.
    """

    BEYOND = 1e3
    """Rates [rad/s], lambdas and biases [rad/s2] of an aircraft, and deviations, are smaller, all together."""

    def __init__(self, model: RateModel, size: int, dt: float = DT) -> None:
        self.dt = dt
        self._drift = dt * np.ascontiguousarray(model.drift)
        self._effect = dt * np.ascontiguousarray(model.effect.transpose(1, 2, 0)).reshape(N_EFFECT, RATES * N_ACTION)
        self.s, self.P = np.zeros((size, N)), np.zeros((size, N, N))
        self.q = np.zeros((size, N))
        """Variance added at each prediction (M, 11)."""
        self.q_gust = 0.0
        """Variance of the sideslip that the air adds at each prediction, and no sensor sees [rad2]: by what it does the
        bias drifts besides."""
        self.moving: tuple[Motion, ...] = ()
        """Of filters in which a surface moves by itself, by :meth:`motion`."""
        self.r = np.zeros(RATES)
        """Variance of each measured rate (3,) [rad2/s2]."""
        self.forget()
        self.drift_step = np.zeros(RATES)
        """dt A phi of the last prediction (3,) [rad/s]."""
        self.known_step = np.zeros((size, RATES))
        """dt B of the deflections that a filter knows (M, 3) [rad/s]."""
        self.F_rates = np.zeros((size, RATES, N))
        """The rows of F that are not the identity's: those of the rates (M, 3, 11)."""
        self.F_rates[:, :, W] = np.eye(RATES)
        self.F_rates[:, :, B] = dt * np.eye(RATES)
        self.variances = self.P.reshape(size, N * N)[:, :: N + 1]
        """The diagonals of P (M, 11); a view."""
        self._F_effect = self.F_rates[:, :, LAMBDA]
        self._F_transposed = self.F_rates.transpose(0, 2, 1)
        self._P_rows, self._P_columns, self._P_rates = self.P[:, W], self.P[:, :, W], self.P[:, W, W]
        self._P_bias = self.P[:, B, B]
        self._P_transposed = self.P.transpose(0, 2, 1)
        self._s_column, self._w = self.s[:, :, None], self.s[:, W]
        # Products of arrays that always lie at the same place: elsewhere the last bit may differ.
        self._phi, self._terms = np.zeros(model.drift.shape[0]), np.zeros(N_EFFECT)
        self._drift_sideslip = np.ascontiguousarray(model.drift[SIDESLIP])
        self._by_sideslip, self._sideslip = np.zeros(len(self._drift_sideslip)), np.zeros(RATES)
        self._gust = np.zeros((RATES, RATES))
        self._effects = np.zeros((RATES, N_ACTION))
        self._effects_flat, self._effects_transposed = self._effects.reshape(-1), self._effects.T
        self._rows, self._columns = np.zeros((size, RATES, N)), np.zeros((size, N, RATES))
        self._stepped = np.zeros((size, RATES, 1))
        self._product = np.zeros((size, N, N))
        self._correction = np.zeros((size, N, 1))
        self._innovation = np.zeros((size, RATES))
        self._innovation_column = self._innovation[:, :, None]
        self._S = np.zeros((size, RATES, RATES))
        self._S_flat = self._S.reshape(size, RATES * RATES)
        self._S_diagonal = self._S_flat[:, :: RATES + 1]
        self._inverse = np.zeros((size, RATES, RATES))
        self._inverse_flat = self._inverse.reshape(size, RATES * RATES)

    def forget(self) -> None:
        """Begin a flight: nothing has been measured, and so nothing surprised."""
        size = len(self.s)
        self.nis, self.log_likelihood = [0.0] * size, [0.0] * size

    def linearise(self, x: list[float], washed: float, u: np.ndarray, known: np.ndarray | None = None) -> None:
        """Set F and what steps without the state.

        x: the first ten states, of which p, q, r may be filtered; washed: the high-passed yaw rate [rad/s]; u (M, 3):
        the deflections that act on x [rad], as each filter takes them to be, and whose effectiveness it learns; known
        (M, 3): those that act besides, fully [rad].
        """
        p, q, r, V, alpha, beta, _, _, _, h = x
        qbar = dynamic_pressure(V, h)
        self._phi[:] = features(p, q, r, V, alpha, beta, washed, qbar)
        np.dot(self._phi, self._drift, out=self.drift_step)
        self._terms[:] = effect_terms(V, alpha, qbar)
        np.dot(self._terms, self._effect, out=self._effects_flat)
        np.multiply(self._effects, u[:, None, :], out=self._F_effect)
        if self.q_gust:
            self._by_sideslip[:] = sideslip_slopes(V, alpha, beta, qbar)
            np.dot(self._by_sideslip, self._drift_sideslip, out=self._sideslip)
            np.multiply(self.q_gust * self._sideslip[:, None], self._sideslip, out=self._gust)
        self.F_rates[:, 1, SLOPES.start] = self.dt * (alpha - ALPHA_MID)
        self.F_rates[:, 2, SLOPES.start + 1] = self.dt * beta
        for motion in self.moving:
            motion.slope[:] = 0.0
        if known is not None:
            np.matmul(known, self._effects_transposed, out=self.known_step)

    @property
    def sound(self) -> bool:
        """Whether every filter's state and variances are within what an aircraft can have."""
        # Sums of squares are quicker than largest elements, and no number fails either comparison.
        return bool(np.vdot(self.s, self.s) < self.BEYOND**2 and np.vdot(self.P, self.P) < self.BEYOND**4)

    def effect(self, axis: int, surface: int) -> float:
        """Return the acceleration of p, q or r by a healthy surface, as last linearised [rad/s2 per rad]."""
        return self._effects.item(axis, surface) / self.dt

    def predict(self) -> None:
        """Take s and P one sample on, with F and the drift as linearised."""
        np.matmul(self.F_rates, self._s_column, out=self._stepped)
        np.add(self._stepped[:, :, 0], self.drift_step, out=self._w)
        np.add(self._w, self.known_step, out=self._w)
        np.matmul(self.F_rates, self.P, out=self._rows)
        np.copyto(self._P_rows, self._rows)
        np.matmul(self.P, self._F_transposed, out=self._columns)
        np.copyto(self._P_columns, self._columns)
        for motion in self.moving:
            self._move(motion)
        np.add(self.variances, self.q, out=self.variances)
        if self.q_gust:
            np.add(self._P_bias, self._gust, out=self._P_bias)

    def motion(self, filters: slice, places: slice | int) -> Motion:
        """Return where filters have a surface's motion: each in a place of its own, or all in one."""
        s, P = self.s[filters], self.P[filters]
        if isinstance(places, int):
            place, row, column = s[:, places], P[:, places], P[:, :, places]
        else:  # the diagonals over filters and places; numpy's own is read-only
            place = np.einsum("ii->i", s[:, places])
            row, column = np.einsum("iij->ij", P[:, places]), np.einsum("iji->ij", P[:, :, places])
        speeds = (P[:, MOTION], P[:, :, MOTION])
        return Motion(place, s[:, MOTION], (row, speeds[0]), (column, speeds[1]), self.F_rates[filters, 2, MOTION])

    def _move(self, motion: Motion) -> None:
        """Let surfaces go on as they move by themselves."""
        for place, speed in ((motion.place, motion.speed), motion.rows, motion.columns):
            np.add(place, self.dt * speed, out=place)

    def update(self, w: np.ndarray | list[float]) -> bool:
        """Learn from measured rates w (3,) [rad/s]; False, and nothing learnt, when a filter is beyond all numbers."""
        np.subtract(w, self._w, out=self._innovation)
        np.copyto(self._S, self._P_rates)
        np.add(self._S_diagonal, self.r, out=self._S_diagonal)
        inverses, nis, log_likelihood = [], self.nis, self.log_likelihood
        # Three by three and symmetric: by cofactors this is quicker than a library's general inverse.
        for i, (S, (p, q, r)) in enumerate(zip(self._S_flat.tolist(), self._innovation.tolist(), strict=True)):
            a, b, c, _, d, e, _, _, f = S
            A, B, C, D, E, G = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
            determinant = a * A + b * B + c * C
            if not 0.0 < determinant < math.inf:
                return False
            each = 1.0 / determinant
            A, B, C, D, E, G = A * each, B * each, C * each, D * each, E * each, G * each
            inverses.append((A, B, C, B, D, E, C, E, G))
            nis[i] = squared = A * p * p + D * q * q + G * r * r + 2.0 * (B * p * q + C * p * r + E * q * r)
            log_likelihood[i] = -0.5 * (squared + math.log(determinant))
        self._inverse_flat[:] = inverses
        np.matmul(self._P_columns, self._inverse, out=self._columns)
        np.matmul(self._columns, self._innovation_column, out=self._correction)
        np.add(self._s_column, self._correction, out=self._s_column)
        np.matmul(self._columns, self._P_rows, out=self._product)
        np.subtract(self.P, self._product, out=self.P)
        np.add(self.P, self._P_transposed, out=self._product)  # rounding must not make it lean
        np.multiply(self._product, 0.5, out=self.P)
        return True

    def surprise(self, i: int) -> tuple[float, float, float]:
        """Return the squared innovations of p, q, r over their own variances, in a filter's last update."""
        a, d, f = self._S_diagonal[i].tolist()
        p, q, r = self._innovation[i].tolist()
        return p * p / a, q * q / d, r * r / f
