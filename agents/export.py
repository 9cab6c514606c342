"""A learned policy as an ONNX model: signals in SI units in, valve commands out, for any runtime."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from sayd_env.agents.bogie_encoding import BogieEncoding
from sayd_env.agents.encoding import Encoding, VehicleEncoding
from sayd_env.agents.policy_file import LearnedPolicy, PolicyDescription, StoredPolicy, interface_like
from sayd_env.config import StudyError
from sayd_env.config.storage import write_file
from sayd_env.envs.scaled import FLOOR

OPSET = 17
INPUT, OUTPUT = "observation", "command"


def export_onnx(stored: StoredPolicy, path: Path) -> None:
    """Write a policy as an ONNX model.

    The model takes ``observation``, float32 of shape (N, *obs) in SI units, and gives ``command``, float32 of
    shape (N, A), valve commands from 0 to 1. Its metadata holds the names of the signals, the layout of the
    valves and the control period. Inside it computes in double precision, as `LearnedPolicy` does.

    Parameters
    ----------
    stored : StoredPolicy
    path : Path

    Raises
    ------
    StudyError
        The file cannot be written, or ONNX refuses the model.
    """
    model = onnx_model(stored)
    try:
        onnx.checker.check_model(model, full_check=True)
    except onnx.checker.ValidationError as error:
        raise StudyError(f"{stored.where}: ONNX refuses the model: {error}") from None
    write_file(path, model.SerializeToString())


def onnx_model(stored: StoredPolicy) -> Any:
    """The ONNX model of a policy."""
    policy = stored.bound(interface_like(stored.description))
    graph = _Graph()
    seen = graph.add("Cast", INPUT, to=TensorProto.DOUBLE)
    values = _network(graph, policy, _encoded(graph, policy.encoding, seen))
    command = _decoded(graph, policy.encoding, values, seen)
    graph.add("Cast", command, to=TensorProto.FLOAT, result=OUTPUT)
    shape = policy.interface.shape
    made = helper.make_graph(
        graph.nodes,
        policy.name,
        [helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, ["N", *shape])],
        [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["N", policy.interface.actions])],
        graph.constants,
    )
    model = helper.make_model(
        made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8, producer_name="sayd-env"
    )
    helper.set_model_props(model, _metadata(stored.description))
    return model


class _Graph:
    """Nodes and constants in the order in which they are added."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any) -> str:
        """Add a constant; return its name."""
        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def add(self, kind: str, *inputs: str, result: str | None = None, **attributes: Any) -> str:
        """Add a node; return the name of its output."""
        name = result or f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name


def _encoded(graph: _Graph, encoding: Encoding, seen: str) -> str:
    """`Encoding.encode`."""
    values = (
        _of_bogies(graph, encoding, seen)
        if isinstance(encoding, BogieEncoding)
        else _of_vehicle(graph, cast(VehicleEncoding, encoding), seen)
    )
    values = _clipped(graph, values, -encoding.clip, encoding.clip)
    # Single precision for a moment, as a learner saw it.
    values = graph.add("Cast", graph.add("Cast", values, to=TensorProto.FLOAT), to=TensorProto.DOUBLE)
    return _reshaped(graph, values, encoding.size)


def _of_vehicle(graph: _Graph, encoding: VehicleEncoding, seen: str) -> str:
    scaling = encoding.scaling
    middle = graph.constant(scaling.middle)
    values = graph.add("Gather", seen, graph.constant(encoding.columns.astype(np.int64)), axis=-1)
    values = graph.add("Where", graph.add("IsNaN", values), middle, values)
    divisor = graph.constant(np.where(scaling.logarithmic, scaling.middle, 1.0))
    ratio = graph.add("Max", graph.add("Div", values, divisor), graph.constant(np.float64(FLOOR)))
    linear = graph.add("Sub", values, middle)
    values = graph.add("Where", graph.constant(scaling.logarithmic), graph.add("Log", ratio), linear)
    return graph.add("Mul", values, graph.constant(scaling.per_half))


def _of_bogies(graph: _Graph, encoding: BogieEncoding, seen: str) -> str:
    nothing, one = graph.constant(np.float64(0.0)), graph.constant(np.float64(1.0))
    seen = _reshaped(graph, seen, len(encoding.linear))
    seen = graph.add("Where", graph.add("IsNaN", seen), nothing, seen)
    linear = graph.add("MatMul", seen, graph.constant(encoding.linear))
    forces = graph.add("Abs", graph.add("MatMul", seen, graph.constant(encoding.force)))
    levels = graph.add("MatMul", forces, graph.constant(encoding.level))
    values = graph.add("Add", graph.add("Add", linear, levels), graph.constant(encoding.constant))
    left = graph.add("Less", graph.add("MatMul", seen, graph.constant(encoding.moment)), nothing)
    sign = _reshaped(graph, graph.add("Where", left, graph.constant(np.float64(-1.0)), one), 1)
    turned = graph.add("Mul", graph.constant(encoding.mirrored), graph.add("Sub", sign, one))
    return graph.add("Mul", _reshaped(graph, values, encoding.size), graph.add("Add", turned, one))


def _network(graph: _Graph, policy: LearnedPolicy, values: str) -> str:
    """`LearnedPolicy.outputs`."""
    activation = "Tanh" if policy.parameters.network.activation == "tanh" else "Relu"
    for i, (weight, bias) in enumerate(policy.layers):
        if i:
            values = graph.add(activation, values)
        product = graph.add("MatMul", values, graph.constant(weight))
        values = graph.add("Add", product, graph.constant(bias))
    return graph.add("Tanh", values) if policy.parameters.squash == "tanh" else values


def _decoded(graph: _Graph, encoding: Encoding, values: str, seen: str) -> str:
    """`Encoding.decode`."""
    bounded = _clipped(graph, values, -1.0, 1.0)
    held = encoding.held if isinstance(encoding, VehicleEncoding) else None
    if held is None:
        scaled = graph.add("Mul", bounded, graph.constant(np.float64(encoding.output.half)))
        command = graph.add("Add", scaled, graph.constant(np.float64(encoding.output.middle)))
    else:
        step = graph.constant(np.float64(cast(VehicleEncoding, encoding).step))
        before = graph.add("Gather", seen, graph.constant(held.astype(np.int64)), axis=-1)
        command = graph.add("Add", before, graph.add("Mul", bounded, step))
    return _reshaped(graph, _clipped(graph, command, 0.0, 1.0), encoding.units * encoding.actions)


def _reshaped(graph: _Graph, values: str, width: int) -> str:
    return graph.add("Reshape", values, graph.constant(np.array([-1, width], dtype=np.int64)))


def _clipped(graph: _Graph, values: str, low: float, high: float) -> str:
    return graph.add("Clip", values, graph.constant(np.float64(low)), graph.constant(np.float64(high)))


def _metadata(description: PolicyDescription) -> dict[str, str]:
    return {
        "observation": description.observation,
        "signals": " ".join(description.signals),
        "history": str(description.history),
        "valves": description.valves,
        "control_period": repr(description.control_period),
    }
