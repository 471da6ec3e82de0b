"""What a policy sees of the aircraft (thesis eq. 11)."""

from __future__ import annotations

import numpy as np

from task.state import N_OBSERVATION, OBSERVATION, REFERENCE, STATE, TRACKED

_TRACKED = [int(i) for i in TRACKED]
_RATES = slice(STATE.p, STATE.r + 1)
_RATES_OBSERVED = slice(OBSERVATION.p, OBSERVATION.r + 1)


def tracking_error(x: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return e = reference - state for theta, phi, beta [rad] (eq. 12).

    x: (..., >=8) aircraft state; reference: (..., 3) theta, phi, beta [rad]; result (..., 3).
    """
    return reference - x[..., _TRACKED]


def observation(x: np.ndarray, reference: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Return s = [theta_e, phi_e, beta_e, p, q, r, alpha] (eq. 11), shape (..., 7).

    x: (..., >=8) aircraft state; reference: (..., 3) [rad]. ``out`` is filled in place when given.
    """
    if out is None:
        out = np.empty((*x.shape[:-1], N_OBSERVATION), dtype=np.result_type(x, reference))
    out[..., OBSERVATION.theta_e] = reference[..., REFERENCE.theta] - x[..., STATE.theta]
    out[..., OBSERVATION.phi_e] = reference[..., REFERENCE.phi] - x[..., STATE.phi]
    out[..., OBSERVATION.beta_e] = reference[..., REFERENCE.beta] - x[..., STATE.beta]
    out[..., _RATES_OBSERVED] = x[..., _RATES]
    out[..., OBSERVATION.alpha] = x[..., STATE.alpha]
    return out
