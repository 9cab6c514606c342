"""Policies as Stable-Baselines3 itself saves them, made policies of ours: the file that can run code is left.

Such a file holds pickled objects. Loading it can run any code on this machine, so only whoever trusts where
it comes from may have it loaded. Out of it come the weights of the network, which then run by NumPy on the
raw observation, as `agents.policy_file.LearnedPolicy`, and command what ``predict`` of the library commands.
"""

from __future__ import annotations

import json
import pickle
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from sayd_env.agents.config import NetworkConfig, OutputConfig
from sayd_env.agents.policy_archive import LARGEST, file_digest, read_bytes
from sayd_env.agents.policy_file import Layers, LearnedPolicy, StoredPolicy, describe
from sayd_env.config import ConfigError, DataError, validate
from sayd_env.config.control import load_online
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.files import MIB
from sayd_env.config.learner import WIDEST, InputConfig, load_learner
from sayd_env.config.units import Array32
from sayd_env.envs.environment import action_box, observation_box
from sayd_env.envs.episode_batch import environment_scenario, make_interface
from sayd_env.envs.interface import ACTIONS, Interface
from sayd_env.envs.scaled import LearnersView

_ACTIVATIONS = ({"tanh"}, {"relu"})
_MARKS = {
    "ppo": ("stable_baselines3.common.policies", {"clip_range", "n_epochs"}),
    "sac": ("stable_baselines3.sac.policies", {"target_entropy", "tau"}),
}
"""Module of the policy's class, and settings that no other algorithm of that module has."""
# What only a training needs: neither unpickled nor allocated.
_UNUSED = {
    "learning_rate": 0.0,
    "lr_schedule": None,
    "clip_range": 0.0,
    "clip_range_vf": None,
    "buffer_size": 1,
}
_TOLERANCE = 1e-4
"""Of a command; the library computes in single precision."""
_HEAD = 4096
"""Bytes of a pickle in which the class of its object is named."""


def read_foreign(
    path: Path | str,
    config: EnvironmentConfig,
    period: float | None = None,
    statistics: Path | None = None,
) -> StoredPolicy:
    """Load a policy that ``PPO.save`` or ``SAC.save`` wrote. This can run any code that the file holds.

    Observation, rows of a history and layout of the valves follow from the shapes of its spaces.

    Parameters
    ----------
    path : Path or str
    config : EnvironmentConfig
        The environment of its training, but for what its spaces say otherwise.
    period : float, optional
        Control period of its training (s), which the file does not say; that of `config` by default.
    statistics : Path, optional
        File that ``VecNormalize.save`` wrote in its training. This can run any code, too.

    Raises
    ------
    ConfigError
        No such file; another algorithm, another network than a plain one, or spaces that no environment has;
        statistics beside the file that were not given.
    DataError
        A damaged file.
    ModuleNotFoundError
        Torch or Stable-Baselines3 are not installed.
    """
    path = Path(path)
    digest = file_digest(path)
    if statistics is None:
        _refuse_forgotten_statistics(path)
    algorithm = _algorithm(path)
    with _one_thread():
        model = _loaded(path, algorithm)
        interface = _interface(path, model, config, period)
        normal = None if statistics is None else _statistics(statistics, model)
        made = {
            "file": path.name,
            "sha256": digest,
            "algorithm": algorithm,
            "steps": int(model.num_timesteps),
            "libraries": {"stable_baselines3": metadata.version("stable_baselines3")},
        }
        if statistics is not None:
            made["vec_normalize"] = {"file": statistics.name, "sha256": file_digest(statistics)}
        policy = _policy(path, model, interface, made, normal)
        _check(path, model, policy.bound(interface), normal)
    return policy


def _refuse_forgotten_statistics(path: Path) -> None:
    """A policy that has learned behind `VecNormalize` does something else without its statistics."""
    folder = path.parent
    found = [p for p in (*folder.glob("*.pkl"), *folder.glob("*.pickle")) if _is_statistics(p)]
    if found:
        raise ConfigError(
            f"{path}: {found[0].name} beside it holds statistics of VecNormalize: a policy that has learned "
            f"with them needs --vec-normalize {found[0]} (which can run any code, too). If it has learned "
            "without, move either file"
        )


def _is_statistics(path: Path) -> bool:
    """Whether a pickle is a `VecNormalize`, by its name or by the class with which its content begins."""
    if not path.is_file():  # reading a pipe would wait without end
        return False
    try:
        with path.open("rb") as stream:
            return "normalize" in path.stem.lower() or b"VecNormalize" in stream.read(_HEAD)
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror}); it may hold statistics of VecNormalize"
        ) from None


