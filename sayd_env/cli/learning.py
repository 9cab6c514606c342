"""Commands that make learned policies."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sayd_env.cli import options
from sayd_env.cli.job import Job, command_text
from sayd_env.config.errors import ConfigError

LARGEST_SEED = 999_999
RESULTS = Path("results")


class Algorithm(StrEnum):
    """How a policy learns."""

    PPO = "ppo"
    SAC = "sac"


def train(
    algorithm: Annotated[
        Algorithm | None, typer.Argument(help="ppo or sac: its packaged configuration.", show_default=False)
    ] = None,
    *,
    config: options.Config = None,
    assignments: options.Set = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Go on with the run in this directory, with its configuration. Only total_steps may change.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            parser=options.whole("--seed", 0, LARGEST_SEED),
            metavar="S",
            help="Seed of weights, exploration and episodes. Default: the configuration's.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            parser=options.whole("--workers", 1, options.MAX_WORKERS),
            metavar="N",
            help="Threads of the simulator (default: all cores); results do not change.",
        ),
    ] = None,
    executor: options.Executor = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            rich_help_panel=options.OUTPUT,
            help="New directory of the run. Default: results/train-ALGORITHM-sSEED.",
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Train a policy; needs pip install 'sayd-env[train]'.

    The run's directory gets the configuration, logs (CSV and TensorBoard), the best and the last policy and
    checkpoints. Ctrl-C saves and says how to go on; a run that was killed goes on from its last checkpoint.
    """
    from sayd_env.agents.config import load_train  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.executors import ExecutorChoice  # noqa: PLC0415
    from sayd_env.studies.learning import train as study  # noqa: PLC0415

    evaluations = ExecutorChoice.parse(executor, workers)
    if resume is not None:
        _refuse_with_resume(algorithm, config, out)
        config, out = str(resume / "config.yaml"), resume
        if not Path(config).is_file():
            raise ConfigError(f"--resume {resume}: holds no run of 'sayd train' (no config.yaml)")
    elif config is None and algorithm is None:
        raise ConfigError("train: what is to learn? Give ppo or sac, --config FILE, or --resume DIR")
    given = list(assignments or ())
    given += [] if seed is None else [f"seed={json.dumps(seed)}"]
    if workers is not None and resume is None:
        given.append(f"environment.threads={workers}")
    chosen = load_train(config or str(algorithm), given)
    if algorithm is not None and chosen.learning.algorithm != algorithm:
        raise ConfigError(
            f"train {algorithm}: the configuration {config} is one of {chosen.learning.algorithm}"
        )
    folder = out or RESULTS / f"train-{chosen.learning.algorithm}-s{chosen.seed}"
    job = Job("train", folder, as_json)
    with job.progress() as progress:
        result = study(
            chosen,
            folder,
            resume=resume is not None,
            command=command_text(),
            executor=evaluations,
            progress=progress,
        )
    job.finish(result, config=chosen, seed=chosen.seed)


def _refuse_with_resume(algorithm: Algorithm | None, config: str | None, out: Path | None) -> None:
    given = {"the algorithm": algorithm, "--config": config, "--out": out}
    for name, value in given.items():
        if value is not None:
            raise ConfigError(f"--resume: goes on with the run as it is; leave out {name}")


def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|FILE|NAME",
            help="Directory of a run (its best policy), a policy file, or a ready policy such as ppo-s3.",
        ),
    ],
    *,
    onnx: Annotated[
        bool,
        typer.Option("--onnx", help=escape("Write an ONNX model besides; needs 'sayd-env[onnx]'.")),
    ] = False,
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Write a learned policy as files for others: weights with their description, and an ONNX model."""
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.policies import foreign_reader  # noqa: PLC0415
    from sayd_env.studies.learning import export as study  # noqa: PLC0415
    from sayd_env.studies.learning import read_source  # noqa: PLC0415

    foreign = foreign_reader(trust_pickles, load_environment(), trained_period, vec_normalize)
    stored = read_source(source, foreign)  # before the directory is made
    target = out or RESULTS / "export"
    job = Job("export", target, as_json)
    job.finish(study(stored, target, onnx=onnx))
