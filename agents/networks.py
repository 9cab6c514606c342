"""Networks of a training: an actor that sees what it will have, a critic that may know the true conditions.

An observation of the learner has the actor's inputs first and behind them the true conditions of the episode
(`sayd_env.envs.privileged`). The actor sees its inputs and what an estimator makes of them; the estimator
learns by itself, by regression on the true conditions, so that its estimates mean what they are called. The
critic sees the actor's inputs and estimates and the conditions that its configuration names: which of two
commands is the better one is told apart more easily by somebody who knows on what they were tried (Pinto and
others, Asymmetric Actor Critic for Image-Based Robot Learning, 2018). Only actor and estimator are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import Actor, SACPolicy
from torch import nn

from sayd_env.agents.config import EstimateConfig, TrainConfig
from sayd_env.config.units import Array32

ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU}
KEPT = 65_536
"""Samples of former rollouts from which an estimator goes on to learn."""


@dataclass(frozen=True)
class Layout:
    """Columns of a learner's observation, and the estimator's network."""

    inputs: int
    """Of the actor; they come first."""
    estimated: tuple[int, ...]
    """Columns of the conditions that are estimated."""
    critics: tuple[int, ...]
    """Columns of the conditions that the critic sees."""
    hidden: tuple[int, ...]
    """Units of the estimator's hidden layers."""
    activation: type[nn.Module]
    clip: float
    """Estimates are cut off at plus and minus this."""

    @classmethod
    def of(cls, config: TrainConfig, inputs: int) -> Layout:
        """The layout of a training whose encoding has so many inputs."""
        places = {name: inputs + i for i, name in enumerate(config.privileged)}
        estimate = config.estimate
        return cls(
            inputs,
            () if estimate is None else tuple(places[name] for name in estimate.conditions),
            tuple(places[name] for name in config.critic),
            () if estimate is None else estimate.hidden,
            ACTIVATIONS[config.network.activation],
            config.clip,
        )

    @property
    def seen(self) -> int:
        """What the actor sees."""
        return self.inputs + len(self.estimated)


class AsymmetricInputs(nn.Module):
    """What actor and critic see of an observation, with the estimator, which learns by `EstimatorTrainer`."""

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self.layout = layout
        self.estimator = None
        if layout.estimated:
            widths = [layout.inputs, *layout.hidden, len(layout.estimated)]
            self.estimator = _network(widths, layout.activation)

    def actor(self, observations: torch.Tensor) -> torch.Tensor:
        """Inputs and estimates, shape (n, seen)."""
        inputs = observations[:, : self.layout.inputs]
        if self.estimator is None:
            return inputs
        with torch.no_grad():
            estimates = self.estimator(inputs).clamp(-self.layout.clip, self.layout.clip)
        return torch.cat([inputs, estimates], dim=1)

    def critic(self, observations: torch.Tensor, seen: torch.Tensor | None = None) -> torch.Tensor:
        """The same with the true conditions that the critic sees behind them."""
        own = self.actor(observations) if seen is None else seen
        if not self.layout.critics:
            return own
        return torch.cat([own, observations[:, list(self.layout.critics)]], dim=1)


def _network(widths: Sequence[int], activation: type[nn.Module]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), activation()]
    return nn.Sequential(*layers[:-1])


class _Bodies(nn.Module):
    """Hidden layers of actor and critic, as `ActorCriticPolicy` asks for them."""

    def __init__(self, layout: Layout, hidden: Sequence[int], activation: type[nn.Module]) -> None:
        super().__init__()
        self.eyes = AsymmetricInputs(layout)  # a name in checkpoints
        self.policy_net = self._body(layout.seen, hidden, activation)
        self.value_net = self._body(layout.seen + len(layout.critics), hidden, activation)
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1] if hidden else layout.seen
        if not hidden:
            self.latent_dim_vf += len(layout.critics)

    @staticmethod
    def _body(width: int, hidden: Sequence[int], activation: type[nn.Module]) -> nn.Sequential:
        network = _network([width, *hidden], activation)
        return nn.Sequential(*network, activation()) if hidden else network

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Both, of whole observations."""
        seen = self.eyes.actor(features)
        return self.policy_net(seen), self.value_net(self.eyes.critic(features, seen))

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """The actor's alone."""
        found: torch.Tensor = self.policy_net(self.eyes.actor(features))
        return found

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """The critic's alone."""
        found: torch.Tensor = self.value_net(self.eyes.critic(features))
        return found


