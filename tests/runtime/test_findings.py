"""What has been found of the aircraft is said in words: once, when it has held, and in 50 characters."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from pyulog import ULog

from runtime.findings import SURFACES, Findings, describe, describe_effect, describe_range
from runtime.hypotheses import hypotheses
from runtime.link import Sample
from runtime.loop import Loop
from runtime.mavlink_link import TEXT
from runtime.presets import PRESETS, resolve
from runtime.ranges import ALL, Range
from runtime.recorder import Recorder
from runtime.structured import Effectiveness
from task.limits import DT
from task.state import STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, watch

NOISE = 6.3e-4


@pytest.fixture
def flight():
    """Return an aircraft, the filters, and a flight on with both that returns what is said, in samples from then."""
    aircraft, found = Aircraft(noise=NOISE), Effectiveness(SETTINGS, MODEL, 1)
    findings = Findings(found)

    def fly(samples):
        said = []
        for k in range(samples):
            watch(found, aircraft, 1)
            if line := findings.look():
                said.append((k, line))
        return said

    assert fly(1000) == []
    return aircraft, found, fly


def test_a_surface_that_works_backwards_is_said_once_and_its_repair_too(flight):
    aircraft, _, fly = flight
    aircraft.effect[0] = -1.0
    ((at, line),) = fly(500)
    assert 50 <= at < 200
    assert line.startswith("found: elevator works backwards (-")
    aircraft.effect[0] = 1.0
    assert [line[:30] for _, line in fly(500)] == ["found: elevator works as it sh"]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"delay": 15}, "found: commands 150 ms late"),
        ({"order": [0, 2, 1]}, "found: aileron and rudder crossed"),
        ({"rate": 0.052}, "found: surfaces no faster than 3 deg/s"),
        ({"swing": np.array([0.0, 0.035, 0.0])}, "found: aileron moves by itself"),
    ],
)
def test_what_became_of_the_commands_is_said(flight, change, line):
    aircraft, _, fly = flight
    gentle = aircraft.command
    aircraft.command = lambda: 2.0 * gentle()
    for name, value in change.items():
        setattr(aircraft, name, value)
    assert line in [said for _, said in fly(400)]


def test_a_surface_that_stops_is_said_with_its_ends(flight):
    aircraft, _, fly = flight
    gentle = aircraft.command
    aircraft.command = lambda: 3.0 * gentle()
    aircraft.low[1], aircraft.high[1] = -0.02, 0.03
    lines = [line for _, line in fly(800)]
    assert any(line.startswith("found: aileron stops at -1.") and line.endswith("1.7 deg") for line in lines), lines
    assert len(lines) <= 3


def test_what_does_not_hold_is_not_said(flight):
    _, found, fly = flight
    found.evidence.believed = 1
    assert fly(40) == []


def test_every_line_fits_the_link():
    lines = [describe(each, DT) for name in PRESETS for each in hypotheses(PRESETS[name], DT)]
    ends = Range()
    for known in ([True, False], [False, True], [True, True], [False, False]):
        ends.known, ends.reach = known, list(ALL)
        lines += [describe_range(surface, ends) for surface in range(3)]
    assert max(len(f"suspected: {line}") for line in lines) <= TEXT
    effects = [describe_effect(surface, value) for surface in range(3) for value in (-12.34, 0.0, 1.0, 0.5, 12.34)]
    assert max(len(f"found: {line}") for line in effects) <= TEXT
    assert describe_range(0, _at(0.03)) == f"{SURFACES[0]} stands still at 1.7 deg"


def _at(place):
    found = Range()
    found.known, found.reach = [True, True], [place, place]
    return found


def test_an_alarm_is_called_so_only_when_it_is_counted():
    said, found = [], SimpleNamespace(alarmed=True, alarms=1)
    loop = SimpleNamespace(
        _alarms=0,
        _findings=SimpleNamespace(suspected=lambda: "suspected: x", look=lambda: ""),
        say=lambda sample, severity, line: said.append(line),
    )
    sample = Sample(0, 1, np.zeros(12))
    for _ in range(2):
        Loop.tell(loop, sample, found)
    loop._findings.look = lambda: 1 / 0
    Loop.tell(loop, sample, found)
    assert [line.partition(":")[0] for line in said] == ["alarm", "suspected", "suspected"]


def test_the_log_names_the_hypotheses_in_order(tmp_path):
    configuration = resolve("ensemble")
    recorder = Recorder(tmp_path / "f.ulg", configuration, "cast", ["a"], tuple(STATE)[:6], {})
    recorder._log.close()
    names = msgspec.json.decode(ULog(str(tmp_path / "f.ulg")).msg_info_dict["hypotheses"])
    assert names == [describe(each, DT) for each in hypotheses(configuration.adaptation, DT)]
    assert (names[0], names[1]) == ("commands are followed as they should", "commands 50 ms late")
    assert len(set(names)) == len(names)
