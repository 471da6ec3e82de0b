"""Entry of ``python -m scenarios.campaign``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("scenarios.campaign.command:main")
