"""The rollout evaluator: policies run episodes, and all signals are kept for assessment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from sayd_env.config import StudyError
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array, Array32, Flags
from sayd_env.envs.cost import EpisodeCost, episode_cost, mean_squares
from sayd_env.envs.draw import Episode
from sayd_env.envs.episode_batch import EpisodeBatch, checked_actions
from sayd_env.envs.loop import BOGIES, LOG, RUNNING, TERMS
from sayd_env.physics.simulator import RUN_OUT


class Policy(Protocol):
    """A reference controller, a learned policy, or a model of Stable-Baselines3."""

    def predict(
        self,
        observation: Any,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Actions for observations of N vehicles, and the state for the next call."""


def uses_run_in(policy: Policy) -> bool:
    """Whether a policy takes the observations of the run-in: whether it has a method `state_after`."""
    return hasattr(policy, "state_after")


def first_state(policy: Policy, batch: EpisodeBatch) -> tuple[Any, Flags]:
    """State of a policy at step 0, and whether it begins there: what `predict` gets first.

    A policy on a train is already running at step 0: where the batch's last reset has kept the run-in, a
    policy with a method `state_after` gets it.
    """
    state = None
    if batch.observed_run_in is not None and uses_run_in(policy):
        state = policy.state_after(batch.observed_run_in)  # type: ignore[attr-defined]
    return state, np.full(batch.count, state is None)


@dataclass(frozen=True, eq=False)
class Rollout:
    """One episode of a policy, t samples and n control periods long."""

    episode: Episode
    control_period: float
    """s."""
    sample_rate: float
    """Hz."""
    run_in: int
    """Samples before step 0."""
    true: Array
    """(t, LOG) true signals from the start of the run-in, by the columns of `sayd_env.envs.loop`."""
    traced: Array
    """(t, kept) further true signals, those columns of `sayd_env.envs.trace` that were asked for."""
    actions: Array32
    """(n, A) valve commands."""
    rewards: Array
    """(n,) minus the mean of the bogies' J, by the on-line filter, without a charge for a termination."""
    terms: Array
    """(n, TERMS) cost of each period."""
    ending: str | None
    """Why the run ended early; None if it did not."""
    samples: int
    """How many there are of the run; the rest of the period in which it ended has no meaning."""
    intervened: Flags | None = None
    """(n, 2) whether the safe fallback intervened in a bogie; None for a policy without one."""

    @property
    def times(self) -> Array:
        """(t,) times of the samples, counted from step 0 (s)."""
        return np.asarray((np.arange(len(self.true)) + 1 - self.run_in) / self.sample_rate)

    def cost(self, seconds: float | None = None) -> tuple[float, float]:
        """Means over the first seconds of (psi_y / y_lim)^2 and (psi_F / F_max)^2, on-line filter.

        Parameters
        ----------
        seconds : float, optional
            How much of the run; by default its whole seconds.
        """
        return mean_squares(self.terms, self.control_period, seconds)

    def episode_cost(self, config: EnvironmentConfig, scenario: Scenario) -> EpisodeCost:
        """J over the episode of the environment that ran, with the charge for an early end."""
        terminated = self.ending is not None
        return episode_cost(self.terms, self.control_period, config, scenario.cost, terminated=terminated)


def assessed_steps(config: EnvironmentConfig, scenario: Scenario, speed: float) -> int:
    """Control periods from step 0 to the end of an assessed run at a speed (m/s), and a little beyond."""
    length = scenario.assessment.length or 0.0
    return math.ceil((length + RUN_OUT) / speed / config.control_period) - 1


