"""The walls: who imports whom, and a runtime that flies where nothing of the offline side is installed."""

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OFFLINE = ("torch", "jsbsim", "onnx", "matplotlib", "scipy", "gymnasium", "rich", "filterpy", "pyulog")
OTHERS = ("export", "sim_bridge", "scenarios")


def test_import_contracts_hold():
    command = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([command, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("module", ["runtime", "runtime.cli"])
def test_importing_the_runtime_loads_nothing_of_the_others(module):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", f"import {module}"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    loaded = {line.rsplit("|", 1)[1].strip().split(".")[0] for line in done.stderr.splitlines() if "|" in line}
    assert "runtime" in loaded
    assert not loaded & {*OFFLINE, *OTHERS}


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def check_what_is_typed(binaries, elsewhere, environment):
    """The one command is there, and what the offline side needs is said in one line, however it is asked for."""

    def typed(*command):
        return subprocess.run(
            [binaries / command[0], *command[1:]], cwd=elsewhere, env=environment, capture_output=True, text=True,
            check=False,
        )  # fmt: skip

    version = typed("understudy", "--version")
    assert version.returncode == 0, version.stderr
    for command, extra in (
        (("understudy", "train", "small"), "export"),
        (("understudy", "fly", "cg_shift"), "sim"),
        (("python", "-m", "export.study", "sweep"), "export"),
        (("python", "-m", "scenarios.campaign"), "sim"),
        (("python", "-m", "sim_bridge"), "sim"),
    ):
        done = typed(*command)
        assert done.returncode == 2, done.stderr
        assert re.fullmatch(rf"understudy: .* needs \w+, which is not installed; .*\[{extra}\]'\n", done.stderr)


def test_the_base_install_flies_without_torch_and_jsbsim(tmp_path, population_folder):
    """A fresh environment with what `pip install understudy` brings; it needs the package index."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "bare"], check=True)
    python = tmp_path / "bare" / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, "-c", ROOT / "constraints.txt", ROOT], check=True, cwd=tmp_path)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    missing = f"import importlib.util as u; print([m for m in {OFFLINE!r} if u.find_spec(m)])"
    found = subprocess.run([python, "-c", missing], cwd=tmp_path, env=environment, capture_output=True, check=True)
    assert found.stdout.strip() == b"[]"
    check_what_is_typed(python.parent, tmp_path, environment)

    port = free_port()
    log = tmp_path / "f.ulg"
    flying = subprocess.Popen(
        [python, "-m", "runtime", "--link", f"udpin:127.0.0.1:{port}", "--population", population_folder, "--log", log],
        cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    aircraft = subprocess.run(
        [sys.executable, "-m", "sim_bridge", "--link", f"udpout:127.0.0.1:{port}", "--duration", "3",
         "--truth", tmp_path / "t.npz"],
        cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    try:
        said = flying.communicate(timeout=60)[1]
    finally:
        flying.kill()
    assert aircraft.returncode == 0, aircraft.stderr
    assert flying.returncode == 0, said
    summary = json.loads((tmp_path / "f.summary.json").read_text())
    assert summary["cycles"] > 100
    assert re.search(r"flight over|aircraft is lost", said)
