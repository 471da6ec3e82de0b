"""Scores of signals whose figures can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.score import score_flight, time_of_loss
from scenarios.trace import AdaptationTrace, FlightTrace, Switch
from task.state import ACTION, N_ACTION, N_REFERENCE, N_STATE, REFERENCE, STATE

DEGREE = np.pi / 180.0


def flight(samples: int = 1000, planned: int | None = None, fault_at: float | None = None) -> FlightTrace:
    x = np.zeros((samples, N_STATE))
    x[:, STATE.V], x[:, STATE.h] = 90.0, 2000.0
    return FlightTrace(
        time=np.arange(samples) * 0.01,
        x=x,
        reference=np.zeros((samples, N_REFERENCE)),
        command=np.zeros((samples, N_ACTION)),
        surfaces=np.zeros((samples, N_ACTION)),
        faulty=np.arange(samples) * 0.01 >= (np.inf if fault_at is None else fault_at),
        planned_samples=planned or samples,
    )


def test_each_channel_is_divided_by_its_own_range() -> None:
    trace = flight()
    trace.reference[:, REFERENCE.theta] = 2.0 * DEGREE  # 2 of 20 deg: 10 %
    trace.reference[:, REFERENCE.phi] = -1.0 * DEGREE  # 1 of 20 deg: 5 %
    trace.x[:, STATE.beta] = np.where(np.arange(1000) % 2, 0.3, -0.3) * DEGREE  # mean 0, so 0.3 of 1 deg: 30 %
    score = score_flight(trace)
    assert score.nmae_theta == pytest.approx(10.0)
    assert score.nmae_phi == pytest.approx(5.0)
    assert score.nmae_beta == pytest.approx(30.0)
    assert score.nmae == pytest.approx(15.0)
    assert score.nmae_attitude == pytest.approx(7.5)
    assert score.beta_deg == pytest.approx(0.3)


def test_a_constant_sideslip_hides_in_the_nmae_and_shows_in_degrees() -> None:
    trace = flight()
    trace.x[:, STATE.beta] = 12.0 * DEGREE
    score = score_flight(trace)
    assert score.nmae_beta == pytest.approx(100.0)
    assert score.beta_deg == pytest.approx(12.0)


def test_the_fault_splits_the_error() -> None:
    trace = flight(fault_at=4.0)
    trace.reference[400:, REFERENCE.theta] = 6.0 * DEGREE  # 30 % of one of three channels
    score = score_flight(trace)
    assert score.nmae_before == pytest.approx(0.0)
    assert score.nmae_after == pytest.approx(10.0)
    assert score.nmae == pytest.approx(6.0)


@pytest.mark.parametrize("fault_at", [None, 0.0])
def test_without_a_sudden_fault_there_is_no_before_and_after(fault_at: float | None) -> None:
    score = score_flight(flight(fault_at=fault_at))
    assert score.nmae_before is None
    assert score.nmae_after is None


def test_smoothness_of_one_sine_is_its_amplitude_and_frequency() -> None:
    # |A[k]|^2 dt = amplitude^2 n^2 dt / 4 at k = f T, so Sm = -8000/T * sqrt(2/n * that * f) with n dt = T = 10 s
    trace = flight()
    amplitude, frequency = 1.0 * DEGREE, 2.0
    trace.command[:, ACTION.de] = amplitude * np.sin(2 * np.pi * frequency * trace.time)
    assert score_flight(trace).smoothness == pytest.approx(-8000.0 / 10.0 * amplitude * np.sqrt(10.0 * frequency / 2.0))


def test_the_largest_command_step_is_over_all_surfaces_in_degrees() -> None:
    trace = flight()
    trace.command[500:, ACTION.da] = -3.2 * DEGREE
    trace.command[700:, ACTION.dr] = 0.7 * DEGREE
    assert score_flight(trace).largest_step_deg == pytest.approx(3.2)


def test_a_lost_flight_is_scored_up_to_its_loss() -> None:
    trace = flight(fault_at=6.0)
    trace.x[500:, STATE.phi] = 80.0 * DEGREE
    score = score_flight(trace)
    assert score.lost_at == pytest.approx(5.0)
    assert not score.survived
    assert score.nmae == 0.0
    assert score.nmae_before == 0.0
    assert score.nmae_after is None


def test_a_trace_that_ends_early_is_lost_at_its_end() -> None:
    assert time_of_loss(flight(samples=300, planned=1000)) == pytest.approx(2.99)
    assert time_of_loss(flight()) is None


def test_switches_are_counted() -> None:
    trace = flight()
    adaptation = AdaptationTrace(
        time=trace.time,
        active=np.zeros(1000, dtype=int),
        innovation=np.zeros((1000, 1)),
        members=["a", "b"],
        switches=[Switch(2.0, 1), Switch(6.0, 0)],
    )
    assert score_flight(trace, adaptation, late_ticks=3).switches == 2
    assert score_flight(trace, adaptation, late_ticks=3).late_ticks == 3
