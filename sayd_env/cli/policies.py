"""Commands that compare policies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from sayd_env.config.scenario import Scenario

KMH = 3.6


def evaluate(
    *,
    policies: options.Policies = None,
    speeds: options.SpeedList = None,
    profile: options.Profile = None,
    wear: options.Wears = None,
    friction: options.Frictions = None,
    track: options.Track = None,
    damper: options.DamperKind = None,
    reward: options.Reward = None,
    environment: options.Environment = "nominal",
    initial_current: Annotated[
        float,
        typer.Option(
            "--initial-current",
            parser=options.share("--initial-current"),
            metavar="0..1",
            help="Valve command of the run-in, before the policies act.",
        ),
    ] = "0",  # type: ignore[assignment] # the parser turns the text into a number
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
    seed: options.Seed = 0,
    seeds: options.Seeds = 10,
    config: options.Config = None,
    assignments: options.Set = None,
    workers: options.Workers = None,
    executor: options.Executor = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
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
            range(seed, seed + seeds),
            policies=specs,
            wear=wear or (),
            friction=friction or (),
            environment=laws,
            initial_current=initial_current,
            context=context,
        )
    job.finish(result, config={**dict(scenario), "environment": laws}, seed=seed)


def _scenario(
    config: str | None,
    assignments: list[str] | None,
    profile: str | None,
    wear: Sequence[float] | None,
    friction: Sequence[float] | None,
    track: str | None,
    damper: str | None,
    reward: str | None,
) -> Scenario:
    """Scenario of the first wear and friction of a list."""
    from sayd_env.studies.evaluate import with_reward  # noqa: PLC0415 - keeps --help fast

    scenario = scenario_from(
        config,
        assignments,
        profile=profile,
        wear=None if wear is None else wear[0],
        friction=None if friction is None else friction[0],
        track=track,
        damper=damper,
    )
    return scenario if reward is None else with_reward(scenario, reward)


def _metres_per_second(speeds: Iterable[float]) -> list[float]:
    return [v / KMH for v in speeds]


def map_(
    *,
    policies: options.Policies = None,
    speeds: options.SpeedList = None,
    condition_speeds: Annotated[
        options.Speeds | None,
        typer.Option(
            "--condition-speeds",
            parser=options.speed_list("--condition-speeds"),
            metavar="KMH",
            help="Speeds for which the best constant current is looked for (default 300, 400 km/h).",
        ),
    ] = None,
    profile: options.Profile = None,
    wear: options.Wears = None,
    friction: options.Frictions = None,
    track: options.Track = None,
    damper: options.DamperKind = None,
    reward: options.Reward = None,
    environment: options.Environment = "nominal",
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
    constants: Annotated[
        bool, typer.Option("--constants/--no-constants", help="Look for the best constant currents, too.")
    ] = True,
    quick: Annotated[
        bool, typer.Option("--quick", help="A coarse map from one seed, within a minute or two.")
    ] = False,
    seed: options.Seed = 0,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds",
            parser=options.whole("--seeds", 1, options.MAX_SEEDS),
            metavar="N",
            help="Number of track realisations: seeds S to S+N-1 (default 2, with --quick 1).",
        ),
    ] = None,
    config: options.Config = None,
    assignments: options.Set = None,
    workers: options.Workers = None,
    executor: options.Executor = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Map the critical speed over wear and friction by policy, and the best constant current with its J.

    Defaults: the passive vehicle and the paper's four controllers, wear 0 to 1 in steps of 0.25, friction 0.2
    to 0.5, speeds 280:440:40 and the middle of the interval in which a limit is crossed. The best constant
    current is that of the lowest J on line (as in evaluate) and off line, among a closed valve and currents
    beyond the throttle's overlap, the closer the less the valve is open, and halfway around the best one.
    Finished runs are kept in the output directory: an interrupted map goes on where it stopped.
    """
    from dataclasses import replace  # noqa: PLC0415 - keeps --help fast

    from sayd_env.config import ConfigError  # noqa: PLC0415
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.runs.policies import foreign_reader, policy_specs  # noqa: PLC0415
    from sayd_env.studies.map import POLICIES, QUICK, MapGrid, stability_map  # noqa: PLC0415

    if condition_speeds and not constants:
        raise ConfigError(
            "--condition-speeds: are those of the best constant currents; leave out --no-constants"
        )
    scenario = _scenario(config, assignments, profile, wear, friction, track, damper, reward)
    given: dict[str, Any] = {
        "wear": wear,
        "friction": friction,
        "speeds": speeds and _metres_per_second(speeds),
        "condition_speeds": condition_speeds and _metres_per_second(condition_speeds),
    }
    changes: dict[str, Any] = {key: tuple(values) for key, values in given.items() if values}
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


def policies(*, out: options.Out = None, as_json: options.Json = False) -> None:
    """List the policies that come with the program: controllers, and ready learned ones with their origin."""
    from sayd_env.studies.policies import policies as study  # noqa: PLC0415 - keeps --help fast

    job = Job("policies", out, as_json)
    job.finish(study())
