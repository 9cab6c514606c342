"""From scenario flags to a scenario."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sayd_env.config.scenario import Scenario

WEAR_OF = {"new": 0.0, "worn": 1.0}


def scenario_from(
    config: str | None = None,
    assignments: Iterable[str] | None = None,
    *,
    profile: str | None = None,
    wear: float | None = None,
    friction: float | None = None,
    track: str | None = None,
    damper: str | None = None,
) -> Scenario:
    """Read the configuration and apply the flags, then the assignments of ``--set``.

    Parameters
    ----------
    config : str, optional
        ``--config``: a packaged study or a YAML file.
    assignments : iterable of str, optional
        ``--set``: key=value.
    profile : str, optional
        ``--profile``: ``new`` and ``worn`` are the scenario's own wheels at wear 0 and 1, anything else is
        the name or path of a wheel profile, unworn unless `wear` says otherwise.
    wear, friction : float, optional
        ``--wear`` (stronger than new and worn) and ``--friction``.
    track : str, optional
        ``--track``: name or path.
    damper : str, optional
        ``--damper``: passive or sayd.

    Raises
    ------
    ConfigError
        A name, file or value that cannot be used.
    """
    from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - keeps --help fast

    if wear is None and profile is not None:
        wear = WEAR_OF.get(profile, 0.0)
    wheel = None if profile in WEAR_OF else profile
    flags = {"wheel": wheel, "wear": wear, "friction": friction, "track": track, "damper": damper}
    # JSON is YAML: quoting keeps a name like "1e3" or "no" a name.
    given = [f"{key}={json.dumps(value)}" for key, value in flags.items() if value is not None]
    return load_scenario(config, [*given, *(assignments or ())])
