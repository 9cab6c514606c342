"""The reproduction: what its seeds, speeds and assumptions may be, and that nothing else has its seeds."""

from __future__ import annotations

import re
from importlib import resources

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.reproduction import load_reproduction


def test_no_other_file_names_a_seed_of_the_reproduction():
    """Twenty tracks to which nothing was fitted."""
    study = load_reproduction()
    assert len(study.seeds) == 20
    assert study.first_seeds(3) == study.seeds[:3]
    for folder in resources.files("sayd_env.configs").iterdir():
        for file in folder.iterdir() if folder.is_dir() else ():
            if file.name.endswith(".yaml") and file.name != "reproduce.yaml":
                numbers = {int(n) for n in re.findall(r"(?<![\d.])\d{4}(?![\d.])", file.read_text())}
                assert not numbers & set(study.seeds), file.name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("seeds=[1, 2, 1]", "seeds: 1 is a duplicate"),
        ("speeds_kmh.new=[300.0, 280.0]", "speeds must rise: 280 follows 300"),
        ("speeds_kmh.sayd=[300.0, 350.0]", "must hold 400, which a row is about"),
        ("fixed=[mppt1]", "'mppt1': expected policies of one command, such as constant:0.4"),
        ("assumptions=[{name: a, track: chine, seeds: 1}]", "did you mean 'china'"),
        ("assumptions=[{name: a, creep_law: polac, seeds: 1}]", "creep_law"),
    ],
)
def test_what_cannot_be_is_refused_by_name(change: str, message: str):
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_reproduction(overrides=[change])


def test_more_seeds_than_there_are_need_a_first_one():
    with pytest.raises(ConfigError, match="21 seeds: the study has 20; name the first with --seed"):
        load_reproduction().first_seeds(21)
