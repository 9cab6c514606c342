"""The linearised vehicle as a state space: x' = A x + B u, y = C x + D u, with names and units.

Inputs are forces of ideal actuators beside the yaw dampers, the irregularities under each wheelset and the
commands of semi-active dampers; outputs the sensors of `sayd_env.config.sensors` that a departure moves.

The contact reads irregularities w and their slopes, at the speed V the rates w' = V dw/ds, by the columns
B_0 and B_1 of the same compiled right-hand side. With the states x - B_1 w the rates are gone,

    (x - B_1 w)' = A (x - B_1 w) + (B_0 + A B_1) w,    C x = C (x - B_1 w) + C B_1 w

so the velocities of wheelsets and track sections among the states are less what the rails' rates make of
them. Angles of rotation of the wheelsets, on which nothing depends, are left out.

Each wheelset has irregularities of its own: the model holds for any track. `StateSpace.delayed` gives the
followers what the first wheelset sees, each later by its distance over V, in Pade approximation.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.io import savemat
from scipy.signal import besselap

from sayd_env.config import ConfigError, nearest
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array, ComplexArray
from sayd_env.physics.equivalent_damper import STATE_UNITS
from sayd_env.physics.layout import longitudinal_rows
from sayd_env.physics.linear import Linearisation, OperatingPoint, equivalent, equivalent_plant, rates_of
from sayd_env.physics.plant import Plant
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.track.realisation import TrackRealisation

CHANNEL_UNITS = dict(zip(CHANNELS, ("m", "m", "rad", "m"), strict=True))
"""Irregularities and their units."""

_RAIL = 0.25  # m between the knots of a track on which each wheelset has its own
_MARGIN = 8  # knots beyond the outermost wheelsets
_VALUE = 1e-8  # m, rad: difference of an irregularity
_RATE = 1e-6  # m/s, rad/s: of its rate


@dataclass(frozen=True)
class StateSpace:
    """x' = a x + b u, y = c x + d u of departures from steady running, SI units.

    Examples
    --------
    >>> one = StateSpace(*map(np.atleast_2d, (-2.0, 1.0, 1.0, 0.0)), ("x",), ("u",), ("y",), {})
    >>> f"{abs(one.response([1.0 / np.pi])[0, 0, 0]):.4f}"
    '0.3536'
    """

    a: Array
    b: Array
    c: Array
    d: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: dict[str, str]
    """Of states, inputs and outputs."""

    def response(self, frequencies: npt.ArrayLike) -> ComplexArray:
        """Frequency response C (i omega - A)^-1 B + D at frequencies (Hz), shape (f, outputs, inputs)."""
        eye = np.eye(len(self.a))
        return np.array(
            [
                self.c @ np.linalg.solve(2j * np.pi * f * eye - self.a, self.b) + self.d
                for f in np.atleast_1d(np.asarray(frequencies, dtype=float))
            ]
        )

    def select(self, inputs: Iterable[str] | None = None, outputs: Iterable[str] | None = None) -> StateSpace:
        """Return the system with some inputs and outputs, in this order; None: all of them.

        Raises
        ------
        ConfigError
            There is none of a name.
        """
        i = _places("input", self.inputs, inputs)
        o = _places("output", self.outputs, outputs)
        return replace(
            self,
            b=self.b[:, i],
            c=self.c[o],
            d=self.d[np.ix_(o, i)],
            inputs=tuple(self.inputs[k] for k in i),
            outputs=tuple(self.outputs[k] for k in o),
        )

    def combined(self, groups: dict[str, dict[str, float]]) -> StateSpace:
        """Return the system whose inputs are groups of these: name of each and the shares of its members.

        The first member's unit becomes the group's.

        Raises
        ------
        ConfigError
            There is none of a member's name.
        """
        share = np.zeros((len(self.inputs), len(groups)))
        for k, members in enumerate(groups.values()):
            share[_places("input", self.inputs, members), k] = list(members.values())
        units = {name: self.units[next(iter(members))] for name, members in groups.items()}
        return replace(
            self,
            b=self.b @ share,
            d=self.d @ share,
            inputs=tuple(groups),
            units={**self.units, **units},
        )

    def delayed(self, wheelsets: Sequence[str], delays: Sequence[float], order: int) -> StateSpace:
        """Return the system in which one track passes under all wheelsets.

        Parameters
        ----------
        wheelsets : sequence of str
            Places in the names of the irregularities, the first wheelset first: ``front.leading``, ...
        delays : sequence of float
            Time (s) by which each sees what the first one saw, rising from 0.
        order : int
            Of the diagonal Pade approximation of each delay: all-pass, its phase within 1 degree up to
            0.28 (order - 2) periods of the longest time from one wheelset to the next.

        Returns
        -------
        StateSpace
            With the inputs ``alignment``, ... in place of ``alignment.front.leading``, ...; the others stay.

        Raises
        ------
        ConfigError
            An order below 1 or above 25, delays that do not rise from 0, or a wheelset that there is not.
        """
        if not 1 <= order <= 25:
            raise ConfigError(f"order of a delay: found {order}, expected a whole number from 1 to 25")
        if len(delays) != len(wheelsets) or delays[0] != 0.0 or np.any(np.diff(delays) <= 0.0):
            raise ConfigError(
                f"delays: found {list(delays)}, expected {len(wheelsets)} numbers that rise from 0"
            )
        kept = [name for name in self.inputs if name.partition(".")[0] not in CHANNELS]
        tracks = [name for name in CHANNELS if any(i.startswith(f"{name}.") for i in self.inputs)]
        *chain, states = _chain(delays, order)
        count = len(tracks)
        own = [f"{name}.{place}" for name in tracks for place in wheelsets]
        seen, rest = self.select(own), self.select(kept)
        a, b, c, d = (np.kron(np.eye(count), part) for part in chain)
        zero = np.zeros((len(a), len(kept)))
        return StateSpace(
            a=np.block([[self.a, seen.b @ c], [np.zeros((len(a), len(self.a))), a]]),
            b=np.block([[rest.b, seen.b @ d], [zero, b]]),
            c=np.hstack([self.c, seen.d @ c]),
            d=np.hstack([rest.d, seen.d @ d]),
            states=(*self.states, *(f"{name}.delay.{k}" for name in tracks for k in range(states))),
            inputs=(*kept, *tracks),
            outputs=self.outputs,
            units={
                **self.units,
                **{name: CHANNEL_UNITS[name] for name in tracks},
                **{f"{name}.delay.{k}": CHANNEL_UNITS[name] for name in tracks for k in range(states)},
            },
        )

    def arrays(self) -> dict[str, Any]:
        """A, B, C, D, names of states, inputs and outputs, and their units, as arrays by name."""
        named = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        return {
            "A": self.a,
            "B": self.b,
            "C": self.c,
            "D": self.d,
            **{key: np.array(names) for key, names in named.items()},
            **{f"{key[:-1]}_units": np.array([self.units[n] for n in names]) for key, names in named.items()},
        }

    def npz(self) -> bytes:
        """The content of a NumPy file of `arrays`."""
        file = io.BytesIO()
        np.savez_compressed(file, **self.arrays())
        return file.getvalue()

    def mat(self) -> bytes:
        """The content of a MATLAB file of `arrays`, names as cells for ``ss(...,'StateName',states)``."""
        cells = {k: v.astype(object) if v.dtype.kind == "U" else v for k, v in self.arrays().items()}
        file = io.BytesIO()
        savemat(file, cells, do_compression=True, oned_as="column")
        return file.getvalue()

    def to_control(self) -> Any:
        """Return it as a `control.StateSpace`.

        Raises
        ------
        ConfigError
            The library `control` is not installed.
        """
        try:
            import control  # noqa: PLC0415 - an extra
        except ImportError:
            raise ConfigError(
                "a control.StateSpace needs python-control: pip install 'sayd-env[control]'"
            ) from None
        return control.StateSpace(
            self.a,
            self.b,
            self.c,
            self.d,
            states=[name.replace(".", "_") for name in self.states],
            inputs=[name.replace(".", "_") for name in self.inputs],
            outputs=[name.replace(".", "_") for name in self.outputs],
            remove_useless_states=False,
        )


def state_space(model: VehicleModel, point: OperatingPoint) -> StateSpace:
    """Linearise a vehicle at an operating point.

    Parameters
    ----------
    model : VehicleModel
        The vehicle, its wheels, friction and dampers.
    point : OperatingPoint
        Speed, RMS of wheelset shift and stroke speed, current.

    Returns
    -------
    StateSpace
        Inputs ``force.*`` (N, tension beside a yaw damper), ``alignment.*``, ``vertical.*``,
        ``cross_level.*`` and ``gauge.*`` of each wheelset, with semi-active dampers ``command.*``, the change
        of the acting current times the pressure drop over its amplitude, see
        `sayd_env.physics.equivalent_damper`. Outputs
        ``lateral_acceleration.*``, ``longitudinal_acceleration.*``, ``stroke.*`` and with semi-active dampers
        ``pressure_a.*``, ``pressure_b.*``, true values: sensors' own errors are left out.

    Raises
    ------
    ConfigError, DataError, StudyError
        As `sayd_env.physics.linear.equivalent`.
    """
    return state_space_of(model, equivalent(model, point))


def state_space_of(model: VehicleModel, steady: Linearisation) -> StateSpace:
    """Return the state space of a linearised vehicle.

    Raises
    ------
    ConfigError
        Accelerometers stand on wheelsets.
    """
    body, n = model.multibody, model.multibody.n
    size, first = len(steady.matrix), 2 * n + len(model.dampers)
    places = [name.partition(".")[2] for name, _, _ in body.yaw_dampers]
    wheelsets = [name.partition(".")[2] for name, _ in body.measuring_points]
    a = steady.matrix
    value, rate = irregularity_columns(model, steady)
    value, rate = (np.pad(part, ((0, size - first), (0, 0))) for part in (value, rate))
    force = np.zeros((size, len(places)))
    force[n : 2 * n] = np.array([car - bogie for _, bogie, car in body.yaw_dampers]).reshape(-1, n).T
    force[n : 2 * n] /= body.mass[:, None]
    command = _command_columns(steady, size, first, len(places))
    b = np.hstack([force, value + a @ rate, command])
    rows, direct, outputs = _sensors(model, steady, places, wheelsets)
    if np.any(direct @ rate):
        raise ConfigError(
            f"{model.scenario.vehicle.name}: accelerometers on wheelsets feel the second derivative of the "
            "irregularities, which no state space gives; it needs bogie frames"
        )
    d = rows @ np.hstack([np.zeros_like(force), rate, np.zeros_like(command)])
    accelerations = direct @ a
    d += direct @ np.hstack([force, value + a @ rate, command])
    kept = np.delete(np.arange(size), body.wheelset_dofs[:, 4])
    states, units = _states(model, steady, places)
    inputs = {f"force.{place}": "N" for place in places}
    inputs |= {f"{name}.{w}": CHANNEL_UNITS[name] for name in CHANNELS for w in wheelsets}
    if steady.sayd is not None:
        inputs |= {f"command.{place}": "-" for place in places}
    return StateSpace(
        a=a[np.ix_(kept, kept)],
        b=b[kept],
        c=(rows + accelerations)[:, kept],
        d=d,
        states=tuple(states[k] for k in kept),
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        units={**{states[k]: units[k] for k in kept}, **inputs, **outputs},
    )


def wheelset_delays(model: VehicleModel, speed: float) -> tuple[list[str], list[float]]:
    """Places of the wheelsets from the first on, and the times (s) by which they see what it saw."""
    x = model.multibody.wheelset_x
    order = np.argsort(-x)
    names = [model.multibody.measuring_points[k][0].partition(".")[2] for k in order]
    return names, [float((x[order[0]] - x[k]) / speed) for k in order]


def irregularity_columns(model: VehicleModel, steady: Linearisation) -> tuple[Array, Array]:
    """What irregularities under each wheelset and their rates do to the rates of (q, v, F).

    Returns
    -------
    value, rate : ndarray, shape (2 n + m, channels * w)
        By the irregularity (1/m, 1/rad) and by its rate at the wheelset; channel by channel.
    """
    body = model.multibody
    track, weights = _own_track(body.wheelset_x)
    plant = equivalent_plant(model, steady.speed, track, steady.tables, steady.stroke)
    x = np.concatenate([steady.q, steady.v, np.zeros(len(model.dampers))])
    work, table = model.work(), np.zeros_like(track.coefficients)

    def column(wheelset: int, channel: int, wanted: tuple[float, float], step: float) -> Array:
        knots, share = weights[wheelset]
        ends = []
        for sign in (1.0, -1.0):
            table[:] = 0.0
            table[knots, channel] = sign * (share @ wanted)
            ends.append(rates_of(_on(plant, table), work, x))
        return np.asarray((ends[0] - ends[1]) / (2.0 * step))

    pairs = [(w, c) for c in range(len(CHANNELS)) for w in range(len(body.wheelset_x))]
    value = [column(w, c, (_VALUE, 0.0), _VALUE) for w, c in pairs]
    rate = [column(w, c, (0.0, _RATE / steady.speed), _RATE) for w, c in pairs]
    return np.array(value).T, np.array(rate).T


def _on(plant: Plant, coefficients: Array) -> Plant:
    return plant._replace(irregularity=coefficients.ravel())


def _own_track(wheelset_x: Array) -> tuple[TrackRealisation, list[tuple[slice, Array]]]:
    """A track at whose position 0 every wheelset has coefficients of its own.

    With each of them, shape (4, 2): what gives it a value and none, or a slope and no value.
    """
    start = float(np.min(wheelset_x)) - _MARGIN * _RAIL
    count = math.ceil((float(np.max(wheelset_x)) - start) / _RAIL) + _MARGIN
    track = TrackRealisation(start, _RAIL, 0.0, np.zeros((count + 2, len(CHANNELS))))
    found = []
    for x in wheelset_x:
        first = int((x - start) / _RAIL)
        knots = slice(first, first + 4)
        answers = []
        for k in range(4):
            one = np.zeros_like(track.coefficients)
            one[first + k] = 1.0
            (value,), (slope,) = replace(track, coefficients=one).evaluate([x])
            answers.append((value[0], slope[0]))
        found.append((knots, np.linalg.pinv(np.array(answers).T)))
    return track, found


def _command_columns(steady: Linearisation, size: int, first: int, count: int) -> Array:
    if steady.sayd is None:
        return np.zeros((size, 0))
    columns = np.zeros((size, count))
    columns[first:] = np.kron(np.eye(count), steady.sayd.command[:, None])
    return columns


def _sensors(
    model: VehicleModel, steady: Linearisation, places: list[str], wheelsets: list[str]
) -> tuple[Array, Array, dict[str, str]]:
    """Rows of the outputs over the states and over their rates; names and units."""
    body, n, size = model.multibody, model.multibody.n, len(steady.matrix)
    first, count = 2 * n + len(model.dampers), len(places)
    lateral = np.array([row for _, row in body.measuring_points]).reshape(-1, n)
    along = longitudinal_rows(body.arrangement) if count else np.zeros((0, n))
    moving = np.pad(np.vstack([lateral, along]), ((0, 0), (n, size - 2 * n)))
    sides = list(dict.fromkeys(place.rpartition(".")[0] for place in places))
    outputs = {f"lateral_acceleration.{w}": "m/s2" for w in wheelsets}
    outputs |= {f"longitudinal_acceleration.{side}": "m/s2" for side in sides}
    still = np.zeros((0, size))
    if steady.sayd is None:
        yaw = np.array([bogie - car for _, bogie, car in body.yaw_dampers]).reshape(-1, n)
        still = np.pad(yaw, ((0, 0), (0, size - n)))
        outputs |= {f"stroke.{place}": "m" for place in places}
    else:
        names = steady.sayd.states
        for sensor, unit in (("pressure_a", "Pa"), ("pressure_b", "Pa"), ("stroke", "m")):
            row = np.array([[float(name == sensor) for name in names]])
            still = np.vstack([still, np.pad(np.kron(np.eye(count), row), ((0, 0), (first, 0)))])
            outputs |= {f"{sensor}.{place}": unit for place in places}
    rows = np.vstack([np.zeros_like(moving), still])
    return rows, np.vstack([moving, np.zeros_like(still)]), outputs


def _states(model: VehicleModel, steady: Linearisation, places: list[str]) -> tuple[list[str], list[str]]:
    """Names and units of (q, v, F, z)."""
    body = model.multibody
    turning = [name.rpartition(".")[2] in ("roll", "pitch", "yaw") for name in body.dof_names]
    names = [*body.dof_names, *(f"{name}.rate" for name in body.dof_names)]
    units = [*("rad" if turn else "m" for turn in turning), *("rad/s" if turn else "m/s" for turn in turning)]
    names += [f"{damper.name}.force" for damper in model.dampers]
    units += ["N"] * len(model.dampers)
    if steady.sayd is not None:
        names += [f"yaw_damper.{place}.{state}" for place in places for state in steady.sayd.states]
        units += [STATE_UNITS[state] for _ in places for state in steady.sayd.states]
    return names, units


def _places(kind: str, names: Sequence[str], wanted: Iterable[str] | None) -> list[int]:
    if wanted is None:
        return list(range(len(names)))
    found = []
    for name in wanted:
        if name not in names:
            raise ConfigError(f"the linear model has no {kind} '{name}'{nearest(name, list(names))}")
        found.append(names.index(name))
    return found


def _chain(delays: Sequence[float], order: int) -> tuple[Array, Array, Array, Array, int]:
    """One input through a delay after the other; outputs are the input and what each of them lets out."""
    gaps = np.diff(delays)
    a, b = np.zeros((0, 0)), np.zeros((0, 1))
    rows, direct = [np.zeros(0)], [1.0]
    for gap in gaps:
        part = _pade(float(gap), order)
        last = np.pad(rows[-1], (0, len(a) - len(rows[-1])))
        a = np.block([[a, np.zeros((len(a), order))], [part[1] @ last[None, :], part[0]]])
        b = np.vstack([b, part[1] * direct[-1]])
        rows.append(np.concatenate([part[3] * last, part[2].ravel()]))
        direct.append(direct[-1] * part[3])
    size = len(a)
    c = np.array([np.pad(row, (0, size - len(row))) for row in rows])
    return a, b, c, np.array(direct)[:, None], size


def _pade(delay: float, order: int) -> tuple[Array, Array, Array, float]:
    """Diagonal Pade approximation of a delay (s) as a chain of all-pass sections: A, B, C, D.

    Its poles are 2 / delay times those of the Bessel filter of unit group delay: both denominators are the
    reverse Bessel polynomial. Sections of first and second order keep the realisation well conditioned.
    """
    poles = besselap(order, norm="delay")[1] * 2.0 / delay
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 1.0
    for pole in poles[poles.imag > -1e-9 * np.abs(poles)]:
        part = _all_pass(complex(pole))
        a = np.block([[a, np.zeros((len(a), len(part[0])))], [part[1] @ c, part[0]]])
        b = np.vstack([b, part[1] * d])
        c = np.hstack([part[3] * c, part[2]])
        d *= part[3]
    return a, b, c, d


def _all_pass(pole: complex) -> tuple[Array, Array, Array, float]:
    """(-s - p) / (s - p), or with the conjugate pole (s + p) (s + p*) / ((s - p) (s - p*))."""
    if abs(pole.imag) < 1e-9 * abs(pole):
        p = pole.real
        return np.array([[p]]), np.array([[1.0]]), np.array([[-2.0 * p]]), -1.0
    size, lean = abs(pole), pole.real  # states scaled by |p|
    a = size * np.array([[0.0, 1.0], [-1.0, 2.0 * lean / size]])
    return a, np.array([[0.0], [1.0]]), np.array([[0.0, 4.0 * lean]]), 1.0
