"""What can break in flight: general mechanisms, each with magnitude, start, end and ramp, alone or combined.

A fault is a settings struct that a scenario's TOML holds; ``kind`` says which. Its *level* runs from 0 to 1 and scales
its magnitude. Combined faults act in the order of the list: factors and mixings multiply, shifts and gusts add, limits
take the tightest, a later jam wins. Angles are in degrees here, as a person writes them.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
import numpy as np

from sim_bridge.actuators import FREE_STOP, Jammed
from sim_bridge.air import Wind
from sim_bridge.effects import CLEAN_ALPHA_MAX, ENGINE_ARM
from sim_bridge.fault import Condition, Fault, NotNegative
from sim_bridge.sensors import SignalName, check_error
from task.state import ACTION, N_ACTION, STATE

SurfaceName = Literal["elevator", "aileron", "rudder"]
SURFACES: dict[str, int] = {"elevator": ACTION.de, "aileron": ACTION.da, "rudder": ACTION.dr}

LARGEST_FACTOR = 10.0
"""No surface works so many times as well as it should, either way [-]."""
LARGEST_ANGLE = round(math.degrees(FREE_STOP), 6)
"""No surface goes farther [deg]."""

Factor = Annotated[float, msgspec.Meta(ge=-LARGEST_FACTOR, le=LARGEST_FACTOR)]
Angle = Annotated[float, msgspec.Meta(ge=-LARGEST_ANGLE, le=LARGEST_ANGLE)]
Amplitude = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_ANGLE)]
Rate = Annotated[float, msgspec.Meta(ge=0.01, le=1000.0)]
Frequency = Annotated[float, msgspec.Meta(ge=0.01, le=50.0)]
"""Up to half the sample rate."""
GARBAGE = 10.0
"""A sensor that fails may say so many times what a flight's own sensors may be off by: what no aircraft does [-]."""
Thrust = Annotated[float, msgspec.Meta(ge=0.0, le=2.0)]
Delay = Annotated[float, msgspec.Meta(ge=0.0, le=2.0)]
Row = tuple[Factor, Factor, Factor]


class Effectiveness(Fault, frozen=True, kw_only=True, tag="effectiveness"):
    """A surface moves, but its effect, trim deflection included, is multiplied (F5: elevator x 0.3)."""

    surface: SurfaceName
    factor: Factor
    """Effect over nominal effect [-]; -1 is reversed, 0 is none."""

    def apply(self, condition: Condition, level: float) -> None:
        """Scale the surface's effect."""
        condition.mixing[:, SURFACES[self.surface]] *= 1.0 + level * (self.factor - 1.0)


class Mixing(Fault, frozen=True, kw_only=True, tag="mixing"):
    """The surfaces' effects are mixed."""

    matrix: tuple[Row, Row, Row]
    """Row: effective elevator, aileron, rudder; column: deflection of elevator, aileron, rudder [-]."""

    def apply(self, condition: Condition, level: float) -> None:
        """Multiply the mixing."""
        identity = np.eye(N_ACTION)
        condition.mixing = (identity + level * (np.array(self.matrix) - identity)) @ condition.mixing


class Crossed(Fault, frozen=True, kw_only=True, tag="crossed"):
    """Two surfaces have each other's effect: a wrongly rigged control."""

    surfaces: tuple[SurfaceName, SurfaceName] = ("aileron", "rudder")

    def __post_init__(self) -> None:
        """Check that there are two."""
        super().__post_init__()
        if self.surfaces[0] == self.surfaces[1]:
            raise ValueError(f"surfaces: expected two that differ, got {self.surfaces[0]} twice")

    def apply(self, condition: Condition, level: float) -> None:
        """Exchange two rows of the mixing."""
        order = list(range(N_ACTION))
        first, second = (SURFACES[name] for name in self.surfaces)
        order[first], order[second] = second, first
        condition.mixing = (1.0 - level) * condition.mixing + level * condition.mixing[order]


class Jam(Fault, frozen=True, kw_only=True, tag="jam"):
    """A surface goes to an angle and stays there (F6: rudder at 15 degrees)."""

    surface: SurfaceName
    angle_deg: Angle | None = None
    """Deflection [deg]; none: where the surface is when the fault begins."""

    def apply(self, condition: Condition, level: float) -> None:
        """Take the surface away from its command."""
        angle = None if self.angle_deg is None else math.radians(self.angle_deg)
        condition.surfaces[SURFACES[self.surface]].jams.append(Jammed(level, angle, self.start))


