"""The aircraft as a state vector: JSBSim behind SI units, trim, and the effects that faults drive.

Training, campaigns and the bridge step this one class. ``step`` sends the command, lets JSBSim run one
frame and reads the state. JSBSim propagates before it reads commands, so a command given with ``x[k]``
first moves the increment ``x[k+2] - x[k+1]`` (docs/architecture.md, "Time and the command lag").
"""

from __future__ import annotations

import math
import os
from typing import Any, NamedTuple

import jsbsim
import numpy as np

from sim_bridge.aircraft.build import MODEL_NAME, PLANET, ROOT
from sim_bridge.conditions import NOMINAL, FlightCondition
from sim_bridge.effects import Effects
from task.errors import UserError
from task.limits import DT
from task.state import ACTION, N_STATE, STATE

FT = 0.3048
"""One foot [m]."""
_TURN = 2.0 * math.pi
_EULER, _ADAMS_BASHFORTH_2, _ADAMS_BASHFORTH_3 = 1, 3, 4
"""JSBSim's numbers for its integrators."""
_INTEGRATORS = {
    # Commands are held over a frame: Euler's scheme integrates their moments exactly, and the moments are
    # identified for it (sim_bridge.aircraft.targets). Everything smooth is integrated to higher order.
    "rate/rotational": _EULER,
    "rate/translational": _ADAMS_BASHFORTH_2,
    "position/rotational": _ADAMS_BASHFORTH_2,
    "position/translational": _ADAMS_BASHFORTH_3,
}

_STEADY = ("accelerations/udot-ft_sec2", "accelerations/wdot-ft_sec2", "accelerations/qdot-rad_sec2")
"""What is zero in a trimmed flight."""
_TRIM_ROUNDS = 60
_TRIM_ACCURACY = 1e-9
"""Largest acceleration left in a trim [ft/s2, rad/s2]."""
_TRIM_STEPS = np.array([1e-4, 1e-4, 1e-3])
"""Differences for the slopes: alpha, elevator [rad], speed error [m/s]."""
_TRIM_STRIDE = np.array([0.05, 0.05, 0.2])
"""Longest Newton step in each."""

_COMMANDS = {
    ACTION.de: "fcs/elevator-command-rad",
    ACTION.da: "fcs/aileron-command-rad",
    ACTION.dr: "fcs/rudder-command-rad",
}


class Trim(NamedTuple):
    """A steady flight."""

    x: np.ndarray
    """State, shape (12,), in the order of :class:`task.state.STATE`."""
    action: np.ndarray
    """Deflections that hold it [rad], shape (3,)."""
    n1: float
    """Fan speed of the engines [%]."""
    n2: float
    """Core speed of the engines [%]."""


