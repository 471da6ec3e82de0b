"""Every hyperparameter of a training run; docs/training.md lists where text and published run differ."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from task.config import Settings, load_toml
from task.errors import UserError
from task.limits import DT
from task.reference import FamilyName

CONFIGS = Path(__file__).parent / "configs"

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Count = Annotated[int, Meta(ge=1)]
Seed = Annotated[int, Meta(ge=0)]
Activation = Literal["tanh", "relu", "leaky_relu", "linear"]


class ActorSettings(Settings, frozen=True):
    """Shape of every actor: Linear, activation, then ``hidden`` x [Linear, LayerNorm, activation], Linear, tanh."""

    width: Count = 72
    """Units of each hidden layer."""
    hidden: Count = 3
    """Normalised hidden layers after the input layer."""
    activation: Activation = "tanh"
    layer_norm: Literal["none", "standard"] = "standard"
    input_scale: tuple[Positive, ...] = ()
    """Fixed factors on theta_e, phi_e, beta_e, p, q, r [1/rad, s/rad] and alpha [1/rad]; empty: ones, as published."""
    action_offset: tuple[float, ...] = ()
    """Deflection of elevator, aileron, rudder [rad] at zero network output; empty: zeros, as published."""


class TD3Settings(Settings, frozen=True):
    """The gradient learner (thesis section II.A)."""

    learning_rate: Positive = 1.86e-4
    """Adam, actor and critics alike."""
    gamma: Fraction = 0.99
    tau: Fraction = 0.005
    """Polyak rate of the targets."""
    batch: Count = 86
    critic_layers: tuple[Count, ...] = (64, 64)
    critic_activation: Activation = "tanh"
    critic_layer_norm: Literal["none", "standard"] = "standard"
    sigma: NonNegative = 0.29
    """Standard deviation of exploration and target noise, in units of the action's bound (eq. 3)."""
    target_noise: bool = True
    """Smooth the targets with noise (eq. 3); off as in DDPG."""
    twin: bool = True
    """Two critics, the smaller of which counts (eq. 1); one as in DDPG."""
    noise_clip: NonNegative = 0.5
    """Both noises are clipped to this, in units of the action's bound."""
    policy_delay: Count = 3
    """Critic updates for one of the actor and the targets."""
    gradient_clip: Positive = 10.0
    """Largest gradient norm, of the actor and of each twin critic's pair."""
    buffer: Annotated[int, Meta(ge=1, le=100_000_000)] = 800_000
    """Transitions in the shared memory D."""
    exploring_flights: Annotated[int, Meta(ge=0)] = 0
    """Further flights of the TD3 actor in each generation, with noise, on tasks of their own: they enter the shared
    memory and count as frames. A learner whose own flights are few learns to act where it never goes."""
    learning_starts: int = 10_000
    """Frames gathered before the first update."""
    updates_per_frame: NonNegative = 1.0
    """Critic updates for each frame gathered."""
    reward_scale: Positive = 1.0
    """Multiplied onto every reward that the critics see, and onto CAPS's weights beside them. The optimum stays;
    a critic whose values are near one gets there in fewer of Adam's steps, which do not grow with the error."""
    discount_penalty: bool = True
    """Remember a crash with the discounted value of losing C_P in every remaining frame, instead of their sum
    (eq. 13), which would be up to 4000 in one reward; the fitness keeps the sum."""
    lambda_s: NonNegative = 0.5
    """Weight of the spatial term of CAPS (eq. 15); 0 switches it off."""
    lambda_t: NonNegative = 0.1
    """Weight of the temporal term of CAPS."""
    caps_sigma: NonNegative = 0.05
    """Standard deviation of the perturbed observation of CAPS [rad, rad/s]."""


class GeneticSettings(Settings, frozen=True):
    """The genetic population (thesis sections II.B, II.C and III.B)."""

    population: Annotated[int, Meta(ge=0)] = 10
    """Genetic actors N; the TD3 actor flies beside them. 0 trains TD3 alone."""
    evaluations: Count = 3
    """Flights of each actor per generation; their mean return is the fitness (eq. 4)."""
    stored_evaluations: Count = 1
    """The last so many of them enter the memories and count as frames, as in the published runs."""
    stored_share: Fraction = 1.0
    """Share of the genetic actors, drawn anew each generation, whose stored flights enter the shared memory and
    count as frames; the TD3 actor's always do, and every actor remembers its own states."""
    elite_fraction: Fraction = 0.2
    tournament: Count = 3
    mutation: Literal["safe", "proximal", "gaussian"] = "safe"
    mutation_magnitude: NonNegative = 2.47e-2
    """sigma_mut of eqs 5 and 8."""
    mutation_end: Fraction = 1.0
    """Share of ``mutation_magnitude`` that is left when the configured frames are reached; it falls linearly."""
    mutation_probability: Fraction = 0.9
    mutation_batch: Count = 86
    """States over which the sensitivity is summed (eq. 8)."""
    sensitivity_floor: Positive = 0.01
    memory: Annotated[int, Meta(ge=2, le=10_000_000)] = 8_000
    """kappa: states in each actor's genetic memory, and in its critical buffer."""
    pairing: Literal["distance", "fitness"] = "distance"
    """How crossover pairs are ranked: behavioural distance (eq. 7) or summed fitness."""
    pairing_batch: Count = 256
    """States of each parent's memory in eq. 7."""
    crossover_epochs: Count = 12
    """Passes over the child's memory while the parents are distilled (eq. 6)."""
    crossover_batch: Count = 128
    crossover_learning_rate: Positive = 1e-3
    synchronisation: Count = 1
    """Generations between two injections of the TD3 actor."""
    smooth_fitness: bool = False
    """Add Sm (eq. 16) to the fitness."""


