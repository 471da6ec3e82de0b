"""The thesis's verifications of section 9.2 and 9.3 again, on our plant; and the learners on the pendulum.

``python -m bench.verification`` gives the aircraft an elevator step, flies the three tuned PIDs through the base case,
flies the pitch-only TD3 agent beside the pitch PID, swings the pendulum up, and writes ``results/verification.json``
and ``docs/img/verification_*.png``. ``understudy train`` of pitch_td3, pendulum_ddpg and pendulum_pderl comes first.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from scipy.optimize import curve_fit

from bench.verification_figures import draw_learning, draw_pendulum, draw_pids, draw_step
from export.training.config import EnvironmentSettings
from export.training.gymnasium_rollouts import GymnasiumRollouts
from export.training.gymnasium_run import BANDS, load_agents, read_bands
from export.verification.pitch import ID, PitchEnv
from runtime.laws.catalogue import load_settings, make_law
from scenarios.figures import save
from sim_bridge.plant import Plant
from task.errors import UserError
from task.limits import DT
from task.metrics import channel_nmae
from task.observation import tracking_error
from task.reference import BASE_PHI, BASE_THETA, base_reference, n_samples
from task.results import Claim, Result, Table, write
from task.state import ACTION, REFERENCE, STATE

STEP = math.radians(0.5)
"""Elevator step of thesis figure 9.1 [rad]."""
STEP_AT = 5.0
STEP_DURATION = 120.0
SETTLED = 20.0
"""From here [s] on the phugoid is alone and is fitted."""
PID_DURATION = 80.0
GRAVITY = 9.80665
THESIS_RETURN = (-30.0, 6.6)
"""Episodic return of the thesis's agent: mean and deviation."""
SEED = 9
"""Of the references on which agent and PID are compared."""


PENDULUM = {"DDPG": "#D55E00", "PDERL": "#0072B2"}
"""Who swings the pendulum, and their colours."""
PENDULUM_SOLVED = -200.0
"""Mean return from which on the pendulum counts as swung up and held; the best there is depends on the start."""


def seeds(count: int) -> np.ndarray:
    """Return the seeds of ``count`` episodes of the tests, (count,) int64."""
    return np.random.default_rng(SEED).integers(2**31, size=count)


class Phugoid(NamedTuple):
    """A damped oscillation fitted to the airspeed."""

    period: float
    """[s]"""
    damping: float
    """Ratio [-]."""
    speed: float
    """Mean airspeed of the oscillation [m/s]."""
    residual: float
    """Root mean square of what the fit leaves [m/s]."""

    @property
    def lanchester(self) -> float:
        """Return the period that an exchange of height and speed alone would have, pi sqrt(2) V / g [s]."""
        return math.pi * math.sqrt(2.0) * self.speed / GRAVITY


def elevator_step() -> np.ndarray:
    """Return the states (T, 12) after a step on the elevator; aileron and rudder stay at zero, nobody steers."""
    plant = Plant()
    states = [plant.reset().copy()]
    command = plant.trim.action.copy()
    for k in range(n_samples(STEP_DURATION) - 1):
        if k == n_samples(STEP_AT):
            command[ACTION.de] += STEP
        states.append(plant.step(command).copy())
    return np.array(states)


def fit_phugoid(speed: np.ndarray) -> Phugoid:
    """Fit a damped oscillation about a drifting mean to an airspeed (T,) [m/s] sampled at 100 Hz."""
    t = np.arange(len(speed)) * DT

    def model(t: np.ndarray, mean: float, drift: float, size: float, decay: float, omega: float, phase: float) -> Any:
        return mean + drift * t + size * np.exp(-decay * t) * np.sin(omega * t + phase)

    start = (speed.mean(), 0.0, np.ptp(speed) / 2.0, 0.01, 2.0 * math.pi / 45.0, 0.0)
    fitted, _ = curve_fit(model, t, speed, p0=start, maxfev=20_000)
    mean, drift, _, decay, omega, _ = fitted.tolist()
    residual = float(np.sqrt(np.mean((model(t, *fitted) - speed) ** 2)))
    natural = math.hypot(omega, decay)
    return Phugoid(2.0 * math.pi / abs(omega), decay / natural, mean + drift * float(t[-1]) / 2.0, residual)


class Tracked(NamedTuple):
    """A flight of the three PIDs."""

    states: np.ndarray
    """(T, 12)."""
    commands: np.ndarray
    """(T, 3) [rad]."""
    reference: np.ndarray
    """(T, 3) [rad]."""

    def overshoot(self, channel: REFERENCE, levels: np.ndarray) -> float:
        """Return the largest excess beyond a level of the base case over the size of its step, 0 to 1."""
        state = {REFERENCE.theta: STATE.theta, REFERENCE.phi: STATE.phi}[channel]
        block = len(self.states) // (len(levels) - 1)
        worst = 0.0
        for i, (before, level) in enumerate(zip((0.0, *levels), levels[:-1], strict=False)):
            part = slice(i * block, (i + 1) * block)
            size = level - before
            if abs(size) > math.radians(1.0):
                final = self.reference[part, channel][-1]
                beyond = np.sign(size) * (self.states[part, state] - final)
                worst = max(worst, float(beyond.max() / abs(size)))
        return worst


