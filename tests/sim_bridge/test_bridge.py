"""Whole short flights of the real aircraft against a scripted runtime on a real socket."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

from sim_bridge.air import Air
from sim_bridge.bridge import Bridge, Summary
from sim_bridge.exchange import TICK_US, Timing
from sim_bridge.faults import Bandwidth
from sim_bridge.flight import Flight
from sim_bridge.link import Link
from sim_bridge.presets import R3_SENSORS
from task.limits import DEFLECTION_LIMIT, DT
from task.state import STATE

QUICK = Timing(patience=0.5, reply_timeout=0.3, resend=0.02)


def flown(
    link: str, seconds: float = 0.5, timing: Timing = QUICK, flight: Flight | None = None, **options
) -> tuple[Summary, dict]:
    with Link(link) as connected:
        bridge = Bridge(flight or Flight(duration=seconds), connected, timing=timing, **options)
        summary = bridge.fly()
    return summary, bridge.truth.arrays()


def test_a_lockstep_flight_asks_once_a_tick_and_applies_each_answer(peer_factory):
    peer = peer_factory()
    summary, truth = flown(peer.link)
    assert (summary.outcome, summary.ticks, summary.link.late, summary.link.stale) == ("complete", 50, 0, 0)
    assert truth["time_us"].tolist() == [k * TICK_US for k in range(51)]
    assert truth["echo_us"].tolist() == [k * TICK_US for k in range(50)]
    assert sorted(set(peer.times)) == [k * TICK_US for k in range(50)]
    q = truth["x"][:-1, STATE.q].astype(np.float32)
    np.testing.assert_allclose(truth["command"][:, 0], (-0.14 + 2.0 * q) * DEFLECTION_LIMIT, atol=1e-8)


def test_two_lockstep_flights_are_equal_bit_for_bit(peer_factory):
    peer = peer_factory()
    first, second = flown(peer.link)[1], flown(peer.link)[1]
    assert np.abs(np.diff(first["command"], axis=0)).max() > 0
    for name in first:
        assert first[name].tobytes() == second[name].tobytes(), name


def test_everything_random_is_repeated_by_the_seed_and_the_truth_is_not_what_is_sent(peer_factory):
    rough = Flight(
        duration=0.5, seed=5, sensors=R3_SENSORS, air=Air(turbulence="moderate", wind_north=3.0),
        faults=(Bandwidth(surface="elevator", hz=1.0, start=0.2),),
    )  # fmt: skip
    peers = [peer_factory(), peer_factory()]
    first, second = (flown(peer.link, flight=rough)[1] for peer in peers)
    assert peers[0].state == peers[1].state
    for name in first:
        assert first[name].tobytes() == second[name].tobytes(), name
    assert abs(peers[0].state[11] - first["x"][49, STATE.q]) > 1e-6
    assert first["faults"][:, 0].tolist() == [0.0] * 20 + [1.0] * 31
    np.testing.assert_allclose(first["surfaces"][1:21, 0], first["command"][:20, 0], atol=1e-12)
    assert (first["surfaces"][21:, 0] != first["command"][20:, 0]).all()
    assert peers[0].ids.count(231) == peers[0].ids.count(331)
    assert peers[0].ids[peers[0].ids.index(331) - 1] == 231


def test_the_lag_of_the_interface_holds_end_to_end(peer_factory, frame_of):
    """a[k] first moves x[k+2] - x[k+1]: the bridge adds nothing to the plant's own sample."""
    step_at = 20

    def script(peer, time_us):
        return [frame_of(time_us, [-0.14 - 0.2 * (peer.stepping and time_us >= step_at * TICK_US), 0, 0])]

    flights = []
    for stepping in (False, True):
        peer = peer_factory(script=script)
        peer.stepping = stepping
        flights.append(flown(peer.link)[1]["x"][:, STATE.q])
    difference = np.flatnonzero(flights[0] != flights[1])
    assert difference[0] == step_at + 2


def test_order_of_messages_and_of_states(peer_factory):
    peer = peer_factory()
    flown(peer.link, 0.1)
    time.sleep(0.05)
    first_tick = peer.ids.index(331)
    assert peer.ids[first_tick - 2 : first_tick] == [0, 49]
    assert peer.statuses[0] == 3
    assert 4 in peer.statuses
    assert peer.statuses[-3:] == [7, 7, 7]


def test_a_late_reply_holds_the_last_command_and_is_counted(peer_factory):
    def script(peer, time_us):
        return [] if time_us == 10 * TICK_US else [peer.plain(time_us)]

    summary, truth = flown(peer_factory(script=script).link)
    assert (summary.outcome, summary.link.late, summary.link.longest_late_run) == ("complete", 1, 1)
    assert (truth["command"][10] == truth["command"][9]).all()
    assert truth["echo_us"][10] == 9 * TICK_US
    assert truth["echo_us"][11] == 11 * TICK_US


