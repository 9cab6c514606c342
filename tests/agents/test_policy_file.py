"""Policies on the disk: what NumPy makes of them, and what is refused. Needs no torch."""

from __future__ import annotations

import io
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.agents.config import InputConfig, NetworkConfig, OutputConfig
from sayd_env.agents.encoding import VehicleEncoding
from sayd_env.agents.onnx_policy import read_onnx
from sayd_env.agents.policy_file import (
    StoredPolicy,
    describe,
    load_policy,
    policy_bytes,
    read_policy,
    save_policy,
)
from sayd_env.config import ConfigError, DataError
from sayd_env.config.errors import StudyError
from sayd_env.envs.interface import Interface
from sayd_env.envs.single import SaydEnv

INPUTS = {
    "acceleration_rms": InputConfig(scale="log", middle=0.5, half=2.0),
    "command": InputConfig(middle=0.5, half=0.5),
    "speed": InputConfig(middle=80.0, half=20.0),
}
COMMAND, CHANGE = OutputConfig(kind="command"), OutputConfig(kind="change", rate=2.0)


@pytest.fixture(scope="module")
def interface() -> Interface:
    return SaydEnv(observation="features", control_period=0.05).interface


def stored(
    interface: Interface, output: OutputConfig = COMMAND, squash: str = "clip", activation: Any = "tanh"
) -> StoredPolicy:
    random = np.random.default_rng(1)
    widths = [13, 6, 5, interface.actions]  # 4 + 8 + 1 inputs
    layers = [
        (random.normal(size=(b, a)).astype(np.float32), random.normal(size=b).astype(np.float32))
        for a, b in pairwise(widths)
    ]
    description = describe(
        interface,
        name="a-policy",
        inputs=INPUTS,
        clip=3.0,
        output=output,
        network=NetworkConfig(hidden=(6, 5), activation=activation),
        squash=squash,
        made={"J": 0.5},
    )
    return StoredPolicy(description, tuple(layers))


def observations(interface: Interface, count: int) -> Any:
    random = np.random.default_rng(2)
    low = np.array([signal.low for signal in interface.signals])
    high = np.array([signal.high for signal in interface.signals])
    return (low + random.random((count, len(low))) * (high - low)).astype(np.float32)


def test_inputs_are_what_the_configuration_says(interface: Interface) -> None:
    encoding = VehicleEncoding(interface, INPUTS, 3.0, COMMAND)
    row = np.zeros((1, len(interface.signals)), np.float32)
    row[0, [interface.index(f"acceleration_rms.{p}") for p in ("front.leading", "rear.trailing")]] = 0.5, 1.5
    row[0, interface.index("command.rear.right.lower")] = 1.0
    row[0, interface.index("speed")] = np.nan
    found = encoding.encode(row)[0]
    # ln(1.5 / 0.5) / 2; the accelerations of 0 are cut off; what is no number counts as the middle
    expected = [0.0, -3.0, -3.0, 0.5 * np.log(3.0), *[-1.0] * 7, 1.0, 0.0]
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert (found.dtype, encoding.size) == (np.float32, 13)


def test_rows_of_a_history_follow_each_other() -> None:
    interface = SaydEnv(observation="history", history=3).interface
    encoding = VehicleEncoding(interface, {"speed": InputConfig(middle=0.0, half=1.0)}, 1e3, COMMAND)
    block = np.zeros((2, *interface.shape), np.float32)
    block[:, :, interface.index("speed")] = [[1, 2, 3], [4, 5, 6]]
    np.testing.assert_array_equal(encoding.encode(block), [[1, 2, 3], [4, 5, 6]])


def test_outputs_become_commands(interface: Interface) -> None:
    seen = np.zeros((2, len(interface.signals)), np.float32)
    outputs = np.array([[-1.0, 0.5], [7.0, 0.0]])
    found = VehicleEncoding(interface, INPUTS, 3.0, COMMAND).decode(outputs, seen)
    np.testing.assert_array_equal(found, np.float32([[0.0, 0.75], [1.0, 0.5]]))
    seen[:, interface.index("command.front.left.upper")] = 0.4
    seen[:, interface.index("command.rear.left.upper")] = 0.95
    found = VehicleEncoding(interface, INPUTS, 3.0, CHANGE).decode(outputs, seen)  # 2 / s for 0.05 s
    np.testing.assert_allclose(found, [[0.3, 1.0], [0.5, 0.95]], atol=1e-7)


