"""A learned policy as an ONNX model: signals in SI units in, valve commands out, for any runtime."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from sayd_env.agents.bogie_encoding import BogieEncoding
from sayd_env.agents.encoding import Encoding, VehicleEncoding
from sayd_env.agents.memory import AVERAGED, MEMORIES, STILL, WIDTH, Memory
from sayd_env.agents.policy_file import (
    LearnedPolicy,
    PolicyDescription,
    RememberingPolicy,
    StoredPolicy,
    Weights,
    interface_like,
)
from sayd_env.agents.state import INPUT, NEXT_STATE, OUTPUT, STATE
from sayd_env.config import StudyError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.storage import write_file
from sayd_env.config.units import KMH
from sayd_env.envs.scaled import FLOOR, Scaling

OPSET = 17


def export_onnx(stored: StoredPolicy, path: Path) -> None:
    """Write a policy as an ONNX model.

    The model takes ``observation``, float32 of shape (N, *obs) in SI units, and gives ``command``, float32 of
    shape (N, A), valve commands from 0 to 1. One that remembers also takes ``state``, float64 of shape
    (N, S), zeros at the start, and gives ``next_state``. Its metadata holds the names of the signals, the
    layout of the valves and the control period. Inside it computes in double precision, as `LearnedPolicy`
    does. A policy that sees forces takes them from pressures with the piston area of the packaged damper,
    which the metadata holds, too.

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
    interface = interface_like(stored.description)
    policy = stored.bound(interface)
    graph = _Graph()
    seen = graph.add("Cast", INPUT, to=TensorProto.DOUBLE)
    inputs = [helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, ["N", *policy.interface.shape])]
    outputs = [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["N", policy.interface.actions])]
    if isinstance(policy, RememberingPolicy):
        values = _remembering(graph, policy, seen)
        inputs.append(helper.make_tensor_value_info(STATE, TensorProto.DOUBLE, ["N", policy.width]))
        outputs.append(helper.make_tensor_value_info(NEXT_STATE, TensorProto.DOUBLE, ["N", policy.width]))
    else:
        values = _network(graph, policy, _encoded(graph, policy.encoding, seen))
    command = _decoded(graph, policy.encoding, values, seen)
    graph.add("Cast", command, to=TensorProto.FLOAT, result=OUTPUT)
    made = helper.make_graph(graph.nodes, policy.name, inputs, outputs, graph.constants)
    model = helper.make_model(
        made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8, producer_name="sayd-env"
    )
    properties = _metadata(stored.description)
    if policy.encoding.memory_width:
        properties["remembered"] = str(policy.encoding.memory_width)
    if isinstance(policy.encoding, BogieEncoding) and isinstance(interface.damper, SaydDamperConfig):
        properties["piston_area"] = repr(interface.damper.cylinder.area)
    helper.set_model_props(model, properties)
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


def _encoded(graph: _Graph, encoding: Encoding, seen: str, memory: str = "") -> str:
    """`Encoding.encode`."""
    values = (
        _of_bogies(graph, encoding, seen)
        if isinstance(encoding, BogieEncoding)
        else _of_vehicle(graph, cast(VehicleEncoding, encoding), seen)
    )
    if encoding.memory is not None:
        values = graph.add("Concat", values, _memory_inputs(graph, encoding.memory, memory), axis=1)
    values = _clipped(graph, values, -encoding.clip, encoding.clip)
    # Single precision for a moment, as a learner saw it.
    values = graph.add("Cast", graph.add("Cast", values, to=TensorProto.FLOAT), to=TensorProto.DOUBLE)
    return _reshaped(graph, values, encoding.size)


