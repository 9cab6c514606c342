"""Commands that compare, tune, draw and list policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sayd_env.cli import options, parsers
from sayd_env.cli.command import Plan, command, result_folder
from sayd_env.cli.learning import tune_training
from sayd_env.cli.options import argument, one_of, option, output, policy, runs, scenario
from sayd_env.cli.output import RESULTS, command_text
from sayd_env.cli.parsers import SPEED, ListOf, Names, name, positive
from sayd_env.config import ConfigError
from sayd_env.config.loader import assigned_keys
from sayd_env.config.storage import write_file
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from sayd_env.cli.output import Output
    from sayd_env.config.environment import EnvironmentConfig
    from sayd_env.config.scenario import Scenario
    from sayd_env.runs.context import RunContext
    from sayd_env.studies.evaluate import EvaluateResult
    from sayd_env.studies.line import LineResult
    from sayd_env.studies.tuning.tune import TuneResult

GROUP = "Policies"
Line = Annotated[
    str | None,
    scenario(
        "--line NAME|FILE",
        "A line along which conditions change: a name, a YAML file or a measured CSV file.",
        autocompletion=one_of(kind="line"),
    ),
]
SPEEDS = parsers.speeds("300,350,400")


@command(GROUP, "--policies passive,mppt1,mppt2 --profile worn --seeds 2", runs=True)
def evaluate(
    grid: options.GridOptions,
    foreign: options.ForeignOptions,
    *,
    policies: Names | None = options.policies(f"Names ({options.WHICH})."),
    line: Line = None,
    initial_current: float = policy(
        "--initial-current 0..1", "Valve command of the run-in, before they act.", options.SHARE, default=0.0
    ),
    seed: options.Seed = 0,
    seeds: options.Seeds = 10,
) -> Plan:
    """Compare policies at given speeds (default 300, 350, 400 km/h): cost, limits, forces, valves, comfort.

    All policies run through the environment, the passive vehicle too, on the same tracks: seed S is the same
    track for each. Without --policies, what the dampers do by themselves: passive ones (default), or with
    --damper sayd the constant current damper.current.

    J is minus the mean reward per second of an episode of the environment with this seed: the on-line filter,
    over the first 20 s behind the run-in (episode_s of --environment), weighted by --reward. A derailment is
    charged in it as the environment does. J_run is the same over the whole assessed 5 km, J_offline with the
    filter of the assessment. The weights do not change what the controllers mppt1 and mppt2 minimise.

    With --line, policies run over the whole of a line, and results are by section: J, the part of its
    force that the curve itself asks for, sliding RMS by EN 14363 on straight parts of 500 m and more, 2 m
    means of Y/Q, of the track shift force and of wheel unloading.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.measured.lines import line_content  # noqa: PLC0415
    from sayd_env.runs.policies import policy_specs  # noqa: PLC0415
    from sayd_env.studies import line as along  # noqa: PLC0415
    from sayd_env.studies.evaluate import evaluate as study  # noqa: PLC0415
    from sayd_env.studies.sweep import over_variants  # noqa: PLC0415

    setup = load_environment(grid.environment)
    specs = policy_specs(policies or (), foreign.reader(setup, policies))
    wear, friction = grid.wear or (), grid.friction or ()
    speeds: Sequence[float] = grid.speeds or SPEEDS
    where: dict[str, Any] = {}
    if line is not None:
        where = {"line": line_content(line)}
        grid.refuse_said(line)
        speeds = along.line_speeds(line, grid.speeds, SPEEDS)
    runs = seeds * max(1, len(specs)) * len(speeds) * max(1, len(wear)) * max(1, len(friction))
    variants, scenarios = grid.sweep(runs, default=setup.study)
    grid.refuse_idle_dampers(scenarios, specs, setup.study)
    options.say_notes(where)

    def one(chosen: Scenario, run: RunContext) -> EvaluateResult | LineResult:
        given: dict[str, Any] = {
            "policies": specs,
            "wear": wear,
            "friction": friction,
            "environment": setup,
            "initial_current": initial_current,
            "context": run,
        }
        seeded = range(seed, seed + seeds)
        if line is not None:
            return along.evaluate_line(chosen, line, speeds, seeded, **given)
        return study(chosen, speeds, seeded, **given)

    return Plan(
        lambda run: over_variants(variants, scenarios, runs, one, run),
        {**dict(scenarios[0]), "environment": setup, **where},
        seed,
        after=lambda _, output: options.say_same_tracks(output.say, scenarios, seeds, line),
    )


