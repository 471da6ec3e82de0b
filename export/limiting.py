"""Limited actuators in an imagination: ``task.actuators.limited``, as little of it as can be within the loop.

What is limited once stays so while it waits. The loop therefore limits every command as it is given, against the one
given before it, and what waits when the flights begin is limited ahead of the loop: what acts is the same as if each
were limited when its turn comes, and where the command before lies in the queue does not depend on the delay.
"""

from __future__ import annotations

import numpy as np
import onnx

from export.builder import Builder, value
from export.rollout import MAX_DELAY
from export.stepping import ACTING, N_LINEAR, ONE
from task.actuators import ACTUATOR
from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.state import N_ACTION

FREE = 1e9
"""A rate [rad/s] without end, as the loop's product wants it: there infinity times zero would not be zero."""

GIVEN = 2
"""Rows at the head of the queue that are what acts already, and are not limited: acted and acting."""


class Limits:
    """Range and reach of a sample in the units of the loop's commands, made before it from ``actuators`` (3, 3)."""

    def __init__(self, g: Builder, offset: np.ndarray, unit: np.ndarray) -> None:
        """Add them; offset, unit: (3,) [rad], a command is offset + unit * its row."""
        self._offset, self._unit = g.constant(offset, "offset"), g.constant(unit, "unit")
        low, high, rate = (g.slice("actuators", 0, row, row + 1) for row in ACTUATOR)
        bounds = self.rows(g, low), self.rows(g, high)
        free = g.constant(np.array(FREE), "endless")
        reach = g.op("Mul", g.op("Min", rate, free), g.constant(DT / np.abs(unit), "sample"))
        # a negative unit turns the range around
        self._rows = g.op("Min", *bounds, name="low"), g.op("Max", *bounds, name="high"), reach
        self._low, self._high, self._reach = (g.op("Transpose", row) for row in self._rows)
        out = g.op("Concat", g.op("Neg", low), high, rate, axis=0)
        least = np.stack([-ACTION_LOW, ACTION_HIGH, np.full(N_ACTION, FREE)])
        each = g.op("Cast", g.op("GreaterOrEqual", out, g.constant(least, "no_limit")), to=onnx.TensorProto.FLOAT)
        self.free = g.op("Cast", g.op("ReduceMin", each, keepdims=0), to=onnx.TensorProto.BOOL, name="free")
        """Whether no surface has a limit of its own, ()."""

    def rows(self, g: Builder, commands: str) -> str:
        """Add rows (n, 3) of commands (n, 3) [rad]."""
        return g.op("Div", g.op("Sub", commands, self._offset), self._unit)

    def waiting(self, g: Builder, recent: str, lag: int) -> str:
        """Add the queue (n, 3) as its commands will act; the first of them do already."""
        count = g.slice(g.op("Shape", recent), 0, 0, 1)
        given = np.zeros((lag + 1 + MAX_DELAY, N_ACTION))
        given[:GIVEN] = np.inf
        slack = g.op("Slice", g.constant(given, "given"), g.integers(0), count, g.integers(0))
        low, high, reach = self._rows
        bounds = g.op("Sub", low, slack), g.op("Add", high, slack), g.op("Add", reach, slack)
        b = Builder(outer=g, prefix="waiting/")
        of = ["waiting/command", "waiting/low", "waiting/high", "waiting/reach"]
        last, (command, lowest, highest, step) = "waiting/last", of
        within = b.op("Min", b.op("Max", command, lowest), highest)
        acting = b.op("Min", b.op("Max", within, b.op("Sub", last, step)), b.op("Add", last, step), name="acting")
        row = (N_ACTION,)
        body = b.body(
            "waiting",
            [value(name, row) for name in (last, *of)],
            [value(acting, row), value(b.op("Identity", acting), row)],
        )
        first = g.op("Reshape", g.slice(recent, 0, 0, 1), g.integers(-1))
        names = ["last_waiting", "waiting"]
        return g.ops("Scan", first, recent, *bounds, names=names, body=body, num_scan_inputs=len(of))[1]

    def reached(self, g: Builder, step_map: str, own: int, waiting: str, lag: int) -> str:
        """Add rows to a step's map (M, n, columns): the most and the least that the next command can be, 3 each.

        own: columns ahead of L; waiting: (1,) columns behind those that every L has.
        """
        columns = N_LINEAR if lag else ACTING
        between = g.op("Add", waiting, g.integers(columns - ONE - 1 - N_ACTION))
        pads = g.op("Concat", g.integers(0, own + ONE, 0), between, axis=0)
        both = g.op("Concat", self._reach, g.op("Neg", self._reach), axis=0)
        newest = g.constant(np.tile(np.eye(N_ACTION), (2, 1)), "newest")
        rows = g.op("Concat", g.op("Pad", both, pads), newest, axis=1)
        models = g.slice(g.op("Shape", step_map), 0, 0, 1)
        every = g.op("Expand", rows, g.op("Concat", models, g.op("Shape", rows), axis=0))
        return g.op("Concat", step_map, every, axis=1, name="step_and_reach")

    def limited(self, b: Builder, command: str, most: str, least: str) -> str:
        """Add commands (M, 3, A) as they will act; most, least: (M, 3, A), from the rows of :meth:`reached`."""
        within = b.op("Min", b.op("Max", command, self._low), self._high)
        return b.op("Min", b.op("Max", within, least), most, name="limited")