def _remembering(graph: _Graph, policy: RememberingPolicy, seen: str) -> str:
    """`RememberingPolicy.predict`: the outputs, and the state after it as `NEXT_STATE`."""
    encoding, split = policy.encoding, policy.encoding.memory_width
    after, memory = [], ""
    if encoding.memory is not None:
        before = _part(graph, STATE, 0, split)
        memory = _remembered(graph, encoding.memory, before, seen, len(encoding.memory.weights))
        after.append(memory)
    outputs = _network(graph, policy, _encoded(graph, encoding, seen, memory))
    if policy.hold > 1:
        elapsed, held = _part(graph, STATE, split, split + 1), _part(graph, STATE, split + 1, policy.width)
        due = graph.add("Equal", elapsed, graph.constant(np.float64(0.0)))
        outputs = graph.add("Where", due, _reshaped(graph, outputs, policy.width - split - 1), held)
        more = graph.add("Add", elapsed, graph.constant(np.float64(1.0)))
        over = graph.add("Less", more, graph.constant(np.float64(policy.hold)))
        after += [graph.add("Where", over, more, graph.constant(np.float64(0.0))), outputs]
    graph.add("Concat", *after, result=NEXT_STATE, axis=1)
    return _reshaped(graph, outputs, encoding.actions)


def _part(graph: _Graph, values: str, begin: int, end: int, axis: int = 1) -> str:
    """Columns of a table."""
    places = [graph.constant(np.array([place], dtype=np.int64)) for place in (begin, end, axis)]
    return graph.add("Slice", values, *places)


def _remembered(graph: _Graph, memory: Memory, before: str, seen: str, signals: int) -> str:
    """`Memory.remember`."""
    flat = _reshaped(graph, seen, signals)
    flat = graph.add("Where", graph.add("IsNaN", flat), graph.constant(np.float64(0.0)), flat)
    linear = graph.add("MatMul", flat, graph.constant(memory.weights))
    linear = _reshaped(graph, linear, len(AVERAGED) - 1)
    forces = graph.add("Abs", graph.add("MatMul", flat, graph.constant(memory.forces)))
    shares = np.full((memory.dampers, 1), 1.0 / memory.dampers)
    level = graph.add("MatMul", _reshaped(graph, forces, memory.dampers), graph.constant(shares))
    values = graph.add("Concat", linear, level, axis=1)
    nothing = graph.add("Mul", level, graph.constant(np.float64(0.0)))
    one = graph.add("Add", nothing, graph.constant(np.float64(1.0)))
    newest = graph.add("Concat", one, values, graph.add("Mul", values, values), axis=1)
    newest = _shaped(graph, newest, [-1, 1, WIDTH])
    keep, times = memory.keep[:, None], len(memory.keep)
    kept = graph.add("Mul", _shaped(graph, before, [-1, times, WIDTH]), graph.constant(keep))
    averages = graph.add("Add", kept, graph.add("Mul", newest, graph.constant(1.0 - keep)))
    return _reshaped(graph, averages, memory.width)


def _memory_inputs(graph: _Graph, memory: Memory, state: str) -> str:
    """`Memory.inputs`, one row for each bogie."""
    averages = _shaped(graph, state, [-1, len(memory.keep), WIDTH])
    least = graph.add("Max", _part(graph, averages, 0, 1, axis=2), graph.constant(np.float64(FLOOR)))
    ratio = graph.add("Div", averages, least)
    mean = _part(graph, ratio, 1, len(AVERAGED) + 1, axis=2)
    square = _part(graph, ratio, len(AVERAGED) + 1, WIDTH, axis=2)
    zero = graph.constant(np.float64(0.0))
    variance = graph.add("Max", graph.add("Sub", square, graph.add("Mul", mean, mean)), zero)
    numbers = [_number(graph, name, mean, variance) for name in memory.names]
    values = _reshaped(graph, graph.add("Concat", *numbers, axis=2), memory.size)
    return _scaled(graph, memory.scaling, values)


def _number(graph: _Graph, name: str, mean: str, variance: str) -> str:
    how = MEMORIES[name]
    place = AVERAGED.index(how.quantity)
    if how.kind in ("mean", "size"):
        found = _part(graph, mean, place, place + 1, axis=2)
        return found if how.kind == "mean" else graph.add("Abs", found)
    of = _part(graph, variance, place, place + 1, axis=2)
    if how.kind == "level":
        return graph.add("Sqrt", of)
    rate = AVERAGED.index("yaw_rate")
    of = graph.add("Max", of, graph.constant(np.float64(STILL)))
    ratio = graph.add("Div", _part(graph, variance, rate, rate + 1, axis=2), of)
    return graph.add("Mul", graph.add("Sqrt", ratio), graph.constant(np.float64(0.5 / np.pi)))


