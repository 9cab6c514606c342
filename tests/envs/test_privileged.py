"""The true conditions of vehicles, beside what the parts that make them say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import load_scenario
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.privileged import AHEAD, CONDITIONS, HALF_CHORD, Conditions
from sayd_env.physics.contact.conicity import AMPLITUDE, equivalent_conicity, radius_difference
from sayd_env.physics.simulator import VehicleModel


@pytest.fixture(scope="module")
def batch() -> EpisodeBatch:
    """Two vehicles on lines of which everything is drawn, half a second on their way."""
    config = load_environment("line", ["run_in=20.0"])
    found = EpisodeBatch(config, 2, num_threads=1)
    found.reset([0, 1], [draw_episode(config, seed, 0) for seed in (3, 4)], whole_track=False)
    for _ in range(50):
        found.step(np.zeros((2, 2)))
    return found


def test_they_are_those_of_the_line_where_the_vehicle_is(batch: EpisodeBatch) -> None:
    conditions = Conditions(batch, list(CONDITIONS))
    conditions.begin([0, 1])
    found = {name: values for name, values in zip(CONDITIONS, conditions().T, strict=True)}
    for i, s in enumerate(batch.distance()):
        line, episode = batch.lines[i], batch.episodes[i]
        assert line is not None
        assert episode is not None
        assert found["speed"][i] == pytest.approx(float(line.speed_at(s)), rel=2e-3)
        assert found["friction"][i] == pytest.approx(float(line.friction.at(s)), abs=0.02)
        assert found["gauge"][i] == pytest.approx(float(line.gauge.at(s)), abs=1e-3)
        assert found["curvature"][i] == pytest.approx(abs(float(line.curvature.at(s))), abs=2e-6)
        assert found["wear"][i] == batch.model(i).scenario.wear
        assert found["payload"][i] == episode.payload
        (level,) = [piece.scale for piece in line.tracks if piece.start <= s < piece.end]
        assert found["track_level"][i] == level


def test_the_conicity_is_that_of_the_vehicles_own_table(batch: EpisodeBatch) -> None:
    """And on wider rails that of a table that was made for them."""
    conditions = Conditions(batch, ["conicity", "gauge"])
    conditions.begin([0, 1])
    model = batch.model(0)
    conicity, gauge = conditions()[0]
    track = model.scenario.track.model_copy(update={"gauge": float(gauge)})
    own = VehicleModel(model.scenario.model_copy(update={"track": track}))
    expected = equivalent_conicity(*radius_difference(own.table, own.right_table), [AMPLITUDE])[0]
    assert conicity == pytest.approx(expected, rel=0.05)


def on_track(*track: str) -> EpisodeBatch:
    """A vehicle at 350 km/h at its step 0, 100 m from the beginning of a track."""
    scenario = load_scenario("nominal", track)
    config = load_environment("nominal", ["run_in=100.0"])
    found = EpisodeBatch(config, 1, scenario=scenario, num_threads=1)
    found.reset([0], [draw_episode(config, 0, 0)], whole_track=False)
    return found


def test_the_versines_to_come_are_those_of_a_sine() -> None:
    """A wave a sin(2 pi x / l) has versines of a (1 - cos(2 pi h / l)) on chords of 2 h, as a wave."""
    batch = on_track("track=sine")
    conditions = Conditions(batch, ["versine_3s"])
    conditions.begin([0])
    irregularity = batch.model(0).scenario.track.irregularity
    gain = 1.0 - math.cos(2.0 * math.pi * HALF_CHORD / irregularity.wavelength)
    expected = irregularity.amplitude * gain / math.sqrt(2.0)
    assert conditions()[0, 0] == pytest.approx(expected, rel=0.02)  # no whole number of waves


def test_the_versines_at_the_end_of_an_episode_are_of_the_track_that_is_known() -> None:
    """It ends 150 m behind the episode, before the next three seconds do."""
    batch = on_track("track=sine")
    conditions = Conditions(batch, ["versine_3s"])
    conditions.begin([0])
    along = conditions._along[0][:, 0]
    assert along[-1] == pytest.approx(along[0], rel=0.05)  # zeros behind the end would make 0.65 of it


def test_the_versines_to_come_lie_ahead() -> None:
    """A defect two seconds ahead is within three seconds and not within one."""
    batch = on_track("track=defect", "track.irregularity.position=295")
    conditions = Conditions(batch, [*AHEAD])
    conditions.begin([0])
    one, three = conditions()[0]
    assert one == 0.0
    assert three > 1e-4


def test_a_level_that_is_not_drawn_is_the_tracks_own() -> None:
    """And a piece of a line that says none has the episode's."""
    batch = on_track("track.irregularity.scale=0.7")
    conditions = Conditions(batch, ["track_level"])
    conditions.begin([0])
    assert conditions()[0, 0] == 0.7
    rough = {"name": "rough", "length": 400.0, "track_scale": 0.9}
    line = {"description": "", "sections": [rough, {"name": "plain", "length": 4000.0}]}
    for scale, expected in ((None, 0.7), (0.5, 0.5)):
        fixed = {"line": line, "speed_kmh": 300.0} | ({} if scale is None else {"track_scale": scale})
        batch.reset([0], [draw_episode(batch.config, 0, 0, fixed)], whole_track=False)
        conditions.begin([0])
        assert conditions()[0, 0] == 0.9
        for _ in range(round(450.0 / (300.0 / 3.6) / batch.config.control_period)):
            batch.step(np.zeros((1, 2)))
        assert conditions()[0, 0] == expected


def test_the_deficiency_is_that_of_the_episodes_speed_where_the_line_has_none() -> None:
    """V^2 kappa b / g - cant, EN 14363: 106 mm at 350 km/h in a curve of 7 km with 100 mm."""
    batch = on_track("track=smooth")
    curve = {"name": "curve", "length": 4000.0, "radius": 7000.0, "turn": "left", "cant": 0.1}
    plain = {"name": "plain", "length": 50.0}
    line = {"description": "", "sections": [plain, curve | {"transition": 150.0}]}
    fixed = {"line": line, "speed_kmh": 350.0}
    batch.reset([0], [draw_episode(batch.config, 0, 0, fixed)], whole_track=False)
    conditions = Conditions(batch, ["deficiency", "speed"])
    conditions.begin([0])
    for _ in range(300):
        batch.step(np.zeros((1, 2)))
    expected = (350.0 / 3.6) ** 2 / 7000.0 * 1.5 / 9.81 - 0.1
    assert conditions()[0] == pytest.approx([expected, 350.0 / 3.6], rel=1e-3)
