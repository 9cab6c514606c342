"""The algorithms: made from a configuration, put on the disk and back without pickled objects."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC

from sayd_env.agents.config import PpoConfig, TrainConfig
from sayd_env.agents.learning_env import EncodedVecEnv
from sayd_env.agents.networks import (
    ACTIVATIONS,
    EstimatorTrainer,
    Layout,
    PpoPolicy,
    SacPolicy,
    asymmetric_inputs,
)
from sayd_env.agents.policy_file import Layers
from sayd_env.config import DataError
from sayd_env.config.storage import uninterrupted, write_folder

STATE, REPLAY, PROGRESS = "state.pt", "replay.npz", "progress.json"
REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True)
class TrainingProgress:
    """How far a training has come."""

    steps: int
    updates: int
    restarts: int
    """How often it was resumed."""
    seconds: float
    """Time of all starts together."""


def make_model(config: TrainConfig, env: EncodedVecEnv) -> Any:
    """A PPO or SAC model that has learned nothing yet."""
    settings = config.learning.model_dump(exclude={"algorithm", "log_std_init", "anneal", "ent_coef_init"})
    if config.learning.anneal:
        settings["learning_rate"] = _falling(
            config.learning.learning_rate, config.update_steps / config.total_steps
        )
    hidden, activation = list(config.network.hidden), ACTIVATIONS[config.network.activation]
    common = {"gamma": config.gamma, "seed": config.seed, "device": "cpu", "verbose": 0}
    network: dict[str, Any] = {"activation_fn": activation, "layout": Layout.of(config, env.inputs)}
    if isinstance(config.learning, PpoConfig):
        network |= {"net_arch": {"pi": hidden, "vf": hidden}, "log_std_init": config.learning.log_std_init}
        model: Any = PPO(PpoPolicy, env, policy_kwargs=network, **settings, **common)
    else:
        # Without a limit of the mean, which a stored policy does not have.
        network |= {"net_arch": {"pi": hidden, "qf": hidden}, "clip_mean": 0.0}
        settings["ent_coef"] = f"auto_{config.learning.ent_coef_init!r}"
        model = SAC(SacPolicy, env, policy_kwargs=network, **settings, **common)
    model.train = uninterrupted()(model.train)  # what is kept at a step is not half of its update
    model.estimating = None if config.estimate is None else EstimatorTrainer(model, config.estimate)
    return model


def _falling(rate: float, update: float) -> Callable[[float], float]:
    """Learning rate over what is left of a training, from 1 to 0; an update is a share of it.

    The library asks after the steps of an update are made: it learns at the rate with which they began.
    """

    def at(left: float) -> float:
        return rate * min(left + update, 1.0)

    return at


def policy_layers(model: Any) -> tuple[Layers, str]:
    """Weights of a model's policy, and what keeps its outputs within -1 and 1."""
    if isinstance(model, PPO):
        body, head, squash = model.policy.mlp_extractor.policy_net, model.policy.action_net, "clip"
    else:
        body, head, squash = model.actor.latent_pi, model.actor.mu, "tanh"
    return _layers([*body, head]), squash


def estimator_layers(model: Any) -> Layers:
    """Weights of a model's estimator; empty without one."""
    network = asymmetric_inputs(model).estimator
    return () if network is None else _layers(network)


def _layers(modules: Iterable[torch.nn.Module]) -> Layers:
    linear = [module for module in modules if isinstance(module, torch.nn.Linear)]
    return tuple(
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in linear
    )


def save_model(path: Path, model: Any, progress: TrainingProgress) -> None:
    """Write a checkpoint: a folder that is complete or not there.

    Raises
    ------
    StudyError
        It cannot be written.
    """

    def fill(folder: Path) -> None:
        torch.save(_state(model), folder / STATE)
        if isinstance(model, SAC):
            _save_replay(folder / REPLAY, model.replay_buffer)
        (folder / PROGRESS).write_text(json.dumps(asdict(progress)), encoding="utf-8")

    write_folder(path, fill)


def load_model(path: Path, model: Any) -> TrainingProgress:
    """Put a checkpoint into a model that was made from the same configuration.

    Raises
    ------
    DataError
        A checkpoint that is damaged or that of another network.
    """
    try:
        # With weights_only torch reads tensors, numbers and texts, and runs nothing from the file.
        state = torch.load(path / STATE, weights_only=True, map_location="cpu")
        progress = TrainingProgress(**json.loads((path / PROGRESS).read_text(encoding="utf-8")))
        _restore(model, state, progress)
        if isinstance(model, SAC):
            _load_replay(path / REPLAY, model.replay_buffer)
    except Exception as error:  # torch and zip files fail in many ways, which all mean the same
        detail = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{path}: is damaged or the checkpoint of another training ({detail})") from None
    return progress


def _state(model: Any) -> dict[str, Any]:
    drawn: Any = np.random.get_state()  # noqa: NPY002 - what the library draws from
    kind, keys, place, has_gauss, gauss = drawn
    _, variables = model._get_torch_save_params()
    estimating = model.estimating
    return {
        "estimator": {} if estimating is None else estimating.optimizer.state_dict(),
        "parameters": model.get_parameters(),
        "variables": {name: getattr(model, name).detach() for name in variables if _is_tensor(model, name)},
        "torch_random": torch.get_rng_state(),
        "numpy_random": [kind, torch.tensor(keys.astype(np.int64)), place, has_gauss, gauss],
    }


def _is_tensor(model: Any, name: str) -> bool:
    return isinstance(getattr(model, name, None), torch.Tensor)


def _restore(model: Any, state: dict[str, Any], progress: TrainingProgress) -> None:
    model.set_parameters(state["parameters"], exact_match=True, device="cpu")
    if model.estimating is not None:
        model.estimating.optimizer.load_state_dict(state["estimator"])
    for name, value in state["variables"].items():
        getattr(model, name).data.copy_(value)
    torch.set_rng_state(state["torch_random"])
    kind, keys, place, has_gauss, gauss = state["numpy_random"]
    np.random.set_state((kind, keys.numpy().astype(np.uint32), place, has_gauss, gauss))  # noqa: NPY002
    model.num_timesteps, model._n_updates = progress.steps, progress.updates


@uninterrupted()
def _save_replay(path: Path, buffer: Any) -> None:
    filled = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: getattr(buffer, name)[:filled] for name in REPLAYED}
    np.savez(path, place=buffer.pos, full=buffer.full, **arrays)


def _load_replay(path: Path, buffer: Any) -> None:
    with np.load(path, allow_pickle=False) as file:
        for name in REPLAYED:
            kept = file[name]
            getattr(buffer, name)[: len(kept)] = kept
        buffer.pos, buffer.full = int(file["place"]), bool(file["full"])
    if buffer.pos > 0 or buffer.full:
        # The vehicles begin new episodes: no return may reach from the last ones into them.
        last = buffer.pos - 1
        buffer.timeouts[last] = np.logical_not(buffer.dones[last])
