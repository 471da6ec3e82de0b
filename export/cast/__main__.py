"""Entry of ``python -m export.cast``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("export.cast.cli:main")