class PpoPolicy(ActorCriticPolicy):
    """`ActorCriticPolicy` whose actor and critic see what a layout says."""

    def __init__(self, *arguments: Any, layout: Layout, **keywords: Any) -> None:
        self.layout = layout
        super().__init__(*arguments, **keywords)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor: Any = _Bodies(self.layout, self.net_arch["pi"], self.activation_fn)


class _ActorsView(BaseFeaturesExtractor):
    def __init__(self, space: Any, inputs: AsymmetricInputs) -> None:
        super().__init__(space, inputs.layout.seen)
        self.eyes = inputs  # a name in checkpoints

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """What the actor sees."""
        return self.eyes.actor(observations)


class _CriticsView(BaseFeaturesExtractor):
    """What the critic sees; estimates, which a critic's target would need a copy of, are not among it."""

    def __init__(self, space: Any, layout: Layout) -> None:
        super().__init__(space, layout.inputs + len(layout.critics))
        self._columns = [*range(layout.inputs), *layout.critics]

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Inputs and conditions."""
        return observations[:, self._columns]


class SacPolicy(SACPolicy):
    """`SACPolicy` whose actor and critics see what a layout says."""

    def __init__(self, *arguments: Any, layout: Layout, **keywords: Any) -> None:
        self.layout = layout
        super().__init__(*arguments, **keywords)

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """The actor, which sees its inputs and estimates."""
        return super().make_actor(_ActorsView(self.observation_space, AsymmetricInputs(self.layout)))

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """A critic, which sees the inputs and the conditions."""
        return super().make_critic(_CriticsView(self.observation_space, self.layout))


def asymmetric_inputs(model: Any) -> AsymmetricInputs:
    """What a model's actor sees."""
    actor = getattr(model, "actor", None)
    view = model.policy.mlp_extractor if actor is None else actor.features_extractor
    found: AsymmetricInputs = view.eyes
    return found


class EstimatorTrainer:
    """Regression of a model's estimator on the true conditions.

    Parameters
    ----------
    model
        Of `PpoPolicy` or `SacPolicy`, with an estimator.
    config : EstimateConfig
    """

    def __init__(self, model: Any, config: EstimateConfig) -> None:
        inputs = asymmetric_inputs(model)
        assert inputs.estimator is not None  # whoever has no estimator needs no trainer
        self._network, self._layout, self._config = inputs.estimator, inputs.layout, config
        self.optimizer = torch.optim.Adam(self._network.parameters(), lr=config.learning_rate)
        self._kept: Array32 = np.zeros((0, 0), np.float32)
        self._place = 0

    def pass_over(self, observations: Array32) -> dict[str, float]:
        """Learn once from each of many observations, and from as many of former rollouts; return the errors.

        Parameters
        ----------
        observations : ndarray, shape (n, columns)

        Returns
        -------
        dict
            RMS error of each condition in units of its map's half.
        """
        former = self._kept[np.random.permutation(len(self._kept))[: len(observations)]]  # noqa: NPY002 - SB3's
        every = np.concatenate([observations, former]) if len(former) else observations
        order = np.random.permutation(len(every))  # noqa: NPY002
        errors = [
            self.update(torch.as_tensor(every[part]))
            for part in np.array_split(order, max(1, len(order) // self._config.batch_size))
        ]
        self._keep(observations)
        return self._named(torch.stack(errors).mean(dim=0))

    def update(self, observations: torch.Tensor) -> torch.Tensor:
        """Learn once from a minibatch; return the mean squares of the errors, shape (conditions)."""
        layout = self._layout
        found = self._network(observations[:, : layout.inputs])
        wanted = observations[:, list(layout.estimated)]
        loss = nn.functional.smooth_l1_loss(found, wanted)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.optimizer.zero_grad()  # the policy's optimiser knows these weights, too, and must find nothing
        return (found.detach() - wanted).square().mean(dim=0)

    def _named(self, squares: torch.Tensor) -> dict[str, float]:
        roots = squares.sqrt().tolist()
        return {f"estimate/{name}": root for name, root in zip(self._config.conditions, roots, strict=True)}

    def named(self, errors: Sequence[torch.Tensor]) -> dict[str, float]:
        """RMS errors of several updates, by name."""
        return self._named(torch.stack(list(errors)).mean(dim=0))

    def _keep(self, observations: Array32) -> None:
        """Some of a rollout, in place of the oldest ones."""
        some = observations[:: max(1, 8 * len(observations) // KEPT)]
        if len(self._kept) < KEPT:
            self._kept = np.concatenate([self._kept.reshape(-1, some.shape[1]), some])[:KEPT]
            return
        places = (self._place + np.arange(len(some))) % KEPT
        self._kept[places], self._place = some, (self._place + len(some)) % KEPT
