"""Pages of every configuration key, made from the models that check the files.

A `Chapter` for each kind of file, a table for each section of it: the key's type and bounds, its meaning with
the unit, and what it is where it is left out. Where the packaged file has a section once, its values stand
beside.
"""

from __future__ import annotations

import inspect
import json
import re
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from sayd_env.agents.config import TrainConfig, load_train
from sayd_env.agents.search_config import SearchConfig, load_search
from sayd_env.config.bound import BoundConfig, load_bound
from sayd_env.config.calibration import CalibrationConfig, load_calibration
from sayd_env.config.comparison import ComparisonConfig
from sayd_env.config.control import (
    ConstantConfig,
    HuntingScheduleConfig,
    LqgConfig,
    MpptConfig,
    OnlineConfig,
    PerturbObserveConfig,
    SkyhookConfig,
    SpeedScheduleConfig,
    load_controller,
    load_online,
)
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig, load_sayd
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.hindsight import HindsightConfig, load_hindsight
from sayd_env.config.learner import LearnerConfig, load_learner
from sayd_env.config.line import LineConfig, read_line
from sayd_env.config.lines import LinesConfig, read_lines
from sayd_env.config.loader import packaged_names
from sayd_env.config.map import MapConfig, load_map
from sayd_env.config.profile import RailProfileConfig, WheelProfileConfig, load_rail, load_wheel
from sayd_env.config.reproduction import ReproductionConfig, load_reproduction
from sayd_env.config.reward import RewardConfig, named_rewards
from sayd_env.config.robustness import RobustnessConfig, load_robustness
from sayd_env.config.safe import SafeConfig, load_safe
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.sensors import SensorsConfig, load_sensors
from sayd_env.config.track import TrackConfig, read_track
from sayd_env.config.tuning import TuningConfig, load_tuning
from sayd_env.config.vehicle import VehicleConfig

WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false", type(None): "null"}
FREE = ("provenance",)
"""Sections with any keys."""
PLAIN = {
    "activation": "Of the hidden layers",
    "algorithm": "Which of the algorithms this section is of",
    "axis": "Along or about which axis it acts",
    "constants": "Constant commands (-)",
    "damper": "The yaw dampers",
    "density": "Law of the spectrum",
    "description": "What it is, in words",
    "distribution": "Which of the distributions this is",
    "elements": "Springs, dampers, stops, and places of yaw dampers",
    "horizons_s": "Horizons (s)",
    "irregularity": "Irregularities of the track",
    "kind": "Which of the kinds this is",
    "learning": "The algorithm and its settings",
    "lines": "Lines, by name",
    "name": "What messages and results call it",
    "observation": "What an observation is",
    "openings": "Valve commands (-)",
    "per": "Index sets over which it is repeated",
    "role": "What it is in the vehicle",
    "samples": "Numbers of sequences",
    "scale": "Scale on which the range is searched",
    "speeds_kmh": "Speeds (km/h)",
    "throttle": "The adjustable throttle",
    "type": "Which of the types this is",
    "unit": "Unit of the range",
    "values": "Values of the quantity, in its unit",
    "valves": "Which valves a command goes to",
    "wheels": "States of the wheels, by name",
}
"""Meaning of keys that their models leave to their names."""


@dataclass(frozen=True)
class Root:
    """What one file holds."""

    model: type[BaseModel]
    name: str
    """Of the packaged file whose values are shown."""
    load: Callable[[], BaseModel] | None


@dataclass(frozen=True)
class Chapter:
    """A kind of file."""

    title: str
    folder: str
    """In configs/."""
    text: str
    roots: tuple[Root, ...]
    names: tuple[str, ...] = ()
    """Its packaged files, where the folder holds others as well."""

    @property
    def packaged(self) -> tuple[str, ...]:
        """Its packaged files."""
        return self.names or tuple(packaged_names(self.folder))

    @property
    def page(self) -> str:
        """Name of its page."""
        return self.title.lower().replace(" ", "-") + ".md"


def _nominal(part: str) -> Callable[[], BaseModel]:
    return lambda: getattr(load_scenario(), part)


