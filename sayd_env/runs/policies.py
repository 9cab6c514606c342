"""Policies by name, as command lines and studies name them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sayd_env import baselines
from sayd_env.agents import pretrained
from sayd_env.agents.policy_file import StoredPolicy, policy_bytes, read_policy
from sayd_env.config import ConfigError, DataError, nearest, validate
from sayd_env.config.control import load_controller
from sayd_env.config.damper import PassiveDamperConfig, load_sayd
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.envs.episode_batch import EpisodeBatch

PASSIVE = "passive"
LEARNED = ".npz"
"""How the files of learned policies end."""
FOREIGN = ".zip"
"""How the files of Stable-Baselines3 end."""
PARAMETERS = ".yaml"
"""How the files of parameters of controllers end."""
ForeignReader = Callable[[Path], StoredPolicy]
"""Reads a file of Stable-Baselines3, for whoever trusts it."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy: one of `baselines.NAMES` with parameters, ``constant:0.3`` for short, or a learned one."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Of a learned policy the hash of its content, by which studies know kept runs of it."""
    label: str = ""
    """How tables call it; its name by default."""
    stored: StoredPolicy | None = None
    """A learned policy."""

    @property
    def title(self) -> str:
        """How tables call it."""
        return self.label or self.name

    def make(self, batch: EpisodeBatch) -> Any:
        """Make the policy for a batch."""
        if self.stored is not None:
            return self.stored.bound(batch.interface)
        return baselines.make(self.name, batch.interface, **self.parameters)

    def environment(self, config: EnvironmentConfig) -> EnvironmentConfig:
        """The environment as the policy needs it: a learned one brings signals, valves and clock of its own.

        Raises
        ------
        ConfigError
            A control period that does not fit the length of an episode.
        """
        if self.stored is None:
            return config
        learned = self.stored.description
        changes = {"observation": learned.observation, "valves": learned.valves}
        period = {"control_period": learned.control_period}
        rows = {"history": learned.history} if learned.observation == "history" else {}
        return validate(EnvironmentConfig, dict(config) | changes | period | rows, self.stored.source)


def policy_spec(text: str, foreign: ForeignReader | None = None) -> PolicySpec:
    """Read a policy from the command line.

    Parameters
    ----------
    text : str
        A name of `baselines.NAMES`, ``constant:V`` with a valve command V from 0 to 1, a name of
        `agents.pretrained`, or the path of a learned policy's file, which ends in ``.npz``, or in ``.zip``
        if Stable-Baselines3 wrote it, or of a controller's parameters in ``.yaml``, named after it.
    foreign : callable, optional
        What reads a file of Stable-Baselines3; without, it is refused.

    Raises
    ------
    ConfigError
        An unknown name, a command that is not a number from 0 to 1, no such file, or one that is not trusted.
    DataError
        A damaged file.
    """
    given = text.strip()
    if given.endswith((LEARNED, FOREIGN)):
        return learned_spec(read_learned(Path(given), foreign))
    if given.endswith(PARAMETERS):
        load_controller(given)  # refused here rather than under way
        return PolicySpec(given, label=f"{Path(given).stem}@{Path(given).resolve().parent.name}")
    name, parameters = baselines.parse(given)
    if name in baselines.NAMES:
        return PolicySpec(name, parameters, given) if parameters else PolicySpec(name)
    ready = pretrained.names()
    if name in ready:
        file = pretrained.path(name)
        return learned_spec(read_policy(file), file.stem)
    known = (*baselines.NAMES, *ready)
    raise ConfigError(
        f"policy '{text}': unknown{nearest(name, known)}; expected {', '.join(known)}, constant:V, "
        f"a file of a learned policy (*{LEARNED}) or of a controller's parameters (*{PARAMETERS})"
    )


def read_learned(path: Path, foreign: ForeignReader | None = None) -> StoredPolicy:
    """Read the file of a learned policy.

    Parameters
    ----------
    path : Path
    foreign : callable, optional
        What reads a file of Stable-Baselines3; without, it is refused.

    Raises
    ------
    ConfigError
        No such file, or one that is not trusted.
    DataError
        A damaged file.
    """
    if path.suffix != FOREIGN:
        return read_policy(path)
    if foreign is None:
        raise ConfigError(
            f"{path}: a file of Stable-Baselines3 can run any code while it is loaded. If you trust where it "
            "comes from, use --trust-pickles of evaluate, render or export (which makes a safe file of it)"
        )
    return foreign(path)


def learned_spec(stored: StoredPolicy, label: str = "") -> PolicySpec:
    """A learned policy among the others.

    Parameters
    ----------
    stored : StoredPolicy
    label : str
        How tables call it; by default as it calls itself.

    Raises
    ------
    DataError
        It calls itself like one of `baselines.NAMES`.
    """
    name = stored.description.name
    if name in baselines.NAMES:
        raise DataError(f"{stored.source}: the policy calls itself '{name}', which is a controller's name")
    digest = hashlib.sha256(policy_bytes(stored)).hexdigest()
    return PolicySpec(name, {"sha256": digest}, label, stored)


def for_policy(scenario: Scenario, policy: PolicySpec, sayd: str = "sayd") -> Scenario:
    """Scenario with the yaw dampers that a policy works with: passive ones, or semi-active ones.

    Parameters
    ----------
    scenario : Scenario
        With passive dampers, or with semi-active ones, which then stay.
    policy : PolicySpec
    sayd : str
        Name or file of the semi-active damper that replaces passive ones.

    Raises
    ------
    ConfigError
        The passive vehicle is asked for where the scenario has semi-active dampers, or an unknown damper.
    """
    passive = isinstance(scenario.damper, PassiveDamperConfig)
    if policy.name == PASSIVE:
        if not passive:
            raise ConfigError(
                f"policy 'passive' needs passive yaw dampers, but the scenario has '{scenario.damper.name}'"
            )
        return scenario
    return scenario.model_copy(update={"damper": load_sayd(sayd)}) if passive else scenario
