"""From a model to a file of a Functional Mock-up Unit: description, shared libraries, archive."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import json
import math
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree

import numpy as np

import sayd_env
from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.storage import uninterrupted
from sayd_env.config.units import Array
from sayd_env.envs.vehicle import check_places
from sayd_env.fmu.controller import ControllerUnit, controller_content
from sayd_env.fmu.damper import damper_model
from sayd_env.fmu.machine_code import ARRAY, FLOAT, LINUX, WINDOWS, object_file
from sayd_env.fmu.serve import MODEL
from sayd_env.fmu.variable import INPUT, OUTPUT, PARAMETER, TIME, UNITS, Variable
from sayd_env.fmu.vehicle import vehicle_variables
from sayd_env.physics.coupled import couple
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.policies import policy_spec

VERSIONS = ("2", "3")
"""Of FMI."""

_SOURCE = Path(__file__).parent / "source"
_SYMBOL = "sayd_couple"
_KINDS = {TIME: "t", INPUT: "i", OUTPUT: "o", PARAMETER: "p"}
_FOLDERS = {
    LINUX: {"2": "linux64", "3": "x86_64-linux", "suffix": ".so"},
    WINDOWS: {"2": "win64", "3": "x86_64-windows", "suffix": ".dll"},
}
_ZIG = {LINUX: "x86_64-linux-gnu.2.17", WINDOWS: "x86_64-windows-gnu"}
_DATE = (1980, 1, 1, 0, 0, 0)  # the same content is the same file


@dataclass(frozen=True)
class Unit:
    """A model before it is made a file."""

    name: str
    """Letters, digits and underscores."""
    text: str
    variables: tuple[Variable, ...]
    step: float
    """Communication step that a tool takes if nobody says otherwise, s."""
    source: str
    """C file of the model."""
    targets: tuple[str, ...]
    """What its libraries can be made for."""
    memory: Array = field(default_factory=lambda: np.zeros(0))
    table: Array = field(default_factory=lambda: np.zeros(0))
    code: Callable[[str], bytes] | None = None
    """Object file for a target."""
    resources: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def plain(self) -> bool:
        """Whether its state is an array that can be copied."""
        return self.code is not None


def damper_unit(config: SaydDamperConfig) -> Unit:
    """The semi-active damper, in machine code: nothing of Python is needed where it runs.

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """
    model = damper_model(config)
    arguments = (FLOAT, ARRAY, ARRAY, ARRAY)
    return Unit(
        name="sayd_damper",
        text=f"Semi-active yaw damper '{config.name}': {config.description}",
        variables=model.variables,
        step=5e-4,
        source="damper.c",
        targets=(LINUX, WINDOWS),
        memory=model.memory,
        table=model.table,
        code=lambda target: object_file(couple, arguments, _SYMBOL, target),
    )


def vehicle_unit(scenario: Scenario, speed: float, seed: int) -> Unit:
    """The vehicle on its track; where it runs, Python with this package is needed.

    Parameters
    ----------
    scenario : Scenario
        With semi-active dampers.
    speed : float
        m/s; like the seed a parameter of the unit.
    seed : int

    Raises
    ------
    ConfigError
        Passive dampers, a speed or seed beyond those of a unit, a vehicle without two bogies' yaw dampers.
    """
    variables = vehicle_variables(scenario, speed, seed)
    check_places(VehicleModel(scenario), "the unit")
    return _process_unit(
        "sayd_vehicle",
        f"Rail vehicle '{scenario.vehicle.name}' with '{scenario.damper.name}' yaw dampers",
        variables,
        1e-3,
        {"kind": "vehicle", "scenario": scenario.content()},
    )


def controller_unit(policy: str, scenario: Scenario) -> Unit:
    """A policy; where it runs, Python with this package is needed.

    Parameters
    ----------
    policy : str
        As on a command line, see `sayd_env.runs.policies.policy_spec`; a file goes into the unit.
    scenario : Scenario
        With the damper whose characteristic the policy may know.

    Raises
    ------
    ConfigError
        An unknown policy, or one that a unit cannot hold.
    DataError
        A damaged file.
    """
    content, files = controller_content(policy)
    made = ControllerUnit(policy_spec(policy), scenario)
    return _process_unit(
        "sayd_controller",
        f"Controller '{policy}' of the dampers of a vehicle, one step of {made.period:g} s",
        made.variables,
        made.period,
        {"kind": "controller", "scenario": scenario.content(), **content},
        files,
    )


def _process_unit(
    name: str,
    text: str,
    variables: tuple[Variable, ...],
    step: float,
    content: Mapping[str, Any],
    files: Mapping[str, bytes] = MappingProxyType({}),
) -> Unit:
    return Unit(
        name=name,
        text=f"{text}; runs in a Python process with sayd-env",
        variables=variables,
        step=step,
        source="process.c",
        targets=(LINUX,),
        resources={MODEL: json.dumps(content).encode(), **files},
    )


def fmu_files(unit: Unit) -> dict[str, bytes]:
    """A unit as files by their names, one for each version of FMI.

    Raises
    ------
    ConfigError
        No C compiler, or FMPy, which brings FMI's headers, is not installed.
    StudyError
        The C compiler failed, or the unit is not valid.
    """
    headers = _headers()
    compilers = _compilers(unit)
    objects = {target: unit.code(target) for target in compilers} if unit.code is not None else {}
    token = _token(unit, objects)
    found = {}
    for version in VERSIONS:
        contents = {"modelDescription.xml": description(unit, version, token)}
        contents |= {f"resources/{name}": data for name, data in unit.resources.items()}
        for target, compiler in compilers.items():
            place = _FOLDERS[target]
            library = f"binaries/{place[version]}/{unit.name}{place['suffix']}"
            contents[library] = _library(unit, version, compiler, objects.get(target), token, headers)
        found[f"{unit.name}_fmi{version}.fmu"] = _archive(contents)
    return found


def _token(unit: Unit, objects: Mapping[str, bytes]) -> str:
    """What changes whenever a unit's content does: a library refuses another unit's description."""
    digest = hashlib.sha256(repr((unit.name, unit.text, unit.variables, unit.step)).encode())
    for name, data in sorted((dict(objects) | dict(unit.resources)).items()):
        digest.update(f"{name}\0{len(data)}\0".encode() + data)
    for array in (unit.memory, unit.table):
        digest.update(array.tobytes())
    return digest.hexdigest()


def _headers() -> Path:
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise ConfigError("export --fmu needs FMPy: install it with pip install 'sayd-env[fmu]'")
    return Path(spec.origin).parent / "c-code"


def _compilers(unit: Unit) -> dict[str, list[str]]:
    """Commands of the C compilers of this machine by what they make."""
    found: dict[str, list[str]] = {}
    own = shlex.split(os.environ.get("CC", "")) or next(
        ([c] for c in ("cc", "gcc", "clang") if shutil.which(c)), []
    )
    if own and sys.platform == "linux" and platform.machine() == "x86_64":
        found[LINUX] = own
    if importlib.util.find_spec("ziglang") is not None:
        found |= {
            target: [sys.executable, "-m", "ziglang", "cc", "-target", name] for target, name in _ZIG.items()
        }
    found = {target: command for target, command in found.items() if target in unit.targets}
    if not found:
        raise ConfigError(
            "export --fmu needs a C compiler: 'cc' on 64-bit Linux (apt install gcc; the variable "
            "CC names another one), or on any system pip install ziglang"
        )
    return found


def _library(
    unit: Unit, version: str, compiler: list[str], code: bytes | None, token: str, headers: Path
) -> bytes:
    with tempfile.TemporaryDirectory(prefix="sayd-fmu-") as name:
        folder = Path(name)
        (folder / "model.h").write_text(_model_header(unit, token))
        sources = [str(_SOURCE / f"fmi{version}.c")]
        if code is not None:
            (folder / "code.o").write_bytes(code)
            sources.append(str(folder / "code.o"))
        target = folder / "library"
        command = [
            *compiler,
            *("-std=gnu11", "-O2", "-s", "-fPIC", "-shared", "-fvisibility=hidden", "-Wno-attribute-alias"),
            *(f"-I{place}" for place in (headers, _SOURCE, folder)),
            f'-DMODEL="{unit.source}"',
            *sources,
            *("-o", str(target), "-lm"),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise ConfigError(f"{compiler[0]}: cannot be run ({error.strerror})") from None
        if done.returncode:
            raise StudyError(f"{' '.join(compiler)}: could not compile the unit\n{done.stderr.strip()}")
        return target.read_bytes()


def _model_header(unit: Unit, token: str) -> str:
    """What the C sources know of a unit."""
    variables = unit.variables
    resting = np.trim_zeros(unit.memory, "b")
    lines = [
        "#include <stddef.h>",
        f"enum {{ VARIABLES = {len(variables)}, MEMORY = {len(unit.memory)}, PLAIN = {int(unit.plain)} }};",
        f"static const char TOKEN[] = {json.dumps(token)};",
        _strings("NAME", (v.name for v in variables)),
        _numbers("START", (v.start for v in variables)),
        _numbers("LOW", (v.low for v in variables)),
        _numbers("HIGH", (v.high for v in variables)),
        f'static const char KIND[] = "{"".join(_KINDS[v.causality] for v in variables)}";',
        f'static const char TYPE[] = "{"".join("i" if v.integer else "r" for v in variables)}";',
    ]
    if not unit.plain:
        lines.append(f"static const char PYTHON[] = {json.dumps(sys.executable)};")
    else:
        lines += [_numbers("RESTING", resting), _numbers("TABLE", unit.table)]
    return "\n".join(lines) + "\n"


def _strings(name: str, values: Iterable[str]) -> str:
    return f"static const char *const {name}[] = {{{', '.join(map(json.dumps, values))}}};"


def _numbers(name: str, values: Iterable[float]) -> str:
    """An array of doubles, exact."""
    texts = (float(v).hex() if math.isfinite(v) else math.copysign(1, v) * 1e999 for v in values)
    written = ", ".join(str(text).replace("-inf", "-INFINITY").replace("inf", "INFINITY") for text in texts)
    return f"static const double {name}[] = {{{written}}};"


@uninterrupted()
def _archive(contents: Mapping[str, bytes]) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in contents.items():
            info = zipfile.ZipInfo(name, _DATE)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, data)
    return held.getvalue()


def description(unit: Unit, version: str, token: str) -> bytes:
    """The model description of a unit by a version of FMI."""
    third = version == "3"
    state = "FMUState" if third else "FMUstate"
    root = ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": unit.name,
            "instantiationToken" if third else "guid": token,
            "description": unit.text,
            "generationTool": f"sayd-env {sayd_env.__version__}",
            "variableNamingConvention": "structured",
        },
    )
    plain = str(unit.plain).lower()
    ElementTree.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": unit.name,
            "needsExecutionTool": str(not unit.plain).lower(),
            "canHandleVariableCommunicationStepSize": "true",
            f"canGetAndSet{state}": plain,
            f"canSerialize{state}": plain,
        },
    )
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(v.unit for v in unit.variables if v.unit != "1"):
        each = ElementTree.SubElement(units, "Unit", {"name": name})
        ElementTree.SubElement(each, "BaseUnit", {base: str(power) for base, power in UNITS[name].items()})
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", {"name": "logStatusError"})
    ElementTree.SubElement(
        root, "DefaultExperiment", {"startTime": "0", "stopTime": "1", "stepSize": f"{unit.step:g}"}
    )
    variables = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(unit.variables):
        _describe(variables, variable, reference, third)
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [i for i, v in enumerate(unit.variables) if v.causality == OUTPUT]
    if third:
        for kind in ("Output", "InitialUnknown"):
            for i in outputs:
                ElementTree.SubElement(structure, kind, {"valueReference": str(i)})
    else:
        for kind in ("Outputs", "InitialUnknowns"):
            group = ElementTree.SubElement(structure, kind)
            for i in outputs:
                ElementTree.SubElement(group, "Unknown", {"index": str(i + 1)})
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, "utf-8", xml_declaration=True))


def _describe(parent: ElementTree.Element, variable: Variable, reference: int, third: bool) -> None:
    about = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.text,
        "causality": variable.causality,
        "variability": "fixed" if variable.causality == PARAMETER else "continuous",
    }
    number = (lambda x: str(int(x))) if variable.integer else repr
    typed = {} if variable.unit == "1" else {"unit": variable.unit}
    if variable.causality in (INPUT, PARAMETER):
        typed["start"] = number(float(variable.start))
    limits = {"min": variable.low, "max": variable.high}
    typed |= {name: number(float(limit)) for name, limit in limits.items() if math.isfinite(limit)}
    kind = ("Int32" if third else "Integer") if variable.integer else ("Float64" if third else "Real")
    if third:
        ElementTree.SubElement(parent, kind, about | typed)
    else:
        ElementTree.SubElement(ElementTree.SubElement(parent, "ScalarVariable", about), kind, typed)
