"""Commands that run the vehicle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from

if TYPE_CHECKING:
    from collections.abc import Sequence

KMH = 3.6


def critical_speed(
    *,
    speeds: options.SpeedList = None,
    profile: options.Profile = None,
    wear: options.Wear = None,
    friction: options.Friction = None,
    track: options.Track = None,
    damper: options.DamperKind = None,
    seed: options.Seed = 0,
    seeds: options.Seeds = 10,
    creep_laws: Annotated[
        options.Names | None,
        typer.Option(
            "--creep-laws",
            parser=options.names("--creep-laws", "table,polach,fastsim"),
            metavar="LAWS",
            help="Give the critical speed by these creep laws, too, for example table,polach.",
        ),
    ] = None,
    config: options.Config = None,
    assignments: options.Set = None,
    workers: options.Workers = None,
    executor: options.Executor = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Find the critical speed by EN 14363: quantities over speed, and where they cross their limits.

    Default speeds: the paper's grid, 280 to 400 km/h on new and 320 to 445 km/h on worn wheels.
    """
    from sayd_env.studies.critical_speed import check_laws, find_critical_speed  # noqa: PLC0415

    check_laws(creep_laws or (), "--creep-laws")
    scenario = scenario_from(
        config, assignments, profile=profile, wear=wear, friction=friction, track=track, damper=damper
    )
    job = Job("critical-speed", out, as_json)
    with job.runs(executor, workers) as context:
        result = find_critical_speed(
            scenario,
            _metres_per_second(speeds),
            range(seed, seed + seeds),
            creep_laws=creep_laws or (),
            context=context,
        )
    job.finish(result, config=scenario, seed=seed)


def _metres_per_second(speeds: Sequence[float] | None) -> list[float] | None:
    return None if speeds is None else [v / KMH for v in speeds]


def calibrate(
    *,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.Seed = 0,
    workers: options.Workers = None,
    executor: options.Executor = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Find what the paper leaves open from its statements on the passive vehicle, within sourced ranges.

    Takes about a quarter of an hour. Finished runs are kept in the output directory, so an
    interrupted calibration goes on where it stopped; the result is also a study file, nominal.yaml.
    """
    from sayd_env.config.calibration import load_calibration  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.tuning.calibrate import calibrate as study  # noqa: PLC0415

    settings = load_calibration("calibration" if config is None else config, tuple(assignments or ()))
    job = Job("calibrate", out, as_json)
    with job.runs(executor, workers) as context:
        result = study(settings, seed=seed, context=context)
    job.finish(result, config=settings, seed=seed)
    if job.directory is not None:
        job.directory.write({"nominal.yaml": result.study().encode()})


def reproduce(
    *,
    friction: options.Friction = None,
    track: options.Track = None,
    seed: options.Seed = 0,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds",
            parser=options.whole("--seeds", 1, options.MAX_SEEDS),
            metavar="N",
            help="Number of track realisations: seeds S to S+N-1 (default 10, with --quick 2).",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Two seeds: a look, not a verdict.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with status 1 if a row does not hold.")
    ] = False,
    allow: Annotated[
        options.Names | None,
        typer.Option(
            "--allow",
            parser=options.names("--allow", "P2,M7"),
            metavar="ROWS",
            help="Rows that may fail with --strict, for example P2,M7.",
        ),
    ] = None,
    control_periods: Annotated[
        options.Numbers | None,
        typer.Option(
            "--control-periods",
            parser=options.positive_list("--control-periods", "s", 1.0),
            metavar="S",
            help="Judge rows S1 to S6 at these control periods (s), too, for example 0.002,0.005,0.01.",
        ),
    ] = None,
    creep_laws: Annotated[
        options.Names | None,
        typer.Option(
            "--creep-laws",
            parser=options.names("--creep-laws", "table,polach,fastsim"),
            metavar="LAWS",
            help="Give the critical speeds of rows P2 and P5 by these creep laws, too.",
        ),
    ] = None,
    config: options.Config = None,
    assignments: options.Set = None,
    workers: options.Workers = None,
    executor: options.Executor = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Measure what the paper shows, row by row: the passive vehicle, the controllers, all figures."""
    from sayd_env.config import ConfigError, StudyError  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.critical_speed import check_laws  # noqa: PLC0415
    from sayd_env.studies.paper.reproduce import ROWS  # noqa: PLC0415
    from sayd_env.studies.paper.reproduce import reproduce as study  # noqa: PLC0415

    unknown = [row for row in allow or () if row not in ROWS]
    if unknown:
        raise ConfigError(f"--allow {unknown[0]}: unknown row; expected {', '.join(ROWS)}")
    check_laws(creep_laws or (), "--creep-laws")
    scenario = scenario_from(config, assignments, friction=friction, track=track)
    job = Job("reproduce", out, as_json)
    with job.runs(executor, workers) as context:
        chosen = range(seed, seed + (seeds or (2 if quick else 10)))
        result = study(
            scenario,
            chosen,
            control_periods=control_periods or (),
            creep_laws=creep_laws or (),
            context=context,
        )
    job.finish(result, config=scenario, seed=seed)
    failed = [row for row in result.failed if row not in (allow or ())]
    if strict and failed:
        raise StudyError(f"rows that do not hold: {', '.join(failed)}")
