"""What the structured adaptation saves and what it costs, flown in process on the plant.

``python -m bench.structured`` flies a cast of two linear laws and the first one's mirrors through reversed surfaces,
with ideal sensors and with gyro noise, beside the first law alone and the right mirror from the fault on, and writes
``results/structured.json``.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from export.folder import write_population
from export.mirrors import with_mirrors
from export.network import Layer, Network, flatten
from export.population import Description, Member, Population
from export.prior import model_prior
from export.rates import rate_model
from runtime.config import resolve
from runtime.link import LOST, OVER, Sample
from runtime.population import Population as Loaded
from runtime.population import load_population
from runtime.reference import RecordedReference
from runtime.session import Session
from sim_bridge.air import Air, Turbulence
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.plant import Plant
from task.limits import DT
from task.metrics import nmae
from task.observation import tracking_error
from task.reference import FamilyName, random_reference
from task.results import Claim, Result, Table, write
from task.reward import terminated
from task.state import ACTION, N_ACTION, N_IDENTIFIED, N_OBSERVATION, OBSERVATION, STATE

GYRO = 6.3e-4
"""Standard deviation of the gyros' noise in the thesis's case R3 [rad/s]."""
FAULT_AT = 5.0
"""When the surfaces fail [s]."""
FAULTS: dict[str, tuple[float, float, float]] = {
    "none": (1.0, 1.0, 1.0),
    "elevator -1": (-1.0, 1.0, 1.0),
    "aileron -1": (1.0, -1.0, 1.0),
    "elevator and aileron -1": (-1.0, -1.0, 1.0),
    "elevator -0.3": (-0.3, 1.0, 1.0),
    "elevator x0.3": (0.3, 1.0, 1.0),
    "rudder -1": (1.0, 1.0, -1.0),
}
TRIM_ELEVATOR = -0.02477
"""Of the nominal flight [rad]."""


class Condition(NamedTuple):
    """What a flight meets besides its fault."""

    noise: float = 0.0
    turbulence: Turbulence = "none"
    family: FamilyName = "evaluation"
    start: FlightCondition = NOMINAL
    duration: float = 20.0


class Flight(NamedTuple):
    """What came of one flight."""

    survived: bool
    nmae: float
    """From the fault to the end [%]; up to the loss when it was lost."""
    alarm: float
    """From the fault to the first alarm after it [s]; NaN without."""
    cast: float
    """From the fault until the right member flies for good [s]; NaN when it does not at the end."""
    alarms: int
    switches: int


class PlantLink:
    """The plant as a link in lockstep, with surfaces that fail and gyros that are noisy."""

    skipped = repeated = 0

    def __init__(self, plant: Plant, effect: tuple[float, ...], condition: Condition, seed: int) -> None:
        self.ended = ""
        self._plant, self._effect, self._condition = plant, np.array(effect), condition
        self._rng = np.random.default_rng([seed, 1])
        self._ticks = round(condition.duration / DT)
        self._tick = 0
        plant.reset(condition.start, air=Air(turbulence=condition.turbulence), seed=seed)
        self.x = [plant.x[:N_IDENTIFIED].copy()]

    def read(self, timeout: float) -> Sample | None:
        """Return the measured state."""
        if self._tick >= self._ticks:
            self.ended = OVER
        elif terminated(self._plant.x):
            self.ended = LOST
        if self.ended:
            return None
        x = self._plant.x.copy()
        x[: STATE.V] += self._condition.noise * self._rng.standard_normal(3)
        return Sample(round(1e6 * DT) * self._tick, 1, x)

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Step the plant."""
        command = np.asarray(action, dtype=float)
        self._plant.step(command * self._effect if self._tick * DT >= FAULT_AT else command)
        self._tick += 1
        self.x.append(self._plant.x[:N_IDENTIFIED].copy())

    def say(self, text: str, severity: int) -> None:
        """Say nothing."""

    def diagnosis(self) -> str:
        """Return what is at the other end."""
        return "the plant"

    def close(self) -> None:
        """Leave the plant to the next flight."""