def roll_out(
    batch: EpisodeBatch,
    policy: Policy,
    episodes: Sequence[Episode],
    steps: Sequence[int],
    *,
    keep: Sequence[int] = (),
) -> list[Rollout]:
    """Run one episode with each vehicle of a batch.

    Parameters
    ----------
    batch : EpisodeBatch
        As many vehicles as episodes.
    policy : Policy
        Acts on the observations of all.
    episodes : sequence of Episode
    steps : sequence of int
        Control periods of each; the episode's own end by time does not count.
    keep : sequence of int
        Columns of the trace that are kept, too; those of the motion only where the batch traces it.

    Raises
    ------
    ConfigError
        An episode that cannot be, or an action that is not allowed.
    StudyError
        A run whose numbers did not stay finite.
    """
    count, samples = batch.count, batch.settings.samples
    columns, seen = list(keep), list[Array]()

    def watch(_: int) -> None:
        seen.append(batch.vehicles.trace[:, :, columns])

    run_in = batch.reset(
        range(count),
        episodes,
        log=True,
        keep_run_in=uses_run_in(policy),
        watch=watch if columns else None,
        steps=steps,
    )
    before = [len(rows) for rows in run_in]
    lengths = [first + n * samples for first, n in zip(before, steps, strict=True)]
    true = [np.empty((length, LOG)) for length in lengths]
    traced = [np.empty((length, len(columns))) for length in lengths]
    for vehicle, head in enumerate(run_in):
        true[vehicle][: len(head)] = head
        # All run-ins end together, those of slow vehicles have begun before the others.
        for place, rows in enumerate(seen[len(seen) - len(head) // samples :]):
            traced[vehicle][place * samples : (place + 1) * samples] = rows[vehicle]
    seen.clear()
    most, shape = max(steps), (count, batch.interface.actions)
    actions = np.zeros((most, *shape), dtype=np.float32)
    rewards, terms = np.zeros((most, count)), np.zeros((most, count, TERMS))
    intervening = getattr(policy, "intervening", None)  # of a safe fallback
    intervened = None if intervening is None else np.zeros((most, count, BOGIES), dtype=np.bool_)
    log = np.zeros((count, samples, LOG))  # a run may end within its first period
    length = np.array(steps)
    observation = batch.observations()
    state, start = first_state(policy, batch)
    for n in range(most):
        action, state = policy.predict(observation, state, start, deterministic=True)
        start[:] = False
        actions[n] = checked_actions(action, shape)
        if intervening is not None and intervened is not None:
            intervened[n] = intervening(state)
        active = (length > n) & (batch.vehicles.status == RUNNING)
        if not active.any():
            break
        observation, _, _, _ = batch.step(actions[n], log=log, active=active)
        rewards[n], terms[n] = batch.vehicles.rewards, batch.vehicles.terms
        for i in np.flatnonzero(active):
            first = before[i] + n * samples
            true[i][first : first + samples] = log[i]
            if columns:
                traced[i][first : first + samples] = batch.vehicles.trace[i][:, columns]
    return [
        _rollout(batch, i, before[i], true[i], traced[i], actions, rewards, terms, intervened, steps[i])
        for i in range(count)
    ]


def _rollout(
    batch: EpisodeBatch,
    i: int,
    before: int,
    true: Array,
    traced: Array,
    actions: Array32,
    rewards: Array,
    terms: Array,
    intervened: Flags | None,
    steps: int,
) -> Rollout:
    episode = batch.episodes[i]
    assert episode is not None  # the reset has set it
    ended = int(batch.vehicles.status[i]) != RUNNING
    taken = int(batch.elapsed[i]) if ended else steps
    if ended and not np.all(np.isfinite(terms[:taken, i])):
        raise StudyError(f"the run of seed {episode.seed} at {episode.speed * KMH:g} km/h diverged")
    end = before + taken * batch.settings.samples
    return Rollout(
        episode=episode,
        control_period=batch.settings.control_period,
        sample_rate=batch.settings.sample_rate,
        run_in=before,
        true=true[:end],
        traced=traced[:end],
        actions=actions[:taken, i].copy(),
        rewards=rewards[:taken, i].copy(),
        terms=terms[:taken, i].copy(),
        intervened=None if intervened is None else intervened[:taken, i].copy(),
        ending=batch.ending(i) if ended else None,
        samples=min(end, before + int(batch.vehicles.memory.view(i).counter[0])),
    )
