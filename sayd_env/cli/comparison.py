"""The command that says which policy is best."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sayd_env.cli import options
from sayd_env.cli.job import Job


def compare(
    *,
    policies: Annotated[
        options.PolicyNames | None,
        typer.Option(
            "--policies",
            parser=options.parse_policies,
            metavar="A,B,...",
            help="Who takes part beside passive and mppt2: names as for evaluate, ready policies by their "
            "algorithm (ppo), training seeds as NAME=FILE+FILE..., or a folder of policy files. Default: the "
            "paper's and the tuned controllers and all ready policies.",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A look at a few of the conditions, with one seed.")
    ] = False,
    config: Annotated[
        str | None,
        typer.Option(
            "--config",
            metavar="NAME|FILE",
            help="Conditions: a YAML file. Default: the held-out ones, which nothing was trained on.",
        ),
    ] = None,
    assignments: options.Set = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            parser=options.whole("--seed", 0, options.LARGEST_SEED),
            metavar="S",
            help="Of the bootstrap; the seeds of the scenarios are the configuration's.",
        ),
    ] = None,
    trust_pickles: options.TrustPickles = False,
    trained_period: options.TrainedPeriod = None,
    vec_normalize: options.VecNormalize = None,
    workers: options.Workers = None,
    executor: options.Executor = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Compare policies on held-out conditions: J with intervals, limits, critical speed, training seeds.

    All policies meet the same scenarios: speeds, wear, friction, tracks and seeds of the configuration, the
    rest drawn from the seed. J is that of evaluate, in MPPT2's weighting; it is judged off line and with
    other weights of the force, too. Intervals are bootstraps over training seeds and scenarios. The best
    constant current of each condition is the bound for slow policies. Finished runs are kept in the output
    directory: an interrupted comparison goes on where it stopped.
    """
    from sayd_env.config.comparison import HELD_OUT, load_comparison  # noqa: PLC0415 - keeps --help fast
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.runs.policies import foreign_reader  # noqa: PLC0415
    from sayd_env.studies.comparison.compare import compare as study  # noqa: PLC0415
    from sayd_env.studies.comparison.entrants import read_entrants  # noqa: PLC0415

    given = list(assignments or ()) + ([] if seed is None else [f"bootstrap.seed={seed}"])
    conditions = load_comparison(config or HELD_OUT, given)
    foreign = foreign_reader(trust_pickles, load_environment(), trained_period, vec_normalize)
    chosen = read_entrants(policies, foreign)
    if out is None and quick and not as_json:
        out = Path("results") / "compare-quick"  # a look must not replace a result
    job = Job("compare", out, as_json)
    with job.runs(executor, workers) as context:
        result = study(conditions, chosen, quick=quick, context=context)
    job.finish(result, config=result.config, seed=result.config.bootstrap.seed)
