"""Settings of all tests; made-up sweeps and runs with known crossings, a scenario that runs in a moment."""

from __future__ import annotations

import base64
import dataclasses
import io
import os
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

# Before NumPy and torch are imported: their threads wait for each other on small matrices when several tests
# run at once.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
from rich.console import Console

from sayd_env.agents import pretrained
from sayd_env.agents.config import load_train
from sayd_env.agents.policy_file import StoredPolicy, describe, save_policy
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.envs.registration import VERSION
from sayd_env.envs.single import SaydEnv
from sayd_env.physics.kernel import COMPILES
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.controlled import ControlledRun, ControlledRuns
from sayd_env.runs.passive import Sweep
from sayd_env.stability import Limits
from sayd_env.studies.paper.controlled_claims import required_runs

# A shell starts background jobs with SIGINT ignored, and children inherit that: tests that interrupt a
# program need it to listen.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave out what looks at compiled code where there is none; files with slow tests come first.

    A process is given whole files in this order: a long one last would keep it alone at work.
    """
    for item in items:
        if not COMPILES and item.get_closest_marker("compiled"):
            item.add_marker(pytest.mark.skip(reason="NUMBA_DISABLE_JIT=1: nothing is compiled"))
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


SHORT = ("assessment.run_in=200", "assessment.length=600")
"""An assessed distance that holds one segment of the spectrum, for runs of a tenth of a second."""

LIMITS = Limits(track_shift_force=30e3, acceleration=5.44)
"""Wang et al. (2022), eq. 25 and 26, for P = 150 kN and m_b = 5.6 t."""

MakeSweep = Callable[..., Sweep]


def make_sweep(
    kmh: Sequence[float],
    acceleration_kmh: Sequence[float],
    force_kmh: Sequence[float],
    *,
    slope: float = 1 / 200,
    trailing: float = 1.25,
    frequency: Callable[[float], float] = lambda kmh: 4.0,
    scatter: Callable[[float], float] = lambda kmh: 0.0,
) -> Sweep:
    """Make quantities over their limits that rise linearly with speed, and pass 1 at given speeds (km/h).

    One crossing speed for each seed. The trailing wheelsets have `trailing` times the leading ones' force;
    the accelerations of the four wheelsets are 1, 0.9, 0.9 and 0.9 of the highest. Dominant frequencies (Hz)
    spread over `scatter` between the wheelsets.
    """
    v = np.array(kmh)[:, None]
    ratio_a, ratio_f = (1 + (v - np.array(c)[None, :]) * slope for c in (acceleration_kmh, force_kmh))
    share_a, share_f = np.array([1.0, 0.9, 0.9, 0.9]), np.array([1 / trailing, 1.0, 1 / trailing, 1.0])
    centre = np.array([frequency(x) for x in kmh])
    width = np.array([scatter(x) for x in kmh])
    f = centre[:, None, None] + width[:, None, None] * np.array([-0.5, 0.0, 0.2, 0.5])
    f = np.broadcast_to(f, (len(kmh), len(acceleration_kmh), 4)).copy()
    return Sweep(
        speeds=np.array(kmh) / 3.6,
        seeds=tuple(range(len(acceleration_kmh))),
        frequency=f,
        frequency_force=f.copy(),
        acceleration=LIMITS.acceleration * ratio_a[..., None] * share_a,
        track_shift=LIMITS.track_shift_force * ratio_f[..., None] * share_f,
    )


@pytest.fixture(scope="session")
def synthetic() -> MakeSweep:
    """Maker of sweeps with known crossings."""
    return make_sweep


def print_of(result: Any) -> str:
    """What a result prints in 80 columns; what is left to ``--wide`` is what would be on a wider screen."""
    found = []
    for width in (80, 400):
        console = Console(file=io.StringIO(), width=width)
        result.summary(console)
        found.append(console.file.getvalue())  # type: ignore[attr-defined]
    narrow, wide = (re.findall(r"\d+ more columns? with --wide", text) for text in found)
    assert narrow == wide
    assert max(map(len, found[0].splitlines())) <= 80
    return found[0]


@pytest.fixture(scope="session")
def printed() -> Callable[[Any], str]:
    """Printer of results."""
    return print_of


@pytest.fixture(scope="session")
def limits() -> Limits:
    """Limits that the made-up sweeps are scaled by."""
    return LIMITS


@pytest.fixture(scope="session")
def short_scenario() -> Scenario:
    """The estimates, which no calibration changes, over a short distance."""
    return load_scenario("estimates", SHORT)


@pytest.fixture(scope="session")
def short_model(short_scenario: Scenario) -> VehicleModel:
    """Vehicle of the short scenario."""
    return VehicleModel(short_scenario)


def save_trained(path: Path, algorithm: str = "ppo", seed: int = 0, **made: Any) -> None:
    """Write a policy as ``sayd train`` leaves it, but with random weights."""
    config = load_train(algorithm, [f"seed={seed}"])
    where = config.environment.model_dump(include={"valves", "observation", "history", "control_period"})
    interface = SaydEnv(**where).interface
    origin = {
        "steps": 1_000_000,
        "seconds": 1500.0,
        "J": 0.0321,
        "environment_version": VERSION,
        "environment_sha256": "0" * 64,
        "config": config.model_dump(mode="json"),
        "git_commit": "0123456789abcdef",
        "git_modified": True,
    }
    description = describe(
        interface,
        name=f"{algorithm}-s{seed}",
        view=config.view,
        inputs=config.inputs,
        clip=config.clip,
        output=config.output,
        network=config.network,
        squash="clip",
        made=origin | made,
    )
    encoding = StoredPolicy(description, ()).encoding(interface)
    random = np.random.default_rng(seed)
    layers = tuple(
        (np.float32(random.normal(0.0, before**-0.5, (after, before))), np.zeros(after, np.float32))
        for before, after in pairwise([encoding.size, *config.network.hidden, encoding.actions])
    )
    save_policy(path, StoredPolicy(description, layers))


@pytest.fixture(scope="session")
def trained_file() -> Callable[..., None]:
    """Writer of a policy as a training leaves it."""
    return save_trained


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder of two trainings in place of the package's."""
    folder = tmp_path_factory.mktemp("ready")
    for seed in range(2):
        save_trained(folder / f"ppo-s{seed}.npz", seed=seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pretrained, "FOLDER", folder)
        yield folder


