"""Who sees what: an actor without the truth, a critic with it, an estimator that learns it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
torch = pytest.importorskip("torch", reason="needs the extra 'train'")

from sayd_env.agents.config import TrainConfig, load_train  # noqa: E402
from sayd_env.agents.learner import estimator_layers, make_model, policy_layers  # noqa: E402
from sayd_env.agents.learning_env import make_learning_env  # noqa: E402
from sayd_env.agents.networks import EstimatorTrainer, asymmetric_inputs  # noqa: E402
from sayd_env.config import ConfigError  # noqa: E402
from sayd_env.envs.privileged import CONDITIONS  # noqa: E402

SMALL = {
    "ppo": ["learning.n_steps=16", "learning.batch_size=32", "learning.n_epochs=1", "total_steps=256"],
    "sac": ["learning.learning_starts=20", "learning.batch_size=32", "learning.buffer_size=400"],
}


def config_of(algorithm: str, folder: Path, *more: str) -> TrainConfig:
    """Two vehicles on straight track and two on lines."""
    (folder / "straight.yaml").write_text("base: training\nrun_in: 20.0\n")
    (folder / "line.yaml").write_text("base: training-line\nrun_in: 20.0\n")
    beside = f"environment.beside=[{{name: {folder / 'line.yaml'}, vehicles: 2, episode_s: 0.6}}]"
    first = [f"environment.name={folder / 'straight.yaml'}", "environment.vehicles=2"]
    return load_train(algorithm, [*SMALL[algorithm], *first, "environment.episode_s=0.4", beside, *more])


@pytest.fixture(scope="module", params=["ppo", "sac"])
def learner(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    config = config_of(request.param, tmp_path_factory.mktemp("env"))
    env, encoding = make_learning_env(config)
    env.seed(5)
    model = make_model(config, env)
    yield config, env, encoding, model, env.reset()
    env.close()


def test_an_observation_holds_the_truth_behind_the_inputs(learner: Any) -> None:
    config, env, encoding, _, observed = learner
    assert observed.shape == (8, encoding.size + len(config.privileged))
    straight, line = (part.vector.batch for part in env.unwrapped.parts)
    place = list(config.privileged).index("speed")
    map_ = config.privileged["speed"]
    for rows, batch in ((observed[:4], straight), (observed[4:], line)):
        speeds = rows[::2, encoding.size + place] * map_.half + map_.middle
        np.testing.assert_allclose(speeds, [each.speed for each in batch.episodes], rtol=1e-5)
        np.testing.assert_array_equal(rows[::2, encoding.size :], rows[1::2, encoding.size :])


def test_the_actor_is_blind_for_the_truth(learner: Any) -> None:
    _, _, encoding, model, observed = learner
    other = observed.copy()
    other[:, encoding.size :] += 1.0
    np.testing.assert_array_equal(*(model.predict(each, deterministic=True)[0] for each in (observed, other)))
    with torch.no_grad():
        values = [_values(model, torch.as_tensor(each)) for each in (observed, other)]
    assert torch.all(values[0] != values[1])


def _values(model: Any, observations: Any) -> Any:
    if hasattr(model, "critic"):
        return model.critic(observations, torch.zeros(len(observations), 1))[0]
    return model.policy.predict_values(observations)


def test_the_policy_leaves_the_estimator_alone_and_it_the_policy(learner: Any) -> None:
    _, env, _, model, _ = learner
    before = estimator_layers(model)
    model.learn(128, log_interval=None)
    for one, other in zip(before, estimator_layers(model), strict=True):
        np.testing.assert_array_equal(one[0], other[0])
    policy, _ = policy_layers(model)
    model.estimating.pass_over(env.reset())
    assert any(np.any(a != b) for (a, _), (b, _) in zip(before, estimator_layers(model), strict=True))
    for one, other in zip(policy, policy_layers(model)[0], strict=True):
        np.testing.assert_array_equal(one[0], other[0])


def test_an_estimator_learns_what_the_inputs_show(learner: Any) -> None:
    config, _, encoding, model, observed = learner
    random = np.random.default_rng(0)
    rows = random.normal(size=(4096, observed.shape[1])).astype(np.float32)
    layout = asymmetric_inputs(model).layout
    for i, column in enumerate(layout.estimated):
        rows[:, column] = 0.5 * rows[:, i]
    trainer = EstimatorTrainer(model, config.estimate.model_copy(update={"batch_size": 64}))
    first = trainer.pass_over(rows)
    for _ in range(5):
        last = trainer.pass_over(rows)
    assert set(last) == {f"estimate/{name}" for name in config.estimate.conditions}
    assert all(last[name] < 0.3 * first[name] or last[name] < 0.1 for name in last)
    with torch.no_grad():
        seen = asymmetric_inputs(model).actor(torch.as_tensor(rows))
    guessed = seen[:, encoding.size :].numpy()
    assert np.sqrt(np.mean((guessed - 0.5 * rows[:, : guessed.shape[1]]) ** 2)) < 0.2


def test_conditions_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"critic: 'friktion' is not among privileged"):
        config_of("ppo", tmp_path, "critic=[friktion]")
    with pytest.raises(ConfigError, match="there is no condition 'friktion', did you mean 'friction'"):
        make_learning_env(config_of("ppo", tmp_path, "privileged.friktion={middle: 0.0, half: 1.0}"))
    assert set(load_train("ppo").privileged) <= set(CONDITIONS)
