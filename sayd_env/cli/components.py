"""Commands that look at one component: wheel and rail, a damper."""

from __future__ import annotations

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
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Compute the equivalent conicity of wheel and rail by EN 15302."""
    from sayd_env.studies.conicity import conicity as study  # noqa: PLC0415

    scenario = scenario_from(config, assignments, profile=profile, wear=wear, track=track)
    job = Job("conicity", out, as_json)
    job.finish(study(scenario), config=scenario)
