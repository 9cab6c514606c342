"""Commands that judge running stability."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from


def assess(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV file of the recording.")],
    *,
    speed: Annotated[
        float | None,
        typer.Option(
            parser=options.positive("--speed", "km/h"), metavar="KMH", help="Speed, if no column gives it."
        ),
    ] = None,
    sample_rate: Annotated[
        float | None,
        typer.Option(
            parser=options.positive("--sample-rate", "Hz"), metavar="HZ", help="If no column gives the time."
        ),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Column to assess; repeatable. Default: every signal."),
    ] = None,
    run_in: Annotated[float, typer.Option(metavar="M", help="Distance left out at the start.")] = 0.0,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.NoSeed = 0,
    workers: options.NoWorkers = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Say whether a recorded run of a train meets the stability limits of EN 14363.

    The header of the file names columns with their units: time_s, speed_kmh or speed_m_s, NAME_m_s2 (lateral
    acceleration of the bogie frame above a wheelset), NAME_kn or NAME_n (track shift force of a wheelset).
    """
    from sayd_env.config.assessment import load_assessment  # noqa: PLC0415
    from sayd_env.studies.assess import assess_file  # noqa: PLC0415

    settings = load_assessment("en14363" if config is None else config, assignments or ())
    job = Job("assess", out, as_json)
    result = assess_file(
        file,
        settings,
        speed=None if speed is None else speed / 3.6,
        sample_rate=sample_rate,
        columns=column,
        run_in=run_in,
    )
    job.finish(result, config=result.settings)


def modes(
    *,
    speeds: options.SpeedList = None,
    amplitude: Annotated[
        float,
        typer.Option(
            "--amplitude",
            parser=options.positive("--amplitude", "mm"),
            metavar="MM",
            help="Lateral amplitude at which wheel-rail contact is linearised.",
        ),
    ] = "3",  # type: ignore[assignment] # the parser turns the text into a number
    profile: options.Profile = None,
    wear: options.Wear = None,
    friction: options.Friction = None,
    track: options.Track = None,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.NoSeed = 0,
    workers: options.NoWorkers = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Compute the vehicle's modes over speed and the linear critical speed, at which it starts to hunt."""
    from sayd_env.studies.modes import modes as study  # noqa: PLC0415

    scenario = scenario_from(config, assignments, profile=profile, wear=wear, friction=friction, track=track)
    job = Job("modes", out, as_json)
    with job.progress() as progress:
        result = study(
            scenario,
            None if speeds is None else [speed / 3.6 for speed in speeds],
            amplitude * 1e-3,
            progress=progress,
        )
    job.finish(result, config=scenario)
