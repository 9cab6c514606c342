"""The page of `sayd reproduce`: our figures beside what the paper shows, and every statement's verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sayd_env.report.files import json_text
from sayd_env.report.html import Block, Code, Grid, Picture, Section, Text, report
from sayd_env.studies.paper.claims import CLAIMS, Claim

TITLE = "The paper's statements, measured"


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper that has a counterpart here."""

    number: int
    heading: str
    shows: str
    """What the paper's figure shows, in our words."""
    compare: str
    """What to look at when both lie side by side."""
    rows: tuple[str, ...] = ()
    """Statements that are measured from it."""

    @property
    def prefix(self) -> str:
        """Start of the names of our pictures."""
        return f"figure_{self.number:02d}"


FIGURES = (
    PaperFigure(
        1,
        "Wheel and rail profiles, equivalent conicity",
        "How the worn S1002CN wheel meets the CN60 rail, and its equivalent conicity.",
        "The worn wheel's conicity lies far above the new one's at small amplitudes. The paper's measured "
        "worn profile is not published; ours is the new one with a hollow of calibrated depth and place.",
    ),
    PaperFigure(
        2,
        "Passive yaw damper: force over velocity",
        "The piecewise characteristic of the damper model.",
        "A steep start, a knee and a flat end. The text gives no values; force and velocity of the knee are "
        "calibrated.",
    ),
    PaperFigure(
        3,
        "Passive yaw damper: loops on a test rig",
        "Measured and simulated force over displacement at 1, 2 and 4 mm and 1 to 10 Hz.",
        "Loops that lean with the series stiffness, widen with amplitude and frequency, and are cut off at "
        "the force of the characteristic.",
        ("P11",),
    ),
    PaperFigure(
        8,
        "Passive vehicle on new wheels",
        "A filtered history at 280 km/h with its sliding RMS, and the largest RMS over speed.",
        "The level at 280 km/h, where the acceleration crosses its limit, and the frequency there.",
        ("P1", "P2", "P3"),
    ),
    PaperFigure(
        10,
        "Passive vehicle on worn wheels",
        "Dominant frequency, track shift force and acceleration of the four wheelsets over speed.",
        "Crossing of the acceleration's limit before that of the force, trailing wheelsets above leading "
        "ones, and frequencies that fall together and rise once the vehicle hunts.",
        ("P4", "P5", "P6", "P7", "P8", "P9", "P10"),
    ),
    PaperFigure(
        11,
        "MPPT1 over speed",
        "Dominant frequency and acceleration with the performance-only weights.",
        "Accelerations far below the limit up to 400 km/h, and frequencies without a trend: nothing hunts.",
        ("M1", "M2"),
    ),
    PaperFigure(
        12,
        "MPPT1 at 400 km/h over time",
        "Command of the rear bogie from a closed and from an open start, and the force of one damper.",
        "The closed start stays within a few percent; the open one comes down within some seconds and then "
        "goes the same way.",
        ("M3", "M4"),
    ),
    PaperFigure(
        13,
        "MPPT2 over speed",
        "The same as figure 11, with the damper force in the cost.",
        "A margin like MPPT1's, although the valves open more.",
        ("M5",),
    ),
    PaperFigure(
        14,
        "MPPT2 at 300 km/h over time",
        "Command and force at the lowest speed, where there is room to open the valves.",
        "Both starts meet at about a third of the opening; the force is lower than in figure 12, above all "
        "its fast part.",
        ("M6", "M7", "M8", "M9"),
    ),
    PaperFigure(
        15,
        "On-off skyhook over speed",
        "Dominant frequency, track shift force and acceleration.",
        "Both quantities stay below half of their limits.",
        ("S1",),
    ),
    PaperFigure(
        16,
        "On-off skyhook at 400 km/h over time",
        "Command of the rear bogie and force of one damper.",
        "The command knows two values and changes within less than a tenth of a second; the force peaks "
        "above those of MPPT.",
        ("S2", "S3"),
    ),
    PaperFigure(
        17,
        "Continuous skyhook over speed",
        "The same as figure 15, with a valve that may stop anywhere.",
        "Stable everywhere, the accelerations a little above those of figure 15.",
        ("S4",),
    ),
    PaperFigure(
        18,
        "Continuous skyhook at 400 km/h over time",
        "Command of the rear bogie and force of one damper.",
        "Swings between a slightly and a fully open valve, in spite of the continuous law, and a force with "
        "more fast components than in figure 16.",
        ("S5", "S6"),
    ),
)