def linear_cast() -> Population:
    """Return two linear laws, ``good`` the champion and ``lazy`` with a quarter of its gains, and good's mirrors."""
    network = Network(layers=(Layer(units=N_ACTION, activation="linear"),), action_scale=(1.0,) * N_ACTION)
    weights = np.zeros((2, N_ACTION, N_OBSERVATION))
    for weight, gain in zip(weights, (1.0, 0.25), strict=True):
        weight[ACTION.de, OBSERVATION.theta_e], weight[ACTION.de, OBSERVATION.q] = -0.8 * gain, 0.4 * gain
        weight[ACTION.da, OBSERVATION.phi_e], weight[ACTION.da, OBSERVATION.p] = -0.6 * gain, 0.2 * gain
        weight[ACTION.dr, OBSERVATION.beta_e] = 0.3
    bias = np.tile([TRIM_ELEVATOR, 0.0, 0.0], (2, 1))
    description = Description(
        network=network, members=(Member(name="good", scores={}), Member(name="lazy", scores={})), champion="good",
        training={},
    )  # fmt: skip
    parameters = flatten(network, {"layers.0.weight": weights, "layers.0.bias": bias})
    return with_mirrors(Population(description, parameters), "linear cast")


def right_member(effect: tuple[float, ...]) -> str:
    """Return the member that an oracle would fly."""
    letters = "".join(letter for letter, factor in zip("ear", effect, strict=True) if factor < 0.0)
    return f"good/-{letters}" if letters else "good"


class Bench:
    """One plant, one cast, one folder for logs."""

    def __init__(self, cast: Loaded, folder: Path) -> None:
        self._cast, self._log, self._plant = cast, folder / "flight.ulg", Plant()
        self.flown = 0
        """Flights so far."""

    def fly(self, effect: tuple[float, ...], condition: Condition, seed: int, method: str) -> Flight:
        """Fly one reference; method: ``structured``, ``none`` (the champion alone) or ``oracle``.

        The oracle is the champion on surfaces whose sign is right: a mirror is exact, so that this is the right mirror
        from the moment of the fault.
        """
        link = PlantLink(self._plant, tuple(np.abs(effect)) if method == "oracle" else effect, condition, seed)
        rows = random_reference(
            np.random.default_rng(seed), condition.duration, float(link.x[0][STATE.theta]), condition.family
        )
        events: list[tuple[float, str]] = []

        def heard(line: str) -> None:
            at, _, text = line.partition(" s: ")
            if text.startswith("alarm") or " switch to " in text:
                events.append((float(at) - FAULT_AT, text))

        configuration = resolve("structured") if method == "structured" else resolve("understudy", switch="none")
        with Session(link, self._cast, RecordedReference(rows), configuration, self._log, heard) as session:
            (flown,) = session.fly()
        self.flown += 1
        x = np.array(link.x[:-1])
        error = tracking_error(x, rows[: len(x)])[round(FAULT_AT / DT) :]
        alarms = [at for at, text in events if text.startswith("alarm") and at >= 0.0]
        switches = [(at, text.split(" switch to ")[1].split(":")[0]) for at, text in events if " switch to " in text]
        there = [at for at, member in switches[-1:] if member == right_member(effect)]
        return Flight(
            flown.outcome == OVER,
            nmae(error) if len(error) else float("nan"),
            alarms[0] if alarms else float("nan"),
            there[0] if there else float("nan"),
            flown.summary.alarms,
            flown.summary.switches,
        )


def spread(values: list[float]) -> str:
    """Return median and worst of the finite values, as text."""
    known = [v for v in values if np.isfinite(v)]
    return f"{np.median(known):.2f} ({max(known):.2f})" if known else "-"


def fault_rows(
    bench: Bench, faults: list[str], conditions: dict[str, Condition], references: int
) -> list[list[object]]:
    """Return one row for each fault and condition."""
    rows: list[list[object]] = []
    for fault in faults:
        for name, condition in conditions.items():
            flown = {
                method: [bench.fly(FAULTS[fault], condition, seed, method) for seed in range(references)]
                for method in ("none", "structured", "oracle")
                if method != "oracle" or min(FAULTS[fault]) < 0.0
            }
            flown.setdefault("oracle", flown["none"])  # no surface is reversed: the champion is the right member
            ours = flown["structured"]
            rows.append([
                fault, name,
                *(f"{sum(f.survived for f in flights)} of {references}" for flights in flown.values()),
                *(spread([f.nmae for f in flights if f.survived]) for flights in flown.values()),
                spread([f.alarm for f in ours]), spread([f.cast for f in ours]),
                sum(f.switches for f in ours),
            ])  # fmt: skip
            click.echo("  ".join(str(cell) for cell in rows[-1]))
    return rows


