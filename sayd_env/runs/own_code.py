"""Policies of one's own code: ``module:factory`` or ``file.py:factory``.

The factory gets the `Interface` of the environment and returns an object with the `predict` of
Stable-Baselines3. It may have an attribute ``environment``, the keywords of the environment that it needs
(observation, history, valves, control_period). What travels to another process is the text and a hash of the
code, which is loaded there.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import os
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError
from sayd_env.config.errors import SaydError
from sayd_env.config.explain import shown
from sayd_env.config.files import MIB, read_bytes
from sayd_env.config.units import Array32
from sayd_env.envs.episode_batch import checked_actions
from sayd_env.envs.interface import Interface, RunIn

KEYWORDS = ("observation", "history", "valves", "control_period")
"""What a factory may ask of its environment."""
_INSTALLED = tuple(sysconfig.get_path(name) for name in ("purelib", "platlib", "stdlib"))
_PREDICT = "predict(observation, state, episode_start, deterministic) -> (action, state)"
LARGEST = 2 * MIB
"""Of a file of code."""
_PACKAGE = str(Path(__file__).resolve().parents[1])
_loaded: dict[str, tuple[str, ModuleType]] = {}  # hash of the code and module, by what names it


@dataclass(frozen=True)
class OwnPolicy:
    """A factory by its name, and which version of its code is meant."""

    where: str
    """``module:factory`` or ``file.py:factory``, the file with its whole path."""
    digest: str
    """SHA-256 of the code and of what it imports or names beside it."""
    needs: Mapping[str, Any]
    """Keywords of the environments in which it can act."""

    @classmethod
    def read(cls, text: str) -> OwnPolicy:
        """Load a factory.

        Raises
        ------
        ConfigError
            There is none of this name, or its code fails.
        """
        place, _, name = text.rpartition(":")
        if place.endswith(".py"):
            place = os.path.realpath(place)  # a link to itself has a path as well
        digest, factory = _factory(place, name)
        needs = getattr(factory, "environment", {})
        if not isinstance(needs, Mapping) or not set(needs) <= set(KEYWORDS):
            raise ConfigError(
                f"{text}: environment: found {shown(needs)}; expected keywords: {', '.join(KEYWORDS)}"
            )
        return cls(f"{place}:{name}", digest, dict(needs))

    @property
    def title(self) -> str:
        """How tables call it: a file without its folder."""
        place, _, name = self.where.rpartition(":")
        return f"{Path(place).stem if place.endswith('.py') else place}:{name}"

    def identity(self) -> str:
        """Hash of the code, and which factory of it."""
        return f"{self.digest}:{self.where.rpartition(':')[2]}"

    def bound(self, interface: Interface) -> CheckedPolicy:
        """Make the policy for an environment.

        Raises
        ------
        ConfigError
            The factory fails, what it returns is no policy, or its code has changed meanwhile.
        """
        interface.check(self.where, self.needs)
        place, _, name = self.where.rpartition(":")
        digest, factory = _factory(place, name)
        if digest != self.digest:
            raise ConfigError(f"{self.where}: its code has changed since the work began")
        with _explained(self.where, "; expected a function of one argument, the environment's interface"):
            policy = factory(interface)
        if not callable(getattr(policy, "predict", None)):
            raise ConfigError(
                f"{self.where}: returned {shown(policy)}; expected an object with a method {_PREDICT}"
            )
        return CheckedPolicy(self.where, policy, interface)


class CheckedPolicy:
    """A policy of one's own whose errors and actions are reported with its name.

    Parameters
    ----------
    where : str
        Which code made it.
    policy
        Acts on the observations of N vehicles at once.
    interface : Interface
        The environment's.
    """

    def __init__(self, where: str, policy: Any, interface: Interface) -> None:
        self.name, self.interface, self._policy = where, interface, policy
        if hasattr(policy, "state_after"):  # found here, as on the policy itself
            self.state_after = self._state_after

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, Any]:
        """Valve commands for the next control period, as those of all policies.

        Raises
        ------
        ConfigError
            The code fails, or its action is none.
        """
        with _explained(self.name, f"; expected {_PREDICT}"):
            found = self._policy.predict(observation, state, episode_start, deterministic=deterministic)
        if not isinstance(found, tuple) or len(found) != 2:
            raise ConfigError(f"{self.name}: predict returned {shown(found)}; expected (action, state)")
        rows, single = self.interface.rows(observation, self.name)
        shape = (self.interface.actions,) if single else (len(rows), self.interface.actions)
        try:
            return checked_actions(found[0], shape).astype(np.float32), found[1]
        except ConfigError as error:
            raise ConfigError(f"{self.name}: {error}") from None

    def _state_after(self, run_in: RunIn) -> Any:
        """State at step 0, as the policy's own method gives it; errors as of `predict`."""
        with _explained(self.name, "; expected state_after(run_in)"):
            return self._policy.state_after(run_in)