def _statistics(path: Path, model: Any) -> Any:
    """The `VecNormalize` of a training."""
    read_bytes(path)  # refuses what is no file
    try:
        with path.open("rb") as stream:
            found = pickle.load(stream)  # whoever gives it trusts it
        shape = np.shape(found.obs_rms.mean) if found.norm_obs else model.observation_space.shape
    except Exception as error:  # code from a file fails in any way
        detail = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(f"{path}: is no VecNormalize that can be loaded ({detail})") from None
    if shape != model.observation_space.shape:
        raise ConfigError(
            f"{path}: is of observations of shape {shape}, those of the policy have "
            f"{model.observation_space.shape}"
        )
    return found if found.norm_obs else None


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep torch to one thread for a moment: on busy cores several wait for each other, for seconds."""
    import torch  # noqa: PLC0415 - may be missing

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _algorithm(path: Path) -> str:
    """Name of the algorithm, read without unpickling anything."""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > LARGEST:
                raise ConfigError(f"{path}: holds more than {LARGEST // MIB} MiB")
            content = json.loads(archive.read("data"))
            whole = archive.testzip() is None
        module, keys = content["policy_class"]["__module__"], set(content)
    except (zipfile.BadZipFile, zlib.error, KeyError, TypeError, ValueError, EOFError, OSError, RuntimeError):
        whole, module, keys = False, "", set()
    if not whole:
        raise DataError(f"{path}: is damaged or no policy of Stable-Baselines3")
    for name, (home, needed) in _MARKS.items():
        if module == home and needed <= keys:
            return name
    raise ConfigError(
        f"{path}: is of another algorithm than PPO and SAC, or of another policy than MlpPolicy (it is from "
        f"'{module}')"
    )


def _loaded(path: Path, algorithm: str) -> Any:
    from stable_baselines3 import PPO, SAC  # noqa: PLC0415 - may be missing

    library = {"ppo": PPO, "sac": SAC}[algorithm]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other versions: what can be loaded is compared below
            return library.load(path, device="cpu", custom_objects=dict(_UNUSED))
    except Exception as error:  # code from a file fails in any way
        detail = " ".join(str(error).split())[:200] or type(error).__name__
        version = metadata.version("stable_baselines3")
        raise DataError(f"{path}: Stable-Baselines3 {version} cannot load it ({detail})") from None


def _interface(path: Path, model: Any, config: EnvironmentConfig, period: float | None) -> Interface:
    """The environment that has the spaces of a model."""
    seen, given = (tuple(space.shape or ()) for space in (model.observation_space, model.action_space))
    layouts = {(count,): valves for valves, count in ACTIONS.items()}
    if given not in layouts:
        counts = ", ".join(f"{count} ({valves})" for valves, count in ACTIONS.items())
        raise ConfigError(f"{path}: commands of shape {given}; expected one of {counts}")
    changes: dict[str, Any] = {"valves": layouts[given]}
    if period is not None:
        changes["control_period"] = period
    found = _made(config, changes | _observation(path, seen, config), str(path))
    view = _view(model, found)
    for what, mine, space in (
        ("observations", model.observation_space, view.observation_box if view else observation_box(found)),
        ("commands", model.action_space, view.action_box if view else action_box(found)),
    ):
        bounds = [np.ravel(each) for each in (mine.low, mine.high, space.low, space.high)]
        # The bounds of an environment with another vehicle differ, but not by orders of magnitude.
        if not np.allclose(bounds[:2], bounds[2:], rtol=0.5):
            raise ConfigError(
                f"{path}: its {what} reach from {bounds[0].min():g} to {bounds[1].max():g}, those of the "
                f"environment from {bounds[2].min():g} to {bounds[3].max():g}; a policy that was trained "
                "behind a wrapper needs that wrapper"
            )
    return found


def _view(model: Any, interface: Interface) -> LearnersView | None:
    """What lay between the environment and its learner, if that was made with ``scaled=True``."""
    return LearnersView(interface) if np.min(model.action_space.low) < 0.0 else None


def _observation(path: Path, shape: tuple[int, ...], config: EnvironmentConfig) -> dict[str, Any]:
    """Kind of observation, and rows of a history, of this shape; a history may be flat."""
    widths = {
        kind: _made(config, {"observation": kind}, str(path)).shape[0] for kind in ("signals", "features")
    }
    for kind, width in widths.items():
        if shape == (width,):
            return {"observation": kind}
    width, count = widths["signals"], int(np.prod(shape))
    if shape[-1:] == (width,) or (len(shape) == 1 and count % width == 0 < count):
        return {"observation": "history", "history": count // width}
    raise ConfigError(
        f"{path}: observations of shape {shape}; expected {widths['signals']} signals, {widths['features']} "
        f"features or a history of signals, shape (rows, {width})"
    )


def _made(config: EnvironmentConfig, changes: dict[str, Any], where: str) -> Interface:
    changed = validate(EnvironmentConfig, dict(config) | changes, where)
    return make_interface(changed, environment_scenario(changed), load_online())


def _policy(path: Path, model: Any, interface: Interface, made: dict[str, Any], normal: Any) -> StoredPolicy:
    """The same network as a policy of ours that sees raw signals, or what a `VecNormalize` makes of them."""
    ppo = made["algorithm"] == "ppo"
    body = model.policy.mlp_extractor.policy_net if ppo else model.actor.latent_pi
    modules = [*body, model.policy.action_net if ppo else model.actor.mu]
    kinds = {type(module).__name__.lower() for module in modules[1::2]}
    if any(type(module).__name__ != "Linear" for module in modules[::2]) or kinds not in (
        *_ACTIVATIONS,
        set(),
    ):
        raise ConfigError(
            f"{path}: its network is none of layers with Tanh or with ReLU between them, as MlpPolicy has it"
        )
    layers = tuple((_numbers(module.weight), _numbers(module.bias)) for module in modules[::2])
    squashed = bool(model.policy.squash_output)
    scaled = _view(model, interface) is not None
    if scaled and normal is not None:
        raise ConfigError(f"{path}: has learned with scaled=True behind VecNormalize; one of them is enough")
    inputs = load_learner().inputs if scaled else {}
    widest = load_learner().clip if scaled else WIDEST
    normalisation = None
    if normal is not None:
        half = np.sqrt(normal.obs_rms.var + normal.epsilon)
        normalisation = normal.obs_rms.mean.reshape(interface.shape), half.reshape(interface.shape)
    description = describe(
        interface,
        str(path),
        name=path.stem,
        inputs={
            name: inputs.get(name, InputConfig(middle=0.0, half=1.0))
            for name in (signal.name.partition(".")[0] for signal in interface.signals)
        },
        clip=widest if normal is None else min(float(normal.clip_obs), widest),
        output=OutputConfig(kind="command"),
        network=NetworkConfig(
            hidden=tuple(len(bias) for _, bias in layers[:-1]),
            activation="relu" if "relu" in kinds else "tanh",
        ),
        squash="tanh" if squashed else "clip",
        made=made,
    )
    own = layers if squashed or scaled else _of_commands(layers)
    return StoredPolicy(description, own, str(path), normalisation)


def _numbers(tensor: Any) -> Array32:
    values: Array32 = tensor.detach().numpy().astype(np.float32)
    return values


def _of_commands(layers: Layers) -> Layers:
    """Layers whose output, cut off at -1 and 1, stands for a command that was cut off at 0 and 1."""
    weight, bias = layers[-1]
    return (*layers[:-1], (2.0 * weight, 2.0 * bias - 1.0))


def _check(path: Path, model: Any, policy: LearnedPolicy, normal: Any) -> None:
    """Refuse a model that is more than its network: the commands of both must be the same."""
    space = observation_box(policy.interface)
    random = np.random.default_rng(0)
    # From tiny to full scale: raw signals saturate the network.
    scales = np.logspace(-9.0, 0.0, 64).reshape(-1, *[1] * len(space.shape))
    seen = (scales * random.uniform(space.low, space.high, (64, *space.shape))).astype(np.float32)
    mine, _ = policy.predict(seen)
    view = _view(model, policy.interface)
    flat = (seen if view is None else view.observe(seen)).reshape(64, *model.observation_space.shape)
    theirs, _ = model.predict(flat if normal is None else normal.normalize_obs(flat), deterministic=True)
    if view is not None:
        theirs = view.commands(theirs, theirs.shape)
    if not np.allclose(mine, theirs, rtol=0.0, atol=_TOLERANCE):
        raise ConfigError(
            f"{path}: has more than a plain network (its commands are others); expected what "
            "PPO('MlpPolicy', ...) or SAC('MlpPolicy', ...) makes"
        )