@command(GROUP, "--quick --policies passive,mppt2", name="map", runs=True, without=("reward",))
def map_(
    grid: options.GridOptions,
    foreign: options.ForeignOptions,
    *,
    policies: Names | None = options.policies(f"Names ({options.WHICH})."),
    conditions: str | None = scenario(
        "--conditions NAME|FILE",
        "Conditions for which the best constant command is looked for (default map).",
        autocompletion=one_of("map"),
    ),
    constants: bool = option(
        "--constants/--no-constants", "Look for the best constant commands, too.", default=True
    ),
    quick: options.Quick = False,
    seed: options.Seed = 0,
    seeds: options.QuickSeeds = None,
) -> Plan:
    """Map the critical speed over wear and friction, and the best constant command over more conditions.

    Defaults: the passive vehicle and the paper's four controllers, wear 0 to 1 in steps of 0.25, friction 0.2
    to 0.5, speeds 280:440:40 and the middle of the interval in which a limit is crossed, 2 track
    realisations. With --quick it is a coarse map from one, within a minute or two.

    The best constant commands are those of the lowest J on line (as in evaluate) for speeds, wheels, gauges,
    friction and track levels of configs/study/map.yaml, by several weights k_F of the force; beside them
    stands what one command for all conditions costs, one for each speed, a closed and an open valve, in the
    geometric mean of J over the best of each condition. Finished runs are kept in the output directory: an
    interrupted map goes on where it stopped.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.map import load_map  # noqa: PLC0415
    from sayd_env.runs.policies import policy_specs  # noqa: PLC0415
    from sayd_env.studies import map as study  # noqa: PLC0415

    if conditions and not constants:
        raise ConfigError("--conditions: are those of the best constant commands; leave out --no-constants")
    setup = load_environment(grid.environment)
    chosen = grid.load(setup.study)
    keys = assigned_keys(grid.assignments)
    for key in ("wear", "friction"):
        if key in keys:
            raise ConfigError(f"--set {key}: has no effect; --{key} is an axis of the map")
    if grid.profile in options.WEAR_OF:
        raise ConfigError(f"--profile {grid.profile}: has no effect; --wear is an axis of the map")
    given = {"wear": grid.wear, "friction": grid.friction, "speeds": grid.speeds}
    changes: dict[str, Any] = {key: tuple(values) for key, values in given.items() if values}
    where = replace(study.QUICK if quick else study.MapGrid(), **changes)
    found = load_map(conditions or "map") if constants else None
    found = found.shortened() if found is not None and quick else found
    specs = policy_specs(policies or study.POLICIES, foreign.reader(setup, policies))
    grid.refuse_idle_dampers([chosen], specs, setup.study)
    numbers = range(seed, seed + (seeds or (1 if quick else 2)))
    return Plan(
        lambda run: study.stability_map(
            chosen, specs, numbers, grid=where, constants=found, environment=setup, context=run
        ),
        {**dict(chosen), "environment": setup, "conditions": found},
        seed,
        after=lambda _, output: options.say_same_tracks(output.say, [chosen], len(numbers)),
    )


@command(GROUP, "--quick", runs=True)
def hindsight(
    foreign: options.ForeignOptions,
    *,
    policies: Names | None = options.policies(
        f"Who is compared ({options.WHICH}). Default: passive and the controllers of the configuration."
    ),
    config: str | None = scenario(
        "--config NAME|FILE", "Lines and commands: a YAML file. Default: configs/study/hindsight.yaml."
    ),
    assignments: options.Set = None,
    quick: options.Quick = False,
) -> Plan:
    """Find what adaptation is worth along lines: J beside that of the best command of each section.

    Constant commands run over packaged lines and lines that the environment line draws. The best one of each
    section, in hindsight, makes a schedule, which is run; the best single command of each line, the best one
    for all lines and controllers are compared with it, by the geometric mean of J over the schedule's.
    Finished runs are kept in the output directory: an interrupted study goes on where it stopped.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.hindsight import load_hindsight  # noqa: PLC0415
    from sayd_env.runs.policies import policy_specs  # noqa: PLC0415
    from sayd_env.studies.hindsight import hindsight as study  # noqa: PLC0415

    settings = load_hindsight("hindsight" if config is None else config, assignments or ())
    settings = settings.shortened() if quick else settings
    chosen = policies or settings.policies
    specs = policy_specs(chosen, foreign.reader(load_environment(settings.environment), chosen))
    return Plan(lambda run: study(settings, specs, context=run), settings, settings.seeds[0])


