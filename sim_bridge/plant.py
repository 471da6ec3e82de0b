"""The aircraft as a state vector: JSBSim behind SI units, trim, and the effects that faults drive.

Training, campaigns and the bridge step this one class. ``step`` sends the command, lets JSBSim run one
frame and reads the state. JSBSim propagates before it reads commands, so a command given with ``x[k]``
first moves the increment ``x[k+2] - x[k+1]`` (docs/architecture.md, "Time and the command lag"); the same
holds for effects.
"""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np

from sim_bridge.actuators import Actuators
from sim_bridge.air import STILL_AIR, Air
from sim_bridge.aircraft.build import MODEL_NAME, PLANET, REST, ROOT
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.effects import FT, Effects
from sim_bridge.trim import Response, Start, Trim, carried_by_wind, find_trim
from task.limits import DT
from task.state import ACTION, N_STATE, STATE

__all__ = ["NOMINAL", "R1", "R2", "FlightCondition", "Plant", "Trim"]

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
_STATE = (
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
"""Properties that make up the state."""
_STEADY = ("accelerations/udot-ft_sec2", "accelerations/wdot-ft_sec2", "accelerations/qdot-rad_sec2")
"""What is zero in a trimmed flight."""
_PACK = struct.Struct(f"{N_STATE}d").pack_into
_HOLD, _GO = -1.0, 0.0
"""Trigger of the model's integrators."""


class Plant:
    """One aircraft. Many may live in one process; each is deterministic and independent of its history.

    ``step`` never raises: a flight that is lost shows as a non-finite state.
    """

    def __init__(self, dt: float = DT, root: Path = ROOT) -> None:
        """Load the aircraft below JSBSim's folder ``root``, with the time step ``dt`` [s], and reset it."""
        os.environ.setdefault("JSBSIM_DEBUG", "0")  # otherwise every instance prints JSBSim's banner
        fdm = jsbsim.FGFDMExec(str(root), None)
        fdm.set_debug_level(0)
        fdm.load_planet(str(PLANET), False)
        fdm.set_dt(dt)  # before the model is loaded: its integrators keep the step they are loaded with
        fdm.load_model(MODEL_NAME)
        self._fdm = fdm
        self._run = fdm.run
        self._time = fdm.get_sim_time
        manager = fdm.get_property_manager()

        def node(name: str) -> Any:
            return manager.get_node(name)

        def readers(*names: str) -> tuple[Any, ...]:
            return tuple(node(name).get_double_value for name in names)

        commands = (f"fcs/{surface}-command-rad" for surface in ("elevator", "aileron", "rudder"))
        self._command = tuple(node(name).set_double_value for name in commands)
        self._read = readers(*_STATE)
        self._engine = readers("propulsion/n1-pct", "propulsion/n2-pct")
        self._wind = readers(*(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down")))
        self._surfaces = readers("fcs/elevator-rad", "fcs/aileron-rad", "fcs/rudder-command-rad")
        self.effects = Effects(fdm)
        self.actuators = Actuators(dt)
        self._x = np.zeros(N_STATE)
        self._buffer = self._x.data
        self._trims: dict[FlightCondition, Trim] = {}
        self.reset()

    def reset(
        self,
        condition: FlightCondition = NOMINAL,
        x: np.ndarray | None = None,
        action: np.ndarray | None = None,
        *,
        n1: float | None = None,
        n2: float | None = None,
        washout: float = 0.0,
        air: Air = STILL_AIR,
        seed: int = 0,
    ) -> np.ndarray:
        """Start a flight and return its state (12,), the array that ``step`` reuses; clears every effect.

        condition: where to trim, and the airspeed that the auto-throttle holds. x (12,): inertial state to
        start from, the trim's (carried by the wind) when not given; action (3,) [rad]: deflections before the
        first step, the trim's when not given; n1, n2 [%]: fan and core speed, the trim's when not given;
        washout [rad/s]: the yaw damper's low-passed yaw rate; air: wind and turbulence; seed: of the
        turbulence. Raises UserError for a condition that the aircraft cannot be trimmed to.
        """
        trim = self._trims.get(condition) or find_trim(condition, self._respond)
        self._trims[condition] = trim
        self.condition, self.trim = condition, trim
        start = Start(
            x=carried_by_wind(trim.x, air) if x is None else np.asarray(x, dtype=float),
            action=trim.action if action is None else np.asarray(action, dtype=float),
            set_speed=condition.speed,
            n1=trim.n1 if n1 is None else n1,
            n2=trim.n2 if n2 is None else n2,
            washout=washout,
            air=air,
        )
        self._initialise(start)
        self._fdm["simulation/randomseed"] = seed
        self.effects.set_turbulence(air.turbulence)
        self._psi = float(start.x[STATE.psi])
        self._north, self._east = float(start.x[STATE.xe]), float(start.x[STATE.ye])
        self._update()
        return self._x

    def step(self, action: np.ndarray) -> np.ndarray:
        """Advance by one time step with absolute deflections [rad], shape (3,); return the reused state (12,)."""
        command = action.tolist()
        if self.actuators.active:
            command = self.actuators.respond(command, self._time())
        set_elevator, set_aileron, set_rudder = self._command
        set_elevator(command[0])
        set_aileron(command[1])
        set_rudder(command[2])
        try:
            self._run()
        except Exception:  # JSBSim refuses a state that is not finite: the flight is lost, and x says so
            self._x.fill(math.nan)
            return self._x
        self._update()
        return self._x

    def run_bare(self) -> None:
        """Let JSBSim run one frame and read nothing: what ``step`` is measured against."""
        self._run()

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
        n1, n2 = self._engine
        return n1(), n2()

    @property
    def surfaces(self) -> np.ndarray:
        """Physical deflections of elevator, aileron and rudder [rad], shape (3,), without the yaw damper's part."""
        if self.actuators.active:
            return np.array(self.actuators.deflection)
        return np.array([read() for read in self._surfaces])

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
        # Packed at once, in the order of STATE: twelve assignments would double the cost of a step.
        _PACK(
            self._buffer,
            0,
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

    def _initialise(self, start: Start) -> None:
        """Put JSBSim at a start, with a nominal aircraft."""
        fdm, x, air = self._fdm, start.x, start.air
        self.actuators.clear()
        self.effects.clear()  # a reset does not restore point masses
        fdm.reset_to_initial_conditions(2)  # 2: without running; run_ic alone keeps the integrators' past
        for name, scheme in _INTEGRATORS.items():
            fdm[f"simulation/integrator/{name}"] = scheme
        # JSBSim turns one angle or speed about the last others, which would leave roundings of the flight before.
        fdm.load_ic(str(REST), False)
        V, alpha, beta = x[STATE.V], x[STATE.alpha], x[STATE.beta]
        initial = {
            "lat-geod-deg": 0.0,
            "long-gc-deg": 0.0,
            "h-sl-ft": x[STATE.h] / FT,
            "phi-rad": x[STATE.phi],
            "theta-rad": x[STATE.theta],
            "psi-true-rad": x[STATE.psi],
            "vw-mag-fps": math.hypot(air.wind_north, air.wind_east) / FT,
            "vw-dir-deg": math.degrees(math.atan2(air.wind_east, air.wind_north)),
            "u-fps": V * math.cos(alpha) * math.cos(beta) / FT,
            "v-fps": V * math.sin(beta) / FT,
            "w-fps": V * math.sin(alpha) * math.cos(beta) / FT,
            "p-rad_sec": x[STATE.p],
            "q-rad_sec": x[STATE.q],
            "r-rad_sec": x[STATE.r],
        }
        for name, value in initial.items():
            fdm[f"ic/{name}"] = value
        for surface, deflection in zip(ACTION, self._command, strict=True):
            deflection(float(start.action[surface]))
        fdm["fcs/set-speed-mps"] = start.set_speed
        fdm["propulsion/n1-initial-pct"] = start.n1
        fdm["propulsion/n2-initial-pct"] = start.n2
        fdm["fcs/yaw-rate-washout-initial"] = start.washout
        fdm["fcs/hold-integrators"] = _HOLD
        fdm.run_ic()
        fdm.run_ic()  # again: the first pass of the engine saw the Mach number of before
        fdm["fcs/hold-integrators"] = _GO

    def _respond(self, start: Start) -> Response:
        """Return what JSBSim makes of a start, for the search of a trim."""
        self._initialise(start)
        fdm = self._fdm
        return Response(
            np.array([fdm[name] for name in _STEADY]),
            fdm["propulsion/n1-command-pct"],
            fdm["propulsion/n2-command-pct"],
        )
