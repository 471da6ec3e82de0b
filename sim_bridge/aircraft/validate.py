"""How close the aircraft comes to the reference: manoeuvres left out of the fit, trims and faults."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sim_bridge import presets
from sim_bridge.aircraft import identify
from sim_bridge.aircraft.build import build
from sim_bridge.aircraft.coefficients import YawDamper, load
from sim_bridge.aircraft.fly import SIGNALS, WINDOW, deviation, errors, fly_window, relative_rmse, window_starts
from sim_bridge.aircraft.recordings import FOLDER, load_case
from sim_bridge.aircraft.structure import aerodynamics
from sim_bridge.conditions import NOMINAL, FlightCondition
from sim_bridge.faults import AnyFault, CGShift
from sim_bridge.plant import Plant
from task.results import Claim, Result, Table
from task.state import ACTION, STATE, STATE_TABLE

REFERENCE_ELEVATOR = {"h2000_v90": -1.4186634, "h2000_v150": 0.7268706, "h10000_v90": -5.7441245}
"""Elevator that trims the reference on its 3 degree descent [deg]."""
LIMIT, LIMIT_SPEED, LIMIT_TRIM = 3.0, 8.0, 0.05
"""Targets: RMSE of V and of every other signal [% of its standard deviation], trim elevator [deg]."""
NAMES = [STATE_TABLE[signal].symbol for signal in SIGNALS]
STEP_DEGREES = np.rad2deg(1.0)


class FaultCase(NamedTuple):
    """One faulty set of recordings and the settings that stand for it."""

    case: str
    faults: Sequence[AnyFault]
    condition: FlightCondition
    meaning: str


FAULT_CASES = (
    FaultCase("ice", presets.F1, NOMINAL, "F1, ice"),
    FaultCase("cg", presets.F2, NOMINAL, "F2, CG 0.25 m aft"),
    FaultCase("cg_timed", (CGShift(aft=0.25, start=20.0),), NOMINAL, "CG 0.25 m aft from 20 s"),
    FaultCase("be", presets.F5, NOMINAL, "F5, elevator x 0.3"),
    FaultCase("gust", presets.R3_GUST, NOMINAL, "R3, gust 20-23 s"),
    FaultCase("cg_for", (), FlightCondition(flight_path=0.0), "level flight, no fault"),
)
EFFECT_SIGNALS = (STATE.V, STATE.alpha, STATE.theta)
"""In which a fault's effect is measured."""


def _row(label: str, values: np.ndarray) -> list[Any]:
    return [label, *(round(float(value), 2) for value in values)]


def leave_one_out(folder: Path, say: Callable[[str], None]) -> tuple[Table, list[Claim], int]:
    """Fit without each healthy manoeuvre in turn and fly it; return table, claims and the number of flights."""
    unknowns = aerodynamics()
    evidence = identify.gather_all(unknowns, folder)
    iced = load_case("ice", folder)
    rows, claims, flights = [], [], 0
    for case, condition in identify.TRIMS.items():
        recordings = [item.recording for item in evidence if item.recording.case == case]
        scale, windows = deviation(recordings), []
        for recording in recordings:
            rest = [item for item in evidence if item.recording is not recording]
            fitted = identify.identify(rest, unknowns, iced)
            with tempfile.TemporaryDirectory() as root:
                build(fitted, Path(root))
                flown = errors(Plant(root=Path(root)), recording, condition, fitted.yaw_damper)
            windows += flown
            rows.append(_row(recording.name, relative_rmse(flown, scale)))
            say(
                f"left out {recording.name}: " + ", ".join(f"{n} {v}" for n, v in zip(NAMES, rows[-1][1:], strict=True))
            )
        flights += len(windows)
        pooled = relative_rmse(windows, scale)
        rows.append(_row(f"{case}, all", pooled))
        for signal, value in zip(SIGNALS, pooled, strict=True):
            limit = LIMIT_SPEED if signal == STATE.V else LIMIT
            claims.append(
                Claim(
                    claim=f"{case}: {STATE_TABLE[signal].symbol} of manoeuvres left out of the fit, open loop, 20 s",
                    value=round(float(value), 2),
                    unit="% of standard deviation",
                    target=f"<= {limit:g}",
                    holds=bool(value <= limit),
                )
            )
    title = "Manoeuvres left out of the fit: RMSE in % of the signal's standard deviation"
    return Table(title=title, columns=["flight", *NAMES], rows=rows), claims, flights