def test_a_lost_datagram_is_made_up_for_within_the_reply_timeout(peer_factory):
    def script(peer, time_us):
        return [] if time_us == 10 * TICK_US and peer.times.count(time_us) == 1 else [peer.plain(time_us)]

    timing = Timing(patience=1.0, reply_timeout=0.4)
    summary, truth = flown(peer_factory(script=script).link, timing=timing)
    assert (summary.outcome, summary.link.late, summary.link.stale) == ("complete", 0, 0)
    assert truth["echo_us"].tolist() == truth["time_us"][:-1].tolist()


def test_a_reply_that_comes_too_late_is_stale_and_not_applied(peer_factory):
    held = []

    def script(peer, time_us):
        if time_us == 10 * TICK_US:
            held.append(peer.plain(time_us))
            return []
        return [*(held.pop() for _ in list(held)), peer.plain(time_us)]

    summary, truth = flown(peer_factory(script=script).link)
    assert (summary.link.late, summary.link.stale) == (1, 2)  # the state was sent twice, and answered twice
    assert 10 * TICK_US not in truth["echo_us"]


@pytest.mark.parametrize("echo", [11 * TICK_US, 10 * TICK_US + 1])
def test_an_echo_of_no_state_is_refused(peer_factory, frame_of, echo):
    def script(peer, time_us):
        wrong = [frame_of(echo, [1.0, 0, 0])] if time_us == 10 * TICK_US else []
        return [*wrong, peer.plain(time_us)]

    summary, truth = flown(peer_factory(script=script).link)
    assert summary.link.refused == {"unknown echo": 1}
    assert truth["echo_us"][10] == 10 * TICK_US
    assert summary.link.late == 0


@pytest.mark.parametrize(
    ("controls", "mode", "reason"),
    [([math.nan, 0, 0], 128, "not finite"), ([2.0, 0, 0], 128, "out of range"), ([0, 0, 0], 0, "not armed")],
)
def test_a_refused_command_answers_the_tick_and_the_last_one_is_held(peer_factory, frame_of, controls, mode, reason):
    def script(peer, time_us):
        bad = 10 * TICK_US <= time_us < 13 * TICK_US
        return [frame_of(time_us, controls, mode) if bad else peer.plain(time_us)]

    summary, truth = flown(peer_factory(script=script).link)
    assert (summary.outcome, summary.link.late) == ("complete", 0)
    assert summary.link.refused == {reason: 3}
    assert (truth["command"][10:13] == truth["command"][9]).all()


def test_nobody_there_ends_in_one_line_after_the_patience():
    began = time.perf_counter()
    summary, truth = flown("udpout:127.0.0.1:9")
    assert 0.4 < time.perf_counter() - began < 3.0
    assert summary.outcome == "no runtime"
    assert "\n" not in summary.reason
    assert "127.0.0.1:9" in summary.reason
    assert "heard nothing" in summary.reason
    assert len(truth["x"]) == 1


def test_a_peer_of_another_dialect_is_named_in_the_line(peer_factory):
    def script(peer, time_us):
        reply = peer.plain(time_us)
        return [reply[:-2] + bytes(2)]

    summary, _ = flown(peer_factory(script=script).link)
    assert summary.outcome == "no runtime"
    assert "unreadable frames (last: invalid MAVLink CRC in msgID 93" in summary.reason


def test_a_peer_that_only_sends_nan_never_starts_the_flight(peer_factory, frame_of):
    summary, truth = flown(peer_factory(script=lambda peer, t: [frame_of(t, [math.nan, 0, 0])]).link)
    assert summary.outcome == "no runtime"
    assert "not finite" in summary.reason
    assert len(truth["command"]) == 0


def test_the_peer_may_come_after_the_bridge(peer_factory):
    port = peer_factory().port
    late = []

    def later():
        time.sleep(0.2)
        late.append(peer_factory(port))

    closed = peer_factory()
    closed.close()
    port = closed.port
    thread = threading.Thread(target=later)
    thread.start()
    summary, _ = flown(f"udpout:127.0.0.1:{port}", timing=Timing(patience=5.0, resend=0.02))
    thread.join()
    assert (summary.outcome, summary.link.late) == ("complete", 0)
    assert late[0].times[0] == 0


def restart_mid_flight(peer_factory, seconds: float, **options):
    """Fly with a peer that dies in flight; another takes its port half a second later."""
    first = peer_factory(script=lambda peer, t: [] if t > 20 * TICK_US else [peer.plain(t)])
    second = []

    def replace():
        while max(first.times, default=0) <= 20 * TICK_US:
            time.sleep(0.005)
        first.close()
        time.sleep(0.2)
        second.append(peer_factory(first.port))

    thread = threading.Thread(target=replace)
    thread.start()
    result = flown(first.link, seconds, **options)
    thread.join()
    return result, second[0]