class Saturation(Fault, frozen=True, kw_only=True, tag="saturation"):
    """A surface cannot leave a range (F3: aileron +-1 degree, F4: elevator +-2.5 degrees)."""

    surface: SurfaceName
    min_deg: Angle
    """Lowest deflection [deg]."""
    max_deg: Angle
    """Highest deflection [deg]."""

    def __post_init__(self) -> None:
        """Check the range."""
        super().__post_init__()
        if self.min_deg > self.max_deg:
            raise ValueError(f"min_deg: expected at most max_deg = {self.max_deg:g}, got {self.min_deg:g}; swap them")

    def apply(self, condition: Condition, level: float) -> None:
        """Tighten the stops; a ramp closes them in from FREE_STOP."""
        surface = condition.surfaces[SURFACES[self.surface]]
        surface.minimum = max(surface.minimum, -FREE_STOP + level * (math.radians(self.min_deg) + FREE_STOP))
        surface.maximum = min(surface.maximum, FREE_STOP + level * (math.radians(self.max_deg) - FREE_STOP))


class RateLimit(Fault, frozen=True, kw_only=True, tag="rate_limit"):
    """A surface moves no faster than this."""

    surface: SurfaceName
    rate_deg_s: Rate
    """Largest rate [deg/s]."""

    def apply(self, condition: Condition, level: float) -> None:
        """Tighten the limit; a ramp comes from an unlimited rate."""
        surface = condition.surfaces[SURFACES[self.surface]]
        surface.rate_limit = min(surface.rate_limit, math.radians(self.rate_deg_s) / level)


class Bandwidth(Fault, frozen=True, kw_only=True, tag="bandwidth"):
    """A surface follows its command through a first-order lag."""

    surface: SurfaceName
    hz: Frequency
    """Corner frequency [Hz]."""

    def apply(self, condition: Condition, level: float) -> None:
        """Add the lag's time constant; a ramp grows it from zero."""
        condition.surfaces[SURFACES[self.surface]].time_constant += level / (2.0 * math.pi * self.hz)


class Latency(Fault, frozen=True, kw_only=True, tag="latency"):
    """Commands arrive late."""

    seconds: Delay
    """Delay [s], rounded to samples."""
    surface: SurfaceName | None = None
    """Whose commands; none: all three."""

    def apply(self, condition: Condition, level: float) -> None:
        """Add the delay."""
        for index in SURFACES.values() if self.surface is None else (SURFACES[self.surface],):
            condition.surfaces[index].latency += level * self.seconds


class Oscillation(Fault, frozen=True, kw_only=True, tag="oscillation"):
    """An oscillatory failure: a sine is added to a surface (liquid) or takes its place (solid)."""

    surface: SurfaceName
    amplitude_deg: Amplitude
    """Amplitude [deg]."""
    hz: Frequency
    """Frequency [Hz]."""
    solid: bool = False
    """The sine takes the deflection's place."""

    def apply(self, condition: Condition, level: float) -> None:
        """Set the surface swinging."""
        surface = condition.surfaces[SURFACES[self.surface]]
        surface.oscillation = level * math.radians(self.amplitude_deg)
        surface.oscillation_frequency = self.hz
        surface.oscillation_start = self.start
        surface.oscillation_replaces = self.solid


class CGShift(Fault, frozen=True, kw_only=True, tag="cg_shift"):
    """The centre of gravity moves along the body (F2: 0.25 m aft)."""

    aft: Annotated[float, msgspec.Meta(ge=-1.5, le=1.5)]
    """How far aft [m]; negative is forward."""

    def apply(self, condition: Condition, level: float) -> None:
        """Add the shift."""
        condition.cg_shift += level * self.aft


class Icing(Fault, frozen=True, kw_only=True, tag="icing"):
    """Ice on the wings: drag, and lift that grows no further beyond a lower angle of attack (F1)."""

    drag: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.05
    """Added drag coefficient [-]. The thesis says 0.06; the reference's recordings show 0.05."""
    alpha_max_deg: Annotated[float, msgspec.Meta(ge=1.0, le=30.0)] = 7.7
    """Angle of attack beyond which lift is lost [deg]: 30 % below the clean wing's 11."""

    def apply(self, condition: Condition, level: float) -> None:
        """Add drag and take the lowest limit; a ramp lowers it from the clean wing's."""
        condition.drag += level * self.drag
        limit = CLEAN_ALPHA_MAX + level * (math.radians(self.alpha_max_deg) - CLEAN_ALPHA_MAX)
        condition.alpha_max = min(condition.alpha_max, limit)


