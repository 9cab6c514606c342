"""Options that several commands share: one name, one meaning, one check."""

from __future__ import annotations

import copy
import json
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from rich.markup import escape
from typer.models import OptionInfo

from sayd_env.cli.parsers import SPEEDS as SPEEDS_USAGE
from sayd_env.cli.parsers import ListOf, Names, Number, Numbers, name, positive, speeds
from sayd_env.config import ConfigError, packaged_names
from sayd_env.config.loader import YAML, assigned_keys, is_path

if TYPE_CHECKING:
    from sayd_env.config.environment import EnvironmentConfig
    from sayd_env.config.scenario import Scenario
    from sayd_env.config.sweep import Variant
    from sayd_env.runs.policies import ForeignReader, PolicySpec

WEAR_OF = {"new": 0.0, "worn": 1.0}
SHARE = Number(0, 1)
FRICTION = positive(high=1)
GAUGE = Number(900, 1700, "mm")
WORKERS = Number(1, 1024, whole=True)
SEED = Number(0, 2**32 - 1, whole=True)
SEEDS = Number(1, 10_000, whole=True)


def option(
    usage: str, text: str, parser: Callable[[str], Any] | None = None, *, default: Any = ..., **more: Any
) -> Any:
    """An option of a command.

    Parameters
    ----------
    usage : str
        Its names and, unless it is a switch, what follows: ``-o --file FILE``.
    text : str
        What it does.
    parser : callable, optional
        Reads what follows; a `ValueError` says what was found and what is allowed.
    default
        Its value where it is not given; left out beside a parameter's own default, else None.
    **more
        Further properties as Typer calls them.
    """
    words = usage.split()
    names = [word for word in words if word.startswith("-")]
    metavar = " ".join(words[len(names) :])
    return typer.Option(default, *names, metavar=metavar, help=escape(text), parser=parser, **more)


def argument(metavar: str, text: str, *, default: Any = ..., **more: Any) -> Any:
    """An argument of a command, required unless it has a default."""
    return typer.Argument(default, metavar=metavar, help=escape(text), show_default=False, **more)


def settled(default: Any) -> Any:
    """A parameter's default; an option without one is None where it is not given."""
    if isinstance(default, OptionInfo) and default.default is ...:
        default.default = None
    return default


scenario = partial(option, rich_help_panel="Scenario")
policy = partial(option, rich_help_panel="Policies")
runs = partial(option, rich_help_panel="Runs")
output = partial(option, rich_help_panel="Output")


def one_of(*names: str, kind: str = "") -> Callable[[str], list[str]]:
    """Completion by some names and those of the packaged configurations of a kind."""

    def complete(incomplete: str) -> list[str]:
        known = (*names, *(packaged_names(kind) if kind else ()))
        return [name for name in known if name.startswith(incomplete)]

    return complete


def policy_names(incomplete: str) -> list[str]:
    """Completion by the names of all policies, of the last one in a list."""
    from sayd_env.agents import pretrained  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.control import CONTROLLERS  # noqa: PLC0415

    before, comma, last = incomplete.rpartition(",")
    shipped = [name for name in CONTROLLERS if name in ("passive", *packaged_names("control"))]
    return [f"{before}{comma}{name}" for name in one_of(*shipped, *pretrained.names())(last)]


def config_names(incomplete: str) -> list[str]:
    """Completion by the packaged scenarios."""
    from sayd_env.config.layers import names_of  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.scenario import STUDY  # noqa: PLC0415

    return one_of(*names_of(STUDY))(incomplete)


