"""The cast: a population folder, verified before it flies, and the behavioural policy with live parameters."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import onnxruntime

from runtime.manifest import GoldenImagination, GoldenLaws, Header, Manifest, check, check_header
from task.actuators import HEALTHY, N_ACTUATOR
from task.config import convert, read_bytes
from task.errors import UserError
from task.laws import N_MEMORY, N_SEEN
from task.model import DYNAMIC, N_REGRESSORS, REDUCED_REGRESSORS, embed_reduced
from task.observation import observation
from task.rates import RATE_MODEL_VERSION, RateModel, shapes
from task.scheduling import Condition
from task.state import N_ACTION, N_IDENTIFIED, N_OBSERVATION, N_REFERENCE

MANIFEST = "manifest.json"
PARAMETERS = "parameters.npy"
BEHAVIOUR = "behaviour.onnx"
IMAGINATION = "imagination.onnx"
PRIOR = "model_prior.npz"
RATES = "rate_model.npz"
LAWS = "laws.onnx"

PROBE_SIZE = 0.2
"""Largest error, rate and angle of attack at which members are compared [rad, rad/s]: those of a lively flight."""

_QUESTION = ("x", "dx", "commands", "delay", "model", "exact_kinematics", "actuators", "reference")
IMAGINATION_INPUTS = (*_QUESTION, "incumbent")
LAWS_INPUTS = (*_QUESTION, "maps", "memory")
IMAGINATION_OUTPUTS = ("returns", "unsafe", "travel")


class Population(NamedTuple):
    """A verified cast; everything that flies comes from these bytes, not from the disk again."""

    manifest: Manifest
    parameters: np.ndarray
    """(P, K) float32, read-only: every member's parameters."""
    behaviour: bytes
    """ONNX graph of the behavioural policy."""
    imagination: bytes
    """ONNX graph of the whole population's rollout."""
    theta: np.ndarray
    """(11, 6): prior of the reduced incremental model."""
    p0: np.ndarray
    """(11, 11): its uncertainty."""
    learnt_at: Condition
    """Flight condition that the prior is of."""
    sha256: str
    """Hash of the manifest, and so of everything: which cast flew."""
    rates: RateModel | None = None
    """Model of the angular accelerations (:mod:`task.rates`); None when the population was exported without."""
    laws: bytes | None = None
    """ONNX graph of the rollout of classical laws (:mod:`task.laws`); None when the population was exported without."""

    def laws_graph(self) -> bytes:
        """Return the graph that plays laws. Raises UserError without one."""
        if self.laws is None:
            raise UserError(
                f"population {self.name}: brings no {LAWS}, so that no laws can be members; export it again, or "
                "--set laws=[] --set first="
            )
        return self.laws

    @property
    def name(self) -> str:
        """Return the population's name."""
        return self.manifest.name

    @property
    def members(self) -> list[str]:
        """Return the members' names."""
        return [m.name for m in self.manifest.members]

    @property
    def champion(self) -> int:
        """Return the index of the member that flies first."""
        return self.members.index(self.manifest.champion)

    @property
    def command_lag(self) -> int:
        """Return the samples between a command and the increment that it moves, beyond eq. 8.2."""
        return self.manifest.command_lag

    @property
    def max_delay(self) -> int:
        """Return the longest delay of the commands, beyond the lag, that the imagination carries [samples]."""
        return self.manifest.max_delay


