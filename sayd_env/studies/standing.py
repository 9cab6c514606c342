"""How policies stand beside each other, in words: what the page of a study says first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sayd_env.report.html import Verdict


@dataclass(frozen=True)
class Standing:
    """A policy over all conditions of a study."""

    policy: str
    J: float
    """Mean."""
    largest_ratio: float
    """Largest ratio to a limit of EN 14363."""
    derailed: int = 0
    """Runs."""


def verdict(standings: Sequence[Standing], where: str, not_judged: str = "") -> Verdict:
    """Say which policy costs least, and which ones keep the limits.

    Parameters
    ----------
    standings : sequence of Standing
        At least one.
    where : str
        What was run: ``3 conditions``.
    not_judged : str
        A sentence on limits that could not be looked at.

    Returns
    -------
    Verdict
        Good where all policies keep the limits, bad where none does.
    """
    ranked = sorted(standings, key=lambda each: each.J)
    best = ranked[0]
    words = f"Lowest mean J over {where}: {best.policy}, {best.J:.4f}"
    if len(ranked) > 1 and 0.0 < ranked[1].J < math.inf:
        below = round(100.0 * (1.0 - best.J / ranked[1].J))
        words += f", {below} % below {ranked[1].policy}" if below else f", about as low as {ranked[1].policy}"
    within = [each for each in standings if each.largest_ratio <= 1.0 and not each.derailed]
    above = [each for each in standings if each not in within]
    lines = [f"{words}."]
    if within:
        limits = "the limits of EN 14363 that were looked at" if not_judged else "all limits of EN 14363"
        lines.append(f"Within {limits}: {', '.join(each.policy for each in within)}.")
    if above:
        lines.append(f"Not within them: {', '.join(map(_excess, above))}.")
    lines += [not_judged] if not_judged else []
    return Verdict(lines, None if within and above else bool(within))


def _excess(standing: Standing) -> str:
    if standing.derailed:
        return f"{standing.policy} (derailed in {standing.derailed} runs)"
    return f"{standing.policy} ({standing.largest_ratio:.2f} times a limit at most)"
