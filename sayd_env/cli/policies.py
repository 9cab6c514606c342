"""Commands that compare, draw and list policies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sayd_env.cli import options, parsers
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import option, output, policy, runs, scenario
from sayd_env.cli.output import RESULTS
from sayd_env.cli.parsers import Names, Numbers, positive
from sayd_env.config.errors import ConfigError
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sayd_env.config.scenario import Scenario
<<<<<<< HEAD
=======
    from sayd_env.studies.comparison.result import CompareResult
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)

GROUP = "Policies"
SPEEDS = parsers.speeds("300,350,400")


@command(GROUP, "--policies passive,mppt2,ppo --profile worn --seeds 2", runs=True)
def evaluate(
    choice: options.ScenarioOptions,
    foreign: options.ForeignOptions,
    *,
    policies: options.Policies = None,
    speeds: options.Speeds = None,
    wear: options.Wears = None,
    friction: options.Frictions = None,
    environment: options.Environment = "nominal",
    reward: options.Reward = None,
    initial_current: Annotated[
        float,
        policy(
            "--initial-current",
            "0..1",
            "Valve command of the run-in, before the policies act.",
            options.SHARE,
        ),
<<<<<<< HEAD
    ] = "0",  # type: ignore[assignment] # the parser turns the text into a number
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
=======
    ] = 0.0,
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)
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
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
<<<<<<< HEAD
    from sayd_env.runs.policies import foreign_reader, policy_specs  # noqa: PLC0415
    from sayd_env.studies.evaluate import evaluate as study  # noqa: PLC0415

    scenario = _scenario(config, assignments, profile, wear, friction, track, damper, reward)
    laws = load_environment(environment)
    specs = policy_specs(policies or (), foreign_reader(trust_pickles, laws, trained_period, vec_normalize))
    job = Job("evaluate", out, as_json)
    with job.runs(executor, workers) as context:
        result = study(
            scenario,
            _metres_per_second(speeds or (300.0, 350.0, 400.0)),
=======
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415
    from sayd_env.studies.evaluate import evaluate as study  # noqa: PLC0415

    chosen = _first(choice, wear, friction, reward)
    setup = load_environment(environment)
    reader = foreign.reader(setup)
    specs = [policy_spec(name, reader) for name in policies or ()]
    return Plan(
        lambda run: study(
            chosen,
            speeds or SPEEDS,
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)
            range(seed, seed + seeds),
            policies=specs,
            wear=wear or (),
            friction=friction or (),
            environment=setup,
            initial_current=initial_current,
            context=run,
        ),
        {**dict(chosen), "environment": setup},
        seed,
    )
<<<<<<< HEAD
    return scenario if reward is None else with_reward(scenario, reward)


def _metres_per_second(speeds: Iterable[float]) -> list[float]:
    return [v / KMH for v in speeds]
=======
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)


@command(GROUP, "--quick --policies passive,mppt2", name="map", runs=True)
def map_(
    choice: options.ScenarioOptions,
    *,
    policies: options.Policies = None,
    speeds: options.Speeds = None,
    condition_speeds: Annotated[
        Numbers | None,
        scenario(
            "--condition-speeds",
            "KMH,...",
            "Speeds for which the best constant current is looked for (default 300, 400 km/h).",
            parsers.speeds,
        ),
    ] = None,
    wear: options.Wears = None,
    friction: options.Frictions = None,
    environment: options.Environment = "nominal",
<<<<<<< HEAD
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
=======
    reward: options.Reward = None,
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)
    constants: Annotated[
        bool, option("--constants/--no-constants", "", "Look for the best constant currents, too.")
    ] = True,
    quick: options.Quick = False,
    seed: options.Seed = 0,
    seeds: options.Realisations = None,
) -> Plan:
    """Map the critical speed over wear and friction by policy, and the best constant current with its J.

    Defaults: the passive vehicle and the paper's four controllers, wear 0 to 1 in steps of 0.25, friction 0.2
    to 0.5, speeds 280:440:40 and the middle of the interval in which a limit is crossed, 2 track
    realisations. With --quick it is a coarse map from one, within a minute or two.