def make_session(graph: bytes, what: str) -> onnxruntime.InferenceSession:
    """Return a session that uses the calling thread alone; raise UserError when the graph is not sound.

    One thread, sequential, no spinning: a pool that spins eats the cores that the other duties need.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # what is wrong is said once, by us
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen kinds that share no base
        raise UserError(
            f"{what}: onnxruntime cannot load it: {_one_line(error)}; export the population again"
        ) from None


def load_population(folder: Path) -> Population:
    """Read and verify a population; raise UserError with one line when it is not whole, sound and for this runtime.

    Checked: format and version, SHA-256 of every file that flies, layouts and units, shapes, finite parameters, the
    graphs' inputs and outputs, and the golden samples of every member and of the imagination.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: no such population; give a folder that 'understudy export' wrote")
    raw = read_bytes(folder / MANIFEST, "manifest of a population")
    manifest = _parse(raw, str(folder / MANIFEST))
    contents = {name: _verified(folder, name, manifest) for name in (PARAMETERS, BEHAVIOUR, IMAGINATION, PRIOR)}
    parameters = _array(contents[PARAMETERS], folder / PARAMETERS)
    expected = (len(manifest.members), manifest.n_parameters)
    if parameters.dtype != np.float32 or parameters.shape != expected or not np.isfinite(parameters).all():
        raise UserError(
            f"{folder / PARAMETERS}: expected finite float32 {expected} (members, parameters), "
            f"got {parameters.dtype} {parameters.shape}; export the population again"
        )
    parameters.setflags(write=False)
    theta, p0, learnt_at = _prior(contents[PRIOR], folder / PRIOR)
    population = Population(
        manifest,
        parameters,
        contents[BEHAVIOUR],
        contents[IMAGINATION],
        theta,
        p0,
        learnt_at,
        hashlib.sha256(raw).hexdigest(),
        _rates(_verified(folder, RATES, manifest), folder / RATES) if RATES in manifest.files else None,
        _verified(folder, LAWS, manifest) if LAWS in manifest.files else None,
    )
    _check_behaviour(population, folder / BEHAVIOUR)
    _check_imagination(population, folder / IMAGINATION)
    if population.laws is not None:
        _check_laws(population, population.laws, folder / LAWS)
    return population


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]


def _parse(raw: bytes, where: str) -> Manifest:
    try:
        data = msgspec.json.decode(raw)
    except msgspec.DecodeError as error:
        raise UserError(f"{where}: not valid JSON: {error}; export the population again") from None
    check_header(convert(data, Header, where), where)
    manifest = convert(data, Manifest, where)
    check(manifest, where)
    return manifest


def _verified(folder: Path, name: str, manifest: Manifest) -> bytes:
    """Return a file's bytes if they are those that the manifest was written for."""
    content = read_bytes(folder / name, "file of the population")
    stated = manifest.files.get(name)
    found = hashlib.sha256(content).hexdigest()
    if stated != found:
        stated_short = f"{stated[:12]}..." if stated else "no hash"
        raise UserError(
            f"{folder / name}: SHA-256 {found[:12]}... is not the manifest's {stated_short}: "
            "the file was changed or damaged; copy or export the population again"
        )
    return content


def _array(content: bytes, path: Path) -> np.ndarray:
    try:
        return np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise UserError(f"{path}: not a plain .npy array: {_one_line(error)}") from None


def _prior(content: bytes, path: Path) -> tuple[np.ndarray, np.ndarray, Condition]:
    n, m = len(REDUCED_REGRESSORS), len(DYNAMIC)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            theta, p0 = np.asarray(arrays["theta"], float), np.asarray(arrays["p0"], float)
            learnt_at = Condition(*np.asarray(arrays["learnt_at"], float).tolist())
    except Exception as error:  # zip, npy and key errors share no base
        raise UserError(
            f"{path}: expected arrays theta, p0 and learnt_at (V, h): {_one_line(error)}; export the population again"
        ) from None
    if not all(np.isfinite(learnt_at)) or learnt_at.V <= 0.0:
        raise UserError(f"{path}: learnt_at: expected speed > 0 [m/s] and altitude [m], got {tuple(learnt_at)}")
    if theta.shape != (n, m) or p0.shape != (n, n) or not (np.isfinite(theta).all() and np.isfinite(p0).all()):
        raise UserError(f"{path}: expected finite theta {(n, m)} and p0 {(n, n)}, got {theta.shape} and {p0.shape}")
    return theta, p0, learnt_at


def probe(population: Population, count: int = 32, seed: int = 0) -> np.ndarray:
    """Return what every member commands on the same ``count`` random observations, (P, count, 3) [rad]."""
    policy = BehaviouralPolicy(population)
    observations = np.random.default_rng(seed).uniform(-PROBE_SIZE, PROBE_SIZE, (count, N_OBSERVATION))
    actions = np.zeros((len(population.members), count, N_ACTION))
    for member, answers in enumerate(actions):
        np.copyto(policy.parameters, population.parameters[member])
        for s, answer in zip(observations, answers, strict=True):
            answer[:] = policy.act(s)
    return actions