def test_a_runtime_that_dies_freezes_time_and_its_successor_flies_on(peer_factory):
    timing = Timing(patience=5.0, reply_timeout=0.2, resend=0.02)
    (summary, truth), second = restart_mid_flight(peer_factory, 0.5, timing=timing)
    assert (summary.outcome, summary.link.reconnections, summary.ticks) == ("complete", 1, 50)
    # The closed port was noticed before the reply timeout: no tick flew without its own command.
    assert summary.link.late == 0
    assert truth["echo_us"].tolist() == truth["time_us"][:-1].tolist()
    assert second.times[0] == 21 * TICK_US
    straight = flown(peer_factory().link)[1]
    assert straight["x"].tobytes() == truth["x"].tobytes()


def test_a_runtime_that_falls_silent_freezes_time_after_three_late_ticks(peer_factory):
    def script(peer, time_us):
        peer.asked = getattr(peer, "asked", 0) + (time_us >= 10 * TICK_US)
        return [] if 0 < peer.asked < 8 else [peer.plain(time_us)]

    timing = Timing(patience=5.0, reply_timeout=0.1, resend=0.02, lost_after=3)
    summary, truth = flown(peer_factory(script=script).link, timing=timing)
    assert (summary.outcome, summary.link.late, summary.link.reconnections) == ("complete", 3, 1)
    assert truth["echo_us"][10:14].tolist() == [9 * TICK_US, 9 * TICK_US, 12 * TICK_US, 13 * TICK_US]


def test_a_runtime_that_never_comes_back_ends_in_one_line_with_the_truth_kept(peer_factory):
    script = lambda peer, t: [] if t > 20 * TICK_US else [peer.plain(t)]  # noqa: E731
    timing = Timing(patience=0.3, reply_timeout=0.1, resend=0.02)
    said = []
    summary, truth = flown(peer_factory(script=script).link, timing=timing, say=said.append)
    assert summary.outcome == "no runtime"
    assert "at 0.23 s of flight" in summary.reason
    assert len(truth["x"]) == len(truth["command"]) + 1 == 24
    assert any("stands still" in line for line in said)


def test_another_start_has_another_reset_counter(peer_factory):
    peer = peer_factory()
    flown(peer.link, 0.02)
    time.sleep(1.05)
    flown(peer.link, 0.02)
    assert len(peer.reset_counters) == 2


def test_a_lost_aircraft_ends_the_flight_and_says_so(peer_factory, frame_of):
    peer = peer_factory(script=lambda peer, t: [frame_of(t, [0.0, 1.0, 0.0])])
    summary, truth = flown(peer.link, 20.0)
    time.sleep(0.05)
    assert summary.outcome == "aircraft lost"
    assert peer.statuses[-3:] == [8, 8, 8]
    assert abs(truth["x"][-1, STATE.phi]) > math.radians(75) > abs(truth["x"][-2, STATE.phi])


def test_real_time_keeps_100_hz_and_counts_no_late_tick(peer_factory):
    began = time.perf_counter()
    summary, truth = flown(peer_factory().link, 1.0, realtime=True)
    wall = time.perf_counter() - began
    assert (summary.outcome, summary.lockstep, summary.ticks) == ("complete", False, 100)
    assert wall >= 0.99
    assert summary.wall_seconds == pytest.approx(1.0 + summary.link.overruns * DT, abs=0.1)
    assert summary.jitter_us is not None
    assert summary.jitter_us.p50 < 5000
    on_time = np.flatnonzero(truth["echo_us"] == truth["time_us"][:-1])
    assert len(on_time) == 100 - summary.link.late


def test_real_time_takes_what_is_there_and_never_waits(peer_factory):
    def script(peer, time_us):
        return [] if 20 * TICK_US <= time_us < 40 * TICK_US else [peer.plain(time_us)]

    summary, truth = flown(peer_factory(script=script).link, 0.6, realtime=True)
    assert summary.outcome == "complete"
    assert summary.link.late >= 20
    assert (truth["echo_us"][20:40] <= 19 * TICK_US).all()
    assert truth["echo_us"][-1] > 40 * TICK_US


def test_real_time_flies_on_while_the_runtime_is_restarted(peer_factory):
    (summary, truth), second = restart_mid_flight(peer_factory, 2.0, realtime=True, timing=Timing(patience=5.0))
    assert (summary.outcome, summary.ticks) == ("complete", 200)
    assert summary.link.reconnections == 1
    assert truth["echo_us"][-1] >= second.times[0]


def test_real_time_gives_up_when_the_runtime_stays_away(peer_factory):
    script = lambda peer, t: [] if t > 5 * TICK_US else [peer.plain(t)]  # noqa: E731
    summary, _ = flown(peer_factory(script=script).link, 5.0, realtime=True)
    assert summary.outcome == "no runtime"
    assert 50 <= summary.ticks < 150
    assert "\n" not in summary.reason
