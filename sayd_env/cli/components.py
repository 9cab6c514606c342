"""Commands that look at one component: wheel and rail, a damper."""

from __future__ import annotations

from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from


def conicity(
    *,
    profile: options.Profile = None,
    wear: options.Wear = None,
    track: options.Track = None,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.NoSeed = 0,
    workers: options.NoWorkers = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Compute the equivalent conicity of wheel and rail by EN 15302."""
    from sayd_env.studies.components.conicity import conicity as study  # noqa: PLC0415

    scenario = scenario_from(config, assignments, profile=profile, wear=wear, track=track)
    job = Job("conicity", out, as_json)
    job.finish(study(scenario), config=scenario)


def hysteresis(
    *,
    damper: Annotated[
        options.Damper | None,
        typer.Option("--damper", rich_help_panel=options.SCENARIO, help="The yaw damper."),
    ] = None,
    amplitudes: Annotated[
        options.Numbers | None,
        typer.Option(
            "--amplitudes",
            parser=options.positive_list("--amplitudes", "mm", 1000.0),
            metavar="MM",
            help="Amplitudes in mm: 1,2,4.",
        ),
    ] = None,
    frequencies: Annotated[
        options.Numbers | None,
        typer.Option(
            "--frequencies",
            parser=options.positive_list("--frequencies", "Hz", 1000.0),
            metavar="HZ",
            help="Frequencies in Hz: 1,2,4,6,8,10.",
        ),
    ] = None,
    current: Annotated[
        options.Numbers | None,
        typer.Option(
            "--current",
            parser=options.share_list("--current"),
            metavar="0..1",
            help="Valve currents of a semi-active damper: 0,0.25,0.5,1.",
        ),
    ] = None,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.NoSeed = 0,
    workers: options.NoWorkers = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Move a yaw damper on a test rig: force over displacement at several amplitudes and frequencies."""
    from sayd_env.studies.components.hysteresis import AMPLITUDES, FREQUENCIES  # noqa: PLC0415
    from sayd_env.studies.components.hysteresis import hysteresis as study  # noqa: PLC0415

    chosen = [] if damper is None else [f"damper={damper.value}"]
    scenario = scenario_from(config, [*chosen, *(assignments or ())])
    job = Job("hysteresis", out, as_json)
    with job.progress() as progress:
        result = study(
            scenario,
            AMPLITUDES if amplitudes is None else [value * 1e-3 for value in amplitudes],
            FREQUENCIES if frequencies is None else frequencies,
            current,
            progress=progress,
        )
    job.finish(result, config=scenario)