class Plant:
    """One aircraft. Many may live in one process; each is deterministic and independent of its history.

    ``step`` never raises: a flight that is lost shows as a non-finite state.
    """

    def __init__(self, dt: float = DT) -> None:
        """Load the aircraft with the time step ``dt`` [s] and reset it to the nominal condition."""
        os.environ.setdefault("JSBSIM_DEBUG", "0")  # otherwise every instance prints JSBSim's banner
        fdm = jsbsim.FGFDMExec(str(ROOT), None)
        fdm.set_debug_level(0)
        fdm.load_planet(str(PLANET), False)
        fdm.set_dt(dt)  # before the model is loaded: its integrators keep the step they are loaded with
        fdm.load_model(MODEL_NAME)
        self.dt = dt
        self._fdm = fdm
        self._run = fdm.run
        self._time = fdm.get_sim_time
        manager = fdm.get_property_manager()

        def node(name: str) -> Any:
            return manager.get_node(name)

        self._set_de, self._set_da, self._set_dr = (node(_COMMANDS[a]).set_double_value for a in ACTION)
        self._read = tuple(
            node(name).get_double_value
            for name in (
                "velocities/p-rad_sec",
                "velocities/q-rad_sec",
                "velocities/r-rad_sec",
                "velocities/u-fps",
                "velocities/v-fps",
                "velocities/w-fps",
                "attitude/phi-rad",
                "attitude/theta-rad",
                "attitude/psi-rad",
                "position/h-sl-meters",
                "position/from-start-neu-n-ft",
                "position/from-start-neu-e-ft",
            )
        )
        self._n2 = node("propulsion/n2-pct").get_double_value
        self._n1 = node("propulsion/n1-pct").get_double_value
        self._wind = tuple(
            node(f"atmosphere/total-wind-{axis}-fps").get_double_value for axis in ("north", "east", "down")
        )
        self.effects = Effects(fdm)
        self._x = np.zeros(N_STATE)
        self._north = self._east = self._psi = 0.0
        self._trims: dict[FlightCondition, Trim] = {}
        self.condition = NOMINAL
        self.trim = self._find_trim(NOMINAL)
        self.reset()

    def reset(
        self,
        condition: FlightCondition = NOMINAL,
        x: np.ndarray | None = None,
        action: np.ndarray | None = None,
        n1: float | None = None,
        n2: float | None = None,
        washout: float = 0.0,
    ) -> np.ndarray:
        """Start a flight and return its state (12,), the array that ``step`` reuses; clears every effect.

        condition: where to trim, and the speed that the auto-throttle holds. x (12,): state to start from,
        the trim's when not given; action (3,) [rad]: deflections before the first step, the trim's when not
        given; n1, n2 [%]: fan and core speed, the trim's when not given; washout [rad/s]: the yaw damper's low-passed
        yaw rate. Raises UserError for a condition that the aircraft cannot be trimmed to.
        """
        trim = self._trims.get(condition) or self._find_trim(condition)
        self.condition, self.trim = condition, trim
        start = trim.x if x is None else np.asarray(x, dtype=float)
        deflections = trim.action if action is None else np.asarray(action, dtype=float)
        self._initialise(start, deflections, condition.speed, trim.n1 if n1 is None else n1, trim.n2 if n2 is None else n2, washout)
        self._north, self._east = float(start[STATE.xe]), float(start[STATE.ye])
        self._psi = float(start[STATE.psi])
        self._update()
        return self._x

    def step(self, action: np.ndarray) -> np.ndarray:
        """Advance by ``dt`` with absolute deflections [rad], shape (3,); return the reused state (12,)."""
        de, da, dr = action.tolist()
        self._set_de(de)
        self._set_da(da)
        self._set_dr(dr)
        try:
            self._run()
        except Exception:  # JSBSim refuses a state that is not finite: the flight is lost, and x says so
            self._x.fill(math.nan)
            return self._x
        self._update()
        return self._x

    @property
    def x(self) -> np.ndarray:
        """State (12,), in the order of :class:`task.state.STATE`; the array that ``step`` reuses."""
        return self._x

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._time()

    @property
    def engine(self) -> tuple[float, float]:
        """Fan and core speed, N1 and N2 [%]."""
        return self._n1(), self._n2()

    @property
    def wind(self) -> np.ndarray:
        """Wind at the aircraft, gusts and turbulence included: north, east, down [m/s], shape (3,)."""
        return np.array([read() for read in self._wind]) * FT

    def _update(self) -> None:
        """Read JSBSim's state into x. V, alpha and beta are of the inertial velocity: wind is not in them."""
        p, q, r, u, v, w, phi, theta, psi, h, north, east = [read() for read in self._read]
        forward = u * u + w * w
        # JSBSim wraps the heading to [0, 2 pi); the state's is continuous, so that its increments are small.
        self._psi += (psi - self._psi + math.pi) % _TURN - math.pi
        # One assignment in the order of STATE: twelve single ones would double the cost of a step.
        self._x[:] = (
            p,
            q,
            r,
            math.sqrt(forward + v * v) * FT,
            math.atan2(w, u),
            math.atan2(v, math.sqrt(forward)),
            phi,
            theta,
            self._psi,
            h,
            self._north + north * FT,
            self._east + east * FT,
        )

    def _initialise(self, x: np.ndarray, action: np.ndarray, speed: float, n1: float, n2: float, washout: float) -> None:
        fdm = self._fdm
        self.effects.clear()
        fdm.reset_to_initial_conditions(2)  # 2: without running; run_ic alone keeps the integrators' past
        for name, scheme in _INTEGRATORS.items():
            fdm[f"simulation/integrator/{name}"] = scheme
        V, alpha, beta = x[STATE.V], x[STATE.alpha], x[STATE.beta]
        fdm["ic/lat-geod-deg"] = 0.0
        fdm["ic/long-gc-deg"] = 0.0
        fdm["ic/h-sl-ft"] = x[STATE.h] / FT
        fdm["ic/phi-rad"] = x[STATE.phi]
        fdm["ic/theta-rad"] = x[STATE.theta]
        fdm["ic/psi-true-rad"] = x[STATE.psi]
        fdm["ic/u-fps"] = V * math.cos(alpha) * math.cos(beta) / FT
        fdm["ic/v-fps"] = V * math.sin(beta) / FT
        fdm["ic/w-fps"] = V * math.sin(alpha) * math.cos(beta) / FT
        fdm["ic/p-rad_sec"] = x[STATE.p]
        fdm["ic/q-rad_sec"] = x[STATE.q]
        fdm["ic/r-rad_sec"] = x[STATE.r]
        self._set_de(float(action[ACTION.de]))
        self._set_da(float(action[ACTION.da]))
        self._set_dr(float(action[ACTION.dr]))
        fdm["fcs/set-speed-mps"] = speed
        fdm["propulsion/n1-initial-pct"] = n1
        fdm["propulsion/n2-initial-pct"] = n2
        fdm["fcs/yaw-rate-washout-initial"] = washout
        fdm["fcs/hold-integrators"] = -1.0
        fdm.run_ic()
        fdm.run_ic()  # again: the first pass of the engine saw the Mach number of before
        fdm["fcs/hold-integrators"] = 0.0

    def _find_trim(self, condition: FlightCondition) -> Trim:
        """Return the steady flight of a condition: Newton's method on alpha, elevator and throttle.

        The throttle is found as the speed error at which the auto-throttle would ask for it; as in the
        reference, a flight then starts at the set speed itself, from those engine speeds.
        """
        fdm = self._fdm
        x = np.zeros(N_STATE)
        x[STATE.V], x[STATE.h], x[STATE.psi] = condition.speed, condition.altitude, condition.heading
        engine = (50.0, 60.0)

        def accelerations(z: np.ndarray) -> np.ndarray:
            """Return u and w accelerations [ft/s2] and the pitch acceleration [rad/s2] in steady flight."""
            nonlocal engine
            alpha, elevator, speed_error = z.tolist()
            x[STATE.alpha], x[STATE.theta] = alpha, alpha + condition.flight_path
            action = np.array([elevator, 0.0, 0.0])
            self._initialise(x, action, condition.speed - speed_error, *engine, 0.0)
            engine = (fdm["propulsion/n1-command-pct"], fdm["propulsion/n2-command-pct"])
            self._initialise(x, action, condition.speed - speed_error, *engine, 0.0)
            return np.array([fdm[name] for name in _STEADY])

        unknowns = np.array([math.radians(4.0), math.radians(-2.0), -1.2])
        for _ in range(_TRIM_ROUNDS):
            residual = accelerations(unknowns)
            if np.abs(residual).max() < _TRIM_ACCURACY:
                x_trim, (n1, n2) = x.copy(), engine
                trim = Trim(x_trim, np.array([unknowns[1], 0.0, 0.0]), n1, n2)
                self._trims[condition] = trim
                return trim
            slopes = [(accelerations(unknowns + step) - residual) / step.max() for step in np.diag(_TRIM_STEPS)]
            change, *_ = np.linalg.lstsq(np.stack(slopes, axis=1), -residual, rcond=None)
            if not np.isfinite(change).all():
                break
            unknowns = unknowns + change * min(1.0, 1.0 / float(np.abs(change / _TRIM_STRIDE).max() + 1e-12))
        raise UserError(
            f"flight condition altitude {condition.altitude:g} m, speed {condition.speed:g} m/s, flight path "
            f"{math.degrees(condition.flight_path):g} deg: the aircraft cannot be trimmed there; "
            "stay near the conditions it was identified at: 2000 m and 90 to 150 m/s, 10000 m and 90 m/s"
        )