<<<<<<< HEAD
    from sayd_env.config import ConfigError  # noqa: PLC0415
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.runs.policies import foreign_reader, policy_specs  # noqa: PLC0415
    from sayd_env.studies.map import POLICIES, QUICK, MapGrid, stability_map  # noqa: PLC0415
=======
    The best constant current is that of the lowest J on line (as in evaluate) and off line, among a closed
    valve and currents beyond the throttle's overlap, the closer the less the valve is open, and halfway
    around the best one. Finished runs are kept in the output directory: an interrupted map goes on where it
    stopped.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415
    from sayd_env.studies import map as study  # noqa: PLC0415
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)

    if condition_speeds and not constants:
        raise ConfigError(
            "--condition-speeds: are those of the best constant currents; leave out --no-constants"
        )
    chosen = _first(choice, wear, friction, reward)
    given = {"wear": wear, "friction": friction, "speeds": speeds, "condition_speeds": condition_speeds}
    changes: dict[str, Any] = {key: tuple(values) for key, values in given.items() if values}
<<<<<<< HEAD
    grid = replace(QUICK if quick else MapGrid(), **changes)
    laws = load_environment(environment)
    foreign = foreign_reader(trust_pickles, laws, trained_period, vec_normalize)
    specs = policy_specs(policies or POLICIES, foreign)
    job = Job("map", out, as_json)
    count = seeds or (1 if quick else 2)
    with job.runs(executor, workers) as context:
        result = stability_map(
            scenario,
            specs,
            range(seed, seed + count),
            grid=grid,
            best_constant=constants,
            environment=laws,
            context=context,
        )
    job.finish(result, config={**dict(scenario), "environment": laws}, seed=seed)
=======
    grid = replace(study.QUICK if quick else study.MapGrid(), **changes)
    specs = [policy_spec(name) for name in policies or study.POLICIES]
    setup = load_environment(environment)
    numbers = range(seed, seed + (seeds or (1 if quick else 2)))
    return Plan(
        lambda run: study.stability_map(
            chosen, specs, numbers, grid=grid, best_constant=constants, environment=setup, context=run
        ),
        {**dict(chosen), "environment": setup},
        seed,
    )
>>>>>>> e8e33f5 (Give all commands one wrapper, which adds the common options and opens, computes and ends alike)


def _first(
    choice: options.ScenarioOptions,
    wear: Sequence[float] | None,
    friction: Sequence[float] | None,
    reward: str | None,
) -> Scenario:
    """Scenario of the first wear and friction of a list."""
    from sayd_env.studies.evaluate import with_reward  # noqa: PLC0415 - keeps --help fast

    chosen = choice.load(wear[0] if wear else None, friction[0] if friction else None)
    return chosen if reward is None else with_reward(chosen, reward)


@command(GROUP, "--quick --policies ppo,own=a.npz+b.npz", runs=True)
def compare(
    *,
    policies: Annotated[
        Names | None,
        policy(
            "--policies",
            "A,B,...",
            "Who takes part beside passive and mppt2: names as for evaluate, ready policies by their algorithm "
            "(ppo), training seeds as NAME=FILE+FILE..., or a folder of policy files. Default: the paper's and "
            "the tuned controllers and all ready policies.",
            options.POLICIES,
            complete=options.policy_names,
        ),
    ] = None,
    config: Annotated[
        str | None,
        scenario(
            "--config",
            "NAME|FILE",
            "Conditions: a YAML file. Default: the held-out ones, which nothing was trained on.",
            complete=lambda: ["heldout"],
        ),
    ] = None,
    assignments: options.Set = None,
    quick: options.Quick = False,
    seed: Annotated[
        int | None,
        runs(
            "--seed",
            "S",
            "Of the bootstrap; the seeds of the scenarios are the configuration's.",
            options.SEED,
        ),
    ] = None,
) -> Plan:
    """Compare policies on held-out conditions: J with intervals, limits, critical speed, training seeds.

    All policies meet the same scenarios: speeds, wear, friction, tracks and seeds of the configuration, the
    rest drawn from the seed; with --quick a few of the conditions, with one seed. J is that of evaluate, in
    MPPT2's weighting; it is judged off line and with other weights of the force, too. Intervals are
    bootstraps over training seeds and scenarios. The best constant current of each condition is the bound for
    slow policies. Finished runs are kept in the output directory: an interrupted comparison goes on where it
    stopped.
    """
    from sayd_env.config.comparison import HELD_OUT, load_comparison  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.comparison.compare import compare as study  # noqa: PLC0415
    from sayd_env.studies.comparison.entrants import contestants  # noqa: PLC0415

    given = list(assignments or ()) + ([] if seed is None else [f"bootstrap.seed={seed}"])
    conditions = load_comparison(config or HELD_OUT, given)
    chosen = contestants(policies)

    def used(result: CompareResult) -> object:
        return result.config

    return Plan(
        lambda run: study(conditions, chosen, quick=quick, context=run), used, conditions.bootstrap.seed
    )


