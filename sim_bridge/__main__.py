"""``python -m sim_bridge``: the bridge."""

from sim_bridge.cli import bridge
from understudy import run

if __name__ == "__main__":
    run(bridge)
