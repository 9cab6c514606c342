"""The search for a training's settings, with a formula in place of trainings."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

pytest.importorskip("optuna", reason="needs the extra 'train'")

from sayd_env.agents.config import TrainConfig, load_train
from sayd_env.agents.search_config import RangeConfig, SearchConfig, load_search
from sayd_env.config import ConfigError
from sayd_env.config.errors import Interrupted, StudyError
from sayd_env.studies.tuning import training as study

BEST = 3.0
"""s, the look-ahead of the formula's minimum."""


def settings(**changes: Any) -> SearchConfig:
    ranges = {
        "discount_s": RangeConfig(low=1.0, high=9.0, log=True),
        "learning.n_epochs": RangeConfig(low=3.0, high=5.0, whole=True),
        "network.hidden": RangeConfig(choices=([64, 64], [32])),
    }
    asked = {
        "trials": 12,
        "random_trials": 4,
        "total_steps": 1_000_000,
        "finalist_seeds": (),
        "ranges": ranges,
    }
    asked |= changes
    return load_search("ppo").model_copy(update=asked)


def formula(config: TrainConfig) -> float:
    return 1.0 + math.log(config.discount_s / BEST) ** 2 + 0.1 * (config.learning.n_epochs != 4)


class Trainings:
    """Stands for `studies.learning.train`."""

    def __init__(self, dies_at: int | None = None, of: Exception | None = None) -> None:
        self.configs: list[TrainConfig] = []
        self._dies_at, self._end = dies_at, of or Interrupted("saved")

    def __call__(self, config: TrainConfig, folder: Path, *, stop_rule: Any, progress: Any, **_: Any) -> Any:
        self.configs.append(config)
        if len(self.configs) == self._dies_at:
            raise self._end
        cost, steps = formula(config), 0
        while steps < config.total_steps:
            steps += config.total_steps // 4
            progress(steps, config.total_steps, "")
            if stop_rule(steps + len(self.configs), cost):  # after a whole update, which differ
                break
        return SimpleNamespace(trained=SimpleNamespace(best=cost, steps=steps))


def test_the_search_comes_near_the_minimum_and_ships_a_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainings = Trainings()
    monkeypatch.setattr(study, "train", trainings)
    progress: list[float] = []
    result = study.search(
        "ppo", settings(), tmp_path / "s", progress=lambda done, total, what="": progress.append(done / total)
    )
    assert len(result.trials) == len(trainings.configs) == 12
    assert abs(math.log(result.best.settings["discount_s"] / BEST)) < 0.5
    assert progress == sorted(progress)
    assert all(config.seed == 900 and not config.evaluation.references for config in trainings.configs)
    # Two bogies of each of 64 vehicles make a decision, of 40 ms, together.
    assert result.simulated_s == pytest.approx(sum(trial.steps for trial in result.trials) / 2 * 0.04)
    assert any(trial.state == "pruned" and trial.steps < 1_000_000 for trial in result.trials)
    file = tmp_path / "ppo-tuned.yaml"
    file.write_text(result.training_file())
    found, packaged = load_train(str(file)), load_train("ppo")
    assert found.discount_s == result.best.settings["discount_s"]
    assert list(found.network.hidden) == result.best.settings["network.hidden"]
    assert (found.total_steps, found.evaluation) == (packaged.total_steps, packaged.evaluation)


def test_an_interrupted_search_goes_on_with_what_was_under_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = Trainings(dies_at=6), Trainings()
    monkeypatch.setattr(study, "train", first)
    with pytest.raises(Interrupted, match="5 of 12 trials are done"):
        study.search("ppo", settings(), tmp_path / "s")
    monkeypatch.setattr(study, "train", second)
    result = study.search("ppo", settings(), tmp_path / "s")
    assert len(result.trials) == 12
    assert len(second.configs) == 7
    assert second.configs[0] == first.configs[5]
    with pytest.raises(ConfigError, match="holds another search"):
        study.search("ppo", settings(trials=13), tmp_path / "s")


def test_a_search_of_a_training_that_was_edited_does_not_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its trials would be those of one training, and the file that it writes another's."""
    monkeypatch.setattr(study, "train", Trainings())
    own = tmp_path / "own.yaml"
    for clip_range in (0.2, 0.4):
        content = load_train("ppo", [f"learning.clip_range={clip_range}"]).model_dump(mode="json")
        own.write_text(yaml.safe_dump(content))
        if clip_range == 0.2:
            study.search("ppo", settings(training=str(own)), tmp_path / "s")
    with pytest.raises(ConfigError, match="holds another search"):
        study.search("ppo", settings(training=str(own)), tmp_path / "s")


