"""Commands that look at the program itself: how fast it is, and whether it holds."""

from __future__ import annotations

from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from


def bench(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few and short measurements, for a trend; a minute or two.")
    ] = False,
    speed: Annotated[
        float,
        typer.Option(
            "--speed",
            parser=options.positive("--speed", "km/h"),
            metavar="KMH",
            help="Speed of the simulator's vehicles.",
        ),
    ] = "350",  # type: ignore[assignment] # the parser turns the text into a number
    profile: options.Profile = None,
    wear: options.Wear = None,
    friction: options.Friction = None,
    track: options.Track = None,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.NoSeed = 0,
    workers: options.Workers = None,
    executor: Annotated[
        str | None,
        typer.Option(
            "--executor",
            metavar="KIND",
            help="Measure runs per second there, too, beside threads and processes: ray, ray://ADDRESS, dask "
            "or dask://ADDRESS.",
        ),
    ] = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Measure simulator, environments and training here: speed, cost of a step by part, start-up, memory."""
    from sayd_env.studies.bench.bench import bench as study  # noqa: PLC0415 - keeps --help fast

    scenario = scenario_from(config, assignments, profile=profile, wear=wear, friction=friction, track=track)
    job = Job("bench", out, as_json)
    with job.progress() as progress:
        result = study(
            scenario,
            speed / 3.6,
            quick=quick,
            workers=workers,
            executors=() if executor is None else (executor,),
            progress=progress,
        )
    job.finish(result, config=scenario)


def soak(
    *,
    steps: Annotated[
        int,
        typer.Option(
            "--steps",
            parser=options.whole("--steps", 1, 10**9),
            metavar="N",
            help="Control steps of all vehicles together.",
        ),
    ] = 2_000_000,
    environment: Annotated[
        str,
        typer.Option(
            "--environment", metavar="NAME|FILE", help="nominal, randomized, faults or a YAML file."
        ),
    ] = "faults",
    environments: Annotated[
        int,
        typer.Option(
            "--environments",
            parser=options.whole("--environments", 1, 4096),
            metavar="N",
            help="Vehicles side by side.",
        ),
    ] = 64,
    seed: options.Seed = 0,
    assignments: options.Set = None,
    workers: options.Workers = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Run millions of random and extreme commands through the environments and check every number.

    Commands are random and held, random at each step, all valves open, all closed, and each valve from end to
    end. Counts episodes, how they ended, and observations, rewards and states that are not finite: any of
    those makes the exit status 1. The largest cost J of one second, twice, is the recommended charge for each
    second that a terminated episode did not run (termination_cost of the environment). What --set assigns
    is not drawn.
    """
    from sayd_env.config import StudyError  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.studies.soak import soak as study  # noqa: PLC0415

    laws = load_environment(environment)
    job = Job("soak", out, as_json)
    with job.progress() as progress:
        result = study(
            environment,
            steps,
            environments=environments,
            seed=seed,
            settings=assignments or (),
            workers=workers,
            progress=progress,
        )
    job.finish(result, config=laws, seed=seed)
    if result.failures:
        raise StudyError(f"the environment has defects: {result.failures}")
