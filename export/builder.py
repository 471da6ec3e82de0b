"""A small writer of ONNX graphs: nodes by name, constants as initialisers, a checked model at the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

OPSET = 18
IR_VERSION = 9
"""Read by every onnxruntime since 1.17."""

END = np.iinfo(np.int64).max
"""Of an axis, however long."""

Shape = Sequence[int | str]


def value(name: str, shape: Shape, dtype: int = onnx.TensorProto.FLOAT) -> onnx.ValueInfoProto:
    """Return the declaration of an input or output; a string in the shape is a free dimension."""
    return helper.make_tensor_value_info(name, dtype, list(shape))


class Builder:
    """Collects the nodes of one graph or of a loop's body; constants go to the outermost graph."""

    def __init__(self, outer: Builder | None = None, prefix: str = "") -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = outer.initializers if outer else []
        self._names: dict[str, int] = outer._names if outer else {}
        self._integers: dict[tuple[int, ...], str] = outer._integers if outer else {}
        self._prefix = prefix

    def _unique(self, name: str) -> str:
        count = self._names.get(name, 0)
        self._names[name] = count + 1
        return f"{name}_{count}" if count else name

    def constant(self, array: np.ndarray, name: str) -> str:
        """Add an initialiser; float arrays are stored as float32."""
        array = np.asarray(array)
        if array.dtype.kind == "f":
            array = array.astype(np.float32)
        name = self._unique(self._prefix + name)
        self.initializers.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def integers(self, *values: int) -> str:
        """Return an int64 vector, as axes, shapes and indices want it; the same one for the same values."""
        if values not in self._integers:
            name = "i_" + ",".join(map(str, values))
            self.initializers.append(numpy_helper.from_array(np.array(values, dtype=np.int64), name))
            self._integers[values] = name
        return self._integers[values]

    def op(self, kind: str, *inputs: str, name: str | None = None, **attributes: Any) -> str:
        """Add a node with one output; return the output's name."""
        return self.ops(kind, *inputs, names=[name or kind.lower()], **attributes)[0]

    def ops(self, kind: str, *inputs: str, names: Sequence[str], **attributes: Any) -> list[str]:
        """Add a node with several outputs; return their names."""
        outputs = [self._unique(self._prefix + n) for n in names]
        self.nodes.append(helper.make_node(kind, list(inputs), outputs, name=outputs[0], **attributes))
        return outputs

    def slice(self, x: str, axis: int, start: int, end: int = END, name: str | None = None) -> str:
        """Add what lies between two places along one axis."""
        return self.op("Slice", x, self.integers(start), self.integers(end), self.integers(axis), name=name)

    def result(self, source: str, name: str) -> None:
        """Name a value as an output of the graph."""
        self.nodes.append(helper.make_node("Identity", [source], [name], name=f"{name}/out"))

    def graph(
        self, name: str, inputs: Sequence[onnx.ValueInfoProto], outputs: Sequence[onnx.ValueInfoProto]
    ) -> onnx.GraphProto:
        """Return the graph; the outermost carries the initialisers."""
        return helper.make_graph(self.nodes, name, list(inputs), list(outputs), self.initializers)

    def body(
        self, name: str, inputs: Sequence[onnx.ValueInfoProto], outputs: Sequence[onnx.ValueInfoProto]
    ) -> onnx.GraphProto:
        """Return a loop's body, which reads the constants of the outer graph."""
        return helper.make_graph(self.nodes, name, list(inputs), list(outputs))

    def model(
        self,
        name: str,
        inputs: Sequence[onnx.ValueInfoProto],
        outputs: Sequence[onnx.ValueInfoProto],
        description: str = "",
    ) -> onnx.ModelProto:
        """Return the checked model; raises onnx's own error when a node, type or shape does not fit."""
        model = helper.make_model(
            self.graph(name, inputs, outputs),
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="understudy",
            doc_string=description,
        )
        onnx.checker.check_model(model, full_check=True)
        onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
        return model