class TaskSettings(Settings, frozen=True):
    """The flights that are trained on (thesis section III.D)."""

    duration: Annotated[float, Meta(ge=0.1, le=3600.0)] = 20.0
    """T_max [s]."""
    family: FamilyName | Literal["published"] = "training"
    """References, common to all actors of a generation: ``training`` as in the text (theta +-25, phi +-45 deg),
    ``published`` as in the published runs (theta +-30, phi +-20 deg), or another family of ``task.reference``."""
    altitude: Positive = 2000.0
    """Trim altitude [m]."""
    speed: Positive = 90.0
    """Trim speed [m/s]."""

    @property
    def ticks(self) -> int:
        """Samples of one flight."""
        return round(self.duration / DT)


class EnvironmentSettings(Settings, frozen=True):
    """A Gymnasium environment in the place of the Citation (``export.training.gymnasium_rollouts``)."""

    id: str
    """As ``gymnasium.make`` takes it: ``Pendulum-v1``, or ``module:name`` for one that a module registers."""
    arguments: dict[str, bool | int | float | str] = {}
    """Keyword arguments of the environment."""
    ticks: Annotated[int, Meta(ge=0)] = 0
    """Most steps of an episode; 0: the environment's own time limit."""
    validation_episodes: Count = 20
    """Episodes, of seeds that training does not see, by which the champion is picked and the curve's bands are made."""
    validation_frames: Count = 40_000
    """Frames between two points of that curve."""


class TrainingConfig(Settings, frozen=True):
    """One training run."""

    name: Annotated[str, Meta(pattern=r"^[^\s./\\][^\n/\\]*$")]
    """Of the run, and of its folder under ``runs`` where none is given."""
    frames: Count
    """Stop after the generation in which the stored frames reach this number."""
    seed: Seed = 0
    actor: ActorSettings = ActorSettings()
    td3: TD3Settings = TD3Settings()
    genetic: GeneticSettings = GeneticSettings()
    task: TaskSettings = TaskSettings()
    environment: EnvironmentSettings | None = None
    """Trained on in the place of the Citation's ``task``."""
    overlap: bool = False
    """Let the next generation fly while TD3 learns from this one: the TD3 actor that flies, and is injected, is then
    one generation late. Where it flies (``--workers``) changes nothing; without it nobody flies while TD3 learns."""
    validation_references: Count = 5
    """Evaluation references (80 s) by which the champion is picked when the run ends."""
    checkpoint_seconds: NonNegative = 60.0
    """Least wall time between two checkpoints [s]; the result does not depend on it."""

    def __post_init__(self) -> None:
        """Check what single fields cannot."""
        if self.genetic.stored_evaluations > self.genetic.evaluations:
            raise ValueError(
                f"genetic.stored_evaluations: expected at most genetic.evaluations = {self.genetic.evaluations}, "
                f"got {self.genetic.stored_evaluations}"
            )
        if self.td3.updates_per_frame > 0.0 and self.td3.buffer <= self.td3.learning_starts:
            raise ValueError(
                f"td3.buffer: expected more than td3.learning_starts = {self.td3.learning_starts}, or nothing is ever "
                f"learnt, got {self.td3.buffer}"
            )
        safe = self.genetic.population and self.genetic.mutation == "safe"
        if safe and self.genetic.memory <= self.genetic.mutation_batch:
            raise ValueError(
                f"genetic.memory: expected more than genetic.mutation_batch = {self.genetic.mutation_batch}, or safe "
                f"mutation never sees a critical state, got {self.genetic.memory}"
            )
        for name, units, norm in (
            ("actor.width", (self.actor.width,), self.actor.layer_norm),
            ("td3.critic_layers", self.td3.critic_layers, self.td3.critic_layer_norm),
        ):
            if norm != "none" and 1 in units:
                raise ValueError(f"{name}: expected at least 2 units where a LayerNorm follows, got 1")


def load(name_or_path: str) -> TrainingConfig:
    """Return a configuration by the name of one that ships (``serl10``) or by path; raise UserError."""
    path = Path(name_or_path)
    if path.suffix != ".toml":
        shipped = CONFIGS / f"{name_or_path}.toml"
        if not shipped.exists():
            known = ", ".join(sorted(p.stem for p in CONFIGS.glob("*.toml")))
            raise UserError(
                f"no training configuration '{name_or_path}'; expected one of {known}, or a path to a .toml"
            )
        path = shipped
    return load_toml(path, TrainingConfig, "training configuration")


def as_toml(config: TrainingConfig) -> str:
    """Return the whole configuration, defaults included, as TOML that :func:`load` reads."""
    values = {key: value for key, value in msgspec.to_builtins(config).items() if value is not None}
    lines = [f"{key} = {_toml(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for table, rows in values.items():
        if isinstance(rows, dict):
            lines += ["", f"[{table}]", *(f"{key} = {_toml(value)}" for key, value in rows.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + "}"
    return msgspec.json.encode(value).decode()  # of strings, numbers, booleans and lists TOML writes the same
