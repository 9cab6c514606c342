"""Policies by name, as command lines, studies and users' programs name them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from sayd_env import baselines
from sayd_env.agents import pretrained
from sayd_env.config import ConfigError, nearest, packaged_names, validate
from sayd_env.config.control import (
    ConstantConfig,
    LqgConfig,
    PassiveControlConfig,
    controller_of,
    load_controller,
    load_online,
)
from sayd_env.config.damper import PassiveDamperConfig, load_sayd
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.explain import shown
from sayd_env.config.safe import load_safe
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.envs.episode_batch import environment_scenario, make_interface
from sayd_env.envs.interface import Interface
from sayd_env.envs.registration import VERSION
from sayd_env.runs.own_code import OwnPolicy

if TYPE_CHECKING:
    from sayd_env.agents.policy_file import StoredPolicy

PASSIVE = "passive"
PAPER = ("mppt1", "mppt2", "skyhook-onoff", "skyhook-continuous")
"""The paper's controllers."""
TUNED = tuple(name for name in baselines.NAMES if name.endswith("-tuned"))
"""Controllers with the parameters of the smallest mean J: the strongest opponents."""
LEARNED = ".npz"
"""How the files of learned policies end."""
FOREIGN = ".zip"
"""How the files of Stable-Baselines3 end."""
ONNX = ".onnx"
PARAMETERS = (".yaml", ".yml")
"""How the files of parameters of controllers end."""
EXPECTED = (
    f"constant:V, the file of a learned policy (*{LEARNED}, *{ONNX}) or of a controller's parameters "
    f"(*{PARAMETERS[0]}), or code of one's own: module:factory, file.py:factory; each of them with "
    f"{baselines.SAFE} before it inside the safe fallback"
)
_CODE = re.compile(r"(?P<place>[\w.]+|.+\.py):(?P<factory>\w+)")
ForeignReader: TypeAlias = "Callable[[Path], StoredPolicy]"
"""Reads a file of Stable-Baselines3, for whoever trusts it."""


class PolicyContent(Protocol):
    """What the file of a policy holds: weights, a model or code."""

    @property
    def where(self) -> str:
        """The file, for messages."""

    @property
    def needs(self) -> Mapping[str, Any]:
        """Keywords of the environments in which it can act."""

    def identity(self) -> Any:
        """What changes whenever its content changes."""

    def bound(self, interface: Interface) -> Any:
        """The policy, ready to act in an environment."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy: one of `baselines.NAMES` with parameters, ``constant:0.3`` for short, or that of a file."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Of a controller."""
    label: str = ""
    """How tables call it; its name by default."""
    stored: PolicyContent | None = None
    """Of a policy that is no controller."""

    @property
    def title(self) -> str:
        """How tables call it."""
        return self.label or self.name

    @property
    def learned(self) -> StoredPolicy | None:
        """Weights with the description of their training, if it has such."""
        if self.stored is None:
            return None
        from sayd_env.agents.policy_file import StoredPolicy  # noqa: PLC0415 - keeps starts without one fast

        return self.stored if isinstance(self.stored, StoredPolicy) else None

    @property
    def needs(self) -> Mapping[str, Any]:
        """Keywords of the environments in which it can act; what it leaves open is not there."""
        if self.stored is not None:
            return self.stored.needs
        return {"damper": "passive"} if self.name == PASSIVE else {}

    @property
    def open_loop(self) -> bool:
        """Whether it reads no sensor: passive dampers, or one command."""
        if self.stored is not None:
            return False
        return isinstance(load_controller(self.name, self.parameters), ConstantConfig | PassiveControlConfig)

    def identity(self) -> Any:
        """What a kept run depends on because of its policy: always the same object.

        Of a controller all its parameters, of a file its content, of code its sources.

        Raises
        ------
        ConfigError
            A controller whose parameters cannot be read.
        """
        return self._identity

    @cached_property
    def _identity(self) -> Any:
        if self.stored is not None:
            return {"content": self.stored.identity()}
        controller = load_controller(self.name, self.parameters)
        parameters = controller.model_dump(mode="json", exclude={"provenance"})
        found = {"controller": controller_of(self.name), "parameters": parameters}
        if isinstance(controller, LqgConfig):
            found["designed_on"] = load_scenario(controller.study).model_dump(mode="json")
        return found

    def make(self, env: Any) -> Any:
        """Make the policy for an environment, a batch or an `Interface`.

        Raises
        ------
        ConfigError
            It needs another environment.
        """
        interface = baselines.interface_of(env)
        if self.stored is not None:
            return self.stored.bound(interface)
        return baselines.make(self.name, interface, **self.parameters)

    def environment(self, config: EnvironmentConfig) -> EnvironmentConfig:
        """The environment as the policy needs it: it brings signals, valves and clock of its own.

        Raises
        ------
        ConfigError
            A control period that does not fit the length of an episode.
        """
        if self.stored is None:
            return config
        return validate(EnvironmentConfig, dict(config) | dict(self.stored.needs), self.stored.where)


