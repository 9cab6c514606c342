"""Object files of compiled kernels that run without Python on any processor of a kind."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import binding

from sayd_env.physics.kernel import njit

LINUX, WINDOWS = "x86_64-unknown-linux-gnu", "x86_64-w64-windows-gnu"
"""Targets for which `object_file` makes code."""

_PROCESSOR = "x86-64"
"""The instruction set that all 64-bit processors of Intel and AMD have."""


def object_file(kernel: Callable[..., Any], arguments: tuple[Any, ...], symbol: str, target: str) -> bytes:
    """Machine code of a kernel as a C function.

    The kernel's own source is compiled as its decorator does, with the kernels that it calls; only Numba's
    wrapper, which takes Python's objects, is left out. What remains is compiled for the target: no
    instruction of the machine that compiles is taken for granted.

    Parameters
    ----------
    kernel : callable
        Of `sayd_env.physics.kernel`, without arrays of its own, called with `arguments`.
    arguments : tuple
        Numba types of its arguments.
    symbol : str
        Name of the function: ``int symbol(int64_t *result, void **error, ...)``. A flat array is seven
        arguments: two null pointers, size, 8, the data's address, size and 8.
    target : str
        LINUX or WINDOWS.
    """
    dispatcher: Any = kernel
    options = {key: dispatcher.targetoptions[key] for key in ("error_model", "nogil", "_nrt")}
    compiled = njit(**options)(dispatcher.py_func)  # of code from a cache there is no text
    compiled.compile(arguments)
    (overload,) = compiled.overloads.values()
    name = overload.fndesc.llvm_func_name
    text = overload.library.get_llvm_str().replace(name, symbol)
    text = re.sub(r'^target (triple|datalayout) = ".*"$', "", text, flags=re.MULTILINE)
    # `gathered_reads` states features of the machine that compiles.
    text = re.sub(r'"target-features"="[^"]*"', "", text)
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    machine = binding.Target.from_triple(target).create_target_machine(
        cpu=_PROCESSOR, opt=3, reloc="pic", codemodel="small"
    )
    module = binding.parse_assembly(text)
    module.triple, module.data_layout = target, str(machine.target_data)
    for function in module.functions:
        if not function.is_declaration and function.name != symbol:
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    # What nothing reaches any more goes: the wrappers, and with them all of Python.
    passes = binding.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, binding.create_pass_builder(machine, binding.create_pipeline_tuning_options()))
    module.verify()
    return bytes(machine.emit_object(module))


FLOAT = numba.types.float64
ARRAY = numba.types.Array(FLOAT, 1, "C")
