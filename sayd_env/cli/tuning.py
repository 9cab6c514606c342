"""The command that looks for a controller's best gains."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from sayd_env.cli import options
from sayd_env.cli.command import Plan, command, result_folder
from sayd_env.cli.options import output, runs
from sayd_env.cli.output import command_text
from sayd_env.config.errors import ConfigError

if TYPE_CHECKING:
    from sayd_env.cli.output import Output
    from sayd_env.studies.tuning.tune import TuneResult


@command("Policies", "mppt2 --quick", runs=True)
def tune(
    controller: Annotated[
        Literal["mppt2", "constant"],
        typer.Argument(metavar="mppt2|constant", help="Whose gains.", show_default=False),
    ],
    *,
    config: options.Config = None,
    assignments: options.Set = None,
    quick: options.Quick = False,
    seed: Annotated[
        int, runs("--seed", "S", "Seed of the search; the scenarios have theirs.", options.SEED)
    ] = 0,
    file: Annotated[
        Path | None,
        output(
            "-o --file", "FILE", "YAML file of the tuned parameters. Default: CONTROLLER-tuned.yaml in --out."
        ),
    ] = None,
    out: Annotated[Path | None, output("--out", "DIR", options.OUT.format("tune-CONTROLLER"))] = None,
    as_json: options.Json = False,
) -> Plan:
    """Find the gains of a controller with the smallest mean J over a list of scenarios.

    The list, the ranges and the budget are those of configs/study/tuning.yaml (--config, --set); J has the
    weights of MPPT2. mppt2: differential evolution, then COBYQA, about ten minutes; constant: Brent's search,
    a minute or two; --quick takes a few scenarios and evaluations.

    The result is a file of parameters that --policies takes like a name, for example
    results/tune-mppt2/mppt2-tuned.yaml; the packaged mppt2-tuned and constant-tuned were found so.
    Evaluations are kept in the output directory: an interrupted tuning goes on where it stopped.
    """
    from sayd_env.config.storage import write_file  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.tuning import load_tuning  # noqa: PLC0415
    from sayd_env.report.files import ResultDirectory  # noqa: PLC0415
    from sayd_env.studies.tuning import tune as study  # noqa: PLC0415

    settings = load_tuning("tuning" if config is None else config, assignments or ())
    settings = settings.shortened() if quick else settings
    if out is not None and out.suffix in (".yaml", ".yml"):
        raise ConfigError(f"--out {out}: expected a directory; the file of parameters is -o {out}")
    if file is not None and file.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"-o {file}: expected a file that ends in .yaml")
    folder = result_folder(f"tune-{controller}", {"out": out, "as_json": as_json, "quick": quick})
    target = file or (None if folder is None else folder / f"{controller}-tuned.yaml")
    if target is not None:
        study.refuse_packaged(target)
        ResultDirectory(target.parent)  # cannot be written to? Say so before the work
    name, typed = config or "configs/study/tuning.yaml", command_text()

    def store(result: TuneResult, output: Output) -> None:
        if target is not None:
            write_file(target, result.control_file().encode())
            output.say(str(target))

    return Plan(
        lambda run: study.tune(controller, settings, name=name, seed=seed, command=typed, context=run),
        settings,
        seed,
        folder,
        store,
    )