@dataclass(frozen=True)
class GuardedPolicy:
    """What ``safe:`` makes of a policy: the same inside a `baselines.SafeFallback`."""

    inside: PolicySpec

    @property
    def where(self) -> str:
        """The policy as it was named."""
        return baselines.SAFE + (self.inside.name if self.inside.stored is None else self.inside.stored.where)

    @property
    def needs(self) -> Mapping[str, Any]:
        """Those of the policy inside."""
        return self.inside.needs

    def identity(self) -> Any:
        """The thresholds, and the policy inside."""
        return {"safe": load_safe().model_dump(mode="json"), "policy": self.inside.identity()}

    def bound(self, interface: Interface) -> baselines.SafeFallback:
        """The policy inside the fallback, ready to act in an environment.

        Raises
        ------
        ConfigError
            As the policy inside, or the environment lacks what the monitor reads.
        """
        return baselines.SafeFallback(self.inside.make(interface), interface)


def _guarded(inside: PolicySpec) -> PolicySpec:
    """A policy inside the safe fallback; passive dampers, and a fallback already, are refused."""
    if inside.name == PASSIVE or isinstance(inside.stored, GuardedPolicy):
        raise ConfigError(
            f"policy '{baselines.SAFE}{inside.name}': expected a policy that commands valves after the colon"
        )
    prefix = baselines.SAFE
    return PolicySpec(prefix + inside.name, label=prefix + inside.title, stored=GuardedPolicy(inside))


def constant_spec(current: float) -> PolicySpec:
    """The policy of one command that never changes."""
    return PolicySpec("constant", {"current": current}, f"constant:{current:g}")


def policy_spec(text: str, foreign: ForeignReader | None = None) -> PolicySpec:
    """Read a policy from a command line.

    Parameters
    ----------
    text : str
        A name of `baselines.NAMES`, ``constant:V`` with a valve command V from 0 to 1, a name of
        `agents.pretrained`; the path of a learned policy's file, which ends in ``.npz``, in ``.onnx``, or in
        ``.zip`` if Stable-Baselines3 wrote it; of a controller's parameters in ``.yaml``, named after it; or
        ``module:factory`` or ``file.py:factory`` of one's own code. With ``safe:`` before it, any of these
        inside a `baselines.SafeFallback`.
    foreign : callable, optional
        What reads a file of Stable-Baselines3; without, it is refused.

    Raises
    ------
    ConfigError
        An unknown name, a command that is not a number from 0 to 1, no such file, or one that is not trusted.
    DataError
        A damaged file.
    """
    if not isinstance(text, str):
        raise ConfigError(f"policy: found {shown(text)}; expected a name, a file or code as text")
    given = text.strip()
    if given.startswith(baselines.SAFE):
        return _guarded(policy_spec(given.removeprefix(baselines.SAFE), foreign))
    if given.endswith((LEARNED, FOREIGN, ONNX, *PARAMETERS)):
        return _file_spec(given, foreign)
    name, parameters = baselines.parse(given)
    if name in baselines.NAMES:
        return PolicySpec(name, parameters, given) if parameters else PolicySpec(name)
    if name in pretrained.names():
        file = pretrained.path(name)
        return learned_spec(read_learned(file), file.stem)
    if _CODE.fullmatch(given):
        own = OwnPolicy.read(given)
        return PolicySpec(own.title, stored=own)
    algorithm = name.partition("-s")[0]
    if algorithm in packaged_names("train") and algorithm not in pretrained.groups():
        raise ConfigError(
            f"policy {shown(text)}: no learned policy of this name comes with the program; train one with "
            f"'sayd train {algorithm}' and name its file, results/train-{algorithm}-s0/best.npz"
        )
    if given.rstrip(":").endswith(".py"):
        raise ConfigError(f"policy {shown(text)}: names no factory; expected {given.rstrip(':')}:FACTORY")
    if given.isdecimal():
        raise ConfigError(f"policy {shown(text)}: a number alone; commas part policies, not decimals")
    known = (*baselines.NAMES, *pretrained.names())
    raise ConfigError(
        f"policy {shown(text)}: unknown{nearest(name.partition(':')[0], known)}; expected "
        f"{', '.join(known)}, {EXPECTED}"
    )