CHAPTERS = (
    Chapter(
        "Study",
        "study",
        "`--config`; its keys are those of `--set`. `vehicle`, `damper`, `wheel`, `rail`, `track` and "
        "`assessment` stand by name, by path or by content.",
        (Root(Scenario, "nominal", load_scenario),),
        names=("nominal", "estimates", "manchester"),
    ),
    Chapter(
        "Vehicle", "vehicle", "`--set vehicle=NAME`.", (Root(VehicleConfig, "emu", _nominal("vehicle")),)
    ),
    Chapter(
        "Damper",
        "damper",
        "`--damper`.",
        (
            Root(PassiveDamperConfig, "passive", _nominal("damper")),
            Root(SaydDamperConfig, "sayd", lambda: load_sayd("sayd")),
        ),
    ),
    Chapter(
        "Profiles",
        "profile",
        "`--profile` (wheels) and `--rail`.",
        (
            Root(WheelProfileConfig, "s1002cn", lambda: load_wheel("s1002cn")),
            Root(RailProfileConfig, "cn60", lambda: load_rail("cn60")),
        ),
    ),
    Chapter(
        "Track", "track", "`--track`.", (Root(TrackConfig, "german_low", lambda: read_track("german_low")),)
    ),
    Chapter("Line", "line", "`--line`.", (Root(LineConfig, "curve_400", lambda: read_line("curve_400")),)),
    Chapter(
        "Drawn lines",
        "lines",
        "`lines` of an environment: what its episodes draw.",
        (Root(LinesConfig, "highspeed", lambda: read_lines("highspeed")),),
    ),
    Chapter(
        "Environment",
        "env",
        "`gymnasium.make(..., environment=...)`; see [the environments](../environments.md).",
        (Root(EnvironmentConfig, "randomized", lambda: load_environment("randomized")),),
    ),
    Chapter(
        "Sensors",
        "sensors",
        "`gymnasium.make(..., sensors=...)`.",
        (Root(SensorsConfig, "realistic", lambda: load_sensors("realistic")),),
    ),
    Chapter(
        "Reward",
        "study",
        "`gymnasium.make(..., reward=NAME)` and `--reward NAME`; the file has weights under each name.",
        (Root(RewardConfig, "mppt2", lambda: named_rewards()["mppt2"]),),
        ("rewards",),
    ),
    Chapter(
        "Scaling",
        "learner",
        "`gymnasium.make(..., scaled=True)`.",
        (Root(LearnerConfig, "scaled", lambda: load_learner("scaled")),),
    ),
    Chapter(
        "Controllers",
        "control",
        "`baselines.make(name, env, key=value)`, and a controller's `.yaml` in `--policies`.",
        (
            Root(ConstantConfig, "constant", lambda: load_controller("constant")),
            Root(MpptConfig, "mppt2", lambda: load_controller("mppt2")),
            Root(PerturbObserveConfig, "perturb-and-observe", lambda: load_controller("perturb-and-observe")),
            Root(SkyhookConfig, "skyhook-onoff", lambda: load_controller("skyhook-onoff")),
            Root(SpeedScheduleConfig, "speed-schedule", lambda: load_controller("speed-schedule")),
            Root(HuntingScheduleConfig, "hunting-schedule", lambda: load_controller("hunting-schedule")),
            Root(LqgConfig, "lqg", lambda: load_controller("lqg")),
            Root(OnlineConfig, "online", load_online),
            Root(SafeConfig, "safe", load_safe),
        ),
    ),
    Chapter("Training", "train", "`sayd train`.", (Root(TrainConfig, "ppo", load_train),)),
    Chapter(
        "Training search",
        "search",
        "`sayd tune ppo|sac`.",
        (Root(SearchConfig, "ppo", lambda: load_search("ppo")),),
    ),
    # Only `sayd compare` reads the held-out conditions: their values do not stand here.
    Chapter(
        "Comparison", "study", "`sayd compare`.", (Root(ComparisonConfig, "heldout", None),), ("heldout",)
    ),
    Chapter("Map", "study", "`sayd map`.", (Root(MapConfig, "map", load_map),), ("map",)),
    Chapter(
        "Hindsight",
        "study",
        "`sayd hindsight`.",
        (Root(HindsightConfig, "hindsight", load_hindsight),),
        ("hindsight",),
    ),
    Chapter("Bound", "study", "`sayd bound`.", (Root(BoundConfig, "bound", load_bound),), ("bound",)),
    Chapter(
        "Robustness",
        "study",
        "`sayd robustness`.",
        (Root(RobustnessConfig, "robustness", load_robustness),),
        ("robustness",),
    ),
    Chapter(
        "Reproduction",
        "study",
        "`sayd reproduce`.",
        (Root(ReproductionConfig, "reproduce", load_reproduction),),
        ("reproduce",),
    ),
    Chapter("Tuning", "study", "`sayd tune`.", (Root(TuningConfig, "tuning", load_tuning),), ("tuning",)),
    Chapter(
        "Calibration",
        "study",
        "`sayd calibrate`.",
        (Root(CalibrationConfig, "calibration", load_calibration),),
        ("calibration",),
    ),
)


@dataclass
class Found:
    """A section of a file: where it may stand, and what it is in the packaged file."""

    chapter: Chapter
    root: Root
    places: list[str]
    instances: list[BaseModel]


def pages() -> dict[str, str]:
    """Every chapter's page, by file name."""
    found = sections()
    return {chapter.page: _page(chapter, found) for chapter in CHAPTERS}