def command_of(times: Sequence[float], values: Sequence[float], duration: float = 45.0) -> np.ndarray:
    """Make commands of both bogies every 10 ms, straight lines between given times (s) and values."""
    course = np.interp(np.arange(round(duration * 100)) / 100, times, values)
    return np.repeat(course[:, None], 2, axis=1).astype(np.float32)


def make_run(policy: str = "mppt1", kmh: float = 400.0, seed: int = 0, **changes: Any) -> ControlledRun:
    """Make a run with the given values; the others are plain: a tenth of every limit, 4 Hz, 5 % commanded."""
    plain: dict[str, Any] = {
        "frequency": np.full(4, 4.0),
        "frequency_force": np.full(4, 4.0),
        "acceleration": np.full(4, 0.1 * LIMITS.acceleration),
        "track_shift": np.full(4, 0.1 * LIMITS.track_shift_force),
        "initial_current": 0.0,
        "force_rms": 3e3,
        "force_peak": 9e3,
        "force_power_high": 1e5,
        "command": command_of([0], [0.05]),
        "control_period": 0.01,
        "force_trace": np.zeros(8000, dtype=np.float32),
        "trace_period": 0.005,
    }
    return ControlledRun(policy=policy, speed=kmh / 3.6, seed=seed, **(plain | changes))


def square(period: float) -> np.ndarray:
    """Make commands that change between 0 and 1 twice in a period (s)."""
    half = round(period * 50)
    return np.repeat((np.arange(4500) // half % 2)[:, None], 2, axis=1).astype(np.float32)


def sine(frequency: float, amplitude: float = 0.5) -> np.ndarray:
    """Make commands that swing about 0.5."""
    course = 0.5 + amplitude * np.sin(2 * np.pi * frequency * np.arange(4500) / 100 + 0.1)
    return np.repeat(course[:, None], 2, axis=1).astype(np.float32)


def paper_like(policy: str, kmh: float, initial: float, seed: int) -> dict[str, Any]:
    """Return values of a run that shows all that the paper shows."""
    at_300 = kmh < 310
    if policy == "mppt1":
        course = command_of([0, 4, 5], [1.0, 0.08, 0.07]) if initial else command_of([0, 10], [0.0, 0.08])
        return {
            "frequency": np.array([2.5, 6.0, 9.0, 4.0]) + 0.01 * seed,
            "command": course,
            "force_rms": 2.5e3 if at_300 else 3e3,
        }
    if policy == "mppt2":
        course = (
            command_of([0, 5, 10], [1.0, 0.3, 0.35]) if initial else command_of([0, 5, 10], [0.0, 0.25, 0.35])
        )
        return {"command": course, "force_rms": 2e3, "force_power_high": 5e4}
    if policy == "skyhook-onoff":
        return {"command": square(0.08), "force_peak": 11e3, "force_power_high": 4e5}
    share = np.full(4, 0.12 * LIMITS.acceleration)
    return {"command": sine(6.0), "acceleration": share, "force_power_high": 6e5}


def controlled_like_paper(
    seeds: int = 5, changes: Callable[[ControlledRun], dict[str, Any]] = lambda run: {}
) -> ControlledRuns:
    """Make all runs that the rows need, like the paper's but for what `changes` gives for a run."""
    runs = [
        make_run(
            policy,
            speed * 3.6,
            seed,
            initial_current=current,
            **paper_like(policy, speed * 3.6, current, seed),
        )
        for policy, speed, current in required_runs()
        for seed in range(seeds)
    ]
    return ControlledRuns(dataclasses.replace(run, **changes(run)) for run in runs)


@pytest.fixture(scope="session")
def controlled_run() -> Callable[..., ControlledRun]:
    """Maker of one run of a controlled vehicle."""
    return make_run


@pytest.fixture(scope="session")
def paper_runs() -> Callable[..., ControlledRuns]:
    """Maker of all runs of the controlled vehicle, like the paper's."""
    return controlled_like_paper


@pytest.fixture(scope="session")
def courses() -> SimpleNamespace:
    """Makers of commands: `line` through points, `square` and `sine`."""
    return SimpleNamespace(line=command_of, square=square, sine=sine)


VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Checks that tags are closed in turn, and collects what a reader sees and what leads elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.pictures: list[bytes] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "src" and value is not None and value.startswith("data:image/png;base64,"):
                self.pictures.append(base64.b64decode(value.partition(",")[2], validate=True))
            elif (name in ("src", "href", "srcset", "action") or name.startswith("on")) and not (
                name == "href" and value is not None and value.startswith("#")
            ):
                self.links.append(f"{name}={value}")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())


@pytest.fixture
def read_page() -> Callable[[str], Page]:
    """Reads a page for browsers."""
    return Page