def _file_spec(given: str, foreign: ForeignReader | None) -> PolicySpec:
    if given.endswith((LEARNED, FOREIGN)):
        return learned_spec(read_learned(Path(given), foreign))
    if given.endswith(ONNX):
        from sayd_env.agents.onnx_policy import read_onnx  # noqa: PLC0415 - keeps starts without one fast

        return PolicySpec(Path(given).stem, stored=read_onnx(Path(given)))
    load_controller(given)  # refused here rather than under way
    return PolicySpec(given, label=f"{Path(given).stem}@{Path(given).resolve().parent.name}")


def policy_specs(texts: Iterable[str], foreign: ForeignReader | None = None) -> list[PolicySpec]:
    """Read several policies, and give those of the same name titles of their own.

    Raises
    ------
    ConfigError, DataError
        As `policy_spec`, or a duplicate policy.
    """
    found: dict[str, PolicySpec] = {}
    for text in texts:
        spec = policy_spec(text, foreign)
        if spec.title in found and spec.identity() != found[spec.title].identity():
            place = spec.stored.where if spec.stored is not None else spec.name
            titles = (f"{spec.title}@{Path(part).name}" for part in Path(place).resolve().parents)
            spec = replace(spec, label=next((title for title in titles if title not in found), spec.title))
        refuse_duplicates([*found.values(), spec])
        found[spec.title] = spec
    return list(found.values())


def refuse_duplicates(policies: Iterable[PolicySpec]) -> None:
    """Refuse policies of the same title.

    Raises
    ------
    ConfigError
        There are some; the message names the title.
    """
    for title, count in Counter(policy.title for policy in policies).items():
        if count > 1:
            raise ConfigError(f"policy '{title}': duplicate")


def load_policy(
    policy: str,
    env: Any = None,
    *,
    trust_pickles: bool = False,
    trained_period: float | None = None,
    vec_normalize: Path | None = None,
) -> Any:
    """Make a policy of any kind, ready to act.

    Parameters
    ----------
    policy : str
        As on a command line, see `policy_spec`.
    env : optional
        What it is to control, see `baselines.make`. An environment must be as the policy needs it. Of an id,
        or without any (then ``SAYD/Nominal``), an environment that fits is assumed: make it with
        ``gymnasium.make(ID, **policy.interface.keywords)``.
    trust_pickles : bool
        Whether a file of Stable-Baselines3, which can run any code while it is loaded, may be loaded.
    trained_period, vec_normalize
        With it: control period of its training (s), and the file of its `VecNormalize`.

    Returns
    -------
    object
        With ``predict(observation, state=None, episode_start=None, deterministic=True)`` and the attributes
        ``name`` and ``interface``.

    Raises
    ------
    ConfigError
        As `policy_spec`, or an environment without what the policy needs; the message says what that is.
    DataError
        A damaged file.
    """
    nominal = load_environment()
    spec = policy_spec(
        policy, foreign_reader([policy], trust_pickles, nominal, trained_period, vec_normalize)
    )
    if env is not None:
        return spec.make(baselines.interface_of(env, spec.needs))
    config = validate(EnvironmentConfig, dict(nominal) | dict(spec.needs), policy)
    return spec.make(make_interface(config, environment_scenario(config), load_online()))


