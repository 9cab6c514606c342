"""Pages of results in a real browser: verdict first, rows that lead to figures, figures to zoom and to hover.

The results are made up where a simulation would take its time; how they are drawn and shown is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sayd_env.config.comparison import load_comparison
from sayd_env.config.environment import load_environment
from sayd_env.config.map import load_map
from sayd_env.config.robustness import load_robustness, single_faults
from sayd_env.config.scenario import Scenario
from sayd_env.report.files import ResultDirectory, document
from sayd_env.report.html import Page
from sayd_env.report.live import extremes
from sayd_env.runs.along import LineRecord, line_runs
from sayd_env.runs.controlled import ControlledRuns
from sayd_env.runs.metrics import Row
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.runs.rollouts import Run
from sayd_env.stability import Crossing, Limits
from sayd_env.studies.adaptation import CommandCosts, ConstantMap
from sayd_env.studies.assess import Train, assess_file
from sayd_env.studies.bound.cases import CONSTANT, SCHEDULE
from sayd_env.studies.bound.result import CLAIRVOYANT, BoundResult, Reached
from sayd_env.studies.comparison import compare as comparison
from sayd_env.studies.comparison.compare import CompareResult
from sayd_env.studies.comparison.entrants import read_entrants
from sayd_env.studies.comparison.grid import MEASURED, ScenarioGrid
from sayd_env.studies.evaluate import EvaluateResult
from sayd_env.studies.hindsight import FOR_ALL, HINDSIGHT, SINGLE, HindsightResult, OnLine
from sayd_env.studies.line import LineResult
from sayd_env.studies.map import CRITERIA, Cell, MapGrid, MapResult
from sayd_env.studies.paper.controlled_claims import controlled_claims
from sayd_env.studies.paper.figures import controlled_plots
from sayd_env.studies.paper.page import reproduce_page
from sayd_env.studies.robustness import FAULT, UNDISTURBED, Disturbance, RobustnessResult, disturbance_of
from sayd_env.studies.simulate import SimulateResult, Target

PHONE = {"width": 390, "height": 844}
TOUCH: dict[str, Any] = {"is_mobile": True, "has_touch": True}
MANY = (
    *("mppt1", "mppt2", "skyhook-onoff", "skyhook-continuous", "mppt2-tuned", "constant-tuned"),
    *("speed-schedule-tuned", "hunting-schedule-tuned", "lqg-tuned"),
)
"""As many policies as a comparison has."""
FAULTS = """
[...document.querySelectorAll('.plot')]
    .map((plot) => Plotly.validate(plot.data, plot.layout) || [])
    .flat()
    // Its own check knows nothing of packed numbers and of a scale that maps share.
    .filter((fault) => !['x', 'y', 'coloraxis'].includes(fault.path.at(-1)))
    .map((fault) => fault.msg)
