"""The way from an environment to its pictures, which are loaded when the first one is wanted."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from gymnasium.error import DependencyNotInstalled

from sayd_env.envs.fleet import Fleet


def open_scene(fleet: Fleet, vehicle: int, mode: str) -> Any:
    """Picture of one vehicle of a fleet.

    Parameters
    ----------
    fleet : Fleet
    vehicle : int
    mode : str
        ``rgb_array`` or ``human``.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        What draws is not installed.
    """
    try:
        module = import_module("sayd_env.envs.rendering")
    except ModuleNotFoundError as error:
        raise DependencyNotInstalled(f"render_mode '{mode}' needs the module '{error.name}'") from None
    return module.Scene(fleet, vehicle, mode)