@command(GROUP, "--quick", runs=True)
def bound(
    foreign: options.ForeignOptions,
    *,
    policies: Names | None = options.policies(
        f"Who is compared beside mppt2 ({options.WHICH}). Default: the controllers of the configuration."
    ),
    config: str | None = scenario(
        "--config NAME|FILE", "Conditions and searches: a YAML file. Default: configs/study/bound.yaml."
    ),
    conditions: str | None = scenario(
        "--conditions FILE",
        "Conditions in place of the configuration's: a YAML file with the key conditions.",
    ),
    assignments: options.Set = None,
    quick: options.Quick = False,
    convergence: bool = option(
        "--convergence",
        "Search some conditions with other numbers of samples and horizons, too.",
        default=False,
    ),
) -> Plan:
    """Find what the best possible controller could reach, and how far policies are on the way to it.

    In each condition run the policies, the best constant command, found by a bounded search, the best command
    of each section of its line, and a search over command sequences on the true simulator with its future
    track: model-predictive control that cannot be built. It starts from the best of the others. The reference
    is the lowest J of all; the way to it is counted from MPPT2. Weights, conditions and the size of the
    search are those of the configuration; a condition of 20 s takes a minute or two. Finished conditions are
    kept in the output directory: an interrupted study goes on where it stopped.
    """
    from sayd_env.config.bound import load_bound, load_conditions  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.runs.policies import policy_specs  # noqa: PLC0415
    from sayd_env.studies.bound.bound import bound as study  # noqa: PLC0415

    settings = load_bound("bound" if config is None else config, assignments or ())
    settings = settings if conditions is None else settings.of(load_conditions(conditions))
    settings = settings.shortened() if quick else settings
    chosen = policies or settings.policies
    specs = policy_specs(chosen, foreign.reader(load_environment(settings.environment), chosen))
    return Plan(
        lambda run: study(settings, specs, convergence=convergence, context=run),
        settings,
        settings.conditions[0].seed,
    )


