"""Compiled functions: CasADi's C code built by the machine's compiler and cached by content."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca

# Contraction and reassociation stay off, so that compiled code and CasADi's virtual machine agree to the last bit.
FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# An operation takes some 0.1 ms to compile and saves some 4 ns a row.
WORTH_EVALUATIONS = 30_000


def compiled(function: ca.Function, evaluations: int) -> ca.Function:
    """Return the function as machine code where that pays, else the function itself; results are the same.

    evaluations is how many rows the caller expects to evaluate. Without a compiler nothing changes but speed.
    """
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        return function
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    source = generator.dump()
    key = hashlib.sha256("\n".join([source, compiler, *FLAGS, platform.machine()]).encode()).hexdigest()
    library = cache_folder() / f"{key[:32]}.so"
    if not library.exists() and (evaluations < WORTH_EVALUATIONS or not _build(compiler, source, library)):
        return function
    return ca.external(function.name(), str(library))


def cache_folder() -> Path:
    """Where machine code is kept between runs: under XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calflow" / "compiled"


def _build(compiler: str, source: str, library: Path) -> bool:
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            code, built = Path(folder, "function.c"), Path(folder, "function.so")
            code.write_text(source)
            subprocess.run([compiler, *FLAGS, str(code), "-o", str(built), "-lm"], check=True, capture_output=True)
            built.replace(library)  # whole or not at all, also when two processes build at once
    except (OSError, subprocess.CalledProcessError):
        return False
    return True