"""
"""What Plotly itself finds wrong."""
OVERLAPS = """
(plot) => {
    const whole = plot.querySelector('.svg-container').getBoundingClientRect(), found = [], boxes = [];
    const add = (kind, elements) => {
        for (const element of elements) {
            const box = element.getBoundingClientRect();
            if (box.width && box.height) boxes.push({ kind, text: element.textContent.trim(), box });
        }
    };
    add('ticks', plot.querySelectorAll("[class$='tick'] text"));
    add('title', plot.querySelectorAll(".infolayer [class*='title'] text"));
    plot.layout.annotations.forEach((note, k) => note.xref.endsWith('domain') && note.y === 1 &&
        add('heading', plot.querySelectorAll(`.annotation[data-index='${k}'] .annotation-text`)));
    add('legend', plot.querySelectorAll('.legend .bg'));
    add('bar', plot.querySelectorAll('.modebar-group'));
    add('panel', plot.querySelectorAll('.draglayer .nsewdrag'));
    const across = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const along = (a, b) => Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    boxes.forEach((one, k) => {
        const out = Math.max(whole.left - one.box.left, one.box.right - whole.right,
            whole.top - one.box.top, one.box.bottom - whole.bottom);
        if (out > 2) found.push(`${one.kind} '${one.text}' is cut by ${out.toFixed(1)} px`);
        for (const other of boxes.slice(k + 1)) {
            if (one.kind === other.kind && ['bar', 'panel'].includes(one.kind)) continue;
            const common = Math.min(across(one.box, other.box), along(one.box, other.box)).toFixed(1);
            if (common > 2) found.push(`${one.kind} ${one.text}, ${other.kind} ${other.text}: ${common} px`);
        }
    });
    return { found, kinds: [...new Set(boxes.map((each) => each.kind))] };
}
"""
"""Which titles, names at ticks, legends, buttons and panels lie over each other, or are cut."""
WAIT = 60_000
"""Longest wait for a page, ms."""


def saved(result: Any, folder: Path) -> Path:
    """The page of a result."""
    content = document(result, {"friction": 0.4}, 0, "sayd test")
    ResultDirectory(folder).save(result, content)
    return folder / "report.html"


def evaluated(scenario: Scenario) -> EvaluateResult:
    """Policies of which one derails; their costs rise with speed, and with the wear."""
    count = [field.name for field in fields(Row)].index("valve_mean") - 5
    rows = [
        Row(policy, kmh, wear, 0.4, seed, *[level * kmh / 300.0 * (1.0 + wear) * (1.0 + 0.1 * seed)] * count)
        for policy, level in (
            ("passive", 0.7),
            ("constant:0.3", 0.28),
            *((each, 0.5 - 0.03 * k) for k, each in enumerate(MANY)),
        )
        for wear in (0.0, 1.0)
        for kmh in (300.0, 350.0, 400.0)
        for seed in range(3)
    ]
    return EvaluateResult(scenario, rows)


def mapped(scenario: Scenario) -> MapResult:
    """Critical speeds between both ends of the grid, and beyond them."""
    grid = MapGrid(wear=(0.0, 1.0), friction=(0.2, 0.4))
    found: dict[tuple[float, float], tuple[float | None, Crossing]] = {
        (0.0, 0.2): (None, Crossing.NOT_REACHED),
        (0.0, 0.4): (400.0, Crossing.FOUND),
        (1.0, 0.2): (350.0, Crossing.FOUND),
        (1.0, 0.4): (None, Crossing.BELOW_GRID),
    }
    cells = [
        Cell(policy, *place, dict.fromkeys(("acceleration", "track_shift_force"), each))
        for policy in ("passive", "mppt2")
        for place, each in found.items()
    ]
    return MapResult(scenario, grid, (0, 1), cells)


def adapted(scenario: Scenario) -> MapResult:
    """The same with the best constant commands, lower at higher speeds."""
    config = load_map()
    costs = {
        each: {v: 0.02 + (v - 30.0 / each.speed_kmh) ** 2 for v in (0.0, 0.1, 0.3, 1.0)}
        for each in config.conditions()
    }
    found = ConstantMap(config, {weight: CommandCosts(costs) for weight in config.force_weights})
    return replace(mapped(scenario), constants=found)


def assessed(scenario: Scenario, folder: Path) -> Any:
    """A ride of 60 s at 300 km/h whose front frame swings above its limit, with a sine of 4 Hz."""
    t = np.arange(0.0, 60.0, 0.005)
    swing = np.sin(2.0 * np.pi * 4.0 * t)
    columns = {f"ddy_{place} (m/s2)": level * swing for place, level in (("front", 9.0), ("rear", 1.0))}
    text = ["time (s)," + ",".join(columns)]
    text += [",".join(f"{value:.5f}" for value in row) for row in zip(t, *columns.values(), strict=True)]
    file = folder / "ride.csv"
    file.write_text("\n".join(text))
    return assess_file(file, scenario.assessment, Train.of(bogie_mass=6000.0), speed=300.0 / 3.6)


def along_lines() -> HindsightResult:
    """Two lines on which rules cost 10 and 60 % more than the best commands."""

    def line(name: str, factor: float) -> OnLine:
        J = {HINDSIGHT: np.array([0.1, 0.2]), SINGLE: factor * np.array([0.1, 0.2])}
        J |= {FOR_ALL: J[SINGLE], "mppt2": 1.1 * J[SINGLE]}
        constants = {0.0: J[SINGLE], 1.0: np.array([0.5, 0.15])}
        return OnLine(name, ("a", "b"), np.array([10.0, 30.0]), constants, (0.0, 1.0), J, dict.fromkeys(J, 0))

    return HindsightResult((line("first", 1.1), line("second", 1.6)), 0.0, ("mppt2",))


def simulated(scenario: Scenario) -> SimulateResult:
    """Two signals of 20 s."""
    time = np.linspace(-2.0, 18.0, 20_001)
    values = {"Y.front.leading.left": 1e4 * np.sin(9.0 * time), "distance": 80.0 * time}
    rows = tuple(
        {"name": name, "unit": "N", "minimum": v.min(), "maximum": v.max(), "mean": v.mean(), "rms": v.std()}
        for name, v in values.items()
    )
    curves = {name: extremes(time, v, 1500) for name, v in values.items()}
    run = Run(policy_spec("passive"), scenario, load_environment(), 80.0, 7)
    return SimulateResult(
        Target(Path("none.csv"), "csv"), run, None, time[[0, -1]], 1e3, rows, curves, curves, None
    )


def lined(scenario: Scenario) -> LineResult:
    """Two policies on a line of three sections, one of them above a limit in the last one."""
    environment, runs, records = load_environment(), [], []
    for policy, level in (("passive", 1.2), ("mppt2", 0.4)):
        (run,) = line_runs([policy_spec(policy)], scenario, "slow_curve", [120.0 / 3.6], [7], environment)
        assert run.line is not None
        ends = [section.end for section in run.line.sections]
        time = np.diff([0.0, *ends]) / run.speed
        seconds = np.arange(int(time.sum()))
        sections, course = level * np.linspace(0.3, 1.0, len(ends)), level * (1.0 + 0.2 * np.sin(seconds))
        position = np.linspace(50.0, ends[-1] - 50.0, 40)
        parts = dict.fromkeys(("acceleration", "force", "curve_force", "unloading"), 0.1 * sections)
        record = LineRecord(
            **parts,
            time=time,
            lost=np.zeros(len(ends)),
            quotient=sections,
            track_shift=1e4 * sections,
            acceleration_rms=np.full(len(ends), np.nan),
            track_shift_rms=1e3 * sections,
            command=0.5 + 0.1 * np.cos(seconds)[:, None],
            cost_acceleration=0.1 * course,
            cost_force=0.1 * course,
            peak_quotient=0.3 * course,
            peak_track_shift=1e4 * course,
            position=position,
            sliding_rms_acceleration=level * np.ones(position.shape),
        )
        runs.append(run)
        records.append(record)
    return LineResult("slow_curve", scenario, tuple(runs), tuple(records))


COMPARISON = """
environment: env.yaml
length: 600.0
tracks: [{name: german_low, scale: 0.6}]
speeds_kmh: [250.0, 300.0, 350.0]
wheels: [{name: new, wear: 0.0, gauge: 1.435}, {name: worn, wear: 1.0, gauge: 1.435}]
friction: [0.35]
seeds: [5, 6, 7]
initial_current: 0.0
critical_speed: {study: study.yaml, speeds_kmh: [320.0, 400.0], wear: 1.0, seeds: [3]}
constants: [0.3]
force_weights: [0.5, 1.0, 2.0]
bootstrap: {samples: 200, seed: 0}
"""


def compared(folder: Path) -> CompareResult:
    """Controllers with made-up runs; the higher the speed, the more they cost."""
    (folder / "env.yaml").write_text("base: randomized\nepisode_s: 4.0\n")
    (folder / "study.yaml").write_text("base: nominal\nassessment: {run_in: 200.0, length: 600.0}\n")
    (folder / "small.yaml").write_text(COMPARISON)

    def run_all(grid: ScenarioGrid, policies: Sequence[PolicySpec], *_: Any) -> dict[str, Any]:
        speed = np.array([each.speed_kmh for each in grid.conditions])[:, None]
        level = speed / 300.0 * (1.0 + 0.1 * np.arange(len(grid.config.seeds)))
        return {
            policy.title: dict.fromkeys(MEASURED, (0.9 - 0.05 * k) * level)
            | dict.fromkeys(("lost", "offline_lost"), 0.0 * level)
            for k, policy in enumerate(policies)
        }

    config = load_comparison(str(folder / "small.yaml"))

    def stability_map(_: Any, policies: Sequence[PolicySpec], *__: Any, **___: Any) -> Any:
        ratios = {name: {kmh: (0.5,) for kmh in config.critical_speed.speeds_kmh} for name in CRITERIA}
        crossing = dict.fromkeys(CRITERIA, (None, Crossing.NOT_REACHED))
        return SimpleNamespace(cells=[Cell(each.title, 1.0, 0.35, crossing, ratios) for each in policies])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison, "run_all", run_all)
        patch.setattr(comparison, "stability_map", stability_map)
        return comparison.compare(config, read_entrants(MANY))


def disturbed() -> RobustnessResult:
    """Policies of which one is above what is asked, with every disturbance and single fault of the study."""
    config = load_robustness()
    environment = load_environment(config.faults)
    assert environment.faults is not None
    faults = single_faults(environment.faults.kinds, config.places, environment.sensors, config.onset)
    disturbances = (
        Disturbance(UNDISTURBED),
        *(disturbance_of(axis, value) for axis in config.axes for value in axis.values),
        *(Disturbance(FAULT, fault=fault, title=name) for name, fault in faults.items()),
    )
    count = [field.name for field in fields(Row)].index("valve_mean") - 5
    constants = tuple(f"constant:{each:g}" for each in config.constants)
    runs = {
        (policy, each.title): [
            Row(policy, c.speed_kmh, c.wear, c.friction, seed, *[(0.4 + 0.07 * k) * (1.0 + 0.01 * n)] * count)
            for c in config.conditions
            for seed in config.seeds
        ]
        for k, policy in enumerate(("mppt1", "mppt2", "passive", *MANY[2:], *constants))
        for n, each in enumerate(disturbances)
    }
    return RobustnessResult(config, disturbances, MANY, constants, runs)


def bounded() -> BoundResult:
    """Two conditions; rules cost the more the later they are named, the search least."""
    rules = (*MANY, CONSTANT, SCHEDULE, CLAIRVOYANT)
    reached = tuple(
        Reached(
            condition=condition,
            J={rule: level * (1.5 - 0.04 * k) for k, rule in enumerate(rules)},
            derailed={},
            current=0.3,
            section_currents=(0.3,),
            start="mppt2",
            changes=3,
            decisions=20,
            seconds=100.0,
            period=0.01,
            commands=np.full((4, 2), 0.3),
        )
        for condition, level in (("350 km/h", 0.02), ("400 km/h", 0.03))
    )
    return BoundResult(reached, MANY)


@dataclass(frozen=True)
class Reproduced:
    """The page of `sayd reproduce` without the passive vehicle's runs."""

    runs: ControlledRuns
    limits: Limits

    def as_dict(self) -> dict[str, Any]:
        return {}

    def tables(self) -> Mapping[str, Any]:
        return {}

    def plots(self) -> Mapping[str, Any]:
        return controlled_plots(self.runs, self.limits, ("11", "12", "21", "22"))

    def summary(self, *_: Any, **__: Any) -> None:
        pass

    def page(self) -> Page:
        return reproduce_page(controlled_claims(self.runs, self.limits), list(self.plots()), 1)