@pytest.mark.parametrize("squash", ["clip", "tanh"])
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_the_network_is_that_of_its_weights(squash: str, activation: str, interface: Interface) -> None:
    policy = stored(interface, squash=squash, activation=activation)
    bound = policy.bound(interface)
    seen = observations(interface, 7)
    inputs = bound.encoding.encode(seen)
    for row, command in zip(inputs, bound.predict(seen)[0], strict=True):
        values = row.astype(float)
        for i, (weight, bias) in enumerate(policy.layers):
            sums = [sum(w * v for w, v in zip(ws, values, strict=True)) for ws in weight.astype(float)]
            values = np.array(sums) + bias
            if i < 2:
                values = np.tanh(values) if activation == "tanh" else np.where(values > 0, values, 0.0)
        last = np.tanh(values) if squash == "tanh" else np.clip(values, -1.0, 1.0)
        np.testing.assert_allclose(command, (last + 1.0) / 2.0, atol=1e-6)


def test_a_vehicle_gets_the_same_commands_alone_and_among_others(interface: Interface) -> None:
    policy, seen = stored(interface).bound(interface), observations(interface, 33)
    together, state = policy.predict(seen)
    assert state is None
    for i in range(33):
        np.testing.assert_array_equal(policy.predict(seen[i])[0], together[i])
    with pytest.raises(ConfigError, match=r"\(31,\)"):
        policy.predict(seen[:, :30])


def test_what_is_written_is_read(interface: Interface, tmp_path: Path) -> None:
    policy, path = stored(interface, CHANGE), tmp_path / "policy.npz"
    save_policy(path, policy)
    found = read_policy(path)
    assert found.description == policy.description
    assert found.description.made == {"J": 0.5}
    for one, other in zip(found.layers, policy.layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
    assert [file.name for file in tmp_path.iterdir()] == ["policy.npz"]
    seen = observations(interface, 3)
    np.testing.assert_array_equal(
        load_policy(path, interface).predict(seen)[0], policy.bound(interface).predict(seen)[0]
    )


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"observation": "signals"}, "observation='features', the environment has 'signals'"),
        ({"valves": "damper"}, "valves='bogie', the environment has 'damper'"),
        ({"control_period": 0.01}, r"control_period=0.05, the environment has 0.01"),
    ],
)
def test_another_environment_is_refused(
    keywords: dict[str, Any], message: str, interface: Interface, tmp_path: Path
) -> None:
    save_policy(tmp_path / "policy.npz", stored(interface))
    env = SaydEnv(**{"observation": "features", "control_period": 0.05} | keywords)
    with pytest.raises(ConfigError, match=message):
        load_policy(tmp_path / "policy.npz", env.interface)