class Gust(Fault, frozen=True, kw_only=True, tag="gust"):
    """The air moves, on top of the steady wind (R3: 15 ft/s for 3 s)."""

    down: Wind = 0.0
    """Velocity of the air downwards [m/s]; the reference's recorded gust is +4.572."""
    north: Wind = 0.0
    """Towards north [m/s]."""
    east: Wind = 0.0
    """Towards east [m/s]."""
    shape: Literal["linear", "cosine"] = "linear"
    """How it comes and goes over the ramp."""
    as_reference: bool = False
    """As the reference has gusts: lift and drag change in size but are still turned by the inertial angle of attack.
    Otherwise the air turns them, as it would. Only for flights without steady wind."""

    def apply(self, condition: Condition, level: float) -> None:
        """Add the gust."""
        share = level if self.shape == "linear" else 0.5 * (1.0 - math.cos(math.pi * level))
        condition.gust += share * np.array([self.north, self.east, self.down])
        condition.gust_upright |= self.as_reference


class Engine(Fault, frozen=True, kw_only=True, tag="engine"):
    """Engines give less thrust, each its own share; unequal shares yaw the aircraft."""

    left: Thrust = 1.0
    """What is left of the left engine's thrust [-]."""
    right: Thrust = 1.0
    """What is left of the right engine's thrust [-]."""
    arm: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = ENGINE_ARM
    """Distance of each engine from the plane of symmetry [m]."""

    def apply(self, condition: Condition, level: float) -> None:
        """Scale each engine's thrust."""
        condition.thrust[0] *= 1.0 + level * (self.left - 1.0)
        condition.thrust[1] *= 1.0 + level * (self.right - 1.0)
        condition.engine_arm = self.arm


class YawDamperOff(Fault, frozen=True, kw_only=True, tag="yaw_damper_off"):
    """The aircraft's own yaw damper is switched off."""

    def apply(self, condition: Condition, level: float) -> None:
        """Switch it off, whatever the level."""
        condition.yaw_damper = False


class SensorNoise(Fault, frozen=True, kw_only=True, tag="sensor_noise"):
    """White noise on a measured signal, on top of the flight's sensors."""

    signal: SignalName
    sd: NotNegative
    """Standard deviation [the signal's SI unit]."""

    def __post_init__(self) -> None:
        """Check it against what the signal can be off by."""
        super().__post_init__()
        check_error("sd", self.signal, self.sd, GARBAGE)

    def apply(self, condition: Condition, level: float) -> None:
        """Add the variance."""
        index = STATE[self.signal]
        condition.noise[index] = math.hypot(condition.noise.get(index, 0.0), level * self.sd)


class SensorBias(Fault, frozen=True, kw_only=True, tag="sensor_bias"):
    """A measured signal reads too much or too little."""

    signal: SignalName
    bias: float
    """Error [the signal's SI unit]."""

    def __post_init__(self) -> None:
        """Check it against what the signal can be off by."""
        super().__post_init__()
        check_error("bias", self.signal, self.bias, GARBAGE)

    def apply(self, condition: Condition, level: float) -> None:
        """Add the bias."""
        index = STATE[self.signal]
        condition.bias[index] = condition.bias.get(index, 0.0) + level * self.bias


class SensorDelay(Fault, frozen=True, kw_only=True, tag="sensor_delay"):
    """The whole measurement arrives late."""

    seconds: Delay
    """Delay [s], rounded to samples."""

    def apply(self, condition: Condition, level: float) -> None:
        """Add the delay."""
        condition.delay += level * self.seconds


class SensorStuck(Fault, frozen=True, kw_only=True, tag="sensor_stuck"):
    """A measured signal keeps the value that it had."""

    signal: SignalName

    def apply(self, condition: Condition, level: float) -> None:
        """Hold it, whatever the level."""
        condition.stuck.add(int(STATE[self.signal]))


AnyFault = (
    Effectiveness
    | Mixing
    | Crossed
    | Jam
    | Saturation
    | RateLimit
    | Bandwidth
    | Latency
    | Oscillation
    | CGShift
    | Icing
    | Gust
    | Engine
    | YawDamperOff
    | SensorNoise
    | SensorBias
    | SensorDelay
    | SensorStuck
)
"""Any one of them; the key ``kind`` says which."""


def describe(fault: Fault) -> str:
    """Return a fault in a few words, for logs and legends."""
    kind = str(fault.__struct_config__.tag).replace("_", " ")
    values = [
        f"{name.removesuffix('_deg')} {value:g}" if isinstance(value, float) else str(value)
        for name in fault.__struct_fields__
        if name not in Fault.__struct_fields__ and (value := getattr(fault, name)) is not None
    ]
    return " ".join([kind, *values])
