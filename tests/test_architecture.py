"""Floors: what stands higher uses what stands lower, not the other way round, and no private names of it."""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

import sayd_env

FLOORS = (
    "config",
    "measured",
    "physics",
    "stability",
    "envs",
    "baselines",
    "agents",
    "runs",
    "fmu",
    "report",
    "studies",
    "cli",
)
"""From the ground up."""
ROOT = "sayd_env"


@dataclass(frozen=True)
class Import:
    """An import statement, at the top of a module or not."""

    module: str
    """Of the statement."""
    line: int
    target: str
    """What is imported from, or as a whole."""
    name: str | None
    """What is imported from it."""

    def __str__(self) -> str:
        return f"{self.module}:{self.line} imports {self.target}{'.' + self.name if self.name else ''}"


@cache
def modules() -> Mapping[str, ast.Module]:
    """All modules of the packages by name; in a checkout some packages are elsewhere than in a wheel."""
    found = {}
    for floor in FLOORS:
        spec = importlib.util.find_spec(f"{ROOT}.{floor}")
        assert spec is not None
        for place in spec.submodule_search_locations or ():
            for path in sorted(Path(place).rglob("*.py")):
                parts = path.relative_to(place).with_suffix("").parts
                name = ".".join((ROOT, floor, *parts)).removesuffix(".__init__")
                found[name] = ast.parse(path.read_text(), str(path))
    for path in sorted(Path(sayd_env.__file__).parent.glob("*.py")):
        found[f"{ROOT}.{path.stem}".removesuffix(".__init__")] = ast.parse(path.read_text(), str(path))
    return found


@cache
def imports() -> tuple[Import, ...]:
    """All imports of the packages from each other, in functions and for the type checker, too."""
    return tuple(each for name, tree in modules().items() for each in imports_of(name, ast.walk(tree)))


def imports_of(module: str, nodes: Iterator[ast.AST]) -> Iterator[Import]:
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == ROOT:
                    yield Import(module, node.lineno, alias.name, None)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: a relative import"
            if str(node.module).split(".")[0] == ROOT:
                for alias in node.names:
                    yield Import(module, node.lineno, str(node.module), alias.name)


def floor_of(module: str) -> str:
    """``sayd_env.runs.cache`` is of ``runs``; what stands above all floors has none."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in FLOORS else ""


def reached(each: Import) -> str:
    """Module that an import needs: a package's module, or the package for one of its names."""
    whole = f"{each.target}.{each.name}"
    return whole if whole in modules() else each.target


def test_every_module_is_on_a_floor():
    entrances = {ROOT, f"{ROOT}.__main__"}
    assert [name for name in modules() if not floor_of(name) and name not in entrances] == []


def test_a_floor_uses_those_below_it_only():
    wrong = []
    for each in imports():
        here, there = floor_of(each.module), floor_of(reached(each))
        if here and there and FLOORS.index(there) > FLOORS.index(here):
            wrong.append(str(each))
    assert wrong == []


def test_learning_knows_nothing_of_runs_and_studies():
    upper = ("runs", "studies", "report", "cli")
    wrong = [str(i) for i in imports() if floor_of(i.module) == "agents" and floor_of(reached(i)) in upper]
    assert wrong == []


def test_there_are_no_circles_of_modules():
    """Imports in functions count. The whole package's own module, which Python loads first, is left out."""
    graph: dict[str, set[str]] = {name: set() for name in modules() if name != ROOT}
    for each in imports():
        if each.module in graph and reached(each) in graph:
            graph[each.module].add(reached(each))
    assert [" -> ".join(circle) for circle in circles(graph)] == []


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """One circle for each node from which a way leads back to a node on it (depth first)."""
    found, finished, way = [], set(), []

    def visit(name: str) -> None:
        if name in way:
            found.append([*way[way.index(name) :], name])
            return
        if name in finished or name not in graph:
            return
        way.append(name)
        for other in sorted(graph[name]):
            visit(other)
        finished.add(way.pop())

    for name in graph:
        visit(name)
    return found


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": set(), "d": {"a", "c"}}) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [["b", "c", "b"]]
    assert circles({"a": {"a"}}) == [["a", "a"]]


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


def test_nobody_uses_another_floor_s_private_names():
    wrong = []
    for each in imports():
        parts = [*each.target.split("."), *([each.name] if each.name else [])]
        if floor_of(each.module) != floor_of(each.target) and any(is_private(part) for part in parts):
            wrong.append(str(each))
    for name, tree in modules().items():
        # Names that stand for modules here: `from sayd_env.physics import step`, then `step._private`.
        aliases = {i.name: reached(i) for i in imports_of(name, ast.walk(tree)) if i.name}
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and is_private(node.attr):
                target = aliases.get(node.value.id, "")
                if target in modules() and floor_of(target) != floor_of(name):
                    wrong.append(f"{name}:{node.lineno} uses {target}.{node.attr}")
    assert wrong == []


def defined(tree: ast.Module) -> Iterator[tuple[str, str, int]]:
    """Names that a module assigns to, what they get, and where."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            names = [target for target in node.targets if isinstance(target, ast.Name)]
            value: ast.expr | None = node.value
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names, value = [node.target], node.value
        else:
            continue
        for name in names:
            yield name.id, "" if value is None else ast.unparse(value), node.lineno


def once_only(name: str, value: str) -> bool:
    """Whether `config.units` defines this already: km/h in 1 m/s, a type of arrays."""
    array = re.fullmatch(
        r"NDArray\[(float64|float32|complex128|int64|bool_)\]", re.sub(r"\bn(pt|p)\.", "", value)
    )
    named = name.strip("_") in ("KMH", "Array", "Array32", "ComplexArray", "Integers", "Flags")
    return named or value in ("3.6", "1 / 3.6", "1.0 / 3.6") or array is not None


def test_kmh_has_one_name():
    """No 3.6 as a factor or divisor: it is `KMH`."""
    wrong = [
        f"{module}:{node.lineno}"
        for module, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div)
        for side in (node.left, node.right)
        if isinstance(side, ast.Constant) and side.value == 3.6
    ]
    assert not wrong


def test_units_and_arrays_are_defined_once():
    wrong = [
        f"{module}:{line}: {name} = {value}"
        for module, tree in modules().items()
        if module != "sayd_env.config.units"
        for name, value, line in defined(tree)
        if once_only(name, value)
    ]
    assert wrong == []


@pytest.mark.parametrize("floor", FLOORS)
def test_every_floor_has_modules(floor: str):
    assert any(floor_of(name) == floor for name in modules())
