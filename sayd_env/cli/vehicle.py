"""Commands that run the vehicle or look at a component of it, and those that judge a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import argument, option
from sayd_env.cli.parsers import SPEED, ListOf, Names, Number, Numbers, name, positive
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from sayd_env.cli.output import Output
    from sayd_env.studies.paper.reproduce import ReproduceResult
    from sayd_env.studies.tuning.calibrate import CalibrationResult

GROUP = "Vehicle and paper"
COMPONENTS = "Components"


@command(GROUP, "--profile worn --speeds 320:445:25 --seeds 2", runs=True, without=("wide",))
def critical_speed(
    scenario: options.VehicleOptions,
    *,
    speeds: options.Speeds = None,
    who: str | None = options.policy(
        "--policy NAME|FILE",
        "What commands semi-active dampers: a controller, constant:V or a file. Default: their own command.",
    ),
    creep_laws: options.CreepLaws = None,
    seed: options.Seed = 0,
    seeds: options.Seeds = 10,
) -> Plan:
    """Find the critical speed by EN 14363: quantities over speed, and where they cross their limits.

    Default speeds: the paper's grid, 280 to 400 km/h on new and 320 to 445 km/h on worn wheels. With
    --policy, semi-active dampers replace passive ones.
    """
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies import critical_speed as study  # noqa: PLC0415 - keeps --help fast

    laws = creep_laws or ()
    study.check_laws(laws, "--creep-laws")
    chosen, spec = scenario.load(), None if who is None else policy_spec(who)
    numbers = range(seed, seed + seeds)
    return Plan(
        lambda run: study.find_critical_speed(
            chosen, speeds, numbers, policy=spec, creep_laws=laws, context=run
        ),
        lambda result: {**dict(result.scenario), "policy": None if spec is None else spec.identity()},
        seed,
    )


@command(GROUP, "--quick", runs=True, without=("profile", "rail", "gauge", "wear"))
def reproduce(
    scenario: options.VehicleOptions,
    *,
    sayd: str = option(
        "--sayd NAME|FILE",
        "Semi-active dampers of the rows on controllers; --damper has the passive ones.",
        rich_help_panel="Scenario",
        default="sayd",
    ),
    controllers: Names | None = option(
        "--controllers FILE,...", "Parameters of the rows' controllers: own/mppt1.yaml.", ListOf(name)
    ),
    assumptions: bool = option(
        "--assumptions",
        "Judge the rows under other creep laws and track irregularities, too: 3.5 times as long.",
        default=False,
    ),
    strict: bool = option("--strict", "Exit with status 1 if a row does not hold.", default=False),
    allow: Names | None = option("--allow ROW,...", "Rows that may fail with --strict: P2,M7.", ListOf(name)),
    control_periods: Numbers | None = option(
        "--control-periods S,...",
        "Judge rows S1 to S6 at these control periods (s), too: 0.002,0.005,0.01.",
        ListOf(positive("s", 1)),
    ),
    creep_laws: options.CreepLaws = None,
    quick: options.Quick = False,
    seed: int | None = options.runs(
        "--seed S", "First seed. Default: the seeds of configs/study/reproduce.yaml.", options.SEED
    ),
    seeds: options.QuickSeeds = None,
) -> Plan:
    """Measure what the paper shows, row by row: the passive vehicle, the controllers, all figures.

    Takes 20 track realisations, with --quick 2. Beside every row stands what fixed commands do in it, in the
    controller's place. --creep-laws gives the critical speeds of rows P2 and P5.
    """
    from sayd_env.config import ConfigError, StudyError  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.damper import load_sayd  # noqa: PLC0415
    from sayd_env.config.reproduction import load_reproduction  # noqa: PLC0415
    from sayd_env.studies.critical_speed import check_laws  # noqa: PLC0415
    from sayd_env.studies.paper.reproduce import ROWS, row_policies  # noqa: PLC0415
    from sayd_env.studies.paper.reproduce import reproduce as study  # noqa: PLC0415

    allowed, laws, periods = allow or (), creep_laws or (), control_periods or ()
    unknown = [row for row in allowed if row not in ROWS]
    if unknown:
        raise ConfigError(f"--allow {unknown[0]}: unknown row; expected {', '.join(ROWS)}")
    check_laws(laws, "--creep-laws")
    chosen, plan = scenario.load(), load_reproduction()
    count = seeds or (plan.quick_seeds if quick else len(plan.seeds))
    numbers = plan.first_seeds(count) if seed is None else tuple(range(seed, seed + count))
    damper, specs = load_sayd(sayd), row_policies(controllers or (), plan.fixed)

    def judge(result: ReproduceResult, _: Output) -> None:
        failed = [row for row in result.failed if row not in allowed]
        if strict and failed:
            raise StudyError(f"rows that do not hold: {', '.join(failed)}")

    return Plan(
        lambda run: study(
            chosen,
            numbers,
            study=plan,
            sayd=damper,
            policies=specs,
            control_periods=periods,
            creep_laws=laws,
            assumptions=assumptions,
            context=run,
        ),
        {
            **dict(chosen),
            "sayd": damper,
            "controllers": {name: spec.identity() for name, spec in specs.items()},
            "reproduction": plan,
        },
        numbers[0],
        after=judge,
    )


@command(GROUP, "--out results/calibrate", runs=True)
def calibrate(
    *,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: options.Seed = 0,
) -> Plan:
    """Find what the paper leaves open from its statements, within sourced ranges.

    The passive vehicle first, then damper, valve and controllers. Takes an hour or two; finished runs are
    kept in the output directory, so an interrupted calibration goes on where it stopped. The result is also
    a folder of parts, configs, as the packaged ones are.
    """
    from sayd_env.config.calibration import load_calibration  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.storage import write_file  # noqa: PLC0415
    from sayd_env.studies.tuning.calibrate import calibrate as study  # noqa: PLC0415

    settings = load_calibration("calibration" if config is None else config, tuple(assignments or ()))

    def store(result: CalibrationResult, output: Output) -> None:
        if output.directory is not None:
            for name, text in result.files().items():
                path = output.directory.path / "configs" / name
                path.parent.mkdir(parents=True, exist_ok=True)
                write_file(path, text.encode())

    return Plan(
        lambda run: study(settings, seed=seed, context=run),
        settings,
        seed,
        after=store,
    )


@command(GROUP, "--speeds 200:400:20 --wear 1", without=("damper",))
def modes(
    scenario: options.VehicleOptions,
    *,
    speeds: options.Speeds = None,
    amplitude: float = option(
        "--amplitude MM", "Lateral amplitude at which contact is linearised.", positive("mm"), default=3.0
    ),
) -> Plan:
    """Compute the vehicle's modes over speed and the linear critical speed, at which it starts to hunt."""
    from sayd_env.studies.modes import modes as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load()
    return Plan(lambda run: study(chosen, speeds, amplitude * 1e-3, progress=run.progress), chosen)