@pytest.fixture(scope="module")
def pages(
    tmp_path_factory: pytest.TempPathFactory,
    short_scenario: Scenario,
    paper_runs: Callable[..., ControlledRuns],
    limits: Limits,
) -> Callable[[str], Path]:
    """The page of a command by its name."""
    folder = tmp_path_factory.mktemp("results")
    make: dict[str, Callable[[], Any]] = {
        "evaluate": lambda: evaluated(short_scenario),
        "map": lambda: adapted(short_scenario),
        "assess": lambda: assessed(short_scenario, folder),
        "hindsight": along_lines,
        "simulate": lambda: simulated(short_scenario),
        "line": lambda: lined(short_scenario),
        "compare": lambda: compared(folder),
        "robustness": disturbed,
        "bound": bounded,
        "reproduce": lambda: Reproduced(paper_runs(1), limits),
    }

    @cache
    def page(name: str) -> Path:
        return saved(make[name](), folder / name)

    return page


COMMANDS = (
    *("evaluate", "map", "assess", "hindsight", "simulate", "line", "compare", "robustness", "bound"),
    "reproduce",
)


def shown(page: Any) -> None:
    """Go to the first figure, and wait until it is live, as all near the screen are."""
    page.locator("figure").first.scroll_into_view_if_needed()
    page.wait_for_selector("figure.live .plot .main-svg", timeout=WAIT)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_page_is_complete_and_fits_a_phone(name: str, pages: Callable[[str], Path], visit: Any) -> None:
    """`visit` fails on any error in the console and on any use of the network."""
    page = visit(pages(name).as_uri(), PHONE["width"], PHONE["height"], **TOUCH)
    order = page.eval_on_selector_all("h1, h2", "all => all.map((each) => each.textContent)")
    assert order[1:3] == ["Verdict", "Contents"]
    assert page.text_content("#verdict p").strip()
    for target in page.eval_on_selector_all("a[href^='#']", "all => all.map((each) => each.hash)"):
        assert page.locator(f"[id='{target[1:]}']").count() == 1
    assert page.locator("td a[href^='#figure-']").count() > 0
    shown(page)
    # Every figure, made live in turn, is valid to Plotly itself.
    for figure in page.query_selector_all("figure"):
        figure.scroll_into_view_if_needed()
        figure.wait_for_selector(".plot .main-svg", timeout=WAIT)
    assert page.evaluate(FAULTS) == []
    width = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert width[0] <= width[1] == PHONE["width"]


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_lies_over_another_thing_in_a_figure(
    name: str, width: int, pages: Callable[[str], Path], visit: Any
) -> None:
    """Titles, names at ticks, legend, buttons and panels, with as many policies as a comparison has."""
    page = visit(pages(name).as_uri(), width, 900, **(TOUCH if width < 640 else {}))
    shown(page)
    for figure in page.query_selector_all("figure"):
        figure.scroll_into_view_if_needed()
        figure.wait_for_selector(".plot .main-svg", timeout=WAIT)
        plot = figure.query_selector(".plot")
        plot.hover()  # the buttons come
        found = plot.evaluate(OVERLAPS)
        assert found["found"] == [], figure.get_attribute("id")
        assert {"ticks", "bar", "panel"} <= set(found["kinds"])


