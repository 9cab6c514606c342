"""The way from an environment to its pictures: what draws them is loaded when the first one is wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sayd_env.envs.recorder import Recorder

if TYPE_CHECKING:
    from sayd_env.envs.rendering import Renderer


def open_scene(recorder: Recorder, mode: str) -> Renderer:
    """Pictures of the vehicle that a recorder watches.

    Parameters
    ----------
    recorder : Recorder
    mode : str
        ``rgb_array`` or ``human``.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        pygame is not installed, or ``human`` finds no screen.
    """
    from sayd_env.envs.rendering import Renderer  # noqa: PLC0415 - Matplotlib's typeface takes its time

    return Renderer(recorder, mode)
