"""Commands that look at the program itself."""

from __future__ import annotations

from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from


def bench(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few and short measurements, for a trend; about a minute.")
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
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Measure simulator and environments here: speed, cost of a step by part, start-up and memory."""
    from sayd_env.studies.bench import bench as study  # noqa: PLC0415 - keeps --help fast

    scenario = scenario_from(config, assignments, profile=profile, wear=wear, friction=friction, track=track)
    job = Job("bench", out, as_json)
    with job.progress() as progress:
        result = study(scenario, speed / 3.6, quick=quick, workers=workers, progress=progress)
    job.finish(result, config=scenario)