def test_damaged_files_are_refused(interface: Interface, tmp_path: Path) -> None:
    good, path = policy_bytes(stored(interface)), tmp_path / "policy.npz"
    broken = bytearray(good)
    broken[len(good) // 3] ^= 0xFF
    for content in (b"", b"text", good[: len(good) // 2], good[:-1], bytes(broken)):
        path.write_bytes(content)
        with pytest.raises(DataError, match="damaged or no policy"):
            read_policy(path)
    with pytest.raises(ConfigError, match="no such policy file"):
        read_policy(tmp_path / "none.npz")


class Bomb:
    """An object that would show if it were unpickled."""

    fired = False

    def __reduce__(self) -> Any:
        return (setattr, (Bomb, "fired", True))


def test_nothing_in_a_file_is_run(interface: Interface, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    save_policy(path, stored(interface))
    with zipfile.ZipFile(path) as archive:
        text = archive.read("policy.yaml")
    stream = io.BytesIO()
    np.savez(stream, weight_0=np.array([Bomb()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("policy.yaml", text)
        archive.writestr("bias_0.npy", pickle.dumps(Bomb()))
    path.write_bytes(stream.getvalue())
    with pytest.raises(DataError):
        read_policy(path)
    stream = io.BytesIO(policy_bytes(stored(interface)))
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("policy.yaml", "!!python/object/apply:os.abort []")
    path.write_bytes(stream.getvalue())
    with pytest.raises((DataError, ConfigError)):
        read_policy(path)
    assert not Bomb.fired


def test_weights_that_do_not_fit_are_refused(interface: Interface, tmp_path: Path) -> None:
    policy, path = stored(interface), tmp_path / "policy.npz"
    save_policy(path, StoredPolicy(policy.description, policy.layers[:-1]))
    with pytest.raises(DataError, match=r"lacks 'bias_2\.npy'"):
        read_policy(path)
    policy.layers[1][0][0, 0] = np.nan
    save_policy(path, policy)
    with pytest.raises(DataError, match="weight_1: expected finite"):
        read_policy(path)


def rewritten(good: bytes, members: dict[str, bytes | None], **archive: Any) -> bytes:
    """A policy file with other members; None removes one."""
    with zipfile.ZipFile(io.BytesIO(good)) as before:
        content: dict[str, bytes | None] = {name: before.read(name) for name in before.namelist()}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", **archive) as after:
        for name, data in (content | members).items():
            if data is not None:
                after.writestr(name, data)
    return stream.getvalue()


def text_of(good: bytes, old: str, new: str) -> bytes:
    """A policy file with another description."""
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        text = archive.read("policy.yaml").decode()
    assert old in text
    return rewritten(good, {"policy.yaml": text.replace(old, new).encode()})


def npy(header: str) -> bytes:
    """An array that begins with a header and has no numbers."""
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(400)


def encrypted(good: bytes) -> bytes:
    """A policy file whose members claim to be encrypted."""
    content = bytearray(good)
    for mark, place in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        start = content.find(mark)
        while start >= 0:
            content[start + place] |= 1
            start = content.find(mark, start + 4)
    return bytes(content)


LAUGHS = "made: {a: &a [1, 1], b: &b [*a, *a, *a, *a, *a, *a, *a, *a], " + ", ".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 8)}]" for old, new in pairwise("bcdefghij")
)
NAMED = "name: a-policy"


@pytest.mark.parametrize(
    ("attack", "message"),
    [
        (lambda good: text_of(good, NAMED, "name: ../../x"), r"name.*'../../x'; a policy's name has"),
        (lambda good: text_of(good, NAMED, "name: /tmp/x"), "a policy's name has at most 64"),
        (lambda good: text_of(good, NAMED, 'name: "a\\0b"'), "without control characters"),
        (lambda good: text_of(good, NAMED, f"name: {'n' * 5000}"), "a policy's name has at most 64"),
        (lambda good: text_of(good, NAMED, "name: mppt2"), "'mppt2', which is a controller's name"),
        (lambda good: text_of(good, NAMED, "name: _hidden"), "a policy's name has"),
        (lambda good: text_of(good, NAMED, f'{NAMED}\n"\\e[2J": 1'), "without control characters"),
        (lambda good: text_of(good, "speed:", "bogus:"), "no quantity 'bogus'"),
        (lambda good: text_of(good, "history: 1", "history: 1000000"), "history.*1000"),
        (lambda good: text_of(good, "control_period: 0.05", "control_period: 5.0e-324"), "control_period"),
        (lambda good: text_of(good, "control_period: 0.05", "control_period: 0.03"), "divides a second"),
        (lambda good: text_of(good, "middle: 80.0", "middle: -1.7e308"), "middle"),
        (lambda good: text_of(good, "made:", LAUGHS + "}\nother:"), "more than 50000 values"),
        (
            lambda good: text_of(good, "made:", "made: {a: !!binary aGVsbG8=}\nother:"),
            "expected text, finite",
        ),
        (
            lambda good: text_of(good, "made:", f"made: {{a: 0x{'f' * 5000}}}\nother:"),
            "expected text, finite",
        ),
        (lambda good: text_of(good, NAMED, "#" * 200_000 + "\n" + NAMED), "damaged"),
        (lambda good: rewritten(good, {f"extra_{i}.npy": b"" for i in range(300)}), "holds 'extra_0.npy'"),
        (lambda good: rewritten(good, {f"{'x' * 90}{i}": b"" for i in range(2000)}), "damaged"),
        (lambda good: rewritten(good, {"../evil.npy": b""}), r"holds '\.\./evil\.npy'"),
        (lambda good: rewritten(good, {"weight_0.npy": b""}), "weight_0: expected finite numbers"),
        (lambda good: rewritten(good, {"weight_0.npy": bytes(10**6)}), "found 1000000 bytes"),
        (lambda good: rewritten(good, {"weight_0.npy": npy("{'descr': '<f4', 'shape': ((")}), "damaged"),
        (lambda good: rewritten(good, {"weight_0.npy": npy("  {'descr':\n a\n  b")}), "damaged"),
        (
            lambda good: rewritten(
                good,
                {"weight_0.npy": npy("{'descr': '<f4', 'fortran_order': False, 'shape': (9**9, 9**9)}")},
            ),
            "damaged",
        ),
        (
            lambda good: rewritten(
                good,
                {"weight_0.npy": npy("{'descr': '<f4', 'fortran_order': False, 'shape': (99999999, 99)}")},
            ),
            r"weight_0: expected .*\(6, 13\)",
        ),
        (lambda good: rewritten(good, {}, compression=zipfile.ZIP_BZIP2), "damaged"),
        (encrypted, "damaged"),
    ],
)
def test_files_of_somebody_who_means_harm_are_refused(
    attack: Callable[[bytes], bytes], message: str, interface: Interface, tmp_path: Path
) -> None:
    """By one line that names the file, before anything large is read."""
    path = tmp_path / "p.npz"
    path.write_bytes(attack(policy_bytes(stored(interface))))
    tracemalloc.start()
    with pytest.raises((ConfigError, DataError), match=message) as caught:
        read_policy(path)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    text = str(caught.value)
    assert "p.npz" in text
    assert len(text) < 1000
    assert text.replace("\n", "").isprintable()


@pytest.mark.parametrize("path", ["/dev/zero", "/dev", "a\0b.npz", f"{'n' * 5000}.npz", "\x1b[2J.npz"])
def test_what_is_no_file_is_refused(path: str) -> None:
    with pytest.raises(ConfigError, match=r"policy file|cannot be read|is not a valid") as caught:
        read_policy(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1500


@pytest.mark.parametrize("name", ["../x", "", "mppt1", "a b", "x" * 65])
def test_a_policy_is_not_written_under_a_bad_name(name: str, interface: Interface) -> None:
    content = stored(interface).description.model_dump()
    with pytest.raises(ConfigError, match="name"):
        describe(interface, "mine", **content | {"name": name})


def test_a_normalisation_is_kept_and_applied(interface: Interface, tmp_path: Path) -> None:
    """Two policies that command the same: one by maps of quantities, one by a map of each number."""
    policy = stored(interface)
    encoding = policy.encoding(interface)
    halves = 1.0 / encoding.scaling.per_half
    linear = {name: InputConfig(middle=0.0, half=1.0) for name in ("command", "speed")}
    description = policy.description.model_copy(update={"inputs": linear})
    layers = ((policy.layers[0][0][:, 4:].copy(), policy.layers[0][1]), *policy.layers[1:])
    plain = policy.description.model_copy(update={"inputs": {n: INPUTS[n] for n in linear}})
    save_policy(
        tmp_path / "p.npz",
        StoredPolicy(description, layers, normalisation=(encoding.scaling.middle[4:], halves[4:])),
    )
    seen = observations(interface, 5)
    expected = StoredPolicy(plain, layers).bound(interface).predict(seen)[0]
    found = read_policy(tmp_path / "p.npz")
    np.testing.assert_allclose(found.bound(interface).predict(seen)[0], expected, atol=1e-6)
    assert found.identity() != StoredPolicy(description, layers).identity()


def test_inputs_that_the_environment_lacks_are_refused(interface: Interface) -> None:
    with pytest.raises(ConfigError, match="no quantity 'stroke'"):
        VehicleEncoding(interface, {"stroke": InputConfig(middle=0.0, half=1.0)}, 3.0, COMMAND)
    with pytest.raises(ConfigError, match="use 'features'"):
        VehicleEncoding(SaydEnv().interface, {"speed": InputConfig(middle=0.0, half=1.0)}, 3.0, CHANGE)


def test_a_full_disk_leaves_the_former_file(
    interface: Interface, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "policy.npz"
    save_policy(path, stored(interface))
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("sayd_env.config.storage.os.fsync", full)
    with pytest.raises(StudyError, match="No space left"):
        save_policy(path, stored(interface, CHANGE))
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["policy.npz"]


@pytest.mark.parametrize("output", [COMMAND, CHANGE], ids=["command", "change"])
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_onnxruntime_gives_the_same_commands(
    output: OutputConfig, activation: str, interface: Interface, tmp_path: Path
) -> None:
    pytest.importorskip("onnx", reason="needs the extra 'onnx'")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra 'onnx'")
    from sayd_env.agents.export import export_onnx  # noqa: PLC0415

    policy = stored(interface, output, "tanh", activation)
    export_onnx(policy, tmp_path / "policy.onnx")
    session = runtime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    seen = observations(interface, 50)
    seen[3, 0], seen[4, 1] = np.nan, 0.0
    (found,) = session.run(None, {"observation": seen})
    np.testing.assert_allclose(found, policy.bound(interface).predict(seen)[0], atol=1e-6, rtol=0)
    reported = session.get_modelmeta().custom_metadata_map
    assert reported["signals"].split() == [signal.name for signal in interface.signals]
    assert (reported["valves"], float(reported["control_period"])) == ("bogie", 0.05)


@pytest.mark.parametrize(
    "output",
    [
        OutputConfig(kind="command", middle=0.4, half=0.3),
        OutputConfig(kind="command", schedule="speed-schedule", half=0.3),
        OutputConfig(kind="command", schedule={"speeds_kmh": [300.0], "commands": [0.4]}, half=0.3),
    ],
    ids=["middle", "schedule", "one-speed"],
)
def test_onnxruntime_gives_the_commands_of_both_bogies(output: OutputConfig, tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="needs the extra 'onnx'")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra 'onnx'")
    from sayd_env.agents.export import export_onnx  # noqa: PLC0415

    names = ("yaw_force", "force_level", "lateral", "yaw_rate", "push_rate", "speed", "place")
    halves = (1e6, 1e6, 30.0, 1.0, 1.0, 50.0, 1.0)
    interface = SaydEnv(observation="history", history=3, control_period=0.02).interface
    random = np.random.default_rng(1)
    widths = [5 * 2 + 2, 7, 1]
    layers = tuple(
        (random.normal(size=(b, a)).astype(np.float32), random.normal(size=b).astype(np.float32))
        for a, b in pairwise(widths)
    )
    description = describe(
        interface,
        name="of-a-bogie",
        view="bogie",
        inputs={name: InputConfig(middle=0.0, half=half) for name, half in zip(names, halves, strict=True)},
        clip=5.0,
        output=output,
        network=NetworkConfig(hidden=(7,), activation="tanh"),
        squash="clip",
    )
    policy = StoredPolicy(description, layers)
    save_policy(tmp_path / "policy.npz", policy)
    export_onnx(read_policy(tmp_path / "policy.npz"), tmp_path / "policy.onnx")
    session = runtime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    low = np.array([signal.low for signal in interface.signals])
    high = np.array([signal.high for signal in interface.signals])
    seen = (low + random.random((25, 3, len(low))) * (high - low)).astype(np.float32)
    (found,) = session.run(None, {"observation": seen})
    expected, _ = policy.bound(interface).predict(seen)
    assert found.shape == expected.shape == (25, 2)
    assert np.ptp(found) > 0.3
    np.testing.assert_allclose(found, expected, atol=1e-6, rtol=0)
    # Its forces are those of a piston; another one is refused, which the other file takes as it is.
    model, damper = read_onnx(tmp_path / "policy.onnx"), interface.damper
    np.testing.assert_array_equal(model.bound(interface).predict(seen)[0], found)
    wide = damper.model_copy(
        update={"cylinder": damper.cylinder.model_copy(update={"area": 1.3 * damper.cylinder.area})}
    )
    other = replace(interface, damper=wide)
    with pytest.raises(ConfigError, match=r"forces of a piston of 0.00186 m2, found one of"):
        model.bound(other)
    policy.bound(other)
