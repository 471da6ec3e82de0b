"""Penalised least squares for sums of tables: normal equations that add up over recordings."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim_bridge.aircraft.coefficients import Axis, Term, regressors


@dataclass(frozen=True)
class Unknown:
    """A term whose values are to be identified."""

    term: Term
    """Name, axes and factors; its values are placeholders."""
    zero_at: int | None = None
    """Entry that is zero by definition, because another term carries the offset."""
    smoothness: tuple[float, ...] = (1.0, 3.0)
    """Weights of the curvature along the first and the second axis."""
    prior: tuple[tuple[int, float, float], ...] = ()
    """Entries known from elsewhere: (entry, value, weight)."""

    @property
    def size(self) -> int:
        """Number of unknown values."""
        return int(np.prod([len(axis.breakpoints) for axis in self.term.axes])) - (self.zero_at is not None)


def unknown(
    name: str,
    axes: dict[str, list[float]] | None = None,
    factors: tuple[str, ...] = (),
    zero_at: float | None = None,
    smoothness: tuple[float, ...] = (1.0, 3.0),
    prior: tuple[tuple[int, float, float], ...] = (),
) -> Unknown:
    """Describe a term to identify; ``zero_at`` is the breakpoint at which it is zero by definition."""
    listed = [Axis(variable=variable, breakpoints=breakpoints) for variable, breakpoints in (axes or {}).items()]
    entry = None if zero_at is None else int(np.argmin(np.abs(np.array(listed[0].breakpoints) - zero_at)))
    return Unknown(Term(name=name, values=[], axes=listed, factors=list(factors)), entry, smoothness, prior)


def design(unknowns: list[Unknown], data: dict[str, np.ndarray]) -> np.ndarray:
    """Return the regressor matrix (N, total size) of some samples."""
    blocks = []
    for item in unknowns:
        block = regressors(item.term, data)
        blocks.append(block if item.zero_at is None else np.delete(block, item.zero_at, axis=1))
    return np.concatenate(blocks, axis=1)


def factor_power(unknowns: list[Unknown], data: dict[str, np.ndarray]) -> np.ndarray:
    """Return the sum over samples of each term's squared product of factors, shape (terms,)."""
    ones = np.ones(len(next(iter(data.values()))))
    return np.array([float((np.prod([ones, *(data[n] for n in u.term.factors)], axis=0) ** 2).sum()) for u in unknowns])


@dataclass
class NormalEquations:
    """What one or more recordings say about the unknowns; add up with ``+``, take apart with ``-``."""

    gram: np.ndarray
    """A'A (n, n)."""
    moment: np.ndarray
    """A'y (n,)."""
    power: np.ndarray
    """Summed squares of each term's factors (terms,)."""
    count: int
    """Samples."""
    sums: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """Sums of y and of y squared."""

    @classmethod
    def of(cls, unknowns: list[Unknown], data: dict[str, np.ndarray], y: np.ndarray) -> NormalEquations:
        """Return the equations of samples: variables of shape (N,) and target y (N,)."""
        A = design(unknowns, data)
        return cls(A.T @ A, A.T @ y, factor_power(unknowns, data), len(y), np.array([y.sum(), (y**2).sum()]))

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(
            self.gram + other.gram,
            self.moment + other.moment,
            self.power + other.power,
            self.count + other.count,
            self.sums + other.sums,
        )

    @property
    def variance(self) -> float:
        """Variance of the target."""
        mean = self.sums / self.count
        return float(mean[1] - mean[0] ** 2)


def _second_differences(breakpoints: list[float]) -> np.ndarray:
    """Return the operator (K-2, K) of changes of slope, scaled by the mean spacing."""
    knots = np.asarray(breakpoints)
    count = len(knots)
    spacing = (knots[-1] - knots[0]) / count
    operator = np.zeros((max(count - 2, 0), count))
    for i in range(count - 2):
        before, after = knots[i + 1] - knots[i], knots[i + 2] - knots[i + 1]
        operator[i, i : i + 3] = spacing / before, -spacing / before - spacing / after, spacing / after
    return operator


def _curvature(item: Unknown) -> np.ndarray:
    """Return the penalty's rows for one term, shape (rows, size)."""
    axes = item.term.axes
    if not axes:
        return np.zeros((0, 1))
    if len(axes) == 1:
        rows = item.smoothness[0] * _second_differences(axes[0].breakpoints)
    else:
        first, second = (_second_differences(axis.breakpoints) for axis in axes)
        rows = np.concatenate(
            [
                item.smoothness[0] * np.kron(first, np.eye(second.shape[1])),
                item.smoothness[1] * np.kron(np.eye(first.shape[1]), second),
            ]
        )
    return rows if item.zero_at is None else np.delete(rows, item.zero_at, axis=1)


def solve(unknowns: list[Unknown], equations: NormalEquations, penalty: float) -> list[Term]:
    """Return the terms that minimise the mean squared residual plus ``penalty`` times their curvature.

    The curvature is weighed in units of the target: each term's by the root mean square of its factors
    and all by the target's variance, so that one number serves every axis.
    """
    count = equations.count
    total = sum(item.size for item in unknowns)
    hessian = equations.gram / count
    moment = equations.moment / count
    start = 0
    for item, power in zip(unknowns, equations.power, strict=True):
        rows = _curvature(item) * np.sqrt(power / count)
        block = slice(start, start + item.size)
        hessian[block, block] += penalty * equations.variance * (rows.T @ rows)
        for entry, value, weight in item.prior:
            hessian[start + entry, start + entry] += weight * equations.variance * power / count
            moment[start + entry] += weight * equations.variance * power / count * value
        start += item.size
    # A whisper of a ridge: entries that no sample reaches and no curvature binds stay at zero.
    hessian[np.diag_indices(total)] += 1e-12 * (np.diag(equations.gram) / count + 1e-8)
    values = np.linalg.solve(hessian, moment)
    terms, start = [], 0
    for item in unknowns:
        entries = values[start : start + item.size]
        if item.zero_at is not None:
            entries = np.insert(entries, item.zero_at, 0.0)
        start += item.size
        terms.append(Term(name=item.term.name, values=entries.tolist(), axes=item.term.axes, factors=item.term.factors))
    return terms