def _factory(place: str, name: str) -> tuple[str, Callable[[Interface], Any]]:
    """Hash of the code at a place, and its factory."""
    where = f"{place}:{name}"
    with _explained(where):
        path = _file_of(place)
        root = _root(path)
        files = _covered(path, root)
        digest = _digest(files)
        if _loaded.get(place, ("",))[0] != digest:
            _forget(root, files)
            _loaded[place] = digest, _load(place, path)
        module = _loaded[place][1]
    factory = getattr(module, name, None)
    if not callable(factory):
        raise ConfigError(f"{where}: has no function '{name}'")
    return digest, factory


def _file_of(place: str) -> Path:
    if place.endswith(".py"):
        if not Path(place).is_file():
            raise ConfigError(f"{place}: no such file")
        return Path(place)
    if str(Path.cwd()) not in sys.path:  # as with python -m
        sys.path.append(str(Path.cwd()))
    spec = None
    if all(part.isidentifier() for part in place.split(".")):
        with suppress(ModuleNotFoundError):  # of its package
            spec = importlib.util.find_spec(place)
    if spec is None or not spec.origin or not spec.origin.endswith(".py"):
        raise ConfigError(f"{place}: no such module")
    return Path(spec.origin).resolve()


def _root(path: Path) -> Path:
    """The folder of a file, or that of its package."""
    folder = path.parent
    while (folder / "__init__.py").is_file():
        folder = folder.parent
    return folder


def _forget(root: Path, files: list[Path]) -> None:
    """Forget former versions of modules, and those of the same names that code in another folder has."""
    for file in files:
        if file.suffix == ".py" and file.is_relative_to(root):
            name = ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
            origin = getattr(sys.modules.get(name), "__file__", None) or ""
            if origin and not origin.startswith(_INSTALLED):
                del sys.modules[name]


def _load(place: str, path: Path) -> ModuleType:
    """Run the code, with its folder first among the places of modules."""
    importlib.invalidate_caches()
    folder = str(path.parent)
    if not place.endswith(".py"):
        return importlib.import_module(place)
    spec = importlib.util.spec_from_file_location(f"sayd_policy_{_digest([path])[:16]}", path)
    assert spec is not None  # the file exists and ends in .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(folder)
        sys.path.append(folder)  # for what the code imports only when it acts
    return module


def _covered(path: Path, root: Path) -> list[Path]:
    """The file, all modules of its package, and what these import or name beside them."""
    todo = sorted((root / path.relative_to(root).parts[0]).rglob("*.py")) or [path]
    found = set[Path]()
    while todo:
        file = todo.pop()
        if file in found or not file.is_file():  # a pipe, of which nobody knows when it ends
            continue
        found.add(file)
        if file.suffix == ".py" and str(root) not in _INSTALLED:
            with suppress(SyntaxError, ValueError):  # reported where it is imported
                for name in _names(ast.parse(read_bytes(file, "Python file", LARGEST))):
                    todo += _beside(root, name)
    return sorted(found)


def _names(tree: ast.AST) -> Iterator[str]:
    """Modules that code imports, and texts that may be files."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (f"{alias.name.replace('.', '/')}.py" for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            module = node.module.replace(".", "/")
            yield from (f"{module}.py", *(f"{module}/{alias.name}.py" for alias in node.names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value) < 256:
            yield node.value


def _beside(folder: Path, name: str) -> list[Path]:
    """The file of this name in a folder, or all modules of the package that it belongs to."""
    try:
        first = folder / name.partition("/")[0].removesuffix(".py")
        if first.name == "sayd_env":  # its sources count in every run
            return []
        if name.endswith(".py") and (first / "__init__.py").is_file():
            return sorted(first.rglob("*.py"))
        return [folder / name] if name and (folder / name).is_file() else []
    except (OSError, ValueError):  # a text that no file can have as its name
        return []


def _digest(files: list[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()


@contextmanager
def _explained(where: str, expected: str = "") -> Iterator[None]:
    """Turn whatever the code of a policy raises into one message with file, line and exception.

    What is raised before its first line runs, as by a call with other arguments, comes with what is expected.
    """
    try:
        yield
    except SaydError as error:
        known = str(error).startswith(where.rpartition(":")[0])
        raise ConfigError(str(error) if known else f"{where}: {error}") from None
    except (Exception, SystemExit) as error:  # code of somebody else fails in any way
        frames = list(traceback.extract_tb(error.__traceback__))
        own = [frame for frame in frames if not frame.filename.startswith((*_INSTALLED, _PACKAGE, "<"))]
        places = [(frame.filename, frame.lineno) for frame in own[-1:]]
        if isinstance(error, SyntaxError) and error.filename:
            places = [(error.filename, error.lineno)]
        place = "".join(f"{file}, line {line}: " for file, line in places)
        said = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
        raise ConfigError(f"{where}: {place}{said}{'' if places else expected}") from None
