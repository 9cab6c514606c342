"""The command that looks for a controller's best gains."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job, command_text
from sayd_env.config.errors import ConfigError

RESULTS = Path("results")


class Tuned(StrEnum):
    """Controllers that can be tuned."""

    MPPT2 = "mppt2"
    CONSTANT = "constant"


def tune(
    controller: Annotated[Tuned, typer.Argument(help="mppt2 or constant.", show_default=False)],
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="A few scenarios and evaluations: a look, not a result.")
    ] = False,
    config: options.Config = None,
    assignments: options.Set = None,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            parser=options.whole("--seed", 0, options.LARGEST_SEED),
            metavar="S",
            help="Seed of the search; the scenarios have theirs.",
        ),
    ] = 0,
    workers: options.Workers = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--file",
            metavar="FILE",
            rich_help_panel=options.OUTPUT,
            help="YAML file of the tuned parameters. Default: CONTROLLER-tuned.yaml in --out.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            rich_help_panel=options.OUTPUT,
            help="Directory of the parameters, result.json, tables and plots. "
            "Default: results/tune-CONTROLLER (none with --json).",
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Find the gains of a controller with the smallest mean J over a list of scenarios.

    The list, the ranges and the budget are those of configs/study/tuning.yaml (--config, --set); J has the
    weights of MPPT2. mppt2: differential evolution, then COBYQA, about ten minutes; constant: Brent's search,
    a minute or two. The result is a file of parameters that --policies takes like a name, for example
    results/tune-mppt2/mppt2-tuned.yaml; the packaged mppt2-tuned and constant-tuned were found so.
    Evaluations are kept in the output directory: an interrupted tuning goes on where it
    stopped.
    """
    from sayd_env.config.storage import write_file  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.tuning import load_tuning  # noqa: PLC0415 - keeps --help fast
    from sayd_env.report.files import ResultDirectory  # noqa: PLC0415
    from sayd_env.studies.tuning.tune import refuse_packaged  # noqa: PLC0415
    from sayd_env.studies.tuning.tune import tune as study  # noqa: PLC0415

    settings = load_tuning("tuning" if config is None else config, assignments or ())
    settings = settings.shortened() if quick else settings
    if out is not None and out.suffix in (".yaml", ".yml"):
        raise ConfigError(f"--out {out}: expected a directory; the file of parameters is -o {out}")
    if file is not None and file.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"-o {file}: expected a file that ends in .yaml")
    folder = out
    if folder is None and not as_json:
        folder = RESULTS / f"tune-{controller.value}{'-quick' if quick else ''}"
    target = file or (None if folder is None else folder / f"{controller.value}-tuned.yaml")
    if target is not None:
        refuse_packaged(target)
        ResultDirectory(target.parent)  # cannot be written to? Say so before the work
    job = Job("tune", folder, as_json)
    with job.runs(workers=workers) as context:
        result = study(
            controller.value,
            settings,
            name="configs/study/tuning.yaml" if config is None else config,
            seed=seed,
            command=command_text(),
            context=context,
        )
    if target is not None:
        write_file(target, result.control_file().encode())
    job.finish(result, config=settings, seed=seed)
    if target is not None:
        job.console.print(str(target), markup=False, highlight=False, soft_wrap=True)