@command(GROUP, "--quick --policies mppt2,safe:mppt2", runs=True)
def robustness(
    foreign: options.ForeignOptions,
    *,
    policies: Names | None = options.policies(
        f"Who is tried ({options.WHICH}). Default: the controllers of the configuration."
    ),
    config: str | None = scenario(
        "--config NAME|FILE",
        "Conditions, disturbances and faults: a YAML file. Default: configs/study/robustness.yaml.",
    ),
    assignments: options.Set = None,
    quick: options.Quick = False,
) -> Plan:
    """Try policies beyond their training: noise, delay, slow valves, worn wheels, wet rails, loads, faults.

    One thing is changed at a time, and each single fault of the environment SAYD/Faults happens alone. J is
    compared with that of the passive vehicle and of the best constant command under the same disturbance, in
    the same conditions, and judged by what the configuration asks. Finished runs are kept in the output
    directory: an interrupted study goes on where it stopped.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.robustness import load_robustness  # noqa: PLC0415
    from sayd_env.runs.policies import policy_specs  # noqa: PLC0415
    from sayd_env.studies.robustness import robustness as study  # noqa: PLC0415

    settings = load_robustness("robustness" if config is None else config, assignments or ())
    settings = settings.shortened() if quick else settings
    chosen = policies or settings.policies
    specs = policy_specs(chosen, foreign.reader(load_environment(settings.environment), chosen))
    return Plan(lambda run: study(settings, specs, context=run), settings, settings.seeds[0])


def _held_out() -> list[str]:
    from sayd_env.config.comparison import HELD_OUT  # noqa: PLC0415 - keeps --help fast

    return [HELD_OUT]


@command(GROUP, "--quick --policies mppt1,own=a.npz+b.npz", runs=True)
def compare(
    foreign: options.ForeignOptions,
    *,
    policies: Names | None = options.policies(
        "Who takes part beside passive and mppt2: as for evaluate, ready policies by their algorithm, "
        "training seeds as NAME=FILE+FILE..., or a folder of policy files. Default: the paper's and tuned "
        "controllers and all ready policies."
    ),
    config: str | None = scenario(
        "--config NAME|FILE",
        "Conditions: a YAML file. Default: the held-out ones, which nothing was trained on.",
        autocompletion=_held_out,
    ),
    assignments: options.Set = None,
    quick: options.Quick = False,
    seed: int | None = runs(
        "--seed S", "Of the bootstrap; the seeds of the scenarios are the configuration's.", options.SEED
    ),
) -> Plan:
    """Compare policies on held-out conditions: J with intervals, limits, critical speed, training seeds.

    All policies meet the same scenarios: speeds, wear, friction, tracks and seeds of the configuration, the
    rest drawn from the seed; with --quick a few of the conditions, with one seed. J is that of evaluate, in
    MPPT2's weighting; it is judged off line and with other weights of the force, too. Intervals are
    bootstraps over training seeds and scenarios. The best constant command of each condition is the bound for
    slow policies. Finished runs are kept in the output directory: an interrupted comparison goes on where it
    stopped.
    """
    from sayd_env.config.comparison import HELD_OUT, load_comparison  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.studies.comparison.compare import compare as study  # noqa: PLC0415
    from sayd_env.studies.comparison.entrants import read_entrants  # noqa: PLC0415

    given = list(assignments or ()) + ([] if seed is None else [f"bootstrap.seed={seed}"])
    conditions = load_comparison(config or HELD_OUT, given)
    chosen = read_entrants(policies, foreign.reader(load_environment(), policies))
    return Plan(
        lambda run: study(conditions, chosen, quick=quick, context=run),
        lambda result: result.config,
        conditions.bootstrap.seed,
    )


@command(
    GROUP, "--policies passive,mppt1 --speed 400 -o ride.gif", without=("damper", "wide"), makes="picture"
)
def render(
    choice: options.VehicleOptions,
    foreign: options.ForeignOptions,
    *,
    who: Names | None = policy(
        "--policies --policy A,B,...",
        f"Who commands the valves, several side by side: names ({options.WHICH}). Default: mppt2.",
        ListOf(name),
        autocompletion=options.policy_names,
    ),
    speed: float | None = scenario("--speed KMH", "Speed. Default: the environment draws it.", SPEED),
    line: Line = None,
    environment: options.Environment = "nominal",
    seconds: float = option("--seconds S", "Length.", positive("s", 600), default=10.0),
    fps: float = option("--fps N", "Pictures per second.", positive("per second", 1000), default=25.0),
    exaggeration: float | None = option(
        "--exaggeration X",
        "How many times as large displacements are drawn (default 20).",
        positive(high=1000),
    ),
    seed: options.Seed = 0,
    file: Path | None = output(
        "-o --file FILE",
        "File of the pictures: .gif, .mp4 or .png (the last picture). Default: render.gif in --out.",
    ),
    out: options.Out = None,
) -> Plan:
    """Draw policies at work: the vehicle from above, its dampers and valves, sliding RMS values and limits.

    Shows episode 0 of the seed, as the environment with this seed runs it; the environment draws what the
    options leave open. Several policies, four at most, run the same episode and stand side by side, on axes
    that stay the same all through the video. Needs pygame, an .mp4 also imageio-ffmpeg: pip install
    'sayd-env[render]' or 'sayd-env[video]'.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.measured.lines import line_content  # noqa: PLC0415
    from sayd_env.runs.policies import policy_specs  # noqa: PLC0415
    from sayd_env.studies import render as study  # noqa: PLC0415
    from sayd_env.studies.line import line_speeds  # noqa: PLC0415

    setup = load_environment(environment)
    chosen = choice.load(setup.study)
    choice.refuse_said(line or setup.line)
    left = drawn_conditions(choice, setup)
    target = file or (out or RESULTS / "render") / "render.gif"
    specs = policy_specs(who or ("mppt2",), foreign.reader(setup, who))
    video = study.Video(specs, target, seconds, fps, exaggeration)
    metric = None if speed is None else speed / KMH
    if line is not None and metric is not None:
        line_speeds(line, [metric], [metric])
    fixed, content = ({}, {}) if line is None else ({"line": line}, {"line": line_content(line)})
    options.say_notes(content)
    return Plan(
        lambda run: study.render(
            video, chosen, left, seed=seed, speed=metric, fixed=fixed, progress=run.progress
        ),
        {**dict(chosen), "environment": setup, **content},
        seed,
    )


