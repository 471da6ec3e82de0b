"""What ice does to the reference: identified from its iced recordings as what the clean aircraft leaves over."""

from __future__ import annotations

import numpy as np

from sim_bridge.aircraft.coefficients import Body, Icing, Term, YawDamper, evaluate
from sim_bridge.aircraft.recordings import Recording
from sim_bridge.aircraft.targets import force_samples, moment_samples

ALPHA_MAX = float(np.deg2rad(0.7 * 11.0))
"""Where the iced lift freezes [rad]: 30 % below the clean wing's largest angle of attack (thesis case F1)."""
KNEES = np.deg2rad(np.arange(8.5, 10.51, 0.05))
"""Candidates for the angle at which the clean lift curve steepens [rad]."""


def _hinge(alpha: np.ndarray, at: float) -> np.ndarray:
    return np.maximum(alpha - at, 0.0)


def identify_icing(recordings: list[Recording], clean: dict[str, list[Term]], body: Body, damper: YawDamper) -> Icing:
    """Return ice's drag, loss of lift and pitching moment, given the clean aircraft's terms."""
    alpha, lift_lost, drag, pitching = [], [], [], []
    for recording in recordings:
        data, target = force_samples(recording, body, damper)
        left_x, left_z = (target[axis] - evaluate(clean[axis], data) for axis in ("CX", "CZ"))
        sin, cos = np.sin(data["alpha"]), np.cos(data["alpha"])
        alpha.append(data["alpha"])
        lift_lost.append(left_z * cos - left_x * sin)
        drag.append(-left_x * cos - left_z * sin)
        data, target = moment_samples(recording, body, damper)
        pitching.append(target["Cm"] - evaluate(clean["Cm"], data))
    angles, lost = np.concatenate(alpha), np.concatenate(lift_lost)

    def misfit(knee: float) -> tuple[float, np.ndarray]:
        hinges = np.stack([_hinge(angles, ALPHA_MAX), _hinge(angles, knee)], axis=1)
        slopes, *_ = np.linalg.lstsq(hinges, lost, rcond=None)
        return float(((lost - hinges @ slopes) ** 2).sum()), slopes

    knee = min(KNEES, key=lambda candidate: misfit(candidate)[0])
    slope, slope_knee = misfit(knee)[1]
    moment = np.concatenate(pitching)
    return Icing(
        drag=float(np.concatenate(drag).mean()),
        lift_slope=float(slope),
        lift_slope_knee=float(slope_knee),
        knee=float(knee),
        pitching_moment=float(lost @ moment / (lost @ lost)),
    )
