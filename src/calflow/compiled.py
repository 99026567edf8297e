"""Compiled functions: CasADi's C code built by the machine's compiler and cached by content."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca

# Contraction and reassociation stay off, so that compiled code and CasADi's virtual machine agree to the last bit.
FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# An operation takes some 0.3 ms to compile and saves some 4 ns a row.
WORTH_EVALUATIONS = 75_000


def compiled(function: ca.Function, evaluations: int) -> ca.Function:
    """Return the function as machine code where that pays, else the function itself; results are the same.

    evaluations is how many rows the caller expects to evaluate. Without a compiler nothing changes but speed.
    """
    command = shlex.split(os.environ.get("CC", "cc"))
    if not command or shutil.which(command[0]) is None:
        return function
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    source = generator.dump()
    key = hashlib.sha256("\n".join([source, *command, *FLAGS, platform.machine()]).encode()).hexdigest()
    library = cache_folder() / f"{key[:32]}.so"
    if library.exists() and (loaded := _load(function, library)):
        return loaded
    if evaluations < WORTH_EVALUATIONS or not _build(command, source, library):
        return function
    return _load(function, library) or function


def cache_folder() -> Path:
    """Where machine code is kept between runs: under XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calflow" / "compiled"


def _load(function: ca.Function, library: Path) -> ca.Function | None:
    """Return what a library holds; None where it is damaged or made for another system."""
    try:
        return ca.external(function.name(), str(library))
    except RuntimeError:
        return None


def _build(command: list[str], source: str, library: Path) -> bool:
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            code, built = Path(folder, "function.c"), Path(folder, "function.so")
            code.write_text(source)
            subprocess.run([*command, *FLAGS, str(code), "-o", str(built), "-lm"], check=True, capture_output=True)
            built.replace(library)  # whole or not at all, also when two processes build at once
    except (OSError, subprocess.CalledProcessError):
        return False
    return True