def _of_vehicle(graph: _Graph, encoding: VehicleEncoding, seen: str) -> str:
    values = graph.add("Gather", seen, graph.constant(encoding.columns.astype(np.int64)), axis=-1)
    return _scaled(graph, encoding.scaling, values)


def _scaled(graph: _Graph, scaling: Scaling, values: str) -> str:
    """`Scaling`, but for its clip."""
    middle = graph.constant(scaling.middle)
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
    return graph.add("Mul", _reshaped(graph, values, encoding.shown), graph.add("Add", turned, one))


def _network(graph: _Graph, policy: LearnedPolicy, values: str) -> str:
    """`LearnedPolicy.outputs`."""
    activation = "Tanh" if policy.parameters.network.activation == "tanh" else "Relu"
    if policy.estimator:
        clip = policy.parameters.clip
        estimates = _clipped(graph, _through(graph, policy.estimator, activation, values), -clip, clip)
        values = graph.add("Concat", values, estimates, axis=1)
    values = _through(graph, policy.layers, activation, values)
    return graph.add("Tanh", values) if policy.parameters.squash == "tanh" else values


def _through(graph: _Graph, layers: Weights, activation: str, values: str) -> str:
    for i, (weight, bias) in enumerate(layers):
        if i:
            values = graph.add(activation, values)
        product = graph.add("MatMul", values, graph.constant(weight))
        values = graph.add("Add", product, graph.constant(bias))
    return values


def _decoded(graph: _Graph, encoding: Encoding, values: str, seen: str) -> str:
    """`Encoding.decode`."""
    bounded = _clipped(graph, values, -1.0, 1.0)
    held = encoding.held if isinstance(encoding, VehicleEncoding) else None
    if held is None:
        scaled = graph.add("Mul", bounded, graph.constant(np.float64(encoding.output.half)))
        command = graph.add("Add", scaled, _base_command(graph, encoding, seen))
    else:
        step = graph.constant(np.float64(cast(VehicleEncoding, encoding).step))
        before = graph.add("Gather", seen, graph.constant(held.astype(np.int64)), axis=-1)
        command = graph.add("Add", before, graph.add("Mul", bounded, step))
    return _reshaped(graph, _clipped(graph, command, 0.0, 1.0), encoding.units * encoding.actions)


def _base_command(graph: _Graph, encoding: Encoding, seen: str) -> str:
    """`Encoding.base_command`, one row for each network: a table is a sum of ramps between its speeds."""
    schedule, interface = encoding.output.schedule, encoding.interface
    if schedule is None or encoding.speed is None:
        return graph.constant(np.float64(encoding.output.middle))
    rows = _reshaped(graph, seen, interface.history * len(interface.signals))
    speed = _part(graph, rows, encoding.speed, encoding.speed + 1, axis=1)
    speed = graph.add("Where", graph.add("IsNaN", speed), graph.constant(np.float64(0.0)), speed)
    speeds, commands = np.array(schedule.speeds_kmh) / KMH, np.array(schedule.commands)
    if len(speeds) == 1:
        return graph.constant(commands)
    above = graph.add("Sub", speed, graph.constant(speeds[:-1]))
    passed = _clipped(graph, graph.add("Div", above, graph.constant(np.diff(speeds))), 0.0, 1.0)
    risen = graph.add("MatMul", passed, graph.constant(np.diff(commands)[:, None]))
    command = graph.add("Add", risen, graph.constant(np.float64(commands[0])))
    return _reshaped(graph, graph.add("Concat", *[command] * encoding.units, axis=1), 1)


def _reshaped(graph: _Graph, values: str, width: int) -> str:
    return _shaped(graph, values, [-1, width])


def _shaped(graph: _Graph, values: str, shape: list[int]) -> str:
    return graph.add("Reshape", values, graph.constant(np.array(shape, dtype=np.int64)))


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
