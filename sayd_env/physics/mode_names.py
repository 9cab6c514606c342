"""Names for mode shapes in the field's terms, from the share of kinetic energy that each motion has."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from sayd_env.config.units import ComplexArray
from sayd_env.physics.layout import AXES, Instance
from sayd_env.physics.multibody import Multibody

TRACK = "track"
GROUPS = {
    "carbody": "carbody",
    "frame": "bogie",
    "wheelset": "wheelset",
    "hinged": "axlebox",
    "body": "body",
    TRACK: "track",
}
"""Roles of bodies and what they are called."""

MOTIONS = {
    "x": "longitudinal",
    "y": "lateral",
    "z": "bounce",
    "roll": "roll",
    "pitch": "pitch",
    "yaw": "yaw",
}
"""Degrees of freedom and what they are called."""

_MAJOR = 0.5  # share of the energy that makes a motion the mode's own
_MINOR = 0.1  # share below which a body does not take part
_PHASE = 0.5  # cosine of the phase angle up to which two motions are in phase


def describe(multibody: Multibody, shape: ComplexArray) -> str:
    """Name the motion of a mode shape.

    Parameters
    ----------
    multibody : Multibody
        The vehicle.
    shape : ndarray, shape (n,)
        Complex displacements.

    Returns
    -------
    str
        A carbody's bounce, pitch, yaw, lower or upper sway; a bogie's hunting (frame and wheelsets together
        in y and yaw), bounce, pitch, roll, ..., and whether two bogies move in phase; wheelset, axlebox and
        track motions.
    """
    part = _Parts(multibody, shape)
    if part.share("carbody") >= _MAJOR:
        return _carbody(part)
    if _hunts(part):
        return f"bogie hunting{part.phase('frame', ('y', 'yaw'))}"
    role = max(GROUPS, key=part.share)
    motion = max(MOTIONS, key=lambda dof: part.share(role, (dof,)))
    if role == "wheelset" and motion in ("x", "y", "z") and _together(part, motion):
        role = "frame"  # the wheelsets go with the bogie as a whole
    return f"{GROUPS[role]} {MOTIONS[motion]}{part.phase(role, (motion,))}"


def numbered(names: list[str], order: Iterable[int] | None = None) -> list[str]:
    """Make names unique: the second and later of equal ones get a number.

    Parameters
    ----------
    names : list of str
        Names that may repeat.
    order : iterable of int, optional
        Indices in the order in which the numbers are given; that of the list by default.
    """
    seen: Counter[str] = Counter()
    result = list(names)
    for i in range(len(names)) if order is None else order:
        seen[names[i]] += 1
        if seen[names[i]] > 1:
            result[i] = f"{names[i]} {seen[names[i]]}"
    return result


class _Parts:
    """A mode shape with the kinetic energy of every unknown, by bodies."""

    def __init__(self, multibody: Multibody, shape: ComplexArray) -> None:
        self.multibody = multibody
        self.shape = shape
        self.energy = multibody.mass * np.abs(shape) ** 2
        self.energy /= np.sum(self.energy)

    def instances(self, role: str) -> list[Instance]:
        """Bodies of a role, in the vehicle's order."""
        return [i for i in self.multibody.instances.values() if i.body.role == role]

    def columns(self, role: str, dofs: Iterable[str]) -> list[list[int]]:
        """Columns of the given freedoms, for each body of a role."""
        if role == TRACK:
            names = ("y", "z", "roll")
            return [[int(s[names.index(d)]) for d in dofs if d in names] for s in self.multibody.section_dofs]
        return [[i.columns[d] for d in dofs if d in i.columns] for i in self.instances(role)]

    def share(self, role: str, dofs: Iterable[str] = tuple(MOTIONS)) -> float:
        """Share of the energy."""
        return float(sum(np.sum(self.energy[c]) for c in self.columns(role, dofs)))

    def phase(self, role: str, dofs: Iterable[str]) -> str:
        """How the two bodies of a role move against each other, or which of them moves."""
        columns = self.columns(role, dofs)
        if len(columns) != 2 or role == TRACK:
            return ""
        first, second = columns
        a, b = np.sum(self.energy[first]), np.sum(self.energy[second])
        if min(a, b) < _MINOR * (a + b):
            body = self.instances(role)[0 if a > b else 1]
            return body.name.removeprefix(body.body.name).replace(".", " ")
        root = np.sqrt(self.multibody.mass)
        cosine = _cosine((root * self.shape)[first], (root * self.shape)[second])
        return " in phase" if cosine > _PHASE else " anti phase" if cosine < -_PHASE else " out of phase"


def _cosine(a: ComplexArray, b: ComplexArray) -> float:
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return float(np.vdot(a, b).real / size) if size > 0.0 else 0.0


def _carbody(part: _Parts) -> str:
    motion = max(MOTIONS, key=lambda dof: part.share("carbody", (dof,)))
    columns = part.instances("carbody")[0].columns
    if motion not in ("y", "roll") or "y" not in columns or "roll" not in columns:
        return f"carbody {MOTIONS[motion]}"
    # A point at height h over the centre moves by y - h roll: it rests at h = y / roll, the pole of the sway.
    pole = part.shape[columns["y"]] * part.shape[columns["roll"]].conj()
    return "carbody lower sway" if pole.real < 0.0 else "carbody upper sway"


def _hunts(part: _Parts) -> bool:
    """Whether frames and wheelsets together, moving as one in y and yaw, have most of the energy."""
    shares = part.share("frame", ("y", "yaw")), part.share("wheelset", ("y", "yaw"))
    return (
        sum(shares) >= _MAJOR * (1.0 - part.share("carbody"))
        and min(shares) >= _MINOR
        and _together(part, "y")
    )


def _together(part: _Parts, axis: str) -> bool:
    """Whether the wheelsets move along an axis as if they were fixed in their frames."""
    frames = part.instances("frame")
    if not frames:
        return False
    own: list[complex] = []
    carried: list[complex] = []
    for wheelset in part.instances("wheelset"):
        frame = min(frames, key=lambda f: abs(f.position[0] - wheelset.position[0]))
        direction = np.eye(3)[AXES[axis]]
        for body, motion in ((wheelset, own), (frame, carried)):
            motion.append(complex(part.multibody.point(body.name, wheelset.position, direction) @ part.shape))
    return _cosine(np.array(own), np.array(carried)) > _PHASE