def drawn_conditions(choice: options.VehicleOptions, setup: EnvironmentConfig) -> EnvironmentConfig:
    """The environment, which draws nothing of what options set."""
    from sayd_env.config.environment import fixed_by  # noqa: PLC0415 - keeps --help fast

    # `--profile new` and `worn` are the study's own profile.
    flags = {"wear": choice.wear, "friction": choice.friction, "track": choice.track, "wheel": choice.profile}
    flags["track.gauge"] = choice.gauge
    keys = [key for key, value in flags.items() if value is not None] + (["wear"] if choice.profile else [])
    keys += assigned_keys(choice.assignments)
    fixed = fixed_by(keys)
    lines = None if setup.lines is None else setup.lines.without(fixed)
    drawn = setup.randomisation.without_keys(keys, setup.damper)
    return setup.model_copy(update={"randomisation": drawn, "lines": lines})


@command(GROUP, "--json")
def policies() -> Plan:
    """List the policies that come with the program: controllers, and ready learned ones with their origin."""
    from sayd_env.studies.policies import policies as study  # noqa: PLC0415 - keeps --help fast

    return Plan(lambda _: study())


@command(GROUP, "mppt2 --quick", runs=True, without=("wide",))
def tune(
    controller: Literal[
        "constant", "speed-schedule", "mppt2", "hunting-schedule", "lqg", "ppo", "sac"
    ] = argument(
        "CONTROLLER",
        "constant, speed-schedule, mppt2, hunting-schedule or lqg; or a training: ppo, sac.",
    ),
    *,
    config: options.PlanFile = None,
    assignments: options.Set = None,
    quick: options.Quick = False,
    seed: int = runs("--seed S", "Seed of the search; the scenarios have theirs.", options.SEED, default=0),
    file: Path | None = output(
        "-o --file FILE", "YAML file of the tuned parameters. Default: CONTROLLER-tuned.yaml in --out."
    ),
    out: Path | None = output(
        "--out DIR", options.out_text("tune-CONTROLLER", quick=True, apart=", but for ppo and sac")
    ),
    as_json: options.Json = False,
) -> Plan:
    """Find the gains of a controller, or the settings of a training, with the smallest J over scenarios.

    The list, the ranges and the budget are those of configs/study/tuning.yaml (--config, --set); J has the
    weights of MPPT2 (--set reward=low-force). constant: Brent's search, some three minutes; the others:
    differential evolution, then COBYQA, up to a quarter of an hour; --quick takes a few scenarios and
    evaluations.
    The simulated time is printed beside that of one PPO training.

    The result is a file of parameters that --policies takes like a name, for example
    results/tune-mppt2/mppt2-tuned.yaml; the packaged controllers with names in -tuned were found so.
    Evaluations are kept in the output directory: an interrupted tuning goes on where it stopped.

    ppo, sac: settings of the training, by Optuna over short trainings (configs/search/); hours. The result,
    results/tune-ppo/ppo-tuned.yaml, is what 'sayd train --config' takes.
    """
    if controller in ("ppo", "sac"):
        if file is not None:
            raise ConfigError("-o: is of controllers; a training's settings go to --out")
        return tune_training(controller, config, assignments or (), seed, out, quick=quick)
    from sayd_env.config.tuning import load_tuning  # noqa: PLC0415 - keeps --help fast
    from sayd_env.report.files import ResultDirectory  # noqa: PLC0415
    from sayd_env.studies.tuning import tune as study  # noqa: PLC0415

    settings = load_tuning("tuning" if config is None else config, assignments or ())
    settings = settings.shortened() if quick else settings
    if out is not None and out.suffix in (".yaml", ".yml"):
        raise ConfigError(f"--out {out}: expected a directory; the file of parameters is -o {out}")
    if file is not None and file.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"-o {file}: expected a file that ends in .yaml")
    folder = result_folder(f"tune-{controller}", {"out": out, "as_json": as_json, "quick": quick})
    target = file or (None if folder is None else folder / f"{controller}-tuned.yaml")
    if target is not None:
        study.refuse_packaged(target)
        # Cannot be written to? Say so before the work.
        ResultDirectory(target.parent, "--out" if file is None else "-o: folder")
    name, typed = config or "configs/study/tuning.yaml", command_text()

    def store(result: TuneResult, output: Output) -> None:
        if target is not None:
            write_file(target, result.control_file().encode())
            output.say(str(target))

    return Plan(
        lambda run: study.tune(controller, settings, name=name, seed=seed, command=typed, context=run),
        settings,
        seed,
        folder,
        store,
    )
