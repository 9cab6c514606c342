"""Options that several commands share: one name, one meaning, one check."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sayd_env.cli import parsers
from sayd_env.cli.parsers import NameList, Names, Number, NumberList, Numbers, positive

if TYPE_CHECKING:
    from sayd_env.config.environment import EnvironmentConfig
    from sayd_env.config.scenario import Scenario
    from sayd_env.runs.policies import ForeignReader

WEAR_OF = {"new": 0.0, "worn": 1.0}
SHARE = Number(0, 1)
FRICTION = positive(high=1)
WORKERS = Number(1, 1024, whole=True)
SEED = Number(0, 2**32 - 1, whole=True)
SEEDS = Number(1, 10_000, whole=True)


def option(
    names: str,
    metavar: str,
    text: str,
    parser: Callable[[str], Any] | None = None,
    *,
    complete: Callable[..., list[str]] | None = None,
    panel: str | None = None,
) -> Any:
    """An option of a command.

    Parameters
    ----------
    names : str
        Separated by spaces.
    metavar : str
        What follows it; nothing follows a switch.
    text : str
        What it does.
    parser : callable, optional
        Reads what follows it; a `ValueError` says what was found and what is allowed.
    complete : callable, optional
        Gives a shell what may follow.
    panel : str, optional
        Its group in the help.
    """
    return typer.Option(
        *names.split(),
        metavar=metavar,
        help=escape(text),
        parser=parser,
        autocompletion=complete,
        rich_help_panel=panel,
    )


scenario = partial(option, panel="Scenario")
policy = partial(option, panel="Policies")
runs = partial(option, panel="Runs")
output = partial(option, panel="Output")


def packaged(kind: str, *others: str) -> Callable[[str], list[str]]:
    """Completion by the names of the packaged configurations of a kind, and others."""

    def complete(incomplete: str) -> list[str]:
        from sayd_env.config.loader import packaged_names  # noqa: PLC0415 - keeps --help fast

        return [name for name in (*others, *packaged_names(kind)) if name.startswith(incomplete)]

    return complete


def policy_names(incomplete: str) -> list[str]:
    """Completion by the names of all policies, of the last one in a list."""
    from sayd_env.agents import pretrained  # noqa: PLC0415 - keeps --help fast

    before, comma, last = incomplete.rpartition(",")
    # Each controller has a configuration; 'online' there is that of what all of them measure.
    known = [name for name in packaged("control", "passive", *pretrained.names())(last) if name != "online"]
    return [f"{before}{comma}{name}" for name in known]


CONFIG = "Configuration: a packaged name or a YAML file."
Config = Annotated[str | None, scenario("--config", "NAME|FILE", CONFIG, complete=packaged("study"))]
Set = Annotated[
    list[str] | None, scenario("--set", "KEY=VALUE", "Override one key of the configuration; repeatable.")
]
Seed = Annotated[int, runs("--seed", "S", "First random seed.", SEED)]
SEEDS_TEXT = "Number of track realisations: seeds S to S+N-1."
Seeds = Annotated[int, runs("--seeds", "N", SEEDS_TEXT, SEEDS)]
Realisations = Annotated[int | None, runs("--seeds", "N", f"{SEEDS_TEXT} Default: see above.", SEEDS)]
Quick = Annotated[bool, runs("--quick", "", "A look, not a result: fewer seeds, shorter.")]
Threads = Annotated[
    int | None, runs("--workers", "N", "Threads (default: all cores); results do not change.", WORKERS)
]
Workers = Annotated[
    int | None,
    runs("--workers", "N", "Threads or processes (default: all cores); results do not change.", WORKERS),
]
Executor = Annotated[
    str | None,
    runs(
        "--executor",
        "KIND",
        "Who computes: threads, processes, ray, ray://ADDRESS, dask or dask://ADDRESS; results do not change. "
        "Default: processes where there are many runs, else threads.",
        complete=lambda: ["threads", "processes", "ray", "dask"],
    ),
]
OUT = "Directory of result.json, tables and plots. Default: results/{0}, of a look results/{0}-quick (none with --json)."
Out = Annotated[Path | None, output("--out", "DIR", OUT.format("COMMAND"))]
Json = Annotated[bool, output("--json", "", "Print the result as JSON and nothing else.")]
Wide = Annotated[bool, output("--wide", "", "Print all columns of the tables, wider than 80 characters.")]
Speed = Annotated[float | None, scenario("--speed", "KMH", "Speed in km/h.", positive("km/h"))]
Speeds = Annotated[
    Numbers | None, scenario("--speeds", "KMH,...", f"Speeds in km/h: {parsers.SPEEDS}.", parsers.speeds)
]
Wear = Annotated[float | None, scenario("--wear", "0..1", "Tread wear, 0 is new.", SHARE)]
Wears = Annotated[
    Numbers | None,
    scenario("--wear", "0..1,...", "Tread wear, 0 is new; one or several.", NumberList(SHARE, distinct=True)),
]
FRICTION_TEXT = "Friction coefficient of wheel and rail"
Friction = Annotated[float | None, scenario("--friction", "MU", f"{FRICTION_TEXT}.", FRICTION)]
Frictions = Annotated[
    Numbers | None,
<<<<<<< HEAD
    typer.Option(
        "--friction",
        parser=several(parse_friction, "--friction"),
        metavar="MU,...",
        rich_help_panel=SCENARIO,
        help="Friction coefficient of wheel and rail; one or several.",
    ),
]
Policies = Annotated[
    PolicyNames | None,
    typer.Option(
        "--policies",
        parser=parse_policies,
        metavar="A,B,...",
        help="Names ('sayd policies' lists all), constant:V, files of learned policies (.npz, .onnx, .zip) "
        "or of controllers (.yaml), or code of one's own: module:factory, file.py:factory.",
    ),
]
TrustPickles = Annotated[
    bool,
    typer.Option(
        "--trust-pickles",
        help="Load a policy that Stable-Baselines3 saved (.zip, PPO or SAC with MlpPolicy). Such a file can "
        "run any code on this machine while it is loaded.",
    ),
]
TrainedPeriod = Annotated[
    float | None,
    typer.Option(
        "--trained-period",
        parser=positive("--trained-period", "s", 1.0),
        metavar="S",
        help="With --trust-pickles: control period of its training (s), which the file does not say. "
        "Default: the environment's.",
    ),
]
VecNormalize = Annotated[
    Path | None,
    typer.Option(
        "--vec-normalize",
        metavar="FILE",
        help="With --trust-pickles: statistics of the VecNormalize behind which it has learned (.pkl), which "
        "can run any code, too.",
    ),
]
Reward = Annotated[
    str | None,
    typer.Option(
        "--reward",
        metavar="NAME",
        help="Weights of the cost J: mppt1 (acceleration alone) or mppt2 (the study's). "
        "Others by --set cost.force_weight=0.3.",
=======
    scenario(
        "--friction", "MU,...", f"{FRICTION_TEXT}; one or several.", NumberList(FRICTION, distinct=True)
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)
    ),
]
Environment = Annotated[
    str,
    scenario(
        "--environment",
        "NAME|FILE",
        "Sensors, control period, length of an episode, and what is drawn: nominal, randomized, faults or a YAML "
        "file.",
        complete=packaged("env"),
    ),
]
Reward = Annotated[
    str | None,
    scenario(
        "--reward",
        "NAME",
        "Weights of the cost J: mppt1 (acceleration alone) or mppt2 (the study's); others by --set "
        "cost.force_weight=0.3.",
        complete=lambda: ["mppt1", "mppt2"],
    ),
]
CreepLaws = Annotated[
    Names | None,
    option(
        "--creep-laws",
        "LAW,...",
        "Give critical speeds by these creep laws, too: table, polach, fastsim.",
        NameList("table,polach,fastsim"),
    ),
]
POLICIES = NameList("passive,mppt1,constant:0.3")
Policies = Annotated[
    Names | None,
    policy(
        "--policies",
        "A,B,...",
        "Names ('sayd policies' lists all), constant:V, or files of learned policies (.npz) or of controllers "
        "(.yaml).",
        POLICIES,
        complete=policy_names,
    ),
]


@dataclass(frozen=True)
class ScenarioOptions:
    """Options that choose vehicle, wheels, track and dampers."""

    profile: Annotated[
        str | None,
        scenario(
            "--profile",
            "NAME|FILE",
            "Wheel profile: new, worn, a name or a YAML file.",
            complete=packaged("profile", *WEAR_OF),
        ),
    ] = None
    track: Annotated[
        str | None,
        scenario("--track", "NAME|FILE", "Track: a name or a YAML file.", complete=packaged("track")),
    ] = None
    damper: Annotated[
        str | None,
        scenario(
            "--damper",
            "NAME|FILE",
            "Yaw dampers: passive, sayd or a YAML file. If --config has the kind, its numbers stay.",
            complete=packaged("damper"),
        ),
    ] = None
    config: Config = None
    assignments: Set = None

    def load(self, wear: float | None = None, friction: float | None = None) -> Scenario:
        """Read the configuration and apply the flags, then the assignments of ``--set``.

        ``--profile new`` and ``worn`` are the scenario's own wheels at wear 0 and 1, anything else is the
        name or path of a wheel profile, unworn unless `wear` says otherwise.

        Parameters
        ----------
        wear, friction : float, optional
            ``--wear`` (stronger than new and worn) and ``--friction``.

        Raises
        ------
        ConfigError
            A name, file or value that cannot be used.
        """
        from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - keeps --help fast

        if wear is None and self.profile is not None:
            wear = WEAR_OF.get(self.profile, 0.0)
        wheel = None if self.profile in WEAR_OF else self.profile
        damper = self.damper
        if damper is not None and load_scenario(self.config).damper.type == damper:
            damper = None  # the configuration's own, whose numbers may differ from the packaged ones
        flags = {"wheel": wheel, "wear": wear, "friction": friction, "track": self.track, "damper": damper}
        # JSON is YAML: quoting keeps a name like "1e3" or "no" a name.
        given = [f"{key}={json.dumps(value)}" for key, value in flags.items() if value is not None]
        return load_scenario(self.config, [*given, *(self.assignments or ())])


@dataclass(frozen=True)
class ForeignOptions:
    """Options for policies that Stable-Baselines3 saved."""

    trust_pickles: Annotated[
        bool,
        policy(
            "--trust-pickles",
            "",
            "Load a policy that Stable-Baselines3 saved (.zip, PPO or SAC with MlpPolicy). Such a file can run "
            "any code on this machine while it is loaded.",
        ),
    ] = False
    trained_period: Annotated[
        float | None,
        policy(
            "--trained-period",
            "S",
            "With --trust-pickles: control period of its training (s), which the file does not say. Default: the "
            "environment's.",
            positive("s", 1),
        ),
    ] = None

    def reader(self, environment: EnvironmentConfig) -> ForeignReader | None:
        """What reads such files, or None where they are not trusted."""
        from sayd_env.studies.learning import foreign_reader  # noqa: PLC0415 - keeps --help fast

        return foreign_reader(self.trust_pickles, environment, self.trained_period)