CONFIG = "Configuration: a packaged name or a YAML file."
Config = Annotated[str | None, scenario("--config NAME|FILE", CONFIG, autocompletion=config_names)]
PlanFile = Annotated[str | None, scenario("--config NAME|FILE", CONFIG)]
"""Of what the command itself does, not of a vehicle."""
SET_TEXT = (
    "One key of the configuration; repeatable. evaluate, critical-speed and simulate run each of several "
    "values, KEY=A,B,C, and of several such keys all combinations; a list is [1, 2], a text with commas is "
    "in quotes."
)
Set = Annotated[list[str] | None, scenario("--set KEY=VALUE", SET_TEXT)]
Seed = Annotated[int, runs("--seed S", "First random seed.", SEED)]
SEEDS_TEXT = "Number of track realisations: seeds S to S+N-1"
Seeds = Annotated[int, runs("--seeds N", f"{SEEDS_TEXT}.", SEEDS)]
QuickSeeds = Annotated[int | None, runs("--seeds N", f"{SEEDS_TEXT} (default above).", SEEDS)]
Quick = Annotated[bool, runs("--quick", "A look, not a result: fewer seeds, shorter.")]
STAY = "(default: all cores); results do not change."
Threads = Annotated[int | None, runs("--workers N", f"Threads {STAY}", WORKERS)]
Out = Annotated[Path | None, output("--out DIR", "Directory of the result's files.")]
Json = Annotated[bool, output("--json", "Print the result as JSON and nothing else.")]
Speeds = Annotated[Numbers | None, scenario("--speeds KMH,...", f"In km/h: {SPEEDS_USAGE}.", speeds)]
MU = "Friction coefficient of wheel and rail"
LAWS = "Give critical speeds by these creep laws, too: table, polach, fastsim."
CreepLaws = Annotated[Names | None, option("--creep-laws LAW,...", LAWS, ListOf(name))]
Environment = Annotated[
    str,
    scenario(
        "--environment NAME|FILE",
        "Sensors, control period, episodes, what is drawn: nominal, randomized, faults or a YAML file.",
        autocompletion=one_of(kind="env"),
    ),
]
WHICH = (
    "'sayd policies' lists all), constant:V, files of learned policies (.npz, .onnx, .zip) or of controllers "
    "(.yaml), or code of one's own (module:factory, file.py:factory), each with safe: before it inside the "
    "safe fallback (safe:mppt2"
)
policies = partial(policy, "--policies A,B,...", parser=ListOf(name), autocompletion=policy_names)
EXECUTORS = one_of("threads", "processes", "ray", "dask")


class Group:
    """Options that belong together: a command with a parameter of this kind offers all of them."""

    def __init__(self, **given: Any) -> None:
        for key, (_, default) in self.offered().items():
            setattr(self, key, given.get(key, getattr(default, "default", default)))

    @classmethod
    def offered(cls) -> dict[str, tuple[Any, Any]]:
        """Annotation and default of each option."""
        hints = get_type_hints(cls, include_extras=True)
        return {key: (hint, settled(getattr(cls, key))) for key, hint in hints.items()}

    def given(self) -> dict[str, Any]:
        """What was given, by the options' names; None for the others."""
        found = {key: getattr(self, key) for key in self.offered()}
        names = {key: "--set" if key == "assignments" else f"--{key.replace('_', '-')}" for key in found}
        return {names[key]: None if value is False else value for key, value in found.items()}


def out_text(command: str, *, quick: bool, apart: str = "") -> str:
    """Help of ``--out`` of a command, with its default directory, and who has one with ``--json``, too."""
    look = f", with --quick {command}-quick" if quick else ""
    return f"Directory of the result's files. Default: results/{command}{look} (none with --json{apart})."


class RunOptions(Group):
    """Options of commands that make many runs."""

    workers: int | None = runs("--workers N", f"Threads or processes {STAY}", WORKERS)
    executor: str | None = runs(
        "--executor KIND",
        "Where runs are computed: threads, processes, ray, ray://ADDRESS, dask, dask://ADDRESS. "
        "Default: processes where there are many runs, else threads.",
        autocompletion=EXECUTORS,
    )


