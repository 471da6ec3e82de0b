"""Entry of ``python -m bench.verification``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("bench.verification.command:main")