def shipped(plant: Plant, damper: YawDamper, folder: Path) -> tuple[Table, int]:
    """Fly the committed aircraft over the recordings that it was fitted to."""
    rows, flights = [], 0
    for case, condition in identify.TRIMS.items():
        recordings = load_case(case, folder)
        windows = [window for recording in recordings for window in errors(plant, recording, condition, damper)]
        rows.append(_row(case, relative_rmse(windows, deviation(recordings))))
        flights += len(windows)
    title = "The aircraft as it is, over the recordings of its fit: RMSE in % of the signal's standard deviation"
    return Table(title=title, columns=["condition", *NAMES], rows=rows), flights


def trims(plant: Plant, folder: Path) -> tuple[Table, list[Claim]]:
    """Compare trims with the reference's."""
    rows, claims = [], []
    for case, condition in identify.TRIMS.items():
        plant.reset(condition)
        trim = plant.trim
        first = load_case(case, folder)[0]
        elevator = float(np.rad2deg(trim.action[ACTION.de]))
        difference = elevator - REFERENCE_ELEVATOR[case]
        rows.append(
            [
                case,
                round(elevator, 3),
                round(REFERENCE_ELEVATOR[case], 3),
                round(float(np.rad2deg(trim.x[STATE.alpha])), 3),
                round(float(np.rad2deg(first.x[0, STATE.alpha])), 3),
                round(trim.n1, 2),
                round(float(first.n1[0]), 2),
                round(trim.n2, 2),
                round(float(first.n2[0]), 2),
            ]
        )
        claims.append(
            Claim(
                claim=f"{case}: trim elevator less the reference's",
                value=round(difference, 4),
                unit="deg",
                target=f"within {LIMIT_TRIM:g}",
                holds=abs(difference) <= LIMIT_TRIM,
            )
        )
    columns = ["condition"]
    for name in ("elevator [deg]", "alpha [deg]", "N1 [%]", "N2 [%]"):
        columns += [name, "reference"]
    return Table(title="Trims on a 3 degree descent", columns=columns, rows=rows), claims


def fault_effects(plant: Plant, damper: YawDamper, folder: Path) -> tuple[list[Table], int]:
    """Compare each fault's response with its recording, and the change that the fault makes.

    The change is the flight less the healthy model's under the same inputs from the same state, over each window:
    ``size`` is the model's root mean square change over the recording's, ``likeness`` their correlation, sign included.
    """
    response, effect, flights = [], [], 0
    for fault_case in FAULT_CASES:
        recordings = load_case(fault_case.case, folder)
        windows, changes, recorded = [], [], []
        for recording in recordings:
            for start in window_starts(recording):
                faulty, healthy = (
                    fly_window(plant, recording, start, fault_case.condition, damper, faults)
                    for faults in (fault_case.faults, ())
                )
                truth = recording.x[start + 1 : start + 1 + len(faulty)]
                windows.append((faulty - truth)[:, SIGNALS])
                changes.append((faulty - healthy)[:, EFFECT_SIGNALS])
                recorded.append((truth - healthy)[:, EFFECT_SIGNALS])
        flights += len(windows)
        response.append(_row(f"{fault_case.case}: {fault_case.meaning}", relative_rmse(windows, deviation(recordings))))
        if fault_case.faults:
            effect.append([f"{fault_case.case}: {fault_case.meaning}", *_likeness(changes, recorded)])
    columns = ["fault"]
    for signal in EFFECT_SIGNALS:
        symbol = STATE_TABLE[signal].symbol
        columns += [f"{symbol}: change recorded", f"{symbol}: size", f"{symbol}: likeness"]
    return [
        Table(
            title="Faults: RMSE in % of the signal's standard deviation in that case",
            columns=["fault", *NAMES],
            rows=response,
        ),
        Table(
            title="Faults: the change they make (m/s, deg; size and likeness are 1 when equal)",
            columns=columns,
            rows=effect,
        ),
    ], flights


