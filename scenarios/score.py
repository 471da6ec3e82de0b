"""How well one flight was flown: the figures of the tables, from the aircraft's true states."""

from __future__ import annotations

import msgspec
import numpy as np

from scenarios.trace import AdaptationTrace, FlightTrace
from task.metrics import channel_nmae, smoothness
from task.observation import tracking_error
from task.reward import terminated
from task.state import REFERENCE

_ATTITUDE = [int(REFERENCE.theta), int(REFERENCE.phi)]


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of one flight; errors are taken over the part that was flown before it was lost."""

    nmae: float
    """Mean over theta, phi and beta of the normalised mean absolute error [%] (``task.metrics``)."""
    nmae_theta: float
    nmae_phi: float
    nmae_beta: float
    """The same, each channel on its own [%]."""
    nmae_attitude: float
    """Mean over theta and phi alone [%]: what is left to judge when the rudder is jammed."""
    beta_deg: float
    """Mean absolute error in sideslip [deg]."""
    nmae_before: float | None
    """nMAE up to the fault [%]; None when the fault is there from the start or there is none."""
    nmae_after: float | None
    """nMAE from the fault on [%]; None when the fault is there from the start or there is none."""
    smoothness: float
    """Sm of eq. 16 over the commands [rad Hz]; higher is smoother."""
    largest_step_deg: float
    """Largest change of any command from one sample to the next [deg]."""
    lost_at: float | None
    """When the aircraft left the limits of ``task.reward.terminated`` [s]; None when it flew to the end."""
    switches: int
    """How often the runtime changed the cast."""
    late_ticks: int
    """Samples that were not answered in time."""

    @property
    def survived(self) -> bool:
        """True when the aircraft flew to the end."""
        return self.lost_at is None


def time_of_loss(flight: FlightTrace) -> float | None:
    """Return when the aircraft was lost [s], or None; a trace that ends before its planned end is lost there."""
    out = np.flatnonzero(terminated(flight.x))
    if out.size:
        return float(flight.time[out[0]])
    if flight.time.size < flight.planned_samples:
        return float(flight.time[-1])
    return None


def _percent(error: np.ndarray) -> float | None:
    """Return the nMAE of errors (T, 3) [rad] in percent, or None when there are none."""
    return 100.0 * float(channel_nmae(error).mean()) if error.shape[0] else None


def score_flight(flight: FlightTrace, adaptation: AdaptationTrace | None = None, late_ticks: int = 0) -> Score:
    """Return the figures of one flight.

    ``flight.fault_at`` [s] splits the error in before and after when it lies inside the flight.
    """
    lost_at = time_of_loss(flight)
    flown = flight.time.size if lost_at is None else max(int(np.searchsorted(flight.time, lost_at)), 1)
    error = tracking_error(flight.x, flight.reference)[:flown]
    command = flight.command[:flown]
    channels = 100.0 * channel_nmae(error)
    fault = flight.fault_at
    split = None if fault is None or fault <= 0.0 else int(np.searchsorted(flight.time[:flown], fault))
    return Score(
        nmae=float(channels.mean()),
        nmae_theta=float(channels[REFERENCE.theta]),
        nmae_phi=float(channels[REFERENCE.phi]),
        nmae_beta=float(channels[REFERENCE.beta]),
        nmae_attitude=float(channels[_ATTITUDE].mean()),
        beta_deg=float(np.degrees(np.abs(error[:, REFERENCE.beta]).mean())),
        nmae_before=None if split is None else _percent(error[:split]),
        nmae_after=None if split is None else _percent(error[split:]),
        smoothness=smoothness(command),
        largest_step_deg=float(np.degrees(np.abs(np.diff(command, axis=0)).max(initial=0.0))),
        lost_at=lost_at,
        switches=0 if adaptation is None else len(adaptation.switches),
        late_ticks=late_ticks,
    )