def index() -> str:
    """The page that lists the chapters."""
    rows = [
        (
            f"[{chapter.title}]({chapter.page})",
            f"`configs/{chapter.folder}/`",
            chapter.text.partition(". ")[0],
        )
        for chapter in CHAPTERS
    ]
    return (
        "# Configuration keys\n\n"
        "Every number with a physical meaning stands in a YAML file in `configs/`, with its unit and source. "
        "These pages list all keys, made from the models that check the files. A file of your own needs only "
        "the keys in which it differs from its `base`; single numbers stand under `set`, or behind `--set` "
        "on the command line, as `key: value` with dots between sections. An unknown key, a wrong type or a "
        "value out of bounds is one message with file, key and what is allowed.\n\n"
        + _table(("kind of file", "packaged in", "given by"), rows)
    )


def sections() -> dict[type[BaseModel], Found]:
    """Every section's model, where it was found first."""
    found: dict[type[BaseModel], Found] = {}
    roots = {root.model: (chapter, root) for chapter in CHAPTERS for root in chapter.roots}
    for model, (chapter, root) in roots.items():
        found[model] = Found(chapter, root, [], [])
    for model, (chapter, root) in roots.items():
        _collect(model, "", chapter, root, found, stop=roots.keys() - {model})
        if root.load is not None:
            for each in _instances(root.load()):
                if type(each) in found and found[type(each)].root is root:
                    found[type(each)].instances.append(each)
    return found


def _collect(
    model: type[BaseModel],
    prefix: str,
    chapter: Chapter,
    root: Root,
    found: dict[type[BaseModel], Found],
    stop: set[type[BaseModel]],
) -> None:
    for name, field in model.model_fields.items():
        if name in FREE:
            continue
        for inner, steps in _models(field.annotation):
            place = ".".join([*filter(None, [prefix]), name, *steps])
            if inner in stop:
                continue
            known = inner in found
            entry = found.setdefault(inner, Found(chapter, root, [], []))
            if entry.root is root and place not in entry.places:
                entry.places.append(place)
            if not known:
                _collect(inner, place, chapter, root, found, stop)


def _models(annotation: Any) -> Iterator[tuple[type[BaseModel], tuple[str, ...]]]:
    """Models in a type, and the steps to them: ``*`` for each entry of a list or mapping."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation, ()
        return
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield from _models(inside[0])
    elif origin in (Union, types.UnionType):
        for each in inside:
            yield from _models(each)
    elif origin in (tuple, list, dict, Mapping):
        for each in inside[1:] if origin in (dict, Mapping) else inside:
            for model, steps in _models(each):
                yield model, ("*", *steps)


def _instances(value: Any) -> Iterator[BaseModel]:
    if isinstance(value, BaseModel):
        yield value
        for name in type(value).model_fields:
            yield from _instances(getattr(value, name))
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _instances(each)
    elif isinstance(value, tuple | list):
        for each in value:
            yield from _instances(each)


def _page(chapter: Chapter, found: Mapping[type[BaseModel], Found]) -> str:
    names = ", ".join(f"`{name}`" for name in chapter.packaged)
    parts = [
        f"# {chapter.title}",
        f"Given by {chapter.text}",
        f"Packaged in `configs/{chapter.folder}/`: {names}.",
    ]
    for model, entry in found.items():
        if entry.chapter is chapter:
            parts += _section(model, entry, found, chapter)
    return "\n\n".join(parts) + "\n"


def _section(
    model: type[BaseModel], entry: Found, found: Mapping[type[BaseModel], Found], chapter: Chapter
) -> list[str]:
    only = entry.instances[0] if len(entry.instances) == 1 else None
    head = ["key", "is", "meaning", "if left out"] + [f"`{entry.root.name}`"] * (only is not None)
    rows = []
    for name, field in model.model_fields.items():
        row = [
            f"`{name}`",
            _type(field.annotation, field.metadata, found, chapter),
            meaning(name, field),
            _default(field),
        ]
        rows.append(row if only is None else [*row, _value(getattr(only, name))])
    where = [f"Stands at {', '.join(f'`{place}`' for place in entry.places)}."] if entry.places else []
    return [
        f"## {title(model, entry)} {{ #{anchor(model)} }}",
        summary(model),
        *where,
        _wide(_table(head, rows)),
    ]


def _wide(table: str) -> str:
    """A table whose meanings keep their width beside long values."""
    return f'<div class="keys" markdown>\n\n{table}\n\n</div>'


def title(model: type[BaseModel], entry: Found) -> str:
    """Heading of a section: where it stands, or what it is."""
    name, value = kind_of(model)
    kind = f", `{name}: {value}`" if name else ""
    if model is entry.root.model:
        return ("The file" if len(entry.chapter.roots) == 1 else words(model)) + kind
    if len(entry.places) <= 2:
        return " and ".join(f"`{place}`" for place in entry.places) + kind
    return words(model) + kind


def kind_of(model: type[BaseModel]) -> tuple[str, str]:
    """The key that tells a section from others in its place, and its value."""
    for name, field in model.model_fields.items():
        if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1:
            return name, get_args(field.annotation)[0]
    return "", ""


def words(model: type[BaseModel]) -> str:
    """A model's name in words."""
    name = model.__name__.removesuffix("Config").replace("Sayd", "SemiActive")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).capitalize().replace("Semi active", "Semi-active")