@command(GROUP, "--policy ppo --speed 350 --seconds 5 -o ride.gif", without=("damper", "wide"))
def render(
    choice: options.ScenarioOptions,
    foreign: options.ForeignOptions,
    *,
    name: Annotated[
        str,
        policy(
            "--policy",
            "NAME|FILE",
            "Who commands the valves: a name ('sayd policies' lists all), constant:0.3, or a file.",
            complete=options.policy_names,
        ),
    ] = "mppt2",
    speed: options.Speed = None,
    wear: options.Wear = None,
    friction: options.Friction = None,
    environment: options.Environment = "nominal",
    seconds: Annotated[float, option("--seconds", "S", "Length.", positive("s", 600))] = 10.0,
    fps: Annotated[float, option("--fps", "N", "Pictures per second.", positive("per second", 1000))] = 25.0,
    exaggeration: Annotated[
        float | None,
        option(
            "--exaggeration",
            "X",
            "How many times as large displacements are drawn (default 20).",
            positive(high=1000),
        ),
    ] = None,
    seed: options.Seed = 0,
    file: Annotated[
        Path | None,
        output(
            "-o --file",
            "FILE",
            "File of the pictures: .gif, .mp4 or .png (the last picture). Default: render.gif in --out.",
        ),
    ] = None,
    out: options.Out = None,
) -> Plan:
    """Draw a policy at work: the vehicle from above, its dampers and valves, running values and limits.

    Shows episode 0 of the seed, as the environment with this seed runs it; the environment draws what the
    options leave open. Needs pygame, an .mp4 also imageio-ffmpeg: pip install 'sayd-env[render]' or
    'sayd-env[video]'.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415
    from sayd_env.studies import render as study  # noqa: PLC0415

    setup = load_environment(environment)
    config = setup.study if choice.config is None else choice.config
    chosen = replace(choice, config=config).load(wear, friction)
    keys = [item.partition("=")[0].strip() for item in choice.assignments or ()]
    fixed = {
        "wear": choice.profile is not None or wear is not None or "wear" in keys,
        "friction": friction is not None or "friction" in keys,
        "tracks": choice.track is not None or any(key.split(".")[0] == "track" for key in keys),
    }
    left = study.fixed_laws(setup, [key for key, is_fixed in fixed.items() if is_fixed])
    target = file or (out or RESULTS / "render") / "render.gif"
    spec = policy_spec(name, foreign.reader(setup))
    film = study.Film(spec, target, seconds, fps, exaggeration)
    metric = None if speed is None else speed / KMH
    return Plan(
        lambda run: study.render(film, chosen, left, seed=seed, speed=metric, progress=run.progress),
        {**dict(chosen), "environment": setup},
        seed,
    )


@command(GROUP, "--json")
def policies() -> Plan:
    """List the policies that come with the program: controllers, and ready learned ones with their origin."""
    from sayd_env.studies.policies import policies as study  # noqa: PLC0415 - keeps --help fast

    return Plan(lambda _: study())
