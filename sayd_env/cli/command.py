"""What all commands have in common: their options, their output, and how they end.

A command is a function that reads its own options into a `Plan`; `command` offers these and the common ones
on the command line, opens the output, gives the study its run context, stores and shows the result.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import typer
from rich.markup import escape
from typer.models import OptionInfo

from sayd_env.cli.options import Group, Out, OutputOptions, RunOptions, out_text, output, settled
from sayd_env.cli.output import RESULTS, Output, typed
from sayd_env.config.errors import ConfigError, Interrupted

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
    """What a command is to do. All that was typed has been checked; nothing has been computed or written."""

    study: Callable[[RunContext], Result]
    config: Any = None
    """The full resolved configuration, or a function that takes it from the result."""
    seed: int | None = None
    """First seed of the random draws; None where nothing is random."""
    folder: Path | None = None
    """Where the result goes if not where `result_folder` says."""
    after: Callable[[Any, Output], None] | None = None
    """Called with the result when it is stored and shown."""
    stored: bool = True
    """Whether the result has a directory of its own."""


Body = TypeVar("Body", bound=Callable[..., Plan])
Parameters: TypeAlias = dict[str, inspect.Parameter]


def command(
    group: str,
    example: str,
    *,
    name: str = "",
    runs: bool = False,
    without: Collection[str] = (),
    makes: str = "",
) -> Callable[[Body], Body]:
    """Make a function a command.

    Its parameters are arguments and options; one whose type is a `Group` stands for all of its options.

    Parameters
    ----------
    group : str
        Under which the list of commands shows it.
    example : str
        Its arguments in a line to copy.
    name : str
        By default that of the function.
    runs : bool
        It makes many runs: an executor makes them, and finished ones are kept in the result's directory.
    without : collection of str
        Common options, or those of a group, that it cannot use.
    makes : str
        The file for which it is there, which it writes with ``--json``, too.
    """

    def register(body: Body) -> Body:
        called = name or body.__name__.replace("_", "-")
        own = dict(inspect.signature(body, eval_str=True).parameters)
        groups = _groups(own)

        def invoke(**given: Any) -> None:
            _refuse_repeated(offered.values())
            plain = {name: given[name] for name in own if name not in groups}
            with _own_output(given["as_json"]):
                plan = body(**plain, **{name: kind(**given) for name, kind in groups.items()})
            _run(called, plan, given, runs)

        common: list[type[Group]] = [RunOptions] * runs + [OutputOptions]
        offered = _offered(own, common, without)
        if "out" in offered and offered["out"].annotation == Out:
            apart = f", but for the {makes}" if makes else ""
            text = out_text(called, quick="quick" in offered, apart=apart)
            offered["out"] = offered["out"].replace(
                annotation=Annotated[Path | None, output("--out DIR", text)]
            )
        signature = inspect.Signature(list(offered.values()))
        invoke.__signature__ = signature  # type: ignore[attr-defined]
        # The help has lines of another width than the docstring.
        paragraphs = [" ".join(part.split()) for part in (inspect.getdoc(body) or "").split("\n\n")]
        app.command(
            called,
            help=escape("\n\n".join(paragraphs)),
            epilog=escape(f"Example: sayd {called} {example}".strip()),
            rich_help_panel=group,
        )(invoke)
        return body

    return register


def _refuse_repeated(offered: Iterable[inspect.Parameter]) -> None:
    """Refuse an option that is given twice, of which one would count.

    Raises
    ------
    ConfigError
        There is one.
    """
    for parameter in offered:
        declared = (*getattr(parameter.annotation, "__metadata__", ()), parameter.default)
        for info in declared:
            if isinstance(info, OptionInfo) and "list" not in str(parameter.annotation):
                names = [name for words in info.param_decls or () for name in words.split("/")]
                given = [word for word in typed if word.partition("=")[0] in names]
                if len(given) > 1:
                    raise ConfigError(f"{names[0]}: found {len(given)} times; expected once")


def _own_output(as_json: bool) -> AbstractContextManager[Any]:
    """Keep standard output for the JSON: what the code of a policy prints goes to standard error."""
    return redirect_stdout(sys.stderr) if as_json else nullcontext()


def result_folder(name: str, given: Mapping[str, Any]) -> Path | None:
    """``--out``, none with ``--json`` alone, or a directory where a look replaces no result."""
    folder: Path | None = given.get("out")
    if folder is not None or given["as_json"]:
        return folder
    return RESULTS / (f"{name}-quick" if given.get("quick") else name)


def _groups(own: Parameters) -> dict[str, type[Group]]:
    """Parameters that stand for several options."""
    kinds = {name: parameter.annotation for name, parameter in own.items()}
    return {name: kind for name, kind in kinds.items() if isinstance(kind, type) and issubclass(kind, Group)}


def _offered(own: Parameters, common: Iterable[type[Group]], without: Collection[str]) -> Parameters:
    """Arguments and options of a command, its own first."""
    groups = _groups(own)
    offered = {
        name: parameter.replace(default=settled(parameter.default))
        for name, parameter in own.items()
        if name not in groups
    }
    for group in (*groups.values(), *common):
        for name, (annotation, default) in group.offered().items():
            if name not in {*without, *offered}:
                offered[name] = inspect.Parameter(
                    name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default
                )
    return offered


def _run(name: str, plan: Plan, given: Mapping[str, Any], keeps: bool) -> None:
    """Compute and store a result, and show it.

    Raises
    ------
    Interrupted
        By Ctrl-C, where finished runs or the result are kept.
    """
    from sayd_env.runs.executors import ExecutorChoice  # noqa: PLC0415 - keeps --help fast

    # Where nothing is kept, workers are what the command itself makes of them.
    executor = ExecutorChoice.parse(given["executor"], given["workers"]) if keeps else ExecutorChoice()
    folder = plan.folder or (result_folder(name, given) if plan.stored else None)
    output = Output(name, folder, as_json=given["as_json"], wide=given.get("wide", False))
    with _own_output(given["as_json"]):
        result = _compute(plan, output, executor, keeps=keeps)
    config = plan.config(result) if callable(plan.config) else plan.config
    try:
        output.finish(result, config, plan.seed, quick=given.get("quick", False))
        if plan.after is not None:
            plan.after(result, output)
    except KeyboardInterrupt:
        if not output.stored:
            raise
        raise Interrupted(f"the result is in {folder}") from None


def _compute(plan: Plan, output: Output, executor: ExecutorChoice, *, keeps: bool) -> Result:
    """Run the study.

    Raises
    ------
    Interrupted
        By Ctrl-C, where finished runs are kept.
    """
    from sayd_env.runs.cache import RunCache  # noqa: PLC0415 - keeps --help fast
    from sayd_env.runs.context import RunContext  # noqa: PLC0415
    from sayd_env.runs.executors import KeptExecutor  # noqa: PLC0415

    folder = output.directory.path / "runs" if keeps and output.directory is not None else None
    cache = RunCache(folder)
    try:
        with output.progress() as progress, KeptExecutor(executor) as kept:
            result = plan.study(RunContext(executor, cache, progress, kept))
    except KeyboardInterrupt:
        if folder is None or not any(folder.glob("*/*.npz")):
            raise
        raise Interrupted(f"finished runs are in {folder}; the same command goes on") from None
    cache.forget_former()
    if cache.reused:
        kept_runs = f"{cache.reused} run{'s' * (cache.reused > 1)}"
        output.say(f"{kept_runs} had been finished by an earlier start")
    return result
