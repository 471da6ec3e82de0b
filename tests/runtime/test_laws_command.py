"""The command with a law: its own process, against the bridge as its own process."""

import json
import os
import socket
import subprocess
import sys

from pyulog import ULog

ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}
TIMEOUT = 60.0


def test_a_law_flies_over_the_link_without_a_population(reference_file, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    bridge = subprocess.Popen(
        [sys.executable, "-m", "sim_bridge", "--link", f"udpout:127.0.0.1:{port}", "--duration", "3"],
        cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        runtime = subprocess.run(
            [
                *(sys.executable, "-m", "runtime", "--link", f"udpin:127.0.0.1:{port}", "--law", "indi-rls-signfree"),
                *("--reference", str(reference_file), "--preset", "understudy", "--switch", "none", "--log", "f.ulg"),
            ],
            cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, timeout=TIMEOUT,
        )  # fmt: skip
        assert bridge.wait(TIMEOUT) == 0
    finally:
        bridge.kill()
        bridge.wait()
    assert runtime.returncode == 0, runtime.stderr
    assert "the law indi-rls-signfree flies alone" in runtime.stderr
    log = ULog(str(tmp_path / "f.ulg"))
    assert json.loads(log.msg_info_dict["members"]) == ["indi-rls-signfree"]
    assert json.loads((tmp_path / "f.summary.json").read_text())["cycles"] == 300