def quiet_rows(bench: Bench, references: int) -> list[list[object]]:
    """Return one row for each condition of a healthy aircraft: alarms, switches and what they did."""
    cases = {
        "evaluation": Condition(duration=60.0),
        "aggressive": Condition(duration=60.0, family="aggressive"),
        "150 m/s": Condition(duration=60.0, start=R1),
        "10 000 m": Condition(duration=60.0, start=R2),
        "light turbulence": Condition(duration=60.0, turbulence="light"),
        "moderate turbulence": Condition(duration=60.0, turbulence="moderate"),
    }
    rows: list[list[object]] = []
    for name, case in cases.items():
        for noise in (0.0, GYRO):
            condition = case._replace(noise=noise)
            ours = [bench.fly(FAULTS["none"], condition, seed, "structured") for seed in range(references)]
            alone = [bench.fly(FAULTS["none"], condition, seed, "none") for seed in range(references)]
            rows.append([
                name, "ideal" if noise == 0.0 else "gyro noise", references * condition.duration / 60.0,
                sum(f.alarms for f in ours), sum(f.switches for f in ours),
                f"{sum(f.survived for f in alone)} of {references}", f"{sum(f.survived for f in ours)} of {references}",
                spread([f.nmae for f in alone if f.survived]), spread([f.nmae for f in ours if f.survived]),
            ])  # fmt: skip
            click.echo("  ".join(str(cell) for cell in rows[-1]))
    return rows


@click.command()
@click.option("--references", default=6, show_default=True, help="Random references for each fault and condition.")
@click.option("--quiet", default=2, show_default=True, help="Faultless flights of 60 s for each condition.")
def main(references: int, quiet: int) -> None:
    """Measure survival, times and false alarms; write results/structured.json."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        write_population(linear_cast(), model_prior(), Path(folder) / "cast", rates=rate_model())
        bench = Bench(load_population(Path(folder) / "cast"), Path(folder))
        still = {"ideal": Condition(), "gyro noise": Condition(noise=GYRO)}
        faults = fault_rows(bench, list(FAULTS), still, references)
        click.echo("turbulence")
        rough = {f"{level} turbulence, gyro noise": Condition(GYRO, level) for level in ("light", "moderate")}
        reversals = [f for f in FAULTS if f.endswith(" -1") and f != "rudder -1"]
        turbulent = fault_rows(bench, reversals, rough, references)
        healthy = quiet_rows(bench, quiet)
    reversed_rows = [row for row in faults if row[0] in reversals]
    survived = sum(int(str(row[3]).split()[0]) for row in reversed_rows)
    flights = references * len(reversed_rows)
    alone = sum(int(str(row[2]).split()[0]) for row in reversed_rows)
    calm = [row for row in healthy if "turbulence" not in str(row[0])]
    columns = [
        "fault at 5 s", "condition", "survive: alone", "structured", "oracle", "nMAE %: alone", "structured", "oracle",
        "alarm [s]", "right member [s]", "switches",
    ]  # fmt: skip
    result = Result(
        title="Structured adaptation: reversed surfaces",
        command=f"python -m bench.structured --references {references} --quiet {quiet}",
        seconds=round(time.perf_counter() - began, 1),
        runs=bench.flown,
        seeds=list(range(references)),
        claims=[
            Claim(claim="reversed elevator, aileron or both survived, still air", value=f"{survived} of {flights}",
                  target="all", holds=survived == flights),
            Claim(claim="the same without adaptation", value=f"{alone} of {flights}"),
            Claim(claim="alarms in faultless still air", value=sum(int(str(row[3])) for row in calm),
                  unit=f"in {sum(float(str(row[2])) for row in calm):g} min", target="none",
                  holds=not any(row[3] for row in calm)),
        ],
        tables=[
            Table(title="Still air, evaluation references of 20 s", columns=columns, rows=faults),
            Table(title="Turbulence (Dryden), evaluation references of 20 s", columns=columns, rows=turbulent),
            Table(title="Faultless flights",
                  columns=["condition", "sensors", "minutes", "alarms", "switches", "survive: alone", "structured",
                           "nMAE %: alone", "structured"], rows=healthy),
        ],
        notes=[
            "The cast: two linear laws on the policy's seven observations and the first one's seven mirrors. It shows "
            "the mechanism, not a trained population.",
            "nMAE: from the fault to the end, survivors only, median (worst). Times: from the fault, median (worst).",
            "The oracle flies the right mirror from the moment of the fault.",
            "Ideal sensors, or gyro noise of 6.3e-4 rad/s on p, q, r; no other sensor errors.",
        ],
    )  # fmt: skip
    click.echo(f"{write('structured', result)}: {result.seconds:.0f} s")


if __name__ == "__main__":
    main()
