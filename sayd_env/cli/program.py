"""Commands of the program itself: how fast it is, whether it holds, and how something of one's own begins."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import argument, option, scenario
from sayd_env.cli.parsers import SPEED, Number
from sayd_env.config import StudyError
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from sayd_env.cli.output import Output
    from sayd_env.studies.soak import SoakResult

GROUP = "Program"


@command(GROUP, "--quick", without=("damper",))
def bench(
    choice: options.VehicleOptions,
    *,
    speed: float = scenario("--speed KMH", "Of the simulator's vehicles.", SPEED, default=350.0),
    quick: options.Quick = False,
    workers: options.Threads = None,
    executor: str | None = option(
        "--executor KIND", "Measure runs per second there, too: ray, ray://ADDRESS, dask or dask://ADDRESS."
    ),
) -> Plan:
    """Measure simulator, environments and training here: speed, cost of a step by part, start-up, memory.

    --quick makes few and short measurements, for a trend; a minute or two.
    """
    from sayd_env.studies.bench.bench import bench as study  # noqa: PLC0415 - keeps --help fast

    chosen = choice.load()
    others = () if executor is None else (executor,)
    return Plan(
        lambda run: study(
            chosen, speed / KMH, quick=quick, workers=workers, executors=others, progress=run.progress
        ),
        chosen,
    )


@command(GROUP, "--environment faults --steps 100000")
def soak(
    *,
    steps: int = option(
        "--steps N",
        "Control steps of all vehicles together.",
        Number(1, 10**9, whole=True),
        default=2_000_000,
    ),
    environment: options.Environment = "faults",
    environments: int = option(
        "--environments N", "Vehicles side by side.", Number(1, 4096, whole=True), default=64
    ),
    assignments: options.Set = None,
    seed: options.Seed = 0,
    workers: options.Threads = None,
) -> Plan:
    """Run millions of random and extreme commands through the environments and check every number.

    Commands are random and held, random at each step, all valves open, all closed, and each valve from end to
    end. Counts episodes, how they ended, and observations, rewards and states that are not finite: any of
    those makes the exit status 1. The largest cost J of one second, twice, is the recommended charge for each
    second that a terminated episode did not run (termination_cost of the environment). What --set assigns
    is not drawn.
    """
    from sayd_env.envs.keywords import configured  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.soak import soak as study  # noqa: PLC0415

    def judge(result: SoakResult, _: Output) -> None:
        if result.failures:
            raise StudyError(f"the environment has defects: {result.failures}")

    return Plan(
        lambda run: study(
            environment,
            steps,
            environments=environments,
            seed=seed,
            settings=assignments or (),
            workers=workers,
            progress=run.progress,
        ),
        dict(zip(("environment", "scenario"), configured(environment, settings=assignments), strict=True)),
        seed,
        after=judge,
    )


@command(GROUP, "vehicle my_train", without=("out", "wide"))
def new(
    kind: Literal["vehicle", "damper", "profile", "line", "controller", "study"] = argument(
        "KIND", "vehicle, damper, profile, line, controller or study."
    ),
    name: str = argument("NAME", "Of what it describes, and of the file, without an ending."),
    *,
    start: str | None = option(
        "--from NAME",
        "Packaged file of this kind to copy. Default: emu-estimate, passive-estimate, s1002, curve_400, "
        "own_controller, estimates.",
    ),
) -> Plan:
    """Write a template into the working directory: a packaged file with all its comments, under a new name.

    Nothing is overwritten. It is valid as it stands, and the program says which commands take it.
    """
    from sayd_env.studies.new import new as study  # noqa: PLC0415 - keeps --help fast

    return Plan(lambda _: study(kind, name, start), stored=False)
