"""Entry of ``python -m bench.cast_shapes``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("bench.cast_shapes.command:main")