def fly_pids() -> Tracked:
    """Fly the tuned PIDs of pitch, roll and sideslip through the base case in nominal conditions."""
    plant, law = Plant(), make_law("pid", load_settings())
    x = plant.reset()
    reference = base_reference(PID_DURATION, float(plant.trim.x[STATE.theta]))
    states, commands = [], []
    for row in reference:
        commands.append(law.steer(x, row).copy())
        states.append(plant.step(commands[-1]).copy())
    return Tracked(np.array(states), np.array(commands), reference)


def pitch_pid(tasks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pitch PID's returns (E,) and mean absolute pitch errors (E,) [rad] on the agent's episodes."""
    env, plant = PitchEnv(), None
    returns, errors = [], []
    for seed in tasks:
        seen, _ = env.reset(seed=int(seed))
        plant, law = env.plant, make_law("pid", load_settings())
        total, error, over, k = 0.0, [], False, 0
        while not over:
            wanted = np.array([env.reference[min(k, len(env.reference) - 1)], 0.0, 0.0])
            action = law.steer(plant.x, wanted)[[ACTION.de]]
            seen, reward, lost, ended, _ = env.step(action)
            total, over, k = total + reward, lost or ended, k + 1
            error.append(abs(float(seen[0])))
        returns.append(total)
        errors.append(float(np.mean(error)))
    return np.array(returns), np.array(errors)


class Agent(NamedTuple):
    """The pitch-only TD3 agent on unseen episodes."""

    returns: np.ndarray
    """(E,)."""
    error: np.ndarray
    """(E,) mean absolute pitch error [rad]."""
    lost: int
    theta_error: np.ndarray
    """(T,) pitch error of the first episode [rad]."""
    training: dict[str, Any]


def fly_agent(folder: Path, tasks: np.ndarray) -> Agent:
    """Fly the champion of a run on the episodes of the seeds ``tasks``."""
    population = load_agents(folder)
    if population.network.observation != len(PitchEnv().observation_space.sample()):
        raise UserError(f"{folder}: expected an agent of pitch alone; train it with 'understudy train pitch_td3'")
    rollouts = GymnasiumRollouts(EnvironmentSettings(id=ID))
    flights = rollouts.fly(population.network, population.parameters[[population.champion]], tasks)
    error = np.where(flights.flown(), np.abs(flights.observation[1:, ..., 0]), 0.0).sum(axis=0) / flights.length
    return Agent(
        flights.returns()[0],
        error[0],
        int(flights.lost.sum()),
        flights.observation[:, 0, 0, 0],
        population.description.training,
    )


def swing(folder: Path, tasks: np.ndarray) -> np.ndarray:
    """Return the returns (E,) of a run's champion on the pendulum."""
    population = load_agents(folder)
    rollouts = GymnasiumRollouts(EnvironmentSettings(id="Pendulum-v1"))
    return rollouts.fly(population.network, population.parameters[[population.champion]], tasks).returns()[0]


def claims(states: np.ndarray, phugoid: Phugoid, flown: Tracked, agent: Agent, pid: np.ndarray) -> list[Claim]:
    """Return what is claimed of plant, PIDs and agent."""
    after = states[n_samples(STEP_AT) : n_samples(STEP_AT + 1.0)]
    down = math.degrees(after[-1, STATE.theta] - after[0, STATE.theta])
    roll = math.degrees(float(np.abs(states[:, STATE.phi]).max()))
    ratio = phugoid.period / phugoid.lanchester
    theta, phi = flown.overshoot(REFERENCE.theta, BASE_THETA), flown.overshoot(REFERENCE.phi, BASE_PHI)
    beta = math.degrees(float(np.abs(flown.states[:, STATE.beta]).max()))
    nmae = channel_nmae(tracking_error(flown.states, flown.reference))
    mean, sd = float(agent.returns.mean()), float(agent.returns.std())
    return [
        Claim(
            claim="elevator +0.5 deg: pitch one second later",
            value=round(down, 2),
            unit="deg",
            target="below 0",
            holds=down < 0.0,
        ),
        Claim(
            claim="elevator +0.5 deg: period of the phugoid over Lanchester's",
            value=round(ratio, 3),
            unit="x",
            target="0.75 to 1.25",
            holds=0.75 <= ratio <= 1.25,
        ),
        Claim(
            claim="elevator +0.5 deg: damping ratio of the phugoid",
            value=round(phugoid.damping, 4),
            target="above 0 and below 0.2: slowly damped",
            holds=0.0 < phugoid.damping < 0.2,
        ),
        Claim(
            claim="elevator +0.5 deg: largest bank in 120 s",
            value=round(roll, 6),
            unit="deg",
            target="below 0.01: pitch alone does not roll",
            holds=roll < 0.01,
        ),
        Claim(
            claim="PIDs: overshoot of the worst step in theta, of its size",
            value=round(100.0 * theta, 2),
            unit="%",
            target="below 10",
            holds=theta < 0.1,
        ),
        Claim(
            claim="PIDs: overshoot of the worst step in phi, of its size",
            value=round(100.0 * phi, 2),
            unit="%",
            target="below 10",
            holds=phi < 0.1,
        ),
        Claim(claim="PIDs: largest sideslip", value=round(beta, 3), unit="deg"),
        Claim(claim="PIDs: nMAE of theta, phi, beta", value=round(100.0 * float(nmae.mean()), 3), unit="%"),
        Claim(
            claim="pitch-only TD3: mean return of 20 s", value=round(mean, 1), target="-30 or more", holds=mean >= -30.0
        ),
        Claim(claim="pitch-only TD3: standard deviation of the return", value=round(sd, 1)),
        Claim(
            claim="pitch-only TD3: episodes lost",
            value=agent.lost,
            unit=f"of {len(agent.returns)}",
            target="0",
            holds=not agent.lost,
        ),
        Claim(claim="pitch PID on the same episodes: mean return", value=round(float(pid.mean()), 1)),
    ]


@click.command()
@click.option("--runs", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, help="Trained.")
@click.option("--episodes", type=click.IntRange(1), default=30, show_default=True, help="Of each agent's test.")
def main(runs: Path, episodes: int) -> None:
    """Verify plant, PIDs and gradient learner as the thesis's chapter 9 does."""
    began = time.monotonic()
    pitch = runs / "pitch_td3"
    pendulum = {name: swing(runs / f"pendulum_{name.lower()}", seeds(episodes)) for name in PENDULUM}
    states = elevator_step()
    phugoid = fit_phugoid(states[n_samples(SETTLED) :, STATE.V])
    flown = fly_pids()
    tasks = seeds(episodes)
    agent = fly_agent(pitch, tasks)
    pid, pid_error = pitch_pid(tasks)
    points = read_bands(pitch / BANDS)
    pictures = Path("docs/img")
    title = f"Elevator +0.5 deg at 5 s: phugoid of {phugoid.period:.1f} s, damping ratio {phugoid.damping:.3f}"
    save(draw_step(states, STEP_AT, title), pictures / "verification_elevator_step.png")
    save(draw_pids(*flown), pictures / "verification_pid.png")
    save(draw_learning(points, pid, THESIS_RETURN[0]), pictures / "verification_pitch_td3.png")
    curves = {name: read_bands(runs / f"pendulum_{name.lower()}" / BANDS) for name in PENDULUM}
    save(draw_pendulum(curves, PENDULUM), pictures / "verification_pendulum.png")
    training = agent.training
    result = Result(
        title="Verification: plant, PIDs, gradient learner",
        command="python -m bench.verification",
        seconds=round(time.monotonic() - began, 1),
        runs=2 + (2 + len(PENDULUM)) * episodes,
        seeds=[SEED, training["seed"]],
        claims=claims(states, phugoid, flown, agent, pid)
        + [
            Claim(
                claim=f"pendulum, {name}: mean return",
                value=round(float(returns.mean()), 1),
                target=f"{PENDULUM_SOLVED:.0f} or more",
                holds=bool(returns.mean() >= PENDULUM_SOLVED),
            )
            for name, returns in pendulum.items()
        ],
        tables=[
            Table(
                title=f"Pitch alone: {episodes} episodes of 20 s that training has not seen",
                columns=["who", "return mean", "sd", "worst", "mean abs pitch error [deg]"],
                rows=[
                    [who, *(round(float(v), 2) for v in (r.mean(), r.std(), r.min(), math.degrees(e.mean())))]
                    for who, r, e in (("TD3", agent.returns, agent.error), ("PID", pid, pid_error))
                ]
                + [["TD3 of the thesis, its plant", *THESIS_RETURN, "", ""]],
            )
        ],
        notes=[
            "The thesis prints no gains of its PIDs and no amplitude of the pitch references; these are the gains of "
            "docs/laws.md and the amplitude of the training references (theta +-25 deg).",
            "The aircraft's auto-throttle holds the speed and so lengthens and damps the phugoid.",
            f"The agent: {training['frames']:,} frames, {training['updates']:,} critic updates, "
            f"{training['seconds']:.0f} s, one seed.",
        ],
    )
    for claim in result.claims:
        verdict = {True: "holds", False: "DOES NOT HOLD", None: ""}[claim.holds]
        click.echo(f"{claim.claim:62s} {claim.value!s:>10} {claim.unit:5s} {claim.target} {verdict}")
    click.echo(f"wrote {write('verification', result)}")
