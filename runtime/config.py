"""Every number of the runtime, with its unit and its reason; their presets are :mod:`runtime.presets`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from task.config import Settings
from task.law_names import why_no_law
from task.limits import DEFLECTION_LIMIT, DT

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Fraction = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]

Count = Annotated[int, msgspec.Meta(ge=1, le=2**31 - 1)]
"""What the log can hold as a parameter."""

Switch = Literal["none", "hard", "soft"]


class Adaptation(Settings, frozen=True, kw_only=True):
    """How the aircraft is identified, when the cast is imagined, and when and how it changes (thesis chapter 8).

    The defaults are the preset ``understudy``.
    """

    switch: Switch = "soft"
    """``none`` flies the champion throughout; ``hard`` copies the winner's parameters; ``soft`` blends (eq. 8.8)."""

    model: Literal["full", "reduced"] = "reduced"
    """``full`` identifies all ten states (eq. 8.2); ``reduced`` the six dynamic ones, attitude and altitude following
    from their exact kinematics."""

    prior: Literal["none", "population", "scheduled"] = "population"
    """``none`` starts from Theta = 0, P = p0 I; ``population`` from the model prior shipped with the population, which
    is of one trim; ``scheduled`` takes that to the speed, height and attitude of each imagination by the population's
    rate model (``task.scheduling``), and learns nothing: ``identify`` must be false. The last two for the reduced model
    only."""

    p0: Positive = 1e12
    """Scale of the identity that P starts from without a prior [1/unit^2]. The thesis gives no number. Increments at
    100 Hz are 1e-5..1e-4, so 1e6 is a heavy ridge that holds G near zero for a whole flight; 1e12 is what "no prior
    knowledge" asks for."""

    kappa: Fraction = 0.9995
    """Forgetting factor of eqs 8.5-8.6, each sample. 0.9995 remembers 20 s at 100 Hz. The thesis gives no number."""

    p_growth_limit: Positive = 1e3
    """Forgetting is suspended while trace(P) exceeds this multiple of its initial trace, so that a long quiet flight
    cannot wind P up. Quiet flight alone reaches it after 138 s at kappa = 0.9995."""

    identify: bool = True
    """False leaves the model at its prior for the whole flight (the frozen nominal model)."""

    lowpass_hz: NotNegative = 0.0
    """Cut-off of a second-order Butterworth low-pass on state and command increments alike [Hz]; 0 for none. About 1.5
    Hz makes identification possible with noisy rate gyros."""

    t_play: Positive = 2.0
    """Time between two imaginations of the population [s]."""

    horizon: Annotated[float, msgspec.Meta(ge=0.1, le=60.0)] = 4.0
    """How far each imagination looks, t_h [s]; each second costs time."""

    preview: bool = True
    """True imagines with the future reference where it is known; False with ``trend_time`` alone."""

    trend_time: NotNegative = 0.0
    """How long a reference that nobody knows beforehand is imagined to go on as it moves now: time constant of its
    slowing down [s], :class:`runtime.reference.Trend`; 0 holds the present one."""

    play_delay_ticks: Count = 10
    """In lockstep an imagination asked for at tick k decides at tick k + this [samples]."""

    max_age: Positive = 1.0
    """In real time an imagination older than this decides nothing [s]."""

    margin: NotNegative = 0.10
    """The best member replaces the incumbent if its return R beats R_incumbent by margin * |R_incumbent|. Returns are
    negative: a margin of 0.5 asks the new member to lose at most half of what the incumbent is predicted to lose."""

    head_start: NotNegative = 0.0
    """Return by which the member that flies first is taken to be better than it is imagined [-; a sample's is between 0
    and -1]. Where all fly closely a share of next to nothing is chance; and who was good so far is trusted beyond what
    is imagined, until more than this is at stake."""

    travel_cost: NotNegative = 0.0
    """What a radian of imagined surface travel beyond ``travel_free`` costs, all surfaces together [return/rad].
    Returns are of tracking alone (eq. 12): a member that swings a surface from limit to limit may have a good one."""

    travel_free: NotNegative = 0.0
    """Mean speed of all surfaces together that costs nothing [rad/s]."""

    rho: Fraction = 0.05
    """Polyak coefficient of eq. 8.8, each sample: half of a change is done after 14 samples."""

    effectiveness: Literal["none", "structured"] = "none"
    """``structured`` runs a Kalman filter for the signed effectiveness of each surface (``runtime.structured``, needs
    the population's rate model), imagines with it, and imagines at once when the filter raises its alarm.
    docs/adaptation.md says what every value below is for."""

    rate_noise: Positive = 1e-4
    """Least standard deviation of the measured rates that the filter assumes [rad/s]; above it the noise is found in
    flight. Not zero with perfect sensors: it also covers what a sample's linear model leaves out."""

    noise_time: Positive = 2.0
    """Time constant with which the sensors' noise is found [s]."""

    q_rate: Positive = 2e-5
    """Process noise of the rates, each sample [rad/s]: the model's error from one sample to the next."""

    q_rate_open: Positive = 5e-5
    """The same while the filter is open [rad/s]."""

    q_effectiveness: NotNegative = 2e-4
    """Drift of lambda that is allowed for, each sample [-]: 0.02 in 100 s."""

    q_effectiveness_open: NotNegative = 0.01
    """The same while the filter is open [-]: lambda may still move by 0.1 in a second."""

    q_bias: tuple[Positive, Positive, Positive] = (6e-4, 2e-3, 4e-4)
    """Drift of the bias b that is allowed for on p, q, r, each sample [rad/s2]: thrust, trim and the centre of gravity
    move the pitching moment most."""

    q_gust: NotNegative = 0.0
    """Drift of the sideslip that the air adds, each sample [rad]. Where the measured sideslip is that of the inertial
    velocity, a gust from the side is a moment of roll and yaw, in the proportion of the healthy aircraft's, that no
    sensor announces: so the bias may drift besides, while it is in doubt what aileron or rudder do. With 0 a gust is
    at times taken for a surface."""

    model_error: NotNegative = 0.3
    """Share of its own change from sample to sample by which the modelled acceleration of the healthy aircraft may be
    wrong [-]; added to the drift of the bias, so that hard manoeuvres alarm no more than gentle ones."""

    model_error_open: NotNegative = 0.3
    """The same while the filters are open [-]. More (4) takes a far shifted centre of gravity less often for a surface
    that has changed, and finds reversed surfaces too late."""

    stall_error: NotNegative = 300.0
    """Growth of the bias's drift with the angle of attack above 8 degrees, where the lift curve bends [1/rad]: by 5 a
    degree. Near the stall a sample says less of the surfaces. Below -3 degrees too, but not soon after an alarm."""

    effectiveness_sd: Positive = 0.05
    """Standard deviation of lambda about 1 at the start of a flight [-]."""

    effectiveness_sd_open: Positive = 1.0
    """The same when an alarm opens the filter [-]: from healthy, reversed is two of them away."""

    open_rate: Positive = 5e-3
    """Standard deviation of the rates when the filter opens [rad/s]; they are set to what is measured."""

    open_bias: tuple[Positive, Positive, Positive] = (0.2, 0.6, 0.1)
    """Standard deviation of the bias on p, q, r when the filter opens [rad/s2]."""

    open_slopes: tuple[NotNegative, NotNegative] = (3.0, 1.0)
    """Standard deviation of the changes of dq'/d(alpha) and dr'/d(beta) when the filter opens [1/s2]: a moved centre of
    gravity changes the slopes, and must not be taken for a surface."""

    open_after: Positive = 0.03
    """From the alarm to the opening [s]: the samples that straddle the fault are not learnt from."""

    recall: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.1
    """The filters open at what was known so long before the alarm [s]: since the fault the bias took it up."""

    open_time: Positive = 1.0
    """How long the filter stays open [s]."""

    effectiveness_limit: Positive = 2.5
    """Largest abs(lambda) that is imagined [-]: a surface that hardly moves tells little of its effectiveness."""

    alarm_threshold: Positive = 75.0
    """Alarm when five normalised innovations squared add up to more than this. With a right model the sum is
    chi-squared with 15 degrees of freedom and reaches 60 twice in 10 million samples."""

    alarm_colour: NotNegative = 0.3
    """The threshold grows by this share for each e-fold of the bias's drift that turbulence asks for [-]: gusts are not
    quite a random walk. Light turbulence more than trebles the threshold."""

    alarm_shift: Positive = 40.0
    """Alarm also when the bias is further from its running mean than so many of its own standard deviations [-]."""

    shift_time: Positive = 5.0
    """Time constant of the bias's running mean [s]."""

    alarm_hold: NotNegative = 0.3
    """No second alarm within this time of the last [s]."""

    unrest_time: Positive = 1.0
    """Time constant with which the drift of each axis's bias follows turbulence [s]: it is raised until the normalised
    innovations squared are 1 on average, so that the thresholds keep their meaning."""

    q_effectiveness_agile: NotNegative = 0.01
    """Drift of lambda, each sample, of the filters that look whether a surface has changed [-]."""

    agile_lead: tuple[Positive, Positive, Positive] = (30.0, 55.0, 50.0)
    """Alarm when the filter that lets one surface's effectiveness move explains the rates better than the believed one
    by so much, with forgetting; elevator, aileron, rudder [nats]. Grows with turbulence as ``alarm_threshold``."""

    delays: tuple[Annotated[float, msgspec.Meta(ge=0.0, le=10.0)], ...] = (0.05, 0.10, 0.15)
    """Delays of the commands that may be found, beyond the population's ``command_lag`` [s]."""

    crossed: bool = True
    """Whether aileron and rudder may be found to have each other's commands."""

    rate_limits: tuple[Positive, ...] = (0.14, 0.087, 0.052)
    """Rates that no surface may be found to exceed [rad/s]."""

    bandwidths: tuple[Positive, ...] = ()
    """Corner frequencies of first-order lags with which all surfaces may be found to follow [Hz]. The imagination has
    no lag: such surfaces are imagined to follow at once from where they are, which suits laws that are told where that
    is, and misleads a cast of networks."""

    q_uncommanded: NotNegative = 0.0
    """How fast a surface moves by itself drifts by so much each sample [rad/s]; 0: no surface is found to."""

    ranges: bool = True
    """Whether a surface may be found to have lost some of its range."""

    foretell: bool = False
    """Whether late commands are made up for: whoever flies answers the state that is foretold for when the answer acts
    (``runtime.foretelling``), and the cast is imagined from there, with commands that are in time."""

    delay_memory: Fraction = 0.99
    """Forgetting of the log-likelihoods of all hypotheses and of the agile filters, each sample [-]."""

    delay_lead: Positive = 36.0
    """Delay, crossed commands or slow surfaces are believed when they lead by so much for three samples [nats].
    In quiet flight every hypothesis has time to find a lambda to suit it, and innovations that are not white
    favour one by chance."""

    delay_lead_open: Positive = 11.0
    """The same while the filters are open [nats]: all hypotheses start alike."""

    belief_sd: NotNegative = 2.0
    """What is imagined of lambda stays where it was within so many standard deviations of the estimate [-]: an
    uncertain estimate changes nothing."""

    settle: NotNegative = 0.08
    """From an alarm to the imagination that it asks for [s]."""

    watch: NotNegative = 2.0
    """For how long after an alarm imaginations follow each other every ``watch_period`` [s]."""

    watch_period: Positive = 0.1
    """Time between imaginations while watching [s]."""

    excitation: Annotated[float, msgspec.Meta(ge=0.0, le=DEFLECTION_LIMIT)] = 0.0
    """Pulse towards the middle for a surface that stands at its limit after an alarm, and of which it is not known what
    it does [rad]; 0: none."""

    excitation_time: Positive = 0.1
    """How long the pulse lasts [s]."""

    excitation_sd: Positive = 0.1
    """There are pulses while lambda's standard deviation is larger than this [-]."""

    elevator_reserve: Annotated[float, msgspec.Meta(ge=0.0, lt=DEFLECTION_LIMIT)] = 0.0
    """How much of the elevator laws keep back while it holds the nose down against a moment that the healthy aircraft
    does not have [rad] (``runtime.advice``); 0: nothing, and they follow the reference until the elevator ends."""

    forecast_time: NotNegative = 0.0
    """Predicted returns are averaged over imaginations with the same belief about the surfaces, forgetting with this
    time constant [s]; 0 decides on each imagination alone."""

    confirmations: Count = 1
    """So many imaginations in a row must name the same member before a change that no alarm asked for."""

    confirmations_watch: Count = 1
    """The same for ``watch`` after an alarm. With a law in the cast that is told what changed, or finds it out itself,
    most changes that a single imagination asks for are to and fro."""

    dwell: NotNegative = 0.0
    """Least time between two switches [s]."""

    laws: tuple[str, ...] = ()
    """Laws that are members of the cast beside the population's networks: shipped ones (docs/laws.md), or one's own as
    MODULE:CLASS (docs/own.md)."""

    first: str = ""
    """Name of the member that flies first; empty: the population's champion."""

    def __post_init__(self) -> None:
        if wrong := next(filter(None, map(why_no_law, self.laws)), ""):
            raise ValueError(f"laws: {wrong}")
        if len(set(self.laws)) < len(self.laws):
            raise ValueError(f"laws: expected each at most once, got {list(self.laws)}")
        if self.prior != "none" and self.model == "full":
            raise ValueError(f"prior = {self.prior!r} needs model = 'reduced'; set prior = 'none'")
        if self.prior == "scheduled" and self.identify:
            raise ValueError("prior = 'scheduled' needs identify = false; to learn Theta set prior = 'population'")
        if self.prior == "none" and not self.identify and self.switch != "none":
            raise ValueError("prior = 'none' with identify = false imagines nothing; set identify = true")
        if self.effectiveness == "structured" and self.model == "full":
            raise ValueError("effectiveness = 'structured' needs model = 'reduced'")