def anchor(model: type[BaseModel]) -> str:
    """Where a page has a section."""
    return model.__name__.lower()


def summary(model: type[BaseModel]) -> str:
    """First sentence of the model's docstring, in which there are no links."""
    return " ".join((inspect.getdoc(model) or "").partition("\n\n")[0].split())


def meaning(name: str, field: FieldInfo) -> str:
    """What a key is: its description, or that of its section."""
    if field.description:
        return field.description
    inner = [summary(model) for model, _ in _models(field.annotation)]
    return inner[0].rstrip(".") if len(inner) == 1 else PLAIN.get(name, "")


def _type(  # noqa: PLR0911 - one for each kind of type
    annotation: Any,
    metadata: Sequence[Any],
    found: Mapping[type[BaseModel], Found],
    chapter: Chapter,
    *,
    short: bool = False,
) -> str:
    """A type in words, with bounds and links to sections."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return _type(inner, [*more, *metadata], found, chapter, short=short)
    bounds = _bounds(metadata)
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(f"`{json.dumps(each).strip(chr(34))}`" for each in inside)
    if origin in (Union, types.UnionType):
        models = [model for each in inside for model, _ in _models(each)]
        short = len(models) > 1
        family = {re.sub(r"^.*(?=[A-Z])", "", model.__name__) for model in models}
        if len(models) > 2 and len(family) == 1:
            link = re.sub(
                r"^\[.*?\]", f"[{family.pop().lower()}]", _link(models[0], found, chapter, short=True)
            )
            return link + " or null" * (type(None) in inside)
        each = (_type(one, metadata, found, chapter, short=short) for one in inside)
        return " or ".join(dict.fromkeys(each))
    if origin is tuple and inside[-1:] != (...,):
        each = [_type(one, (), found, chapter) for one in inside]
        return f"{len(each)} times {each[0]}" if len(set(each)) == 1 else f"[{'; '.join(each)}]"
    if origin in (tuple, list):
        return f"list of {_type(inside[0], (), found, chapter)}{bounds}"
    if origin in (dict, Mapping):
        return f"by name, each {_type(inside[1], (), found, chapter)}{bounds}"
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return _link(annotation, found, chapter, short=short)
    return WORDS.get(annotation, "value") + (bounds if annotation is not type(None) else "")


def _link(
    model: type[BaseModel], found: Mapping[type[BaseModel], Found], chapter: Chapter, *, short: bool
) -> str:
    """A link to a section; a short one names only what tells it from others in its place."""
    if model not in found:
        return "any keys"
    entry, (_, value) = found[model], kind_of(model)
    label = f"`{value}`" if short and value else title(model, entry)
    if label == "The file":
        label = entry.chapter.title.lower()
    page = "" if entry.chapter is chapter else entry.chapter.page
    return f"[{label}]({page}#{anchor(model)})"


def _bounds(metadata: Sequence[Any]) -> str:
    signs = ((annotated_types.Gt, ">", "gt"), (annotated_types.Ge, "≥", "ge"))
    signs += ((annotated_types.Lt, "<", "lt"), (annotated_types.Le, "≤", "le"))
    flat = [each for one in metadata for each in (one.metadata if isinstance(one, FieldInfo) else (one,))]
    words = [
        f"{sign} {getattr(each, key):g}"
        for kind, sign, key in signs
        for each in flat
        if isinstance(each, kind)
    ]
    return "".join(f", {word}" for word in words)


def _default(field: FieldInfo) -> str:
    return "required" if field.is_required() else _value(field.get_default(call_default_factory=True))


def _value(value: Any) -> str:
    """A value as YAML has it; nothing where it is a section or long."""
    text = _yaml(value)
    return f"`{text}`" if text and len(text) <= 44 else ""


def _yaml(value: Any) -> str:
    if isinstance(value, BaseModel) or (
        isinstance(value, tuple) and any(isinstance(v, BaseModel) for v in value)
    ):
        return ""
    if isinstance(value, bool | str | type(None)):
        return json.dumps(value, ensure_ascii=False).strip('"') or '""'
    if isinstance(value, float | int):
        return f"{value:.7g}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_yaml, value))}]"
    return "{}" if value == {} else ""


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