class OutputOptions(Group):
    """Options of all commands."""

    out: Out = None
    as_json: Json = False
    wide: bool = output("--wide", "Print all columns of tables, beyond 80 characters.", default=False)


def gauge_text(text: str) -> str:
    """A gauge that is typed: mm, or a track's name or path, which is read later."""
    if re.fullmatch(r"[-+.\d].*|nan|inf(inity)?", text.strip(), re.IGNORECASE) and not is_path(text):
        GAUGE(text)
    return text


class ScenarioOptions(Group):
    """Options that choose vehicle, wheels, track and dampers."""

    profile: str | None = scenario(
        "--profile NAME|FILE",
        "Wheel profile: new, worn, a name, a YAML file or a profile file (.csv, .txt, .prw, .whl).",
        autocompletion=one_of(*WEAR_OF, kind="profile"),
    )
    rail: str | None = scenario(
        "--rail NAME|FILE",
        "Rail profile: a name, a YAML file or a profile file (.csv, .txt, .prr, .ban).",
        autocompletion=one_of(kind="profile"),
    )
    gauge: str | None = scenario(
        "--gauge MM|NAME|FILE", "Track gauge in mm, or that of a track: a name or a YAML file.", gauge_text
    )
    track: str | None = scenario(
        "--track NAME|FILE",
        "Track: a name, a YAML file or a CSV file of measured geometry.",
        autocompletion=one_of(kind="track"),
    )
    damper: str | None = scenario(
        "--damper NAME|FILE",
        "Yaw dampers: passive, sayd, a YAML file, or a measured curve or valve map (.csv, .txt). passive and "
        "sayd leave the numbers of --config where it has the kind.",
        autocompletion=one_of(kind="damper"),
    )
    config: Config = None
    assignments: Set = None

    def read(self, wear: float | None, friction: float | None, default: str | None = None) -> Scenario:
        """Read the configuration and apply the flags and the assignments of ``--set``.

        ``--profile new`` and ``worn`` are the scenario's own wheels at wear 0 and 1, anything else is the
        name or path of a wheel profile, unworn unless `wear` says otherwise.

        Parameters
        ----------
        wear, friction : float, optional
            ``--wear`` (stronger than new and worn) and ``--friction``.
        default : str, optional
            Configuration where ``--config`` is not given.

        Raises
        ------
        ConfigError
            A name, file or value that cannot be used, or one that is given twice.
        """
        from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - keeps --help fast

        self._refuse_twice()
        if wear is None and self.profile is not None:
            wear = WEAR_OF.get(self.profile, 0.0)
        wheel = None if self.profile in WEAR_OF else self.profile
        config = default if self.config is None else self.config
        flags = {"wheel": wheel, "wear": wear, "friction": friction, "track": self.track}
        flags |= {"rail": self.rail, "track.gauge": self._gauge()}
        # JSON is YAML: quoting keeps a name like "1e3" or "no" a name.
        given = [f"{key}={json.dumps(value)}" for key, value in flags.items() if value is not None]
        found = load_scenario(config, [*given, *self._damper(config), *(self.assignments or ())])
        say_notes(dict(found))
        return found

    def _refuse_twice(self) -> None:
        """Refuse a key of the configuration, or one above it, that both an option and ``--set`` give."""
        keys = {"gauge": "track.gauge", "profile": "wear" if self.profile in WEAR_OF else "wheel"}
        for option in ("wear", "friction", "profile", "rail", "gauge", "track", "damper"):
            own = keys.get(option, option)
            for key in assigned_keys(self.assignments):
                given = getattr(self, option, None) is not None
                if given and (own == key or own.startswith(f"{key}.")):
                    raise ConfigError(f"--{option}: sets what --set {key} does; give one")

    def refuse_said(self, line: str | None) -> None:
        """Refuse options that a line says itself, of a gauge, a track or a coefficient of friction.

        Raises
        ------
        ConfigError, DataError
            There is one; or the line cannot be used.
        """
        from sayd_env.measured.lines import options_of, refuse_said  # noqa: PLC0415 - keeps --help fast

        if line is None:
            return
        flags = {f"--{name}": name for name in ("gauge", "friction", "track") if getattr(self, name)}
        settings = options_of(assigned_keys(self.assignments))
        refuse_said(line, flags | {f"--set {key}": name for key, name in settings.items()})

    def refuse_idle_dampers(
        self, found: Iterable[Scenario], policies: Iterable[PolicySpec] = (), default: str | None = None
    ) -> None:
        """Refuse dampers of one's own that no run has.

        Raises
        ------
        ConfigError
            The vehicle has no yaw dampers; or all policies command valves, so that semi-active ones replace
            passive ones, see `for_policy`.
        """
        from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - keeps --help fast
        from sayd_env.runs.policies import replaces_dampers  # noqa: PLC0415

        keys = [key for key in assigned_keys(self.assignments) if key.partition(".")[0] == "damper"]
        given = f"--set {keys[0]}" if keys else f"--damper {self.damper}"
        config, replaced = default if self.config is None else self.config, replaces_dampers(policies)
        usual = load_scenario(config).damper
        for each in found:
            if each.damper == usual:
                continue
            if not each.vehicle.yaw_damped:
                raise ConfigError(f"{given}: has no effect: vehicle '{each.vehicle.name}' has no yaw dampers")
            if replaced and each.damper.type == "passive":
                raise ConfigError(
                    f"{given}: has no effect: every policy commands valves, so semi-active dampers replace "
                    "passive ones; add the policy passive, or choose semi-active dampers"
                )

    def _damper(self, config: str | None) -> list[str]:
        """What ``--damper`` sets."""
        from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - keeps --help fast

        if self.damper is None or load_scenario(config).damper.type == self.damper:
            return []  # the configuration's own, whose numbers may differ from the packaged ones
        if is_path(self.damper) and not self.damper.lower().endswith(YAML):
            from sayd_env.measured.dampers import damper_settings  # noqa: PLC0415

            return damper_settings(self.damper)
        return [f"damper={json.dumps(self.damper)}"]

    def _gauge(self) -> float | None:
        """Gauge (m) that is typed, or that of the track that is named."""
        from sayd_env.config.track import read_track  # noqa: PLC0415 - keeps --help fast

        if self.gauge is None:
            return None
        try:
            return float(self.gauge) * 1e-3
        except ValueError:
            if is_path(self.gauge) and not self.gauge.lower().endswith(YAML):
                raise ConfigError(
                    f"--gauge {self.gauge}: expected mm, or a track's name or YAML file; a measured file "
                    "belongs to --track"
                ) from None
            return read_track(self.gauge).gauge

    def sweep(
        self, runs: int, most: int = 10_000, default: str | None = None
    ) -> tuple[list[Variant], list[Scenario]]:
        """Configurations by the values of ``--set``, each with its scenario.

        Parameters
        ----------
        runs : int
            Runs of each.
        most : int
            Runs of all together: some hours on two cores.
        default : str, optional
            As for `read`.

        Raises
        ------
        ConfigError
            As `read` and `variants`.
        """
        from sayd_env.config.sweep import variants  # noqa: PLC0415 - keeps --help fast

        found = variants(self.assignments, runs, most=most)
        return found, [self._with(variant).load(default) for variant in found]

    def _with(self, variant: Variant) -> ScenarioOptions:
        """The same with the assignments of one configuration."""
        other = copy.copy(self)
        other.assignments = list(variant.assignments)
        return other

    def load(self, default: str | None = None) -> Scenario:
        """Read the scenario."""
        raise NotImplementedError


