"""docs/environments.md says what the environments say, names all they have, and its snippets run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import environment_tables
import numpy as np
import pytest

from sayd_env.config.distribution import (
    ChoiceDistribution,
    FixedDistribution,
    NormalDistribution,
    UniformDistribution,
)
from sayd_env.config.environment import load_environment
from sayd_env.config.fault import Fault
from sayd_env.envs import vector, wrappers
from sayd_env.envs.options import OPTIONS
from sayd_env.envs.registration import IDS
from sayd_env.envs.single import SaydEnv

PAGE = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
ENVIRONMENTS = {name: load_environment(name) for name in IDS.values()}


TABLES = environment_tables.tables()


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_those_of_the_environments(name: str) -> None:
    assert f"\n\n{TABLES[name]}\n\n" in PAGE, f"docs/environments.md lacks this table:\n{TABLES[name]}"


@pytest.mark.parametrize("name", ["action", "signals", "features"])
def test_the_docstring_shows_what_the_environment_says(name: str) -> None:
    page = [line.strip() for line in (SaydEnv.__doc__ or "").splitlines()]
    lines = TABLES[name].splitlines()
    start = page.index(lines[2]) - 2
    assert page[start : start + len(lines)] == lines


def test_numbers_in_the_text_are_those_of_the_configuration() -> None:
    words = " ".join(PAGE.split())
    config, faults = ENVIRONMENTS["nominal"], ENVIRONMENTS["faults"].faults
    assert faults is not None
    assert f"J_term is {config.termination_cost:g}:" in words
    ending = config.derailment
    assert f"exceeds {ending.quotient:g} in the mean over {ending.averaging:g} m (`derailment`)" in words
    assert f"| episode | {config.episode_s:g} s" in words
    assert f"| {1e3 * config.control_period:g} ms (`control_period`)" in words
    assert f"over {config.run_in:g} m with the initial command" in words
    assert f"`history` is k, {config.history} by default" in words
    assert f"Faults: {environment_tables.in_words(faults.count)} in an episode" in words
    assert f"each beginning {environment_tables.in_words(faults.onset)} s after step 0" in words


def test_everything_is_named() -> None:
    kinds = [member.model_fields["kind"].annotation for member in get_args(get_args(Fault)[0])]
    names = [*IDS, *OPTIONS, *vector.KEYWORDS, *wrappers.__all__, *(get_args(kind)[0] for kind in kinds)]
    table = set(re.findall(r"[A-Za-z_/0-9-]+", " ".join(re.findall(r"`[^`\n]+`|^\| \w+", PAGE, flags=re.M))))
    assert [name for name in names if name not in table] == []


@pytest.mark.parametrize("damper", ["sayd", "passive"])
def test_info_is_named(damper: str, quick: str) -> None:
    env = SaydEnv(quick, info="full", damper=damper)
    info: dict[str, Any] = dict(env.reset(seed=0)[1])
    info |= env.step(np.zeros(2, np.float32))[4]
    assert [key for key in (*info, "ending", "error") if f"`{key}`" not in PAGE] == []


@pytest.mark.parametrize(
    ("drawn", "words"),
    [
        (FixedDistribution(distribution="fixed", value=0.5), "0.5"),
        (UniformDistribution(distribution="uniform", low=0.0, high=1.5), "0 to 1.5"),
        (
            UniformDistribution(distribution="uniform", low=0.0, high=1.0, step=0.05),
            "0 to 1 in steps of 0.05",
        ),
        (
            NormalDistribution(distribution="normal", mean=1.0, deviation=0.1, low=0.7, high=1.3),
            "1 ± 0.1, 0.7 to 1.3",
        ),
        (ChoiceDistribution(distribution="choice", values=(0, 2), weights=(1.0, 3.0)), "0 (25 %), 2 (75 %)"),
        (ChoiceDistribution(distribution="choice", values=(1, 2)), "1 (50 %), 2 (50 %)"),
    ],
)
def test_distributions_in_words(drawn: Any, words: str) -> None:
    assert environment_tables.in_words(drawn) == words


def test_a_table_of_no_faults_is_empty() -> None:
    assert environment_tables.fault_table(ENVIRONMENTS["nominal"]) == ""


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_snippets_run(snippet: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(snippet, "docs/environments.md", "exec"), {})
    assert capsys.readouterr().out


def test_there_are_snippets() -> None:
    assert len(SNIPPETS) == 4
