"""``python -m sim_bridge``: the bridge."""

from understudy import run

if __name__ == "__main__":
    run("sim_bridge.cli:bridge")
