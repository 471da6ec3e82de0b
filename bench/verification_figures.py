"""The pictures of ``bench.verification``: thesis figures 9.1, 9.2 and 9.3b on our plant."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from export.training.gymnasium_run import Point
from scenarios.panels import STYLE as PANELS
from task.limits import DT
from task.state import ACTION, REFERENCE, STATE

STYLE: Any = PANELS


def draw_step(states: np.ndarray, step_at: float, title: str) -> Figure:
    """Draw the answer (T, 12) to an elevator step at ``step_at`` [s] (thesis figure 9.1)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.6), layout="constrained")
        t = np.arange(len(states)) * DT
        panels = figure.subplots(2, 2, sharex=True).ravel()
        shown = (
            ("θ [deg]", np.degrees(states[:, STATE.theta])),
            ("q [deg/s]", np.degrees(states[:, STATE.q])),
            ("α [deg]", np.degrees(states[:, STATE.alpha])),
            ("V [m/s]", states[:, STATE.V]),
        )
        for axes, (label, signal) in zip(panels, shown, strict=True):
            axes.plot(t, signal)
            axes.axvline(step_at, color="#CC79A7", lw=1.0)
            axes.set_ylabel(label)
        for axes in panels[2:]:
            axes.set_xlabel("time [s]")
        figure.suptitle(title, fontsize=9.5)
        return figure


def draw_pids(states: np.ndarray, commands: np.ndarray, reference: np.ndarray) -> Figure:
    """Draw states (T, 12) against their reference (T, 3), and the commands (T, 3) [rad] (thesis figure 9.2)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.6), layout="constrained")
        t = np.arange(len(states)) * DT
        top, bottom = figure.subplots(2, 3, sharex=True)
        for axes, channel, state, label in (
            (top[0], REFERENCE.theta, STATE.theta, "θ [deg]"),
            (top[1], REFERENCE.phi, STATE.phi, "φ [deg]"),
            (top[2], REFERENCE.beta, STATE.beta, "β [deg]"),
        ):
            axes.plot(t, np.degrees(states[:, state]), label="flown")
            axes.plot(t, np.degrees(reference[:, channel]), "--", color="#1b1b1b", lw=0.9, label="reference")
            axes.set_ylabel(label)
        for axes, surface, label in zip(bottom, ACTION, ("elevator", "aileron", "rudder"), strict=True):
            axes.plot(t, np.degrees(commands[:, surface]), color="#D55E00")
            axes.set_ylabel(f"{label} [deg]")
            axes.set_xlabel("time [s]")
        top[0].legend(loc="upper right")
        return figure


def draw_learning(points: list[Point], pid: np.ndarray, thesis: float) -> Figure:
    """Draw the agent's curve beside the PID's returns (E,) and the thesis's mean return (thesis figure 9.3b)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.2), layout="constrained")
        axes = figure.subplots()
        x = np.array([p.frames for p in points]) / 1e3
        mean, sd = np.array([p.learner for p in points]), np.array([p.learner_sd for p in points])
        axes.plot(x, mean, label="TD3, validation episodes")
        axes.fill_between(x, mean - sd, mean + sd, alpha=0.2, lw=0)
        axes.axhline(pid.mean(), color="#8c6d31", lw=1.0, ls="--", label="pitch PID")
        axes.axhline(thesis, color="#767676", lw=1.0, ls=":", label="thesis's agent, thesis's plant")
        axes.set(xlabel="frames [thousand]", ylabel="return of 20 s", ylim=(max(float(mean.min()), -400.0), 5.0))
        axes.legend(loc="lower right")
        return figure


def draw_pendulum(curves: dict[str, list[Point]], colours: dict[str, str]) -> Figure:
    """Draw who learns to swing the pendulum up, and when: champions on the validation episodes."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.0), layout="constrained")
        axes = figure.subplots()
        for name, points in curves.items():
            x = np.array([p.frames for p in points]) / 1e3
            mean, sd = np.array([p.champion for p in points]), np.array([p.champion_sd for p in points])
            axes.plot(x, mean, color=colours[name], label=name)
            axes.fill_between(x, mean - sd, mean + sd, color=colours[name], alpha=0.15, lw=0)
        axes.set(xlabel="frames [thousand]", ylabel="return of an episode", xlim=(0.0, None), ylim=(-1700.0, 0.0))
        axes.legend(loc="lower right")
        return figure
