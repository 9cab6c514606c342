"""The command that lets a hand drive."""

from __future__ import annotations

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import scenario
from sayd_env.cli.parsers import SPEED
from sayd_env.cli.policies import GROUP, drawn_conditions


@command(GROUP, "--speed 400 --profile worn", without=("damper", "out", "wide"))
def play(
    choice: options.VehicleOptions,
    *,
    speed: float | None = scenario("--speed KMH", "Speed. Default: the environment draws it.", SPEED),
    environment: options.Environment = "nominal",
    seed: options.Seed = 0,
) -> Plan:
    """Drive by hand: a window in real time, with sliding RMS of acceleration and force against their limits.

    Keys: up and down move the command of all valves, at once. Left and right change the speed by 10 km/h,
    W the wear, T the track: for these the train begins anew, its valves as they stand. Space pauses, R begins
    again, Q quits. At the end come the runs and their J. Needs pygame and a screen: pip install
    'sayd-env[render]'.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.play import play as study  # noqa: PLC0415

    setup = load_environment(environment)
    chosen = choice.load(setup.study)
    choice.refuse_said(setup.line)
    left = drawn_conditions(choice, setup)
    fixed = {} if speed is None else {"speed_kmh": speed}
    return Plan(
        lambda _: study(chosen, left, seed=seed, options=fixed),
        {**dict(chosen), "environment": setup},
        seed,
        stored=False,
    )