@pytest.mark.parametrize("name", ["evaluate", "compare", "robustness", "bound", "line", "hindsight", "map"])
def test_every_row_about_policies_leads_to_a_figure(
    name: str, pages: Callable[[str], Path], visit: Any
) -> None:
    page = visit(pages(name).as_uri())
    rows = page.locator("table:has(thead) tbody tr")
    assert rows.count() == page.locator("table:has(thead) tbody tr:has(td a[href^='#figure-'])").count() > 0
    assert page.get_by_role("link", name="figure", exact=True).count() == 0


def test_a_row_leads_to_its_figure_which_zooms_and_hovers(pages: Callable[[str], Path], visit: Any) -> None:
    page = visit(pages("evaluate").as_uri())
    shown(page)
    link = page.locator("td a[href='#figure-evaluate_wear_1_friction_0.4']").first
    link.scroll_into_view_if_needed()
    link.click()
    figure = page.locator("[id='figure-evaluate_wear_1_friction_0.4']")
    figure.locator(".main-svg").first.wait_for(timeout=WAIT)
    page.wait_for_function(
        "Math.abs(document.getElementById('figure-evaluate_wear_1_friction_0.4')"
        ".getBoundingClientRect().top) < 40"
    )
    plot = figure.locator(".plot")
    point = plot.evaluate(
        "(p) => { const a = p._fullLayout.xaxis, b = p._fullLayout.yaxis, t = p._fullData[0];"
        " return [a._offset + a.d2p(350), b._offset + b.d2p(t.y[1])]; }"
    )
    corner = plot.bounding_box()
    page.mouse.move(corner["x"] + point[0], corner["y"] + point[1])
    figure.locator(".hoverlayer .hovertext").first.wait_for(timeout=WAIT)
    panel = figure.locator(".nsewdrag").first
    box = panel.bounding_box()
    before = plot.evaluate("(p) => p.layout.xaxis.range.slice()")
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.3 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.7 * box["height"], steps=4)
    page.mouse.up()
    page.wait_for_function(
        "(p) => p.layout.xaxis.range[1] - p.layout.xaxis.range[0] < 70", arg=plot.element_handle()
    )
    after = plot.evaluate("(p) => p.layout.xaxis2.range.slice()")
    assert before[0] < after[0] < after[1] < before[1]  # the panel beside it follows


