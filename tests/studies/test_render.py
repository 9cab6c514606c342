"""Videos: the right number of pictures at the right times, complete files, clear refusals."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

import sayd_env  # noqa: F401 - registers the environments
from sayd_env.cli import main
from sayd_env.config import ConfigError, StudyError
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.envs.canvas import Picture
from sayd_env.report.video import checked_video, write_video
from sayd_env.runs.policies import policy_specs
from sayd_env.studies.render import RenderResult, Video, render

pytest.importorskip("pygame")

COLOURS = np.array([[255, 0, 0], [0, 0, 255]], dtype=np.uint8)


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("env") / "quick.yaml"
    path.write_text("base: nominal\nrun_in: 20.0\nepisode_s: 0.2\n")
    return str(path)


@pytest.fixture(scope="module")
def environment(quick: str) -> EnvironmentConfig:
    return load_environment(quick)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("nominal")


def video(file: Path, policies: str = "constant:0.5", seconds: float = 0.2, fps: float = 25.0) -> Video:
    return Video(policy_specs(policies.split(",")), file, seconds, fps)


def blinking(count: int) -> Iterator[Picture]:
    for n in range(count):
        yield np.broadcast_to(COLOURS[n % 2], (32, 48, 3)).copy()


def test_a_gif_has_its_pictures_at_its_rate(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig
) -> None:
    file = tmp_path / "new" / "run.gif"
    result = render(video(file), scenario, environment)
    with Image.open(file) as found:
        assert found.n_frames == 5
        assert found.size == (1280, 720)
        assert found.info["duration"] == 40
        assert found.info["loop"] == 0
        pictures = []
        for n in range(5):
            found.seek(n)
            pictures.append(np.asarray(found.convert("RGB")))
    assert all(np.any(a != b) for a, b in pairwise(pictures))
    assert result.pictures == 5
    assert [row[0] for row in result.runs[0].rows] == pytest.approx([0.04, 0.08, 0.12, 0.16, 0.2])
    assert [path.name for path in file.parent.iterdir()] == ["run.gif"]


def test_policies_stand_side_by_side(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig
) -> None:
    """Each runs as alone, in a column of 484 pixels with spaces of 12, the same pixels wherever it stands."""
    file = tmp_path / "both.png"
    both = render(video(file, "passive,constant:0.5"), scenario, environment, seed=2)
    with Image.open(file) as found:
        picture = np.asarray(found.convert("RGB"))
    assert picture.shape[:2] == (704, 2 * 484 + 12 + 2 * 14)
    assert not np.any(np.mod(picture.shape[:2], 16))  # or a video would be scaled
    for run, name in zip(both.runs, ("passive", "constant:0.5"), strict=True):
        alone = render(video(tmp_path / "alone.png", name), scenario, environment, seed=2)
        assert run.policy == name
        assert run.rows == alone.runs[0].rows
        assert run.costs == alone.runs[0].costs
    header, rows = both.tables()["pictures"]
    assert list(header)[:2] == ["policy", "time_s"]
    assert [row[0] for row in rows] == ["passive", "constant:0.5"]
    # In the other order the columns change places, and the axes, which are common, do not change.
    render(video(file, "constant:0.5,passive"), scenario, environment, seed=2)
    with Image.open(file) as found:
        turned = np.asarray(found.convert("RGB"))
    column = slice(14, 14 + 484)
    np.testing.assert_array_equal(picture[60:-24, column], turned[60:-24, 510 : 510 + 484])


def test_a_learned_policy_stands_beside_others(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig, trained_file: Callable[..., None]
) -> None:
    """It has signals and a clock of its own, and the same track."""
    learned = tmp_path / "mine.npz"
    trained_file(learned)
    result = render(video(tmp_path / "both.png", f"passive,{learned}"), scenario, environment)
    assert [run.policy for run in result.runs] == ["passive", "ppo-s0"]
    assert [run.seconds for run in result.runs] == pytest.approx([0.2, 0.2])
    assert [run.rows[-1][:3] for run in result.runs] == [result.runs[0].rows[-1][:3]] * 2


def test_axes_stay_the_same_all_through_a_video(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig
) -> None:
    """Where a chart has its ticks no pixel changes from the first picture to the last."""
    file = tmp_path / "both.gif"
    render(video(file, "passive,constant:0.9"), scenario, environment)
    with Image.open(file) as found:
        assert found.n_frames == 5
        pictures = []
        for n in (0, 4):
            found.seek(n)
            pictures.append(np.asarray(found.convert("RGB")))
    for left in (14, 510):
        for top in (60 + 42 + 262, 60 + 42 + 262 + 158):  # ticks are left of the axes, and below
            ticks = np.s_[top + 26 : top + 158, left + 2 : left + 42]
            np.testing.assert_array_equal(pictures[0][ticks], pictures[1][ticks])
            assert len(np.unique(pictures[0][ticks])) > 1
    assert np.any(pictures[0] != pictures[1])


def test_a_png_shows_the_end(tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig) -> None:
    result = render(video(tmp_path / "end.png", seconds=0.15), scenario, environment)
    (run,) = result.runs
    assert run.rows[-1][0] == pytest.approx(0.15)
    assert run.seconds == pytest.approx(0.15)
    with Image.open(tmp_path / "end.png") as found:
        assert found.size == (1280, 720)


def test_a_video_plays(tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    render(video(tmp_path / "run.mp4", fps=30.0), scenario, environment)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "run.mp4"))
    assert frames == 6
    assert seconds == pytest.approx(0.2, abs=0.01)


def test_the_run_is_the_environments(
    quick: str, tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig
) -> None:
    result = render(video(tmp_path / "a.png"), scenario, environment, seed=3)
    env = gym.make("SAYD/Nominal-v1", environment=quick)
    env.reset(seed=3)
    rewards = [float(env.step(np.full(2, 0.5, dtype=np.float32))[1]) for _ in range(20)]
    env.close()
    assert result.runs[0].costs["J"] == pytest.approx(-sum(rewards) / 0.2, rel=1e-12)


def test_the_passive_vehicle_has_its_dampers(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig
) -> None:
    result = render(video(tmp_path / "a.png", "passive"), scenario, environment, speed=300 / 3.6)
    assert result.runs[0].rows[-1][-2:] == (None, None)
    assert result.as_dict()["speed_kmh"] == pytest.approx(300.0)


def test_a_run_that_ends_early_stops_the_video(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig
) -> None:
    # Any wheel is beyond a Y/Q limit that small: the run ends at once, and its last picture stays for 1 s.
    strict = environment.derailment.model_copy(update={"quotient": 1e-6})
    config = environment.model_copy(update={"derailment": strict})
    result = render(video(tmp_path / "a.gif", seconds=4.0, fps=5.0), scenario, config)
    ending = result.runs[0].ending
    assert ending is not None
    assert "derailment" in ending
    assert result.pictures <= 6


def test_a_failure_leaves_the_former_file(tmp_path: Path) -> None:
    file = tmp_path / "run.gif"
    file.write_bytes(b"former")

    def failing() -> Iterator[Picture]:
        yield from blinking(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(file, failing(), 25.0, COLOURS)
    assert file.read_bytes() == b"former"
    assert list(tmp_path.iterdir()) == [file]


def test_a_video_that_breaks_off_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setattr(ffmpeg, "count_frames_and_secs", lambda path: (2, 0.1))
    with pytest.raises(StudyError, match="2 of 3 pictures"):
        write_video(tmp_path / "run.mp4", blinking(3), 25.0, COLOURS)
    assert list(tmp_path.iterdir()) == []


def test_a_video_keeps_its_colours(tmp_path: Path) -> None:
    file = tmp_path / "run.gif"
    write_video(file, blinking(4), 10.0, COLOURS)
    with Image.open(file) as found:
        for n in range(4):
            found.seek(n)
            assert found.info["duration"] == 100
            assert found.convert("RGB").getpixel((5, 5)) == tuple(COLOURS[n % 2].tolist())


@pytest.mark.parametrize(
    ("name", "fps", "count", "problem"),
    [
        ("run.avi", 25.0, 10, "expected a file name that ends in .gif, .mp4, .png"),
        ("run", 25.0, 10, "expected a file name that ends in"),
        ("run.gif", 30.0, 10, "--fps 30: a GIF shows a picture for two or more whole hundredths"),
        ("run.gif", 100.0, 10, "--fps 100"),
        ("run.gif", 25.0, 1501, "1501 pictures are too many for a GIF, at most 1500"),
        ("file/run.gif", 25.0, 10, "cannot be written"),
        ("folder.gif", 25.0, 10, "a folder is in the way"),
    ],
)
def test_videos_that_cannot_be(tmp_path: Path, name: str, fps: float, count: int, problem: str) -> None:
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder.gif").mkdir()
    with pytest.raises(ConfigError) as error:
        checked_video(tmp_path / name, fps, count)
    assert problem in str(error.value)


def test_a_video_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ConfigError, match=r"pip install 'sayd-env\[video\]'"):
        checked_video(tmp_path / "run.mp4", 25.0, 10)


def test_pictures_need_their_extra(
    tmp_path: Path, scenario: Scenario, environment: EnvironmentConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ConfigError, match=r"pip install 'sayd-env\[render\]'"):
        render(video(tmp_path / "run.png"), scenario, environment)


def test_the_command_writes_pictures_and_json(
    quick: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "a.png", tmp_path / "out"
    options = ["--policy", "mppt2", "--speed", "300", "--profile", "worn", "--seconds", "0.1", "--json"]
    assert main(["render", *options, "--environment", quick, "-o", str(file), "--out", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["policy"] == "mppt2"
    assert printed["speed_kmh"] == pytest.approx(300.0)
    assert printed["wear"] == 1.0
    assert printed["pictures"] == 1
    assert printed["config"]["environment"]["run_in"] == 20.0
    assert sorted(path.name for path in out.iterdir()) == ["pictures.csv", "result.json"]
    with Image.open(file) as found:
        assert found.format == "PNG"


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--policy", "mppt9"], "policy 'mppt9': unknown"),
        (
            ["--policies", "passive,mppt1,mppt2,constant,skyhook-onoff"],
            "--policies: found 5",
        ),
        (["--policies", "mppt1,mppt1"], "policy 'mppt1': duplicate"),
        (["--seconds", "0"], "--seconds 0"),
        (["--seconds", "0.001"], "at least one control period"),
        (["--fps", "101", "-o", "a.mp4"], "--fps 101: expected at most one picture in a control period, 100"),
        (["--exaggeration", "-1"], "--exaggeration -1"),
        (["--speed", "900"], "speed_kmh: found 900"),
        (["--environment", "nominl"], "nominl"),
        (["-o", "a.bmp"], "expected a file name that ends in"),
    ],
)
def test_bad_options(
    options: list[str], problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = [] if "-o" in options else ["-o", str(tmp_path / "a.png")]
    assert main(["render", *options, *file, "--json"]) == 2
    message = capsys.readouterr().err
    assert problem in message
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_result_says_what_was_seen(tmp_path: Path) -> None:
    result = RenderResult(video(tmp_path / "a.gif"), 100.0, 0, 1.0, 0.4)
    assert result.as_dict()["speed_kmh"] == pytest.approx(360.0)
    assert dict(result.plots()) == {}
