"""Commands that make learned policies."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import argument, option, output, runs, scenario
from sayd_env.cli.output import RESULTS, command_text
from sayd_env.cli.parsers import SPEED, Number
from sayd_env.config import ConfigError
from sayd_env.config.storage import write_file
from sayd_env.config.units import KMH

if TYPE_CHECKING:
    from sayd_env.agents.config import TrainConfig
    from sayd_env.cli.output import Output
    from sayd_env.studies.tuning.training import SearchResult

GROUP = "Learning"
OF_A_DAMPER = ("--damper", "--config", "--set")
"""Options of the scenario that a semi-active damper by itself can follow."""


@command(GROUP, "ppo --seed 7 --set total_steps=200000", without=("wide",))
def train(
    algorithm: Literal["ppo", "sac"] | None = argument(
        "ALGORITHM", "ppo or sac: its packaged configuration.", default=None
    ),
    *,
    config: str | None = scenario(
        "--config NAME|FILE", options.CONFIG, autocompletion=options.one_of(kind="train")
    ),
    assignments: options.Set = None,
    resume: Path | None = option(
        "--resume DIR", "Go on with the run in this directory. Only total_steps may change."
    ),
    seed: int | None = runs(
        "--seed S",
        "Seed of weights, exploration and episodes. Default: the configuration's.",
        Number(0, 999_999, whole=True),
    ),
    seeds: int | None = runs(
        "--seeds N",
        "So many trainings, with seeds from --seed on: a run sSEED of each in --out, in a process of its "
        "own. The same command again takes up what was interrupted.",
        options.SEEDS,
    ),
    parallel: int | None = runs(
        "--parallel N", "With --seeds: trainings side by side. Default: as many as cores.", options.WORKERS
    ),
    workers: int | None = runs(
        "--workers N",
        f"Threads or processes of the evaluations {options.STAY}",
        options.WORKERS,
    ),
    executor: str | None = runs(
        "--executor KIND",
        "Who makes the evaluations' runs: threads (default), processes, ray, ray://ADDRESS, dask, dask://ADDRESS.",
        autocompletion=options.EXECUTORS,
    ),
    out: Path | None = output(
        "--out DIR", "New directory of the run. Default: results/train-ALGORITHM-sSEED."
    ),
    wandb: bool = output("--wandb", "Log at Weights & Biases, too; needs 'sayd-env[wandb]'.", default=False),
) -> Plan:
    """Train a policy; needs pip install 'sayd-env[train]'.

    The run's directory gets the configuration, logs (CSV and TensorBoard), the best and the last policy and
    checkpoints. Ctrl-C saves and says how to go on; a run that was killed goes on from its last checkpoint.
    """
    from sayd_env.agents.config import load_train  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.executors import THREADS, ExecutorChoice  # noqa: PLC0415
    from sayd_env.studies.learning import train as study  # noqa: PLC0415

    what = {"the algorithm": algorithm, "--config": config}
    _check_train(what, out, resume, seeds, parallel, {"--workers": workers, "--executor": executor})
    evaluations = ExecutorChoice.parse(executor or THREADS, workers)
    if resume is not None:
        config, out = str(resume / "config.yaml"), resume
    given = list(assignments or ())
    given += [] if seed is None else [f"seed={json.dumps(seed)}"]
    chosen = load_train(config or str(algorithm), given)
    learns = chosen.learning.algorithm
    if algorithm not in {None, learns}:
        raise ConfigError(f"train {algorithm}: the configuration {config} is one of {learns}")
    if seeds is not None:
        numbers = range(chosen.seed, chosen.seed + seeds)
        return _of_seeds(chosen, numbers, parallel, out, wandb=wandb)
    folder = out or RESULTS / f"train-{learns}-s{chosen.seed}"
    return Plan(
        lambda run: study(
            chosen,
            folder,
            resume=resume is not None,
            command=command_text(),
            executor=evaluations,
            progress=run.progress,
            wandb=wandb,
        ),
        chosen,
        chosen.seed,
        folder,
    )


def _check_train(
    what: Mapping[str, str | None],
    out: Path | None,
    resume: Path | None,
    seeds: int | None,
    parallel: int | None,
    evaluations: Mapping[str, object],
) -> None:
    """Refuse options that do not go together; `what` is to learn."""
    if seeds is not None:
        _refuse({"--resume": resume, **evaluations}, "--seeds: leave out")
    elif parallel is not None:
        raise ConfigError("--parallel: belongs to --seeds")
    if resume is not None:
        _refuse({**what, "--out": out}, "--resume: goes on with the run as it is; leave out")
        if not (resume / "config.yaml").is_file():
            raise ConfigError(f"--resume {resume}: holds no run of 'sayd train' (no config.yaml)")
    elif all(value is None for value in what.values()):
        raise ConfigError("train: what is to learn? Give ppo or sac, --config FILE, or --resume DIR")


def _refuse(given: Mapping[str, object], why: str) -> None:
    for name, value in given.items():
        if value is not None:
            raise ConfigError(f"{why} {name}")


def _of_seeds(
    config: TrainConfig, seeds: Sequence[int], parallel: int | None, out: Path | None, *, wandb: bool
) -> Plan:
    """A training with several seeds."""
    from sayd_env.runs.executors import cores  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.learning import require_training  # noqa: PLC0415
    from sayd_env.studies.seeds import train_seeds  # noqa: PLC0415

    require_training()
    folder = out or RESULTS / f"train-{config.learning.algorithm}"
    abreast = min(parallel or cores(), len(seeds))
    return Plan(
        lambda run: train_seeds(config, seeds, folder, parallel=abreast, wandb=wandb, progress=run.progress),
        config,
        seeds[0],
        folder,
    )


def tune_training(
    algorithm: str,
    config: str | None,
    assignments: Sequence[str],
    seed: int,
    out: Path | None,
    *,
    quick: bool,
) -> Plan:
    """The search for the settings of a training: `sayd tune ppo`."""
    from sayd_env.agents.search_config import load_search  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies.learning import require_training  # noqa: PLC0415
    from sayd_env.studies.tuning.training import search  # noqa: PLC0415

    require_training()
    settings = load_search(config or algorithm, assignments)
    if quick:
        settings = settings.shortened()
    folder = out or RESULTS / f"tune-{algorithm}{'-quick' if quick else ''}"

    def store(result: SearchResult, output: Output) -> None:
        target = folder / f"{algorithm}-tuned.yaml"
        write_file(target, result.training_file().encode())
        output.say(str(target))

    typed = command_text()
    return Plan(
        lambda run: search(
            algorithm,
            settings,
            folder,
            seed=seed,
            command=typed,
            executor=run.executor,
            progress=run.progress,
        ),
        settings,
        seed,
        folder,
        store,
    )


@command(GROUP, "results/train-ppo-s0 --onnx --out my-policy", without=("wide",), makes="export")
def export(
    foreign: options.ForeignOptions,
    choice: options.VehicleOptions,
    source: Path | None = argument(
        "DIR|FILE|NAME",
        "Directory of a run (its best policy), a policy file, or the name of a ready policy.",
        autocompletion=options.policy_names,
        default=None,
    ),
    *,
    onnx: bool = option("--onnx", "Write an ONNX model besides; needs 'sayd-env[onnx]'.", default=False),
    fmu: Literal["damper", "vehicle", "controller"] | None = option(
        "--fmu KIND", "Write a unit for other simulation tools: damper, vehicle, or controller (of a policy)."
    ),
    speed: float | None = scenario("--speed KMH", "Speed of --fmu vehicle. Default: 300.", SPEED),
    seed: int | None = runs("--seed S", "Seed of the track of --fmu vehicle. Default: 0.", options.SEED),
    out: options.Out = None,
) -> Plan:
    """Write what others use: a learned policy (weights, an ONNX model), or an FMU for their simulation tools.

    --fmu damper writes the semi-active damper as a Functional Mock-up Unit for co-simulation, for FMI 2.0 and
    3.0: machine code, which runs without Python. --fmu vehicle writes the vehicle on its track, with its own
    dampers or for outside ones, and NAME --fmu controller a policy, from sensors' signals to valve commands;
    where these two run, Python with sayd-env is needed. All need a C compiler and pip install
    'sayd-env[fmu]'. The scenario's options belong to --fmu.
    """
    target = out or RESULTS / "export"
    if fmu is None:
        return _export_policy(foreign, choice, source, target, speed, seed, onnx=onnx)
    from sayd_env.config.damper import SaydDamperConfig  # noqa: PLC0415 - keeps --help fast
    from sayd_env.fmu.unit import controller_unit, damper_unit, vehicle_unit  # noqa: PLC0415
    from sayd_env.studies.fmu import export as study  # noqa: PLC0415

    if onnx:
        raise ConfigError(f"--fmu {fmu}: leave out --onnx")
    _refuse(foreign.given(), f"--fmu {fmu}: leave out")
    if fmu != "vehicle":
        others = {name: value for name, value in choice.given().items() if name not in OF_A_DAMPER}
        _refuse(others, f"--fmu {fmu}: has no vehicle; leave out")
    if (source is None) == (fmu == "controller"):
        raise ConfigError(f"--fmu {fmu}: {'of which policy?' if source is None else f'leave out {source}'}")
    if fmu != "vehicle" and (speed is not None or seed is not None):
        raise ConfigError(f"--fmu {fmu}: has no track; leave out --speed and --seed")
    if choice.damper is None and choice.config is None:
        choice.damper = "sayd"
    chosen = choice.load()
    damper = chosen.damper
    if fmu == "vehicle":
        metric, track = (300.0 if speed is None else speed) / KMH, seed or 0
        return Plan(lambda _: study(vehicle_unit(chosen, metric, track), target), chosen, track, target)
    if fmu == "controller":
        return Plan(lambda _: study(controller_unit(str(source), chosen), target), chosen, folder=target)
    if not isinstance(damper, SaydDamperConfig):
        raise ConfigError(
            f"--fmu damper: '{damper.name}' is passive; expected one of type sayd: --damper sayd"
        )
    return Plan(lambda _: study(damper_unit(damper), target), chosen, folder=target)


def _export_policy(
    foreign: options.ForeignOptions,
    choice: options.VehicleOptions,
    source: Path | None,
    target: Path,
    speed: float | None,
    seed: int | None,
    *,
    onnx: bool,
) -> Plan:
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies import learning as study  # noqa: PLC0415

    if source is None:
        raise ConfigError(
            "export: what? Give a run's directory, a policy's file or name, or --fmu damper or vehicle"
        )
    fits = {"--speed": speed, "--seed": seed, **choice.given()}
    for name, value in fits.items():
        if value is not None:
            raise ConfigError(f"{name}: belongs to --fmu; a policy has none")
    stored = study.read_source(source, foreign.reader(load_environment(), [str(source)]))
    return Plan(lambda _: study.export(stored, target, onnx=onnx), folder=target)