def foreign_reader(
    policies: Iterable[str],
    trusted: bool,
    config: EnvironmentConfig,
    period: float | None = None,
    statistics: Path | None = None,
) -> ForeignReader | None:
    """What reads files of Stable-Baselines3, or None.

    Parameters
    ----------
    policies : iterable of str
        Those that are to be read, as on a command line.
    trusted : bool
        Whether such files, which can run any code while they are loaded, may be loaded.
    config : EnvironmentConfig
        The environment of their training.
    period : float, optional
        Control period of their training (s); that of `config` by default.
    statistics : Path, optional
        File of the `VecNormalize` of their training.

    Raises
    ------
    ConfigError
        A period or statistics, where no file may be loaded or none of the policies is one.
    """
    given = {"--trained-period": period, "--vec-normalize": statistics}
    asked = next((option for option, value in given.items() if value is not None), None)
    if asked is not None and not any(FOREIGN in policy for policy in policies):
        raise ConfigError(f"{asked}: is that of a file of Stable-Baselines3 ({FOREIGN}); no policy is one")
    if asked is not None and not trusted:
        raise ConfigError(f"{asked}: is that of files of Stable-Baselines3: add --trust-pickles")

    def read(path: Path) -> StoredPolicy:
        try:
            from sayd_env.agents.foreign import read_foreign  # noqa: PLC0415 - imports torch, which may be missing

            return read_foreign(path, config, period, statistics)
        except ModuleNotFoundError as error:
            raise ConfigError(
                f"{path}: needs torch and Stable-Baselines3: install them with pip install 'sayd-env[train]' "
                f"(no module '{error.name}')"
            ) from None

    return read if trusted else None


def read_learned(path: Path, foreign: ForeignReader | None = None) -> StoredPolicy:
    """Read the file of a learned policy.

    Parameters
    ----------
    foreign : callable, optional
        What reads a file of Stable-Baselines3; without, it is refused.

    Raises
    ------
    ConfigError
        No such file, one that is not trusted, or a policy that was trained on another version of the
        environments.
    DataError
        A damaged file.
    """
    if path.suffix != FOREIGN:
        from sayd_env.agents.policy_file import read_policy  # noqa: PLC0415 - keeps starts without one fast

        stored = read_policy(path)
        if (version := stored.environment_version) not in (None, VERSION):
            raise ConfigError(
                f"{stored.where}: was trained on version {shown(version)} of the environments; "
                f"version {VERSION} is another plant. Train it again, or load it in spite of that in Python: "
                "sayd_env.agents.policy_file.load_policy(file, env.unwrapped.interface)"
            )
        return stored
    if foreign is None:
        raise ConfigError(
            f"{path}: a file of Stable-Baselines3 can run any code while it is loaded. If you trust where it "
            "comes from, 'sayd export FILE --trust-pickles' makes a safe file of it; commands for several "
            "policies take --trust-pickles, too (in Python trust_pickles=True)"
        )
    return foreign(path)


def learned_spec(stored: StoredPolicy, label: str = "") -> PolicySpec:
    """A learned policy among the others; tables call it as it calls itself, unless by a label."""
    return PolicySpec(stored.description.name, label=label, stored=stored)


def for_policy(scenario: Scenario, policy: PolicySpec) -> Scenario:
    """Scenario with the yaw dampers that a policy works with: passive ones, or semi-active ones.

    Semi-active ones stay where the scenario has them; elsewhere the packaged ones replace its passive ones.

    Raises
    ------
    ConfigError
        The passive vehicle is asked for where the scenario has semi-active dampers.
    """
    passive = isinstance(scenario.damper, PassiveDamperConfig)
    if policy.name == PASSIVE:
        if not passive:
            raise ConfigError(
                f"policy 'passive' needs passive yaw dampers, but the scenario has '{scenario.damper.name}'"
            )
        return scenario
    return scenario.model_copy(update={"damper": load_sayd("sayd")}) if passive else scenario


def replaces_dampers(policies: Iterable[PolicySpec]) -> bool:
    """Whether all of some policies, and at least one, command valves: `for_policy` drops passive dampers."""
    names = [policy.name for policy in policies]
    return bool(names) and PASSIVE not in names
