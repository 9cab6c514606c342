"""How does a wheelset steer? Equivalent conicity of a wheel profile on a rail profile (EN 15302).

Two contacts are distinguished. That of *rigid* profiles is what EN 15302 defines and measured profiles give;
where its contact point jumps, so does its rolling radius. The *regularised* one, averaged over the patch that
the static wheel load presses, is the contact table of the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.palette import BLUE, CYCLE, GREY, VERMILION
from sayd_env.config.profile import sides
from sayd_env.config.units import Array
from sayd_env.physics.contact.conicity import equivalent_conicity, harmonic_conicity, radius_difference
from sayd_env.physics.contact.geometry import ContactTable, RigidContact, contact_table, rigid_contact
from sayd_env.physics.multibody import assemble
from sayd_env.physics.profiles import Profile, rail_profile, wheel_profile
from sayd_env.physics.simulator import table_load
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, label, legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.config.scenario import Scenario

AMPLITUDES: Array = np.asarray(np.arange(10, 81) * 1e-4, dtype=np.float64)
"""Amplitudes of the conicity curve: 1 to 8 mm, around the range of EN 15302 (m)."""

_MILLI = 1e3
_SHOWN_AMPLITUDES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
_CONTACT_LINES_EVERY = 1e-3
_CONTACT_LINES_REACH = 8e-3
_NAMES_APART = 4e-3  # m on the wheel between contact lines whose positions are written beside them

CURVE = (
    Column("amplitude_mm", "amplitude", "mm"),
    Column("tan_gamma_e", "rigid: EN 15302", digits=3),
    Column("tan_gamma_e_table", "regularised: EN 15302", digits=3),
    Column("tan_gamma_harmonic", "regularised: harmonic", digits=3),
)
"""Of the conicity curve."""


@dataclass(frozen=True)
class Side:
    """Wheel and rail of one side. Right ones stand as left ones: their table is read at minus the shift."""

    wheel: Profile
    rail: Profile
    contact: RigidContact
    """Touching points of the rigid profiles."""
    table: ContactTable
    """The regularised table."""

    def as_dict(self) -> dict[str, str]:
        """Return names of the profiles."""
        return {"wheel": self.wheel.name, "rail": self.rail.name}


@dataclass(frozen=True)
class ConicityResult:
    """Conicity and rolling radii of a wheelset; SI units."""

    sides: tuple[Side, ...]
    """The left one, and the right one where it differs."""
    wear: float
    """0 new to 1 worn."""
    gauge: float
    """m."""
    amplitude: Array
    """(m,) m."""
    tan_gamma_e: Array
    """(m,) equivalent conicity of the rigid profiles, as EN 15302 defines it; NaN where no motion of that
    amplitude passes through the centre."""
    tan_gamma_e_table: Array
    """(m,) the same of the regularised contact, the table that a simulation uses."""
    harmonic: Array
    """(m,) conicity of the regularised contact by harmonic linearisation; it exists for every profile."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was recognised and changed in measured profiles."""
        own = [profile for side in self.sides for profile in (side.wheel, side.rail)]
        return tuple(dict.fromkeys(note for profile in own for note in profile.notes))

    @property
    def title(self) -> str:
        """Wheels on rails, left and right ones where they differ."""
        names = [side.as_dict().values() for side in self.sides]
        wheels, rails = (" and ".join(dict.fromkeys(each)) for each in zip(*names, strict=True))
        return f"{wheels} (wear {self.wear:g}) on {rails}, gauge {self.gauge * _MILLI:g} mm"

    def delta_r(self) -> tuple[Array, Array, Array]:
        """Lateral position, rigid and regularised difference of the rolling radii (m), every 0.1 mm."""
        left, right = self.sides[0], self.sides[-1]
        rigid_y, rigid = radius_difference(left.contact, right.contact)
        table_y, soft = radius_difference(left.table, right.table)
        reach = round(rigid_y[-1] * 1e4)
        y = np.arange(-reach, reach + 1) * 1e-4
        return y, np.interp(y, rigid_y, rigid), np.interp(y, table_y, soft)

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        y, rigid, soft = self.delta_r()
        return {
            **self.sides[0].as_dict(),
            "right": self.sides[1].as_dict() if len(self.sides) > 1 else None,
            "notes": self.notes,
            "wear": self.wear,
            "gauge_mm": self.gauge * _MILLI,
            "load_kn": self.sides[0].table.load / _MILLI,
            "simulation_uses": "regularised",
            "amplitude_mm": self.amplitude * _MILLI,
            "tan_gamma_e": self.tan_gamma_e,
            "tan_gamma_e_table": self.tan_gamma_e_table,
            "tan_gamma_harmonic": self.harmonic,
            "y_mm": y * _MILLI,
            "delta_r_mm": rigid * _MILLI,
            "delta_r_table_mm": soft * _MILLI,
        }

    def tables(self) -> dict[str, Table]:
        """Return the conicity curve and the rolling radii."""
        found = self.as_dict()
        radii = ("y_mm", "delta_r_mm", "delta_r_table_mm")
        return {
            "conicity": csv_table(CURVE, self._curve()),
            "delta_r": (radii, np.column_stack([found[name] for name in radii]).tolist()),
        }

    def _curve(self) -> list[dict[str, float]]:
        """Conicities by amplitude, by `CURVE`."""
        found = self.as_dict()
        names = [column.name for column in CURVE]
        values = np.column_stack([found[name] for name in names]).tolist()
        return [dict(zip(names, row, strict=True)) for row in values]

    def plots(self) -> dict[str, Plot]:
        """Return the picture: profiles in contact, conicity, rolling radii (figure 1 of the paper)."""
        return {"conicity": lambda figure: plot_conicity(figure, [self])}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the conicity at whole amplitudes, with `wide` at all of them."""
        rows = [
            row for row in self._curve() if wide or np.any(np.isclose(row["amplitude_mm"], _SHOWN_AMPLITUDES))
        ]
        Listing(self.title, CURVE, rows).print(console, wide)
        console.print(
            "rigid: touching points of the profiles. regularised: mean over the patch under "
            f"{self.sides[0].table.load / _MILLI:g} kN a wheel, as a simulation has it."
        )


def conicity(scenario: Scenario, amplitudes: Array = AMPLITUDES) -> ConicityResult:
    """Conicity of a scenario's wheels on its rails for amplitudes of the lateral motion (m).

    The range of the lateral position is the half width of the contact table, which is pressed by the static
    wheel load.

    Raises
    ------
    ConfigError, DataError
        A profile that cannot be used, or an amplitude beyond the contact table.
    """
    contact, gauge = scenario.contact, scenario.track.gauge
    if np.max(amplitudes) > contact.table_half_width:
        raise ConfigError(
            f"contact.table_half_width: found {contact.table_half_width:g} m, amplitudes up to "
            f"{np.max(amplitudes):g} m are asked for"
        )
    load = table_load(assemble(scenario.vehicle, scenario.track.section).wheel_load)
    pairs = [
        (wheel_profile(wheel, scenario.wear), rail_profile(rail))
        for wheel, rail in dict.fromkeys(sides(scenario.wheel, scenario.rail))
    ]
    radius, made = scenario.vehicle.wheel_radius, []
    for pair, other in zip(pairs, [*pairs[1:], *pairs[:1]] if len(pairs) > 1 else [None], strict=True):
        rigid = rigid_contact(*pair, gauge, contact.table_half_width, other=other)
        table = contact_table(*pair, gauge, contact, radius, load, other=other)
        made.append(Side(*pair, rigid, table))
    y, delta_r = radius_difference(made[0].contact, made[-1].contact)
    table_y, table_delta_r = radius_difference(made[0].table, made[-1].table)
    return ConicityResult(
        sides=tuple(made),
        wear=scenario.wear,
        gauge=gauge,
        amplitude=np.asarray(amplitudes, dtype=float),
        tan_gamma_e=equivalent_conicity(y, delta_r, amplitudes),
        tan_gamma_e_table=equivalent_conicity(table_y, table_delta_r, amplitudes),
        harmonic=harmonic_conicity(table_y, table_delta_r, amplitudes),
    )


def plot_conicity(figure: Figure, results: Sequence[ConicityResult]) -> None:
    """Draw profiles in contact with their contact lines, and conicity and rolling radii of all wheels."""
    shown = [(side, result.wear) for result in results for side in result.sides]
    figure.set_size_inches(10.0, 3.2 * (1 + len(shown)))
    grid = figure.add_gridspec(1 + len(shown), 2)
    first: Any = None
    for row, (side, wear) in enumerate(shown):
        # All to the same scale, one below the other.
        axes = figure.add_subplot(grid[row, :], sharex=first, sharey=first)
        first = first or axes
        _draw_side(axes, side, wear)
    curves, radii = figure.add_subplot(grid[-1, 0]), figure.add_subplot(grid[-1, 1])
    for i, each in enumerate(results):
        name = _label(each.sides[0], each.wear)
        conicities = (each.tan_gamma_e, each.tan_gamma_e_table, each.harmonic)
        _draw_ways(curves, i, name, each.amplitude, conicities)
        y, *differences = each.delta_r()
        near = np.abs(y) <= _CONTACT_LINES_REACH
        _draw_ways(radii, i, name, y[near], [difference[near] * _MILLI for difference in differences])
    curves.set(
        xlabel="amplitude (mm)", ylabel="equivalent conicity (-)", title="equivalent conicity, EN 15302"
    )
    radii.set(
        xlabel="lateral position (mm)",
        ylabel="difference (mm)",
        title="difference of rolling radii",
    )
    legend_below(figure, curves, columns=3)


def _label(side: Side, wear: float) -> str:
    return label(f"{side.wheel.name}, wear {wear:g}")


def _draw_side(axes: Axes, side: Side, wear: float) -> None:
    """Wheel above its rail in the centred position, points that touch joined by lines."""
    wheel, rail, contact, lift = side.wheel, side.rail, side.contact, 0.010
    offset = float(np.interp(0.0, contact.y, contact.s - contact.t))
    axes.plot(wheel.y * _MILLI, (lift - wheel.z) * _MILLI, BLUE, label=label(wheel.name))
    axes.plot((rail.y + offset) * _MILLI, rail.z * _MILLI, GREY, label=label(rail.name))
    named = np.array([])
    steps = int(min(_CONTACT_LINES_REACH, contact.y[-1]) / _CONTACT_LINES_EVERY + 1e-6)
    # The ends first, which always have their names.
    for y in _CONTACT_LINES_EVERY * np.array(sorted(range(-steps, steps + 1), key=lambda k: (-abs(k), k))):
        s, t = np.interp(y, contact.y, contact.s), np.interp(y, contact.y, contact.t)
        ends = lift - np.interp(s, wheel.y, wheel.z), np.interp(t, rail.y, rail.z)
        axes.plot(np.array([s, t + offset]) * _MILLI, np.array(ends) * _MILLI, VERMILION, linewidth=0.7)
        if np.all(np.abs(s - named) >= _NAMES_APART):
            # Beside a flank, above what is flat.
            steep = abs(np.interp(s, wheel.y, np.gradient(wheel.z, wheel.y))) > 1.0
            aside, up = (-1.0, 0.0) if steep else (0.0, 1.0)
            words = f"{y * _MILLI:+.0f}" if y else "0"
            place = s * _MILLI + aside, ends[0] * _MILLI + up
            axes.annotate(words, place, fontsize=7, ha="right" if steep else "center")
            named = np.append(named, s)
    axes.set(
        title=f"{_label(side, wear)} on {rail.name}: contact lines for y in mm",
        xlabel="distance from the tape circle (mm), field side positive",
        ylabel="height (mm)",
        aspect="equal",
    )
    axes.legend(loc="lower right")


_WAYS = {"rigid": "-", "regularised (simulated)": "--", "regularised, harmonic": ":"}
"""Lines of the contacts, and of the way of taking the conicity."""


def _draw_ways(axes: Axes, number: int, name: str, x: Array, curves: Sequence[Array]) -> None:
    """Draw a wheel's curves by each contact in the wheel's colour."""
    for (way, line), values in zip(_WAYS.items(), curves, strict=False):
        axes.plot(x * _MILLI, values, CYCLE[number % len(CYCLE)], linestyle=line, label=f"{name}: {way}")
    axes.grid(alpha=0.3)
