"""Commands of one run: to drive it by hand, and to take it home, its signals as a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import option, output
from sayd_env.cli.output import RESULTS, command_text
from sayd_env.cli.parsers import SPEED, ListOf, Names, name, positive
from sayd_env.cli.policies import GROUP, Line, drawn_conditions
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from sayd_env.config.scenario import Scenario
    from sayd_env.runs.context import RunContext
    from sayd_env.studies.simulate import SimulateResult

MOST_FILES = 100
"""Of a sweep: each has tens of megabytes."""


@command(GROUP, "--speed 400 --profile worn", without=("damper", "out", "wide"))
def play(
    choice: options.VehicleOptions,
    *,
    speed: float | None = options.scenario("--speed KMH", "Speed. Default: the environment draws it.", SPEED),
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
    from sayd_env.studies.play import Cab  # noqa: PLC0415

    setup = load_environment(environment)
    chosen = choice.load(setup.study)
    choice.refuse_said(setup.line)
    left = drawn_conditions(choice, setup)
    fixed = {} if speed is None else {"speed_kmh": speed}
    return Plan(
        lambda _: Cab(chosen, left, seed, fixed).drive(),
        {**dict(chosen), "environment": setup},
        seed,
        stored=False,
    )


@command(GROUP, "--policy mppt2 --seconds 20 --signals Y,Q -o run.csv", makes="recording")
def simulate(
    choice: options.VehicleOptions,
    foreign: options.ForeignOptions,
    *,
    who: str | None = options.policy(
        "--policy NAME|FILE",
        f"Who commands the valves: a name ({options.WHICH}). Default: what the dampers do by themselves.",
        autocompletion=options.policy_names,
    ),
    speed: float | None = options.scenario("--speed KMH", "Speed (default 300).", SPEED),
    line: Line = None,
    environment: options.Environment = "nominal",
    initial_current: float = options.policy(
        "--initial-current 0..1", "Valve command of the run-in, before it acts.", options.SHARE, default=0.0
    ),
    seconds: float | None = option(
        "--seconds S",
        "Time behind the run-in. Default: the assessed 5 km, or the whole line.",
        positive("s", 1e5),
    ),
    signals: Names | None = option(
        "--signals A,B,...",
        "Quantities (Y,damper_force), signals, patterns (Y.front.*), or all. Default: the usual ones.",
        ListOf(name),
    ),
    run_in: bool = option("--run-in/--no-run-in", "Write the run-in, at negative times, too.", default=True),
    kind: Literal["csv", "parquet", "mat", "mf4"] | None = option(
        "--format KIND", "Of the file: csv, parquet, mat or mf4 (MDF 4). Default: by its ending, else csv."
    ),
    seed: options.Seed = 0,
    file: Path | None = output(
        "-o --file FILE", "File of the signals. Default: simulate.csv (or by --format) in --out."
    ),
    out: options.Out = None,
) -> Plan:
    """Write the time histories of one run: a file of all signals at 1 kHz, and a page that shows them.

    The run is that of evaluate with this seed: run-in and the assessed 5 km, with --line the whole of a line.
    At time 0 the policy begins to act. Names and units of all signals are in docs/simulate.md. Parquet and
    MDF need pip install 'sayd-env[measured]'.
    """
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.measured.lines import line_content  # noqa: PLC0415
    from sayd_env.report.files import ResultDirectory  # noqa: PLC0415
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415
    from sayd_env.studies import simulate as study  # noqa: PLC0415
    from sayd_env.studies.line import line_speeds  # noqa: PLC0415
    from sayd_env.studies.sweep import over_variants  # noqa: PLC0415

    target = study.chosen_target(file, kind, out or RESULTS / "simulate")
    # Cannot be written to? Say so before the work.
    ResultDirectory(target.file.parent, "--out" if file is None else "-o: folder")
    setup = load_environment(environment)
    variants, scenarios = choice.sweep(1, MOST_FILES, setup.study)
    reader = foreign.reader(setup, None if who is None else [who])
    spec = None if who is None else policy_spec(who, reader)
    choice.refuse_idle_dampers(scenarios, [] if spec is None else [spec], setup.study)
    metric = (300.0 if speed is None else speed) / KMH
    where = {} if line is None else {"line": line_content(line)}
    choice.refuse_said(line)
    if line is not None:
        (metric,) = line_speeds(line, None if speed is None else [metric], [metric])
    count = 0

    def one(chosen: Scenario, _: RunContext) -> SimulateResult:
        nonlocal count
        count += 1
        return study.simulate(
            chosen,
            target if len(variants) == 1 else target.numbered(count),
            policy=spec,
            speed=metric,
            line=line,
            seed=seed,
            seconds=seconds,
            signals=signals or (),
            run_in=run_in,
            environment=setup,
            initial_current=initial_current,
            about={"command": command_text()},
        )

    return Plan(
        lambda run: over_variants(variants, scenarios, 1, one, run),
        {**dict(scenarios[0]), "environment": setup, **where},
        seed,
    )
