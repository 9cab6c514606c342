"""Pages of the Python interface: which names they show; their docstrings say the rest."""

from __future__ import annotations

from sayd_env import stability

PAGES = {
    "Policies": ("From a name or a file to something with `predict`.", ["sayd_env.load_policy"]),
    "Simulator": (
        "`sayd_env.physics`: vehicle, contact, track and dampers, without Gymnasium and policies.",
        [
            "sayd_env.config.scenario.load_scenario",
            "sayd_env.physics.simulator.VehicleModel",
            "sayd_env.physics.simulator.Simulator",
            "sayd_env.physics.simulator.Telemetry",
            "sayd_env.physics.batch.BatchSimulator",
        ],
    ),
    "Stability": (
        "`sayd_env.stability`: EN 14363 and EN 12299, usable alone on measured signals.",
        [
            *(f"{getattr(stability, name).__module__}.{name}" for name in stability.__all__),
            "sayd_env.stability.comfort.mean_comfort",
            "sayd_env.stability.comfort.weighted",
        ],
    ),
    "Measured files": (
        "`sayd_env.measured`: readers of files that people have.",
        [
            "sayd_env.measured.profiles.read_profile_file",
            "sayd_env.measured.profiles.MeasuredProfile",
            "sayd_env.measured.tracks.read_measured",
            "sayd_env.measured.tracks.MeasuredTrack",
            "sayd_env.measured.lines.load_line",
            "sayd_env.measured.dampers.read_curve",
            "sayd_env.measured.valves.read_valve_map",
            "sayd_env.measured.valves.ThrottleField",
            "sayd_env.measured.table.read_text_table",
            "sayd_env.measured.table.TextTable",
        ],
    ),
    "Environments": (
        "`sayd_env.envs`: what `gymnasium.make` and `make_vec` give, and what a policy may know of it.",
        [
            "sayd_env.envs.single.SaydEnv",
            "sayd_env.envs.vector.SaydVectorEnv",
            "sayd_env.envs.environment.InvalidAction",
            "sayd_env.envs.interface.Interface",
            "sayd_env.envs.interface.Signal",
            "sayd_env.envs.wrappers.NormalizeSignals",
            "sayd_env.envs.wrappers.NormalizeVectorSignals",
            "sayd_env.envs.rollout.roll_out",
            "sayd_env.envs.rollout.Rollout",
        ],
    ),
    "Controllers": (
        "`sayd_env.baselines`: the paper's controllers, simpler ones, and opponents that are tuned.",
        [
            "sayd_env.baselines.make",
            "sayd_env.baselines.parse",
            "sayd_env.baselines.observation_layout.interface_of",
            "sayd_env.baselines.policy.Policy",
            "sayd_env.baselines.constant.Constant",
            "sayd_env.baselines.constant.Passive",
            "sayd_env.baselines.mppt.Mppt",
            "sayd_env.baselines.perturb_observe.PerturbAndObserve",
            "sayd_env.baselines.skyhook.OnOffSkyhook",
            "sayd_env.baselines.skyhook.ContinuousSkyhook",
            "sayd_env.baselines.speed_schedule.SpeedSchedule",
            "sayd_env.baselines.hunting_schedule.HuntingSchedule",
            "sayd_env.baselines.lqg.Lqg",
            "sayd_env.baselines.safe.SafeFallback",
        ],
    ),
    "Learning": (
        "`sayd_env.agents`: training with Stable-Baselines3, and policies in files that run without it.",
        [
            "sayd_env.agents.sb3_vec.SaydVecEnv",
            "sayd_env.agents.config.load_train",
            "sayd_env.agents.training.train",
            "sayd_env.agents.training.Trained",
            "sayd_env.agents.policy_file.load_policy",
            "sayd_env.agents.policy_file.read_policy",
            "sayd_env.agents.policy_file.save_policy",
            "sayd_env.agents.policy_file.LearnedPolicy",
            "sayd_env.agents.export.export_onnx",
        ],
    ),
}
"""By title: what the page says, and whose docstrings it shows."""


def pages() -> dict[str, str]:
    """Every page, by file name."""
    return {
        f"{title.lower().replace(' ', '-')}.md": "\n\n".join(
            [f"# {title}", text, *(f"::: {name}" for name in names), ""]
        )
        for title, (text, names) in PAGES.items()
    }
