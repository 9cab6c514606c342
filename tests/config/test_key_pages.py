"""The site's pages of configuration keys have every key that a file may have, each with a meaning."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

import configuration_tables as tables
import pytest

from sayd_env import config
from sayd_env.agents.config import EstimatorConfig
from sayd_env.config import fault
from sayd_env.config.base import Model
from sayd_env.config.control import PassiveControlConfig, TunedProvenance

FOUND = tables.sections()
PAGES = tables.pages()
ELSEWHERE = {
    # Faults that the options of `reset` name: docs/environments.md, which a test of its own compares.
    fault.ValveStuck,
    fault.PowerLost,
    fault.DamperLost,
    fault.SensorDead,
    fault.SensorFrozen,
    fault.SensorBiased,
    fault.SensorNoisy,
    # In the files of policies, which trainings write.
    EstimatorConfig,
    # Of no keys; of any keys.
    PassiveControlConfig,
    TunedProvenance,
}


def models(of: type[Model] = Model) -> Iterator[type[Model]]:
    for each in of.__subclasses__():
        yield each
        yield from models(each)


def test_every_model_of_a_file_has_a_table():
    for module in pkgutil.iter_modules(config.__path__):
        importlib.import_module(f"{config.__name__}.{module.name}")
    # What is only a base of others, or adds no key to its own base, is in their tables.
    lost = {
        model.__name__
        for model in models()
        if model.__module__.startswith((config.__name__, "sayd_env.agents.config"))
        and model not in {*FOUND, *ELSEWHERE}
        and not model.__name__.startswith("_")
        and not model.__subclasses__()
        and not any(
            base in FOUND and model.model_fields.keys() == base.model_fields.keys() for base in model.__mro__
        )
    }
    assert lost == set()


@pytest.mark.parametrize("chapter", tables.CHAPTERS, ids=lambda chapter: chapter.title)
def test_a_page_has_every_key(chapter: tables.Chapter):
    page = PAGES[chapter.page]
    for model, entry in FOUND.items():
        if entry.chapter is chapter:
            table = page.partition(f"{{ #{tables.anchor(model)} }}")[2].partition("</div>")[0]
            keys = [line.split("`")[1] for line in table.splitlines() if line.startswith("| `")]
            assert keys == list(model.model_fields)


def test_every_key_has_a_meaning():
    bare = [
        f"{m.__name__}.{k}"
        for m in FOUND
        for k, field in m.model_fields.items()
        if not tables.meaning(k, field)
    ]
    assert bare == []


def test_values_and_bounds_are_those_of_the_files():
    # configs/damper/sayd-estimate.yaml and the schema; no calibrated number.
    row = next(line for line in PAGES["damper.md"].splitlines() if line.startswith("| `failsafe_current`"))
    assert row.split(" | ") == [
        "| `failsafe_current`",
        "number, ≥ 0, ≤ 1",
        "Current that the unpowered valve's opening corresponds to (-)",
        "required",
        "`0` |",
    ]