class Operation(Settings, frozen=True, kw_only=True):
    """How the loop keeps time and what it does when something is missing."""

    dt: Annotated[float, msgspec.Meta(ge=1e-3, le=0.1)] = DT
    """Sample time of the loop [s]; a population flies with its own alone, 0.01 s."""

    real_time: bool = False
    """True keeps the wall clock: nobody waits, late samples are missed. False is lockstep: each state is answered when
    it comes, and two flights are equal bit for bit."""

    reference_from: Literal["zero", "first_state"] = "zero"
    """Where t = 0 of a reference file lies: at time_usec = 0, so that a runtime that is started again in mid-flight
    keeps its place, or at the first state, for simulators whose clock does not start at zero."""

    start_patience: Positive = 60.0
    """How long to wait for the first state [s of wall clock]."""

    patience: Positive = 15.0
    """How long to wait for a state in mid-flight before giving up [s of wall clock]. A bridge that comes back within it
    starts a new flight."""

    hold_time: NotNegative = 0.5
    """With no usable state the last good command is held for this long, then fades to trim [s]."""

    fade_time: Positive = 1.0
    """Time of the fade from the held command to trim [s]."""

    trim_time: Positive = 5.0
    """Time constant of the running mean of good commands that stands for trim [s]; until there is one, trim is zero
    deflection."""

    missed_factor: Annotated[float, msgspec.Meta(gt=1.0)] = 1.5
    """In real time a sample that is not there after this many sample times counts as missed."""

    core: Annotated[int, msgspec.Meta(ge=-1, le=65535)] = -1
    """CPU core that the control thread is pinned to in real time; -1 pins to none."""

    flush_ticks: Count = 25
    """The log is handed to the operating system every so many samples; what is there survives a kill -9."""


class Configuration(Settings, frozen=True, kw_only=True):
    """Everything that decides a flight but the population and the reference; saved beside each log."""

    preset: str
    """The preset that the values started from."""
    adaptation: Adaptation
    """How the cast is changed."""
    operation: Operation = Operation()
    """How the loop is run."""