def test_a_training_that_fails_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the same seed it would fail again, however often the command is repeated."""
    failing, second = Trainings(dies_at=6, of=StudyError("diverged")), Trainings()
    monkeypatch.setattr(study, "train", failing)
    with pytest.raises(StudyError, match="diverged"):
        study.search("ppo", settings(), tmp_path / "s", seed=2**32 - 1)
    monkeypatch.setattr(study, "train", second)
    assert len(study.search("ppo", settings(), tmp_path / "s", seed=2**32 - 1).trials) == 12
    assert failing.configs[5] not in second.configs


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"learning.tau": RangeConfig(low=0.1, high=0.2)}, "unknown key 'learning.tau'"),
        ({"learning.gae_lambda": RangeConfig(low=0.9, high=1.5)}, "gae_lambda"),
    ],
)
def test_settings_that_a_training_does_not_have_are_refused(
    ranges: dict[str, RangeConfig], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=message):
        study.search("ppo", settings(ranges=ranges), tmp_path / "s")
    with pytest.raises(ConfigError, match="is one of ppo"):
        study.search("sac", settings(), tmp_path / "s")


@pytest.mark.parametrize(("most", "first"), [(9.0, True), (1.5, False)])
def test_the_trainings_own_settings_are_tried_first(
    most: float, first: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the ranges hold them: the packaged training looks ahead for 2 s."""
    trainings = Trainings()
    monkeypatch.setattr(study, "train", trainings)
    ranges = {
        "discount_s": RangeConfig(low=1.0, high=most, log=True),
        "output.hold": RangeConfig(choices=(1, 2, 3)),
        "learning.n_epochs": RangeConfig(low=4.0, high=12.0, whole=True),
    }
    study.search("ppo", settings(ranges=ranges, trials=2), tmp_path / "s")
    packaged = load_train("ppo")
    own = trainings.configs[0].discount_s, trainings.configs[0].output, trainings.configs[0].learning
    assert (own == (packaged.discount_s, packaged.output, packaged.learning)) is first
    assert trainings.configs[1] != trainings.configs[0]


def test_a_choice_is_the_trainings_own_whatever_its_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The packaged training has an entropy bonus of 0.0, the range one of 0."""
    trainings = Trainings()
    monkeypatch.setattr(study, "train", trainings)
    ranges = {
        "learning.ent_coef": RangeConfig(choices=(0, 0.01)),
        "discount_s": RangeConfig(low=1.0, high=9.0, log=True),
    }
    study.search("ppo", settings(ranges=ranges, trials=1), tmp_path / "s")
    packaged = load_train("ppo")
    (first,) = trainings.configs[:1]
    assert (first.discount_s, first.learning.ent_coef) == (packaged.discount_s, packaged.learning.ent_coef)


@pytest.mark.parametrize(("worse", "own_wins"), [(1.0, True), (0.0, False)])
def test_luck_of_single_trainings_does_not_decide(
    worse: float, own_wins: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but the training's own settings (2 s) come out worse when they are repeated; or as they did."""
    trainings, repeated = Trainings(), dict[Path, list[int]]()
    own = load_train("ppo").discount_s

    def train_seeds(config: TrainConfig, seeds: list[int], folder: Path, *, progress: Any, **_: Any) -> Any:
        repeated[folder] = [*seeds]
        progress(0.0, 1.0)
        cost = formula(config) + (worse if config.discount_s != own else 0.0)
        return SimpleNamespace(best=dict.fromkeys(seeds, cost))

    monkeypatch.setattr(study, "train", trainings)
    monkeypatch.setattr(study, "train_seeds", train_seeds)
    asked = settings(finalists=2, finalist_seeds=(901, 902))
    own_in_ranges = asked.ranges | {"learning.n_epochs": RangeConfig(low=3.0, high=9.0, whole=True)}
    counts: list[tuple[float, float]] = []
    result = study.search(
        "ppo",
        asked.model_copy(update={"ranges": own_in_ranges}),
        tmp_path / "s",
        progress=lambda done, total, what="": counts.append((done, total)),
    )
    first, *others = sorted(t.cost or 9.0 for t in result.trials if t.state == "complete")
    assert [*repeated.values()] == [[901, 902]] * 3  # the best two, and the packaged settings
    assert (result.best.settings["discount_s"] == own) is own_wins
    assert result.best.mean == pytest.approx(result.best.cost)
    assert (result.best.cost == first) is not own_wins
    assert others
    assert result.as_dict()["mean_J"] == result.best.mean
    assert counts == sorted(counts)
    assert counts[-1] == ((12 + 2 * 2) * 1_000_000, (12 + 3 * 2) * 1_000_000)
    assert result.simulated_s > sum(trial.simulated_s for trial in result.trials)


def test_a_range_holds_numbers_alone() -> None:
    whole = RangeConfig(low=1.0, high=4.0, whole=True)
    assert [whole.holds(value) for value in (1, 4, 2.5, 5, None, "2")] == [True, True] + [False] * 4


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_the_packaged_searches_fit_their_trainings(name: str) -> None:
    found = load_search(name)
    assert found.training == name
    assert found.shortened().trials < found.trials
    base = load_train(name)
    for key, each in found.ranges.items():
        for value in each.choices or (each.low, each.high):
            study._with_settings(base, {key: int(value) if each.whole else value})