@pytest.mark.parametrize("name", ["assess", "compare", "robustness"])
def test_a_printed_page_shows_every_picture(name: str, pages: Callable[[str], Path], visit: Any) -> None:
    """On paper the still pictures stand in place of the live ones; neither they nor a table are wider."""
    page = visit(pages(name).as_uri())
    shown(page)
    paper = page.pdf(format="A4")
    assert paper.startswith(b"%PDF-")
    page.set_viewport_size({"width": 700, "height": 1000})
    page.emulate_media(media="print")
    assert page.locator("figure img:visible").count() == page.locator("figure").count()
    assert page.locator(".plot:visible, nav:visible").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    right = page.eval_on_selector_all("table", "all => all.map((t) => t.getBoundingClientRect().right)")
    assert max(right) <= 700.5
    heights = page.eval_on_selector_all(
        "td.short, td.number",
        "all => all.map((d) => { const r = document.createRange(); r.selectNodeContents(d);"
        " return new Set([...r.getClientRects()].map((each) => Math.round(each.top))).size; })",
    )
    assert max(heights) == 1  # no number is broken


def test_without_scripts_the_pictures_stay(pages: Callable[[str], Path], visit: Any) -> None:
    page = visit(pages("hindsight").as_uri(), java_script_enabled=False)
    assert page.locator("figure img:visible").count() == 1