def notes_of(parts: Mapping[str, Any]) -> tuple[str, ...]:
    """What was recognised in measured files that parts of a configuration name, and done to their numbers.

    Raises
    ------
    ConfigError, DataError
        One cannot be used.
    """
    from sayd_env.measured.notes import measured_notes  # noqa: PLC0415 - keeps --help fast
    from sayd_env.physics.profiles import profile_notes  # noqa: PLC0415

    return (*profile_notes(parts), *measured_notes(parts))


def say_notes(parts: Mapping[str, Any]) -> None:
    """Tell `notes_of` on standard error; errors as there."""
    for note in notes_of(parts):
        sys.stderr.write(f"sayd: {note}\n")


def say_same_tracks(
    say: Callable[[str], None], scenarios: Iterable[Scenario], seeds: int, line: str | None = None
) -> None:
    """Tell, below a result, where several seeds made no other track."""
    from sayd_env.measured.lines import irregularities_along  # noqa: PLC0415 - keeps --help fast

    tracks = [each.track for each in scenarios]
    if seeds > 1 and all(each.type != "spectrum" for each in irregularities_along(tracks, line)):
        say("the track is the same for every seed: nothing of it is drawn")


class VehicleOptions(ScenarioOptions):
    """Options that choose one scenario, or those of a sweep."""

    wear: float | None = scenario("--wear 0..1", "Tread wear, 0 is new.", SHARE)
    friction: float | None = scenario("--friction MU", f"{MU}.", FRICTION)

    def load(self, default: str | None = None) -> Scenario:
        """Read the scenario."""
        return self.read(self.wear, self.friction, default)


