"""Commands that make learned policies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import argument, option, output, runs, scenario
from sayd_env.cli.output import RESULTS, command_text
from sayd_env.cli.parsers import Number
from sayd_env.config.errors import ConfigError

GROUP = "Learning"


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
) -> Plan:
    """Train a policy; needs pip install 'sayd-env[train]'.

    The run's directory gets the configuration, logs (CSV and TensorBoard), the best and the last policy and
    checkpoints. Ctrl-C saves and says how to go on; a run that was killed goes on from its last checkpoint.
    """
    from sayd_env.agents.config import load_train  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.executors import THREADS, ExecutorChoice  # noqa: PLC0415
    from sayd_env.studies.learning import train as study  # noqa: PLC0415

    evaluations = ExecutorChoice.parse(executor or THREADS, workers)
    if resume is not None:
        left_out = {"the algorithm": algorithm, "--config": config, "--out": out}
        for name, value in left_out.items():
            if value is not None:
                raise ConfigError(f"--resume: goes on with the run as it is; leave out {name}")
        config, out = str(resume / "config.yaml"), resume
        if not Path(config).is_file():
            raise ConfigError(f"--resume {resume}: holds no run of 'sayd train' (no config.yaml)")
    elif config is None and algorithm is None:
        raise ConfigError("train: what is to learn? Give ppo or sac, --config FILE, or --resume DIR")
    given = list(assignments or ())
    given += [] if seed is None else [f"seed={json.dumps(seed)}"]
    chosen = load_train(config or str(algorithm), given)
    learns = chosen.learning.algorithm
    if algorithm not in {None, learns}:
        raise ConfigError(f"train {algorithm}: the configuration {config} is one of {learns}")
    folder = out or RESULTS / f"train-{learns}-s{chosen.seed}"
    return Plan(
        lambda run: study(
            chosen,
            folder,
            resume=resume is not None,
            command=command_text(),
            executor=evaluations,
            progress=run.progress,
        ),
        chosen,
        chosen.seed,
        folder,
    )


@command(GROUP, "results/train-ppo-s0 --onnx --out my-policy", without=("wide",))
def export(
    foreign: options.ForeignOptions,
    source: Path = argument(
        "DIR|FILE|NAME",
        "Directory of a run (its best policy), a policy file, or the name of a ready policy.",
        autocompletion=options.policy_names,
    ),
    *,
    onnx: bool = option("--onnx", "Write an ONNX model besides; needs 'sayd-env[onnx]'.", default=False),
    out: options.Out = None,
) -> Plan:
    """Write a learned policy as files for others: weights with their description, and an ONNX model."""
    from sayd_env.config.environment import load_environment  # noqa: PLC0415 - keeps --help fast
    from sayd_env.studies import learning as study  # noqa: PLC0415

    stored = study.read_source(source, foreign.reader(load_environment()))
    target = out or RESULTS / "export"
    return Plan(lambda _: study.export(stored, target, onnx=onnx), folder=target)
