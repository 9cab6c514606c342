"""What the comparison with an earlier commit makes of its figures; nothing is measured here."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import pytest


def _loaded(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(f"bench_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


check, measure = _loaded("check"), _loaded("measure")


def row(base: list[float], tree: list[float], **wanted: Any) -> Any:
    made = check.Row(check.Wanted("n", "what", "unit", **wanted))
    for side, values in ((check.BASE, base), (check.TREE, tree)):
        for value in values:
            made.add(side, {"value": value})
    return made


def test_rates_and_times_are_compared_by_medians() -> None:
    assert row([1.0, 9.0, 2.0], [4.0, 5.0, 0.1], ratio=2.0).ratio == 2.0
    assert row([1.0, 9.0, 2.0], [4.0, 5.0, 0.1], ratio=2.0).ok
    assert not row([2.0], [3.9], ratio=2.0).ok
    assert row([6.0], [2.0], ratio=3.0, is_time=True).ratio == 3.0
    # A first start of at most 1.7 times the base's.
    assert row([10.0], [16.9], ratio=1.0 / 1.7, is_time=True).ok
    assert not row([10.0], [17.1], ratio=1.0 / 1.7, is_time=True).ok


def test_limits_hold_for_the_tree_alone() -> None:
    assert row([1.0], [401.0], limit=400.0).ok
    assert not row([500.0], [399.0], limit=400.0).ok
    assert not row([500.0], [1200.0], ratio=2.5, limit=1300.0).ok
    assert row([50.0], [29.0], limit=30.0, is_time=True).ok


def test_a_small_share_of_the_environment_is_enough() -> None:
    slow = row([100.0], [], ratio=2.0, or_small_share=True)
    slow.add(check.TREE, {"value": 120.0, "share": 0.2})
    assert slow.ok
    slow.add(check.TREE, {"value": 120.0, "share": 0.4})
    assert not slow.ok  # 0.3 in the median


def test_what_the_tree_has_alone_is_compared_with_its_limit() -> None:
    made = row([], [1.04], limit=1.05, is_time=True, alone=True)
    assert made.ok
    assert made.as_dict()["ratio"] is None
    assert not row([], [1.06], limit=1.05, is_time=True, alone=True).ok


def test_every_wanted_quantity_can_be_measured() -> None:
    assert set(check.names()) == set(measure.MEASUREMENTS)


def test_the_exit_status_says_whether_something_is_missed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check, "checkout", lambda _: tmp_path)
    values = {check.ROOT: 10.0, tmp_path: 5.0}
    monkeypatch.setattr(check, "measure", lambda _, root: {"value": values[root]})
    assert check.main(["--only", "ppo", "--rounds", "2", "--json"]) == 0
    (reported,) = json.loads(capsys.readouterr().out)["rows"]
    assert (reported["ratio"], reported["ok"], reported["tree"]["values"]) == (2.0, True, [10.0, 10.0])
    values[tmp_path] = 5.1
    assert check.main(["--only", "ppo"]) == 1
    assert "NO" in capsys.readouterr().out


def test_what_cannot_be_measured_is_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check, "checkout", lambda _: tmp_path)
    assert check.main(["--only", "pppo"]) == 2
    assert "unknown 'pppo'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        check.main(["--rounds", "0"])
    assert "found '0'" in capsys.readouterr().err


def test_a_commit_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main(["--base", "no-such-commit"]) == 2
    assert "no-such-commit" in capsys.readouterr().err
