"""Commands that run the vehicle or look at a component of it, and those that judge a run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import argument, option
from sayd_env.cli.output import command_text
from sayd_env.cli.parsers import SPEED, ListOf, Names, Number, Numbers, name, positive
from sayd_env.config import ConfigError, StudyError
from sayd_env.config.limits import AXLE_LOAD, BOGIE_MASS
from sayd_env.config.loader import assigned_keys
from sayd_env.config.storage import write_file
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from sayd_env.cli.output import Output
    from sayd_env.config.scenario import Scenario
    from sayd_env.runs.context import RunContext
    from sayd_env.studies.paper.reproduce import ReproduceResult
    from sayd_env.studies.tuning.calibrate import CalibrationResult

GROUP = "Vehicle and paper"
COMPONENTS = "Components"
_KILONEWTONS = Number(1e-3 * AXLE_LOAD.low, 1e-3 * AXLE_LOAD.high, "kN")


@command(GROUP, "--profile worn --speeds 320:445:25 --seeds 2", runs=True)
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
    from sayd_env.runs.policies import for_policy, policy_spec  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies import critical_speed as study  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.sweep import over_variants  # noqa: PLC0415

    laws = creep_laws or ()
    study.check_laws(laws, "--creep-laws")
    spec, numbers = None if who is None else policy_spec(who), range(seed, seed + seeds)
    grid = speeds or max(map(study.default_speeds, (0.0, 1.0)), key=len)
    runs = seeds * len(grid) * (1 + len(laws))
    variants, scenarios = scenario.sweep(runs)
    scenario.refuse_idle_dampers(scenarios, [] if spec is None else [spec])

    def one(chosen: Scenario, run: RunContext) -> study.CriticalSpeedResult:
        return study.find_critical_speed(chosen, speeds, numbers, policy=spec, creep_laws=laws, context=run)

    first = scenarios[0] if spec is None else for_policy(scenarios[0], spec)
    return Plan(
        lambda run: over_variants(variants, scenarios, runs, one, run),
        {**dict(first), "policy": None if spec is None else spec.identity()},
        seed,
        after=lambda _, output: options.say_same_tracks(output.say, scenarios, seeds),
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
    from sayd_env.config.damper import load_sayd  # noqa: PLC0415 - keeps --help fast
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
    if "wear" in assigned_keys(scenario.assignments):
        raise ConfigError("--set wear: has no effect; the rows are about new and worn wheels, wear 0 and 1")
    count = seeds or (plan.quick_seeds if quick else len(plan.seeds))
    numbers = plan.first_seeds(count) if seed is None else tuple(range(seed, seed + count))
    damper, specs = load_sayd(sayd), row_policies(controllers or (), plan.fixed)

    def judge(result: ReproduceResult, output: Output) -> None:
        options.say_same_tracks(output.say, [chosen], count)
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
    config: options.PlanFile = None,
    assignments: options.Set = None,
    seed: options.Seed = 0,
) -> Plan:
    """Find what the paper leaves open from its statements, within sourced ranges.

    The passive vehicle first, then damper, valve and controllers. Takes one to two and a half hours;
    finished runs are kept in the output directory, so an interrupted calibration goes on where it stopped.
    The result is also a folder of parts, configs, as the packaged ones are. Files of one's own:
    --set semi_active_damper=own/sayd.yaml, --set controllers=[own/mppt1.yaml], and base for the vehicle.
    """
    from sayd_env.config.calibration import load_calibration  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.software import git_state  # noqa: PLC0415
    from sayd_env.studies.tuning.calibrate import calibrate as study  # noqa: PLC0415

    settings = load_calibration("calibration" if config is None else config, tuple(assignments or ()))
    typed = command_text()

    def store(result: CalibrationResult, output: Output) -> None:
        if output.directory is not None:
            for name, text in result.files(typed, git_state()[0] or "unknown").items():
                write_file(output.directory.path / "configs" / name, text.encode())

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
    """Compute the vehicle's modes over speed and the linear critical speed, at which it starts to hunt.

    Yaw dampers are at rest, semi-active ones held by friction; 'sayd linearise' has them in motion.
    """
    from sayd_env.studies.modes import modes as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load()
    return Plan(lambda run: study(chosen, speeds, amplitude * 1e-3, progress=run.progress), chosen)


@command(GROUP, "--speed 300 --damper sayd --current 0.3")
def linearise(
    scenario: options.VehicleOptions,
    *,
    speed: float = options.scenario("--speed KMH", "At which it runs.", SPEED, default=350.0),
    shift: float | None = option(
        "--shift MM",
        "RMS of the wheelsets' lateral shift; 0: the tangent. Default: 2.12, an amplitude of 3 mm.",
        Number(0, 100, "mm"),
    ),
    stroke_speed: float | None = option(
        "--stroke-speed MM/S",
        "RMS of the yaw dampers' stroke speed; 0: at rest, where friction holds. Default: 10.",
        Number(0, 2000, "mm/s"),
    ),
    current: float | None = option(
        "--current 0..1", "Acting current of semi-active dampers. Default: their own.", options.SHARE
    ),
    frequency: float | None = option(
        "--frequency HZ", "Of the motion. Default: the least damped hunting mode's.", positive("Hz", 100)
    ),
    delay_order: int | None = option(
        "--delay-order N",
        "One track under all wheelsets, delays in Pade approximation. Default: each has inputs of its own.",
        Number(1, 25, whole=True),
    ),
) -> Plan:
    """Give the vehicle as a state space at a stated amplitude, with passive or semi-active yaw dampers.

    Inputs are damper forces, irregularities and commands, outputs the sensors, named with units, in
    state_space.mat (MATLAB) and state_space.npz (NumPy); docs/linearise.md has the theory.
    """
    from sayd_env.studies import linearise as study  # noqa: PLC0415 - keeps --help fast

    chosen = scenario.load()
    scenario.refuse_idle_dampers([chosen])
    if stroke_speed is not None and not chosen.vehicle.yaw_damped:
        raise ConfigError(
            f"--stroke-speed: has no effect: vehicle '{chosen.vehicle.name}' has no yaw dampers"
        )

    def store(result: study.LineariseResult, output: Output) -> None:
        if output.directory is not None:
            written = output.directory.write(result.files())
            output.say(f"{output.directory.path}: {', '.join(path.name for path in written)}")

    return Plan(
        lambda run: study.linearise(
            chosen,
            speed / KMH,
            study.SHIFT if shift is None else shift * 1e-3,
            study.STROKE_SPEED if stroke_speed is None else stroke_speed * 1e-3,
            current=current,
            frequency=frequency,
            delay_order=delay_order,
            progress=run.progress,
        ),
        chosen,
        after=store,
    )


@command(GROUP, "ride.csv --speed 300 --bogie-mass 5600 --axle-load 150")
def assess(
    file: Path = argument("FILE", "Recording: text table (.csv, .txt), MDF, TDMS, MATLAB or Parquet."),
    *,
    bogie_mass: float | None = option(
        "--bogie-mass KG",
        "Mass of the bogie with its wheelsets: limit of accelerations.",
        Number(*BOGIE_MASS),
    ),
    axle_load: float | None = option(
        "--axle-load KN", "Static load of a wheelset: limit of track shift forces.", _KILONEWTONS
    ),
    speed: float | None = option("--speed KMH", "Speed, if no column gives it.", SPEED),
    sample_rate: float | None = option(
        "--sample-rate HZ", "Sampling rate in place of the times in the file.", positive("Hz")
    ),
    column: list[str] | None = option(
        "--column NAME", "Column to assess; repeatable. Default: every signal."
    ),
    run_in: float = option("--run-in M", "Distance left out at the start.", Number(0, 1e6, "m"), default=0.0),
    config: options.Config = None,
    assignments: options.Set = None,
) -> Plan:
    """Say whether a recorded run of a train meets the stability limits of EN 14363.

    Columns have names with units: time_s, speed_kmh or speed_m_s, NAME_m_s2 or NAME_g (lateral acceleration
    of the bogie frame above a wheelset), NAME_kn or NAME_n (track shift force of a wheelset); NAME [m/s2] and
    a row of units are read, too. The limits need --bogie-mass and --axle-load of the train, or --config with
    its vehicle.
    """
    from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.assess import Train, assess_file  # noqa: PLC0415

    keys = assigned_keys(assignments)
    _refuse_idle(keys)
    scenario = load_scenario(config, assignments or ())
    # The default vehicle is the paper's, and nobody's train.
    known = config is not None or any(key.startswith("vehicle") for key in keys)
    train = Train.of(
        bogie_mass=bogie_mass,
        axle_load=None if axle_load is None else axle_load * 1e3,
        scenario=scenario if known else None,
    )
    metric = None if speed is None else speed / KMH

    return Plan(
        lambda _: assess_file(
            file,
            scenario.assessment,
            train,
            speed=metric,
            sample_rate=sample_rate,
            columns=column,
            run_in=run_in,
        ),
        lambda result: result.settings,
    )


def _refuse_idle(keys: Iterable[str]) -> None:
    """Refuse settings that say nothing of a recording."""
    instead = {
        "assessment.run_in": "--run-in leaves out the start",
        "assessment.length": "all of a recording is assessed",
        "assessment.sample_rate": "--sample-rate stands above the times in the file",
    }
    for key in keys:
        if key in instead or key.partition(".")[0] not in ("vehicle", "assessment"):
            why = instead.get(key, "only vehicle and assessment are used")
            raise ConfigError(f"--set {key}: has no effect on a recording: {why}")


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