def _rates(content: bytes, path: Path) -> RateModel:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            version = int(arrays["version"])
            model = RateModel(*(np.asarray(arrays[name], float) for name in RateModel._fields))
    except Exception as error:  # zip, npy and key errors share no base
        raise UserError(f"{path}: expected version, drift and effect: {_one_line(error)}") from None
    if version != RATE_MODEL_VERSION:
        raise UserError(
            f"{path}: version: this runtime reads {RATE_MODEL_VERSION}, got {version}; export the population again"
        )
    got = {name: array.shape for name, array in zip(RateModel._fields, model, strict=True)}
    if got != shapes() or not all(np.isfinite(array).all() for array in model):
        raise UserError(f"{path}: expected finite {shapes()}, got {got}; export the population again")
    return model


def _check_interface(
    session: onnxruntime.InferenceSession, inputs: dict[str, tuple[int | None, ...]], named: tuple[str, ...], path: Path
) -> None:
    """Raise UserError unless the graph has these inputs (None: any length) and outputs of these names."""
    got = {i.name: tuple(d if isinstance(d, int) else None for d in i.shape) for i in session.get_inputs()}
    outputs = tuple(o.name for o in session.get_outputs())
    if got != inputs or outputs != named:
        wrong = sorted(set(got.items()) ^ set(inputs.items())) if got != inputs else outputs
        raise UserError(f"{path}: inputs or output differ from the manifest at {wrong}; export the population again")


def _check_behaviour(population: Population, path: Path) -> None:
    policy = BehaviouralPolicy(population, str(path))
    golden = population.manifest.golden_actions
    where = f"{path.parent / MANIFEST}: golden_actions"
    observations = _golden(golden.observations, f"{where}.observations").astype(np.float32)
    expected = _golden(golden.actions, f"{where}.actions")
    for name, array, shape in (
        ("observations", observations, (len(observations), N_OBSERVATION)),
        ("actions", expected, (len(population.members), len(observations), N_ACTION)),
    ):
        if array.shape != shape:
            raise UserError(f"{where}.{name}: expected {shape}, got {array.shape}; export the population again")
    for member, answers in zip(range(len(population.members)), expected, strict=True):
        np.copyto(policy.parameters, population.parameters[member])
        for s, answer in zip(observations, answers, strict=True):
            difference = float(np.abs(policy.act(s) - answer).max())
            if not difference <= golden.tolerance:
                raise UserError(
                    f"{path}: member {population.members[member]!r} answers a golden sample {difference:.1e} rad off, "
                    f"tolerance {golden.tolerance:.0e}; export the population again"
                )


def _golden(values: list, where: str) -> np.ndarray:
    """Return a golden array; raise UserError when its rows differ in length."""
    try:
        return np.array(values, float)
    except ValueError:
        raise UserError(f"{where}: expected rows of equal length; export the population again") from None


def _question_shapes(population: Population) -> dict[str, tuple[int | None, ...]]:
    """Return the inputs that both graphs have."""
    return {
        "x": (N_IDENTIFIED,),
        "dx": (N_IDENTIFIED,),
        "commands": (population.command_lag + 1 + population.max_delay, N_ACTION),
        "delay": (),
        "model": (None, N_REGRESSORS, N_IDENTIFIED),
        "exact_kinematics": (),
        "actuators": (N_ACTUATOR, N_ACTION),
        "reference": (None, N_REFERENCE),
    }


def _golden_question(population: Population, where: str) -> dict[str, np.ndarray]:
    """Return the golden question but for its actuators, in the model prior with exact kinematics."""
    golden = population.manifest.golden_imagination
    return {
        **{
            name: _golden(getattr(golden, name), f"{where}.{name}").astype(np.float32)
            for name in ("x", "dx", "commands", "reference")
        },
        "delay": np.array(golden.delay),
        "model": embed_reduced(population.theta)[None].astype(np.float32),
        "exact_kinematics": np.array(True),
    }