def _likeness(changes: list[np.ndarray], recorded: list[np.ndarray]) -> list[float]:
    model, truth = np.concatenate(changes), np.concatenate(recorded)
    cells: list[float] = []
    for column, signal in enumerate(EFFECT_SIGNALS):
        ours, theirs = model[:, column], truth[:, column]
        rms_ours, rms_theirs = np.sqrt((ours**2).mean()), np.sqrt((theirs**2).mean())
        unit = 1.0 if signal == STATE.V else STEP_DEGREES
        likeness = float((ours * theirs).mean() / (rms_ours * rms_theirs))
        cells += [round(float(rms_theirs * unit), 2), round(float(rms_ours / rms_theirs), 3), round(likeness, 3)]
    return cells


def speed(plant: Plant, steps: int = 50_000) -> tuple[float, float]:
    """Return steps per CPU second of :meth:`Plant.step` and of JSBSim's bare frame, each the best of three."""
    action = plant.trim.action

    def per_second(call: Callable[[], Any]) -> float:
        plant.reset()
        begin = time.process_time()
        for _ in range(steps):
            call()
        return steps / (time.process_time() - begin)

    rounds = [(per_second(lambda: plant.step(action)), per_second(plant.run_bare)) for _ in range(3)]
    return max(with_reading for with_reading, _ in rounds), max(bare for _, bare in rounds)


def validate(folder: Path = FOLDER, say: Callable[[str], None] = lambda line: None) -> Result:
    """Measure everything; ``say`` is told of progress. Raises UserError when recordings are missing."""
    begin = time.perf_counter()
    plant, damper = Plant(), load().yaw_damper
    trim_table, trim_claims = trims(plant, folder)
    fault_tables, fault_flights = fault_effects(plant, damper, folder)
    shipped_table, shipped_flights = shipped(plant, damper, folder)
    with_reading, bare = speed(plant)
    out_table, out_claims, out_flights = leave_one_out(folder, say)
    speed_claims = [
        Claim(claim="Plant.step, one instance", value=round(with_reading), unit="steps/s of CPU time"),
        Claim(claim="Plant.step over JSBSim's bare frame", value=round(with_reading / bare, 2), unit="-"),
    ]
    return Result(
        title="The aircraft against its reference",
        command="understudy aircraft validate",
        seconds=round(time.perf_counter() - begin, 1),
        runs=fault_flights + shipped_flights + out_flights,
        seeds=[],
        claims=[*out_claims, *trim_claims, *speed_claims],
        tables=[out_table, trim_table, *fault_tables, shipped_table],
        notes=[
            "Open loop at 100 Hz: the model starts from the recorded state and engine speeds and flies the recorded "
            f"deflections for {WINDOW:g} s; windows follow one another over each recording.",
            "The standard deviation is that of the recorded signal over all samples of all manoeuvres of the case.",
            "'Left out' means: the aerodynamics, thrust and engine speeds are fitted anew without that recording. The "
            "weights of the fit's smoothness were chosen by looking at these same figures.",
            "The reference lets a gust change the size of lift and drag but not their direction; preset R3 does the "
            "same, a gust is otherwise turned with the air.",
            "The speed is that of the machine of the day, shared with others; the ratio is what travels.",
        ],
    )