def reproduce_page(
    claims: Sequence[Claim], images: Mapping[str, bytes], document: Mapping[str, Any], seeds: int
) -> str:
    """Return the page of all claims, PNG pictures whose names start with ``figure_NN``, ``result.json``."""
    verdicts = {claim.id: claim for claim in claims}
    figures = [
        Section(f"Figure {figure.number}: {figure.heading}", _figure_blocks(figure, images, verdicts))
        for figure in FIGURES
        if any(name.startswith(figure.prefix) for name in images)
    ]
    return report(TITLE, [_claims_section(claims, seeds), *figures, *_provenance(document)])


def _claims_section(claims: Sequence[Claim], seeds: int) -> Section:
    held = sum(claim.holds for claim in claims)
    words = (
        f"{held} of {len(claims)} rows hold, on {seeds} track seeds. The paper: Wang, Liu, Di Gialleonardo, "
        "Kovacic and Bruni, Vehicle System Dynamics 60(8), 2608-2633 (2022). A row judged by seed holds if "
        "at least 80 % of the seeds pass it; one judged by median, if the median over the seeds passes and "
        "at least 80 % of 1,000 bootstraps over the seeds do; one judged once has no randomness. What "
        "the paper's figures show is taken from its text."
    )
    return Section("Statements", [Text(words), _claims_grid(claims)])


def _claims_grid(claims: Sequence[Claim]) -> Grid:
    return Grid.of(CLAIMS, claims, frozenset(i for i, c in enumerate(claims) if not c.holds))


def _figure_blocks(
    figure: PaperFigure, images: Mapping[str, bytes], verdicts: Mapping[str, Claim]
) -> list[Block]:
    words = (f"In the paper: {figure.shows}", f"To compare: {figure.compare}")
    names = sorted(name for name in images if name.startswith(figure.prefix))
    blocks: list[Block] = [
        Picture(
            images[name], f"Counterpart of figure {figure.number}: {figure.heading}", words if i == 0 else ()
        )
        for i, name in enumerate(names)
    ]
    measured = [verdicts[row] for row in figure.rows if row in verdicts]
    return [*blocks, _claims_grid(measured)] if measured else blocks


def _provenance(document: Mapping[str, Any]) -> list[Section]:
    """Where the numbers come from: command, versions, and every origin that the configuration names."""
    about = [(key, document.get(key)) for key in ("command", "created", "seed", "git_commit", "git_modified")]
    versions = sorted(dict(document.get("versions") or {}).items())
    config = document.get("config") or {}
    origins: list[Block] = [
        Grid(("calibrated part", "what", "value"), [(path, key, str(value)) for key, value in origin.items()])
        for path, origin in _origins(config)
    ]
    return [
        Section("How this was computed", [Grid(("", ""), about), Grid(("software", "version"), versions)]),
        Section("Configuration", [*origins, Code("All values, in SI units", json_text(config))]),
    ]


def _origins(config: Any, path: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every non-empty section `provenance` of a configuration, with the key under which it stands."""
    if not isinstance(config, Mapping):
        return
    for key, value in config.items():
        if key == "provenance" and isinstance(value, Mapping) and value:
            yield path or "scenario", value
        else:
            yield from _origins(value, f"{path}.{key}".lstrip("."))
