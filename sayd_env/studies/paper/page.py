"""The page of `sayd reproduce`: our figures beside what the paper shows, and every statement's verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from sayd_env.report.columns import Listing
from sayd_env.report.html import Block, Grid, Page, Picture, Section, Text, Verdict
from sayd_env.studies.paper.assumptions import CRITICAL_SPEEDS, ByAssumption, side_by_side, speed_rows
from sayd_env.studies.paper.claims import Claim, claim_columns, claim_rows

TITLE = "The paper's statements, measured"


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper that has a counterpart here."""

    heading: str
    shows: str
    """What the paper's figure shows, in our words."""
    compare: str
    """What to look at when both lie side by side."""
    rows: tuple[str, ...] = ()
    """Statements that are measured from it."""


FIGURES = {
    1: PaperFigure(
        "Wheel and rail profiles, equivalent conicity",
        "How the worn S1002CN wheel meets the CN60 rail, and its equivalent conicity.",
        "The worn wheel's conicity lies far above the new one's at small amplitudes. The paper's measured "
        "worn profile is not published; ours is the new one with a hollow of calibrated depth and place.",
    ),
    2: PaperFigure(
        "Passive yaw damper: force over velocity",
        "The piecewise characteristic of the damper model.",
        "A steep start, a knee and a flat end. The text gives no values; force and velocity of the knee are "
        "calibrated. Beside it stands how far along the curve each loop of figure 3 goes.",
    ),
    3: PaperFigure(
        "Passive yaw damper: loops on a test rig",
        "Measured and simulated force over displacement at 1, 2 and 4 mm and 1 to 10 Hz.",
        "Loops that lean with the series stiffness, widen with amplitude and frequency, and are flattened "
        "beyond the knee of the characteristic.",
        ("P11",),
    ),
    8: PaperFigure(
        "Passive vehicle on new wheels",
        "A filtered history at 280 km/h with its sliding RMS, and the largest RMS over speed.",
        "The level at 280 km/h, where the acceleration crosses its limit, and the frequency there. The first "
        "speed above the limit has its history, too.",
        ("P1", "P2", "P3"),
    ),
    10: PaperFigure(
        "Passive vehicle on worn wheels",
        "Dominant frequency, track shift force and acceleration of the four wheelsets over speed.",
        "Crossing of the acceleration's limit before that of the force, trailing wheelsets above leading "
        "ones, and frequencies that fall together and rise once the vehicle hunts.",
        ("P4", "P5", "P6", "P7", "P8", "P9", "P10"),
    ),
    11: PaperFigure(
        "MPPT1 over speed",
        "Dominant frequency and acceleration with the performance-only weights.",
        "Accelerations far below the limit up to 400 km/h, and frequencies without a trend: nothing hunts.",
        ("M1", "M2"),
    ),
    12: PaperFigure(
        "MPPT1 at 400 km/h over time",
        "Command of the rear bogie from a closed and from an open start, and the force of one damper.",
        "The closed start stays within a few percent; the open one comes down within some seconds and then "
        "goes the same way.",
        ("M3", "M4"),
    ),
    13: PaperFigure(
        "MPPT2 over speed",
        "The same as figure 11, with the damper force in the cost.",
        "A margin like MPPT1's, although the valves open more.",
        ("M5",),
    ),
    14: PaperFigure(
        "MPPT2 at 300 km/h over time",
        "Command and force at the lowest speed, where there is room to open the valves.",
        "Both starts meet at about a third of the opening; the force is lower than in figure 12, above all "
        "its fast part.",
        ("M6", "M7", "M8", "M9"),
    ),
    15: PaperFigure(
        "On-off skyhook over speed",
        "Dominant frequency, track shift force and acceleration.",
        "Both quantities stay below half of their limits.",
        ("S1",),
    ),
    16: PaperFigure(
        "On-off skyhook at 400 km/h over time",
        "Command of the rear bogie and force of one damper.",
        "The command knows two values and changes within less than a tenth of a second; the force peaks "
        "above those of MPPT.",
        ("S2", "S3"),
    ),
    17: PaperFigure(
        "Continuous skyhook over speed",
        "The same as figure 15, with a valve that may stop anywhere.",
        "Stable everywhere, the accelerations a little above those of figure 15.",
        ("S4",),
    ),
    18: PaperFigure(
        "Continuous skyhook at 400 km/h over time",
        "Command of the rear bogie and force of one damper.",
        "Swings between a slightly and a fully open valve, in spite of the continuous law, and a force with "
        "more fast components than in figure 16.",
        ("S5", "S6"),
    ),
}
"""By number."""


