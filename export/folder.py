"""A population's folder, written whole or not at all, and flown once in onnxruntime before it gets its name."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import onnxruntime

from export.behaviour import behaviour
from export.card import CARD, card
from export.golden import GoldenImagination
from export.imagination import imagination
from export.law_imagination import law_imagination
from export.manifest import MANIFEST, Manifest, describe
from export.network import unflatten
from export.population import PARAMETERS, Population, checked
from export.prior import COMMAND_LAG, Prior
from task.actuators import HEALTHY
from task.config import to_json
from task.errors import UserError
from task.files import make_folder
from task.model import embed_reduced
from task.rates import RATE_MODEL_VERSION, RateModel

if TYPE_CHECKING:
    from export.screening import Screening

BEHAVIOUR = "behaviour.onnx"
IMAGINATION = "imagination.onnx"
LAWS = "laws.onnx"
PRIOR = "model_prior.npz"
RATES = "rate_model.npz"
TRAINING = "training"


def versions() -> dict[str, str]:
    """Return the versions of what writes the folder."""
    packages = {name: metadata.version(name) for name in ("understudy", "numpy", "onnx", "onnxruntime")}
    return packages | {"onnx_opset": str(onnx.defs.onnx_opset_version())}


def write_population(
    population: Population,
    prior: Prior,
    folder: Path,
    records: Mapping[str, Path] | None = None,
    lag: int = COMMAND_LAG,
    rates: RateModel | None = None,
    screening: Screening | None = None,
) -> Manifest:
    """Write ``folder``; return its manifest.

    rates: model that the runtime needs to find the effectiveness of the surfaces; a population flies without it.
    screening: what the members were seen to do, for the model card.
    records: files copied to ``training/`` under their names. The folder appears complete, checked against its own
    golden samples, or does not appear; an older population of that name is replaced. Raises UserError when the
    population does not hold together or ``folder`` holds something else.
    """
    checked(population, folder.name)
    check_place(folder)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as temporary:
        made = Path(temporary) / "new"
        made.mkdir()
        if rates is not None:
            np.savez(made / RATES, version=RATE_MODEL_VERSION, drift=rates.drift, effect=rates.effect)
        (made / CARD).write_text(card(population, folder.name, versions(), screening))
        manifest = _fill(made, population, prior, folder.name, records or {}, lag)
        verify(made, manifest, population, prior)
        old = Path(temporary) / "old"
        if folder.exists():
            folder.rename(old)
        try:
            made.rename(folder)
        except OSError as error:
            if old.exists():
                old.rename(folder)
            raise UserError(f"{folder}: cannot be written: {error.strerror}; the population is as it was") from None
    return manifest


def check_place(folder: Path) -> None:
    """Raise UserError unless a population can be written to ``folder``."""
    if folder.name in ("", ".."):
        raise UserError(f"{str(folder)!r}: expected a folder named as the population; give populations/NAME")
    if folder.exists() and not (folder.is_dir() and ((folder / MANIFEST).exists() or not any(folder.iterdir()))):
        raise UserError(f"{folder}: exists and is not a population; choose another folder or remove it")
    make_folder(folder.parent, str(folder))


def _fill(
    folder: Path, population: Population, prior: Prior, name: str, records: Mapping[str, Path], lag: int
) -> Manifest:
    np.save(folder / PARAMETERS, population.parameters, allow_pickle=False)
    np.savez(folder / PRIOR, theta=prior.theta, p0=prior.p0, learnt_at=np.array(prior.learnt_at))
    (folder / BEHAVIOUR).write_bytes(behaviour(population.network).SerializeToString())
    graph = imagination(population.network, population.parameters, lag)
    (folder / IMAGINATION).write_bytes(graph.SerializeToString())
    (folder / LAWS).write_bytes(law_imagination(lag).SerializeToString())
    if records:
        (folder / TRAINING).mkdir()
    for record, source in records.items():
        shutil.copyfile(source, folder / TRAINING / record)
    manifest = describe(population, prior, folder, name, versions(), lag)
    (folder / MANIFEST).write_bytes(to_json(manifest))
    return manifest


def session(path: Path) -> onnxruntime.InferenceSession:
    """Return a single-threaded session of a graph."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def verify(folder: Path, manifest: Manifest, population: Population, prior: Prior) -> None:
    """Raise RuntimeError unless all graphs give the golden samples within their tolerances."""
    golden = manifest.golden_actions
    policy = session(folder / BEHAVIOUR)
    worst = 0.0
    for parameters, answers in zip(population.parameters, golden.actions, strict=True):
        tensors = unflatten(population.network, parameters)
        for s, answer in zip(golden.observations, answers, strict=True):
            action = policy.run(None, {"observation": np.array([s], dtype=np.float32), **tensors})[0]
            worst = max(worst, float(np.abs(action[0] - answer).max()))
    _within("behaviour", worst, golden.tolerance)

    play = manifest.golden_imagination
    asked = _question(play, prior)
    healthy, limited = (
        {"actuators": actuators.astype(np.float32)} for actuators in (HEALTHY, np.array(play.actuators))
    )
    members = asked | {"incumbent": population.parameters[play.incumbent]}
    graph = session(folder / IMAGINATION)
    _within("imagination", _difference(graph, members | healthy, play.returns), play.tolerance)
    _within("imagination", _difference(graph, members | limited, play.limited_returns), play.tolerance)
    laws = manifest.golden_laws
    if laws is not None:
        given = {"maps": np.array(laws.maps, dtype=np.float32), "memory": np.array(laws.memory, dtype=np.float32)}
        graph = session(folder / LAWS)
        _within("laws", _difference(graph, asked | given | healthy, laws.returns), laws.tolerance)
        _within("laws", _difference(graph, asked | given | limited, laws.limited_returns), laws.tolerance)


def _question(play: GoldenImagination, prior: Prior) -> dict[str, np.ndarray]:
    """Return the inputs that every imagination has, but for the actuators."""
    vectors = {name: np.array(getattr(play, name), dtype=np.float32) for name in ("x", "dx", "commands", "reference")}
    return {
        **vectors,
        "delay": np.array(play.delay),
        "model": embed_reduced(prior.theta)[None].astype(np.float32),
        "exact_kinematics": np.array(True),
    }


def _difference(graph: onnxruntime.InferenceSession, question: dict[str, np.ndarray], returns: list[float]) -> float:
    return float(np.abs(graph.run(["returns"], question)[0][0] - returns).max())


def _within(graph: str, difference: float, tolerance: float) -> None:
    if not difference <= tolerance:
        raise RuntimeError(f"{graph}.onnx differs from its reference by {difference:.2e}, tolerance {tolerance:.0e}")