class GridOptions(ScenarioOptions):
    """Options of a study over speeds, wear and friction in an environment."""

    speeds: Speeds = None
    wear: Numbers | None = scenario(
        "--wear 0..1,...", "Tread wear, 0 is new; one or several.", ListOf(SHARE, distinct=True)
    )
    friction: Numbers | None = scenario(
        "--friction MU,...", f"{MU}; one or several.", ListOf(FRICTION, distinct=True)
    )
    environment: Environment = "nominal"
    reward: str | None = scenario(
        "--reward NAME",
        "Weights of the cost J: mppt1 (acceleration alone), mppt2 (the default) or low-force; others by "
        "--set cost.force_weight=0.3.",
        autocompletion=one_of("mppt1", "mppt2", "low-force"),
    )

    def load(self, default: str | None = None) -> Scenario:
        """Scenario of the first wear and friction."""
        from sayd_env.config.reward import with_reward  # noqa: PLC0415 - keeps --help fast

        keys = set(assigned_keys(self.assignments))
        twice = keys & {"cost", "cost.acceleration_weight", "cost.force_weight"}
        if self.reward is not None and twice:
            raise ConfigError(
                f"--reward {self.reward}: sets the weights, as --set {min(twice)} does; give one"
            )
        wear, friction = (values[0] if values else None for values in (self.wear, self.friction))
        found = self.read(wear, friction, default)
        return found if self.reward is None else with_reward(found, self.reward)


class ForeignOptions(Group):
    """Options for policies that Stable-Baselines3 saved."""

    trust_pickles: bool = policy(
        "--trust-pickles",
        "Load what Stable-Baselines3 saved (.zip, PPO or SAC, MlpPolicy), which can run any code here.",
        default=False,
    )
    trained_period: float | None = policy(
        "--trained-period S",
        "With --trust-pickles: control period of its training (s). Default: the environment's.",
        positive("s", 1),
    )
    vec_normalize: Path | None = policy(
        "--vec-normalize FILE",
        "With --trust-pickles: its training's VecNormalize (.pkl), which can run any code, too.",
    )

    def reader(self, environment: EnvironmentConfig, chosen: Iterable[str] | None) -> ForeignReader | None:
        """What reads such files among the chosen policies, or None where they are not trusted."""
        from sayd_env.runs.policies import foreign_reader  # noqa: PLC0415 - keeps --help fast

        own = self.trust_pickles, environment, self.trained_period, self.vec_normalize
        return foreign_reader(chosen or (), *own)
