"""Commands that look at one component: wheel and rail, a damper."""

from __future__ import annotations

from typing import Annotated

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import option
from sayd_env.cli.parsers import NumberList, Numbers, positive

GROUP = "Components"


@command(GROUP, "--profile lmb10", without=("damper",))
def conicity(scenario: options.ScenarioOptions, *, wear: options.Wear = None) -> Plan:
    """Compute the equivalent conicity of wheel and rail by EN 15302."""
    from sayd_env.studies.components.conicity import conicity as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load(wear)
    return Plan(lambda _: study(chosen), chosen)


@command(GROUP, "--damper sayd --current 0,0.5,1 --amplitudes 2", without=("profile", "track"))
def hysteresis(
    scenario: options.ScenarioOptions,
    *,
    amplitudes: Annotated[
        Numbers | None,
        option("--amplitudes", "MM,...", "Amplitudes in mm: 1,2,4.", NumberList(positive("mm", 1000))),
    ] = None,
    frequencies: Annotated[
        Numbers | None,
        option(
            "--frequencies", "HZ,...", "Frequencies in Hz: 1,2,4,6,8,10.", NumberList(positive("Hz", 1000))
        ),
    ] = None,
    current: Annotated[
        Numbers | None,
        option(
            "--current",
            "0..1,...",
            "Valve currents of a semi-active damper: 0,0.25,0.5,1.",
            NumberList(options.SHARE),
        ),
    ] = None,
) -> Plan:
    """Move a yaw damper on a test rig: force over displacement at several amplitudes and frequencies."""
    from sayd_env.studies.components import hysteresis as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load()
    metres = study.AMPLITUDES if amplitudes is None else [value * 1e-3 for value in amplitudes]
    hertz = frequencies or study.FREQUENCIES
    return Plan(lambda run: study.hysteresis(chosen, metres, hertz, current, progress=run.progress), chosen)
