"""What all commands have in common: their options, their output, and how they end.

A command is a function that reads its own options into a `Plan`; `command` offers them on the command line
together with the common ones, makes the plan's output and run context, computes, stores and shows.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, get_type_hints

import typer
from rich.markup import escape

from sayd_env.cli import options
from sayd_env.cli.output import RESULTS, Output

if TYPE_CHECKING:
    from sayd_env.report.files import Result
    from sayd_env.runs.context import RunContext
    from sayd_env.runs.executors import ExecutorChoice

app = typer.Typer(
    name="sayd",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@dataclass(frozen=True)
class Plan:
    """What a command is to do. Everything typed has been checked; nothing has been computed or written."""

    study: Callable[[RunContext], Result]
    config: Any = None
    """The full resolved configuration, or a function that takes it from the result."""
    seed: int | None = None
    """First seed of the random draws; None where nothing is random."""
    folder: Path | None = None
    """Where the result goes if not where `result_folder` says."""
    after: Callable[[Any, Output], None] | None = None
    """Called with the result when it is stored and shown."""


Body = TypeVar("Body", bound=Callable[..., Plan])
Parameters: TypeAlias = dict[str, inspect.Parameter]

OUTPUT: dict[str, tuple[Any, Any]] = {
    "out": (options.Out, None),
    "as_json": (options.Json, False),
    "wide": (options.Wide, False),
}
RUNS: dict[str, tuple[Any, Any]] = {"workers": (options.Workers, None), "executor": (options.Executor, None)}


def command(
    group: str, example: str, *, name: str = "", runs: bool = False, without: Collection[str] = ()
) -> Callable[[Body], Body]:
    """Make a function a command.

    Its keyword parameters are options; one that is a dataclass of options stands for all of them.

    Parameters
    ----------
    group : str
        Under which the list of commands shows it.
    example : str
        One line to copy, without the name of the program and of the command.
    name : str
        By default that of the function.
    runs : bool
        It makes many runs: an executor makes them, and finished ones are kept in the result's directory.
    without : collection of str
        Common options, or those of a dataclass, that it cannot use.
    """

    def register(body: Body) -> Body:
        called = name or body.__name__.replace("_", "-")
        own = dict(inspect.signature(body, eval_str=True).parameters)
        offered = _offered(own, (RUNS if runs else {}) | OUTPUT, without)

        def invoke(**given: Any) -> None:
            _run(called, body(**_arguments(own, given)), given, keeps=runs)

        invoke.__signature__ = inspect.Signature(list(offered.values()))  # type: ignore[attr-defined]
        app.command(
            called,
            help=escape(_paragraphs(body)),
            epilog=escape(f"Example: sayd {called} {example}".strip()),
            rich_help_panel=group,
        )(invoke)
        return body

    return register


def result_folder(name: str, given: Mapping[str, Any]) -> Path | None:
    """Directory of a result: that of ``--out``, or one of its own; None with ``--json`` alone.

    Parameters
    ----------
    name : str
        Of the directory in ``results``; a look (``--quick``) never replaces a result.
    given : mapping
        Values of the options ``out``, ``as_json`` and ``quick``.
    """
    if given["out"] is not None or given["as_json"]:
        folder: Path | None = given["out"]
        return folder
    return RESULTS / (f"{name}-quick" if given.get("quick") else name)


def _offered(own: Parameters, common: dict[str, tuple[Any, Any]], without: Collection[str]) -> Parameters:
    """All options of a command."""
    offered: Parameters = {}
    for parameter in own.values():
        if not is_dataclass(parameter.annotation):
            offered[parameter.name] = parameter
            continue
        hints = get_type_hints(parameter.annotation, include_extras=True)
        common = {f.name: (hints[f.name], f.default) for f in fields(parameter.annotation)} | common
    for name, (annotation, default) in common.items():
        if name not in without and name not in offered:
            offered[name] = inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default
            )
    return offered


def _arguments(own: Parameters, given: dict[str, Any]) -> dict[str, Any]:
    """What a command's function is called with."""
    return {
        name: parameter.annotation(
            **{f.name: given[f.name] for f in fields(parameter.annotation) if f.name in given}
        )
        if is_dataclass(parameter.annotation)
        else given[name]
        for name, parameter in own.items()
    }


def _run(name: str, plan: Plan, given: dict[str, Any], *, keeps: bool) -> None:
    from sayd_env.runs.executors import ExecutorChoice  # noqa: PLC0415 - keeps --help fast

    # Where there is no executor, workers are what the command itself makes of them.
    executor = ExecutorChoice.parse(given["executor"], given["workers"]) if keeps else ExecutorChoice()
    folder = plan.folder or result_folder(name, given)
    output = Output(name, folder, as_json=given["as_json"], wide=given.get("wide", False))
    result = _compute(plan, output, executor, keeps=keeps)
    config = plan.config(result) if callable(plan.config) else plan.config
    output.finish(result, config=config, seed=plan.seed, quick=given.get("quick", False))
    if plan.after is not None:
        plan.after(result, output)


def _compute(plan: Plan, output: Output, executor: ExecutorChoice, *, keeps: bool) -> Result:
    """Run the study.

    Raises
    ------
    Interrupted
        By Ctrl-C, where finished runs are kept.
    """
    from sayd_env.config.errors import Interrupted  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.cache import RunCache  # noqa: PLC0415
    from sayd_env.runs.context import RunContext  # noqa: PLC0415

    folder = output.directory.path / "runs" if keeps and output.directory is not None else None
    cache = RunCache(folder)
    try:
        with output.progress() as progress:
            result = plan.study(RunContext(executor, cache, progress))
    except KeyboardInterrupt:
        if folder is None:
            raise
        raise Interrupted(f"finished runs are in {folder}; the same command goes on") from None
    cache.forget_former()
    if cache.reused:
        output.say(f"{cache.reused} runs had been finished by an earlier start")
    return result


def _paragraphs(body: Callable[..., Any]) -> str:
    """The docstring without its line ends, which would break the lines of a help that is as wide as it likes."""
    return "\n\n".join(" ".join(part.split()) for part in (inspect.getdoc(body) or "").split("\n\n"))