def reproduce_page(
    claims: Sequence[Claim], plots: Iterable[str], seeds: int, by_assumption: ByAssumption | None = None
) -> Page:
    """Return the page of all claims, and of plots whose names start with ``figure_NN``.

    The rows under several assumptions stand on it where there are more than the study's own.
    """
    verdicts = {claim.id: claim for claim in claims}
    names = {number: sorted(n for n in plots if n.startswith(f"figure_{number:02d}")) for number in FIGURES}
    first = {row: names[number][0] for number, of in FIGURES.items() if names[number] for row in of.rows}
    figures = [
        Section(f"Figure {number}: {FIGURES[number].heading}", _figure_blocks(number, found, verdicts))
        for number, found in names.items()
        if found
    ]
    beside = _assumption_sections(by_assumption or {}, first)
    statements = Section("Statements", [Text(_JUDGED), _claims_grid(claims, first)])
    return Page(TITLE, _verdict(claims, seeds), [statements, *beside, *figures])


_JUDGED = (
    "The paper: Wang, Liu, Di Gialleonardo, Kovacic and Bruni, Vehicle System Dynamics 60(8), 2608-2633 "
    "(2022). A row judged by seed holds if at least 80 % of the seeds pass it; one judged by median, if the "
    "median over the seeds passes and at least 80 % of 1,000 bootstraps over the seeds do; one judged once "
    "has no randomness. What the paper's figures show is taken from its text. Columns named after a fixed "
    "command say whether it passes as well, in the place of the row's controller; rows about the motion of "
    "the command and about passive dampers do not apply to it. The name of a row leads to its figure."
)


def _verdict(claims: Sequence[Claim], seeds: int) -> Verdict:
    failed = [claim.id for claim in claims if not claim.holds]
    tracks = f"{seeds} track seed{'s' * (seeds != 1)}"
    words = f"{len(claims) - len(failed)} of {len(claims)} statements of the paper hold, on {tracks}."
    return Verdict([words, *([f"Not: {', '.join(failed)}."] if failed else [])], not failed)


def _assumption_sections(found: ByAssumption, figures: Mapping[str, str]) -> list[Section]:
    """Critical speeds, and the rows where there is more than one assumption."""
    if not found:
        return []
    own = {"new": figures.get("P2"), "worn": figures.get("P5")}
    table = Listing("", CRITICAL_SPEEDS, speed_rows(found), "assumption")
    grid = Grid.of(table, lambda row: own.get(row["wheels"]))
    speeds = Section("Critical speeds of the passive vehicle", [grid])
    words = "Whether each row holds, and its share of seeds or bootstraps, with one assumption changed."
    beside = Grid.of(Listing("", *side_by_side(found)), lambda row: figures.get(row["id"]))
    rows = Section("What each assumption carries", [Text(words), beside])
    return [rows, speeds] if len(found) > 1 else [speeds]


def _claims_grid(claims: Sequence[Claim], figures: Mapping[str, str] = MappingProxyType({})) -> Grid:
    listing = Listing("", claim_columns(claims), claim_rows(claims))
    return Grid.of(listing, lambda row: figures.get(row["id"]))


def _figure_blocks(number: int, names: Sequence[str], verdicts: Mapping[str, Claim]) -> list[Block]:
    figure = FIGURES[number]
    words = (f"In the paper: {figure.shows}", f"To compare: {figure.compare}")
    title = f"Counterpart of figure {number}: {figure.heading}"
    blocks: list[Block] = [Picture(name, title, words if name == names[-1] else ()) for name in names]
    measured = [verdicts[row] for row in figure.rows if row in verdicts]
    return [*blocks, _claims_grid(measured)] if measured else blocks
