"""Commands that draw the vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job
from sayd_env.cli.scenario import scenario_from

KMH = 3.6


def render(
    *,
    policy: Annotated[
        str,
        typer.Option(
            "--policy",
            metavar="NAME|FILE",
            help="Who commands the valves: a name ('sayd policies' lists all), constant:0.3, a file, or "
            "code of one's own: module:factory, file.py:factory.",
        ),
    ] = "mppt2",
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            parser=options.positive("--speed", "km/h"),
            metavar="KMH",
            rich_help_panel=options.SCENARIO,
            help="Speed; default: the environment's.",
        ),
    ] = None,
    profile: options.Profile = None,
    wear: options.Wear = None,
    friction: options.Friction = None,
    track: options.Track = None,
    environment: Annotated[
        str,
        typer.Option(
            "--environment",
            metavar="NAME|FILE",
            rich_help_panel=options.SCENARIO,
            help="nominal, randomized, faults or a YAML file: draws what the flags leave open.",
        ),
    ] = "nominal",
    seconds: Annotated[
        float,
        typer.Option(
            "--seconds", parser=options.positive("--seconds", "s", 600.0), metavar="S", help="Length."
        ),
    ] = "10",  # type: ignore[assignment] # the parser turns the text into a number
    fps: Annotated[
        float,
        typer.Option(
            "--fps",
            parser=options.positive("--fps", "per second", 1000.0),
            metavar="N",
            help="Pictures per second.",
        ),
    ] = "25",  # type: ignore[assignment]
    exaggeration: Annotated[
        float | None,
        typer.Option(
            "--exaggeration",
            parser=options.positive("--exaggeration", "", 1000.0),
            metavar="X",
            help="How many times as large displacements are drawn (default 20).",
        ),
    ] = None,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.Seed = 0,
    workers: options.NoWorkers = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--file",
            metavar="FILE",
            rich_help_panel=options.OUTPUT,
            help="File of the pictures: .gif, .mp4 or .png (the last picture). Default: render.gif in --out.",
        ),
    ] = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Draw a policy at work: the vehicle from above, its dampers and valves, running values and limits.

    Shows episode 0 of the seed, as the environment with this seed runs it. Needs pygame, an .mp4 also
    imageio-ffmpeg: pip install 'sayd-env[render]' or 'sayd-env[video]'.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.policies import foreign_reader, policy_spec  # noqa: PLC0415
    from sayd_env.studies.render import Film, fixed_laws  # noqa: PLC0415
    from sayd_env.studies.render import render as study  # noqa: PLC0415

    laws = load_environment(environment)
    study_name = laws.study if config is None else config
    scenario = scenario_from(
        study_name, assignments, profile=profile, wear=wear, friction=friction, track=track
    )
    given = [item.partition("=")[0].strip() for item in assignments or ()]
    fixed = {
        "wear": profile is not None or wear is not None or "wear" in given,
        "friction": friction is not None or "friction" in given,
        "tracks": track is not None or any(key.split(".")[0] == "track" for key in given),
    }
    target = file or (out or Path("results") / "render") / "render.gif"
    spec = policy_spec(policy, foreign_reader(trust_pickles, laws, trained_period, vec_normalize))
    film = Film(spec, target, seconds, fps, exaggeration)
    job = Job("render", out, as_json)
    with job.progress() as progress:
        result = study(
            film,
            scenario,
            fixed_laws(laws, [name for name, is_fixed in fixed.items() if is_fixed]),
            seed=seed,
            speed=None if speed is None else speed / KMH,
            progress=progress,
        )
    job.finish(result, config={**dict(scenario), "environment": laws}, seed=seed)