def _check_play(
    session: onnxruntime.InferenceSession, feeds: dict[str, np.ndarray], golden: GoldenImagination | GoldenLaws,
    actuators: list[list[float]], path: Path,
) -> None:  # fmt: skip
    """Raise UserError unless a graph answers the golden question, surfaces healthy and limited, as when exported."""
    try:
        difference = 0.0
        for of, expected in ((HEALTHY, golden.returns), (np.array(actuators), golden.limited_returns)):
            returns = session.run(["returns"], feeds | {"actuators": of.astype(np.float32)})[0][0]
            difference = float(np.maximum(difference, np.abs(returns - np.array(expected)).max()))
    except Exception as error:  # shapes that do not fit: whatever onnxruntime or numpy calls it
        raise UserError(f"{path}: cannot play the golden imagination: {_one_line(error)}") from None
    if not difference <= golden.tolerance:
        raise UserError(
            f"{path}: the golden imagination is {difference:.1e} off, tolerance {golden.tolerance:.0e}; "
            "export the population again"
        )


def _check_imagination(population: Population, path: Path) -> None:
    session = make_session(population.imagination, str(path))
    shapes = {**_question_shapes(population), "incumbent": (population.manifest.n_parameters,)}
    _check_interface(session, shapes, IMAGINATION_OUTPUTS, path)
    golden = population.manifest.golden_imagination
    question = _golden_question(population, f"{path.parent / MANIFEST}: golden_imagination")
    feeds = {**question, "incumbent": population.parameters[golden.incumbent]}
    _check_play(session, feeds, golden, golden.actuators, path)


def _check_laws(population: Population, graph: bytes, path: Path) -> None:
    golden = population.manifest.golden_laws
    if golden is None:
        raise UserError(f"{path.parent / MANIFEST}: golden_laws: expected answers of {LAWS}, got none; export it again")
    session = make_session(graph, str(path))
    maps = (None, N_ACTION + N_MEMORY, N_MEMORY + N_SEEN)
    shapes = {**_question_shapes(population), "maps": maps, "memory": (None, N_MEMORY)}
    _check_interface(session, shapes, IMAGINATION_OUTPUTS, path)
    where = f"{path.parent / MANIFEST}: golden_"
    laws = {
        name: _golden(getattr(golden, name), f"{where}laws.{name}").astype(np.float32) for name in ("maps", "memory")
    }
    actuators = population.manifest.golden_imagination.actuators
    _check_play(session, {**_golden_question(population, f"{where}imagination"), **laws}, golden, actuators, path)


class BehaviouralPolicy:
    """The policy that flies. Its parameters are live: what is written into them flies from the next call on."""

    def __init__(self, population: Population, where: str = BEHAVIOUR) -> None:
        """Start as the champion; raise UserError when the graph does not fit the manifest."""
        manifest = population.manifest
        session = make_session(population.behaviour, where)
        shapes: dict[str, tuple[int | None, ...]] = {t.name: t.shape for t in manifest.parameters}
        _check_interface(session, {"observation": (1, N_OBSERVATION), **shapes}, ("action",), Path(where))
        self.parameters = population.parameters[population.champion].copy()
        """(K,) float32, flat, in the manifest's layout; change it in place."""
        self._seen = np.zeros(N_OBSERVATION)
        self._observation = np.zeros(N_OBSERVATION, dtype=np.float32)
        self._action = np.zeros(N_ACTION, dtype=np.float32)
        # The graph reads and writes these arrays where they lie: nothing is copied or allocated per call.
        binding = session.io_binding()
        memory = {"device_type": "cpu", "device_id": 0, "element_type": np.float32}
        binding.bind_input("observation", shape=(1, N_OBSERVATION), buffer_ptr=self._observation.ctypes.data, **memory)
        for tensor in manifest.parameters:
            piece = self.parameters[tensor.offset : tensor.offset + tensor.size]
            binding.bind_input(tensor.name, shape=tensor.shape, buffer_ptr=piece.ctypes.data, **memory)
        binding.bind_output("action", shape=(1, N_ACTION), buffer_ptr=self._action.ctypes.data, **memory)
        self._binding = binding
        self._run = session.run_with_iobinding

    def act(self, s: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] for an observation (7,), unlimited; the array is reused by the next call."""
        self._observation[:] = s
        self._run(self._binding)
        return self._action

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] for a state (12,) and a reference (3,) [rad], unlimited; reused by the next."""
        return self.act(observation(x, reference, self._seen))

    def sent(self, command: np.ndarray) -> None:
        """Do nothing: the network remembers no command."""

    def reset(self) -> None:
        """Do nothing: the network remembers no flight; its parameters are the cast's to set."""

    def restart_history(self) -> None:
        """Do nothing: the network remembers no sample."""