@command(GROUP, "ride.csv --speed 300")
def assess(
    file: Path = argument("FILE", "CSV file of the recording."),
    *,
    speed: float | None = option("--speed KMH", "Speed, if no column gives it.", SPEED),
    sample_rate: float | None = option("--sample-rate HZ", "If no column gives the time.", positive("Hz")),
    column: list[str] | None = option(
        "--column NAME", "Column to assess; repeatable. Default: every signal."
    ),
    run_in: float = option("--run-in M", "Distance left out at the start.", Number(0, 1e6, "m"), default=0.0),
    config: options.Config = None,
    assignments: options.Set = None,
) -> Plan:
    """Say whether a recorded run of a train meets the stability limits of EN 14363.

    The header of the file names columns with their units: time_s, speed_kmh or speed_m_s, NAME_m_s2 (lateral
    acceleration of the bogie frame above a wheelset), NAME_kn or NAME_n (track shift force of a wheelset).
    """
    from sayd_env.config.assessment import load_assessment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.assess import assess_file  # noqa: PLC0415

    settings = load_assessment("en14363" if config is None else config, assignments or ())
    metric = None if speed is None else speed / KMH

    return Plan(
        lambda _: assess_file(
            file, settings, speed=metric, sample_rate=sample_rate, columns=column, run_in=run_in
        ),
        lambda result: result.settings,
    )


@command(COMPONENTS, "--profile lmb10", without=("damper", "friction"))
def conicity(scenario: options.VehicleOptions) -> Plan:
    """Compute the equivalent conicity of wheel and rail by EN 15302."""
    from sayd_env.studies.components.conicity import conicity as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load()
    return Plan(lambda _: study(chosen), chosen)


@command(
    COMPONENTS,
    "--damper sayd --current 0,0.5,1 --amplitudes 2",
    without=("profile", "rail", "gauge", "track", "wear", "friction"),
)
def hysteresis(
    scenario: options.VehicleOptions,
    *,
    amplitudes: Numbers | None = option(
        "--amplitudes MM,...", "Amplitudes in mm: 1,2,4.", ListOf(positive("mm", 1000))
    ),
    frequencies: Numbers | None = option(
        "--frequencies HZ,...", "Frequencies in Hz: 1,2,4,6,8,10.", ListOf(positive("Hz", 1000))
    ),
    current: Numbers | None = option(
        "--current 0..1,...", "Valve currents of a semi-active damper: 0,0.25,0.5,1.", ListOf(options.SHARE)
    ),
) -> Plan:
    """Move a yaw damper on a test rig: force over displacement at several amplitudes and frequencies."""
    from sayd_env.studies.components import hysteresis as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load()
    metres = study.AMPLITUDES if amplitudes is None else [value * 1e-3 for value in amplitudes]
    hertz = frequencies or study.FREQUENCIES
    return Plan(lambda run: study.hysteresis(chosen, metres, hertz, current, progress=run.progress), chosen)
