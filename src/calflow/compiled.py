"""Compiled functions: CasADi's C code built by the machine's compiler and cached by content."""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shlex
import shutil
import stat
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import casadi as ca

# Contraction and reassociation stay off, so that compiled code and CasADi's virtual machine agree to the last bit.
FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# An operation takes some 0.3 ms to compile and saves some 4 ns a row.
WORTH_EVALUATIONS = 75_000
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


class NotCompiled(Exception):
    """Why there is no machine code, to be told to the user once."""


def compiled(function: ca.Function, evaluations: int) -> ca.Function:
    """Return the function as machine code where that pays, else the function itself; results are the same.

    evaluations is how many rows the caller expects to evaluate. Where machine code would pay and cannot be had, that is
    logged once as a warning, and nothing changes but speed.
    """
    try:
        return _compiled(function, evaluations) or function
    except NotCompiled as reason:
        if evaluations >= WORTH_EVALUATIONS:
            _tell(str(reason))
        return function


def hindrance() -> str:
    """Return what keeps functions from being compiled, by compiling a small one; empty where nothing does."""
    x = ca.SX.sym("x")
    try:
        made = _compiled(ca.Function("trial", [x], [x * x]), WORTH_EVALUATIONS)
    except NotCompiled as reason:
        return str(reason)
    return "" if made else "machine code that was just made cannot be loaded"


def cache_folder() -> Path:
    """Where machine code is kept between runs: under XDG_CACHE_HOME, or ~/.cache.

    Raises:
        NotCompiled: there is no home folder.
    """
    if asked := os.environ.get("XDG_CACHE_HOME"):
        return Path(asked) / "calflow" / "compiled"
    try:
        home = Path.home()
    except RuntimeError:
        raise NotCompiled("there is no home folder to keep machine code in; XDG_CACHE_HOME can name another") from None
    if not home.is_dir():
        raise NotCompiled(f"there is no home folder {home} to keep machine code in; XDG_CACHE_HOME can name another")
    return home / ".cache" / "calflow" / "compiled"


def _compiled(function: ca.Function, evaluations: int) -> ca.Function | None:
    """Return the function as machine code; None where it is not there and would not pay."""
    command, folder = _compiler(), cache_folder()
    # What the code is made from: CasADi writes it out in half the time that it takes to make the code, which is seldom needed.
    content = [function.serialize(), ca.CasadiMeta.version(), *command, *FLAGS, platform.machine()]
    key = hashlib.sha256("\n".join(content).encode()).hexdigest()[:32]
    try:
        for library in sorted(folder.glob(f"{key}-*.so")):
            if _is_trusted(folder, library) and (loaded := _load(function, library)):
                return loaded
        return (
            None
            if evaluations < WORTH_EVALUATIONS
            else _load(function, _build(command, _source(function), folder, key))
        )
    except OSError as error:
        raise NotCompiled(f"the folder of machine code cannot be used ({error})") from None


def _source(function: ca.Function) -> str:
    """Return the function's C code."""
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    return str(generator.dump())


def _compiler() -> list[str]:
    """Return the compiler's command, from CC."""
    asked = os.environ.get("CC", "cc")
    try:
        command = shlex.split(asked)
    except ValueError as error:
        raise NotCompiled(f"CC={asked} is no command ({error})") from None
    if not command or shutil.which(command[0]) is None:
        raise NotCompiled(f"there is no C compiler '{asked}'")
    return command


def _is_trusted(folder: Path, library: Path) -> bool:
    """Whether a library is whole: its name ends in its own SHA-256.

    Raises:
        NotCompiled: others than its user could have put it there.
    """
    if not stat.S_ISREG(library.lstat().st_mode):
        return False
    _check_owner(folder)
    _check_owner(library)
    return library.stem.rpartition("-")[2] == _sha256(library)


def _check_owner(path: Path) -> None:
    if os.name != "posix":
        return  # modes say nothing there
    found = path.stat()
    if found.st_uid != os.geteuid():
        raise NotCompiled(f"{path} is not yours: machine code that somebody else put there is not loaded; remove it")
    if found.st_mode & OTHERS_WRITE:
        raise NotCompiled(
            f"others may write to {path}: machine code is not loaded from there; chmod go-w it, or remove it"
        )


def _load(function: ca.Function, library: Path) -> ca.Function | None:
    """Return what a library holds; None where it is made for another system."""
    try:
        return ca.external(function.name(), str(library))
    except RuntimeError:
        return None


def _build(command: list[str], source: str, folder: Path, key: str) -> Path:
    """Compile into the cache and return the library: whole or not at all, also when two processes build at once."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    _check_owner(folder)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        code, built = Path(work, "function.c"), Path(work, "function.so")
        code.write_text(source)
        try:
            subprocess.run([*command, *FLAGS, str(code), "-o", str(built), "-lm"], check=True, capture_output=True)
        except subprocess.CalledProcessError as error:
            said = error.stderr.decode(errors="replace").strip().splitlines()
            # The last line may say no more than that it ended.
            why = next((line for line in said if "error" in line), said[-1] if said else "")
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' failed{f': {why}' if why else ''}") from None
        except OSError as error:
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' cannot be run ({error})") from None
        if not built.is_file():
            raise NotCompiled(f"the C compiler '{shlex.join(command)}' made nothing")
        built.chmod(0o700)
        with built.open("rb+") as stream:
            os.fsync(stream.fileno())
        library = folder / f"{key}-{_sha256(built)}.so"
        built.replace(library)
    return library


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@lru_cache
def _tell(reason: str) -> None:
    """Say once why functions run uncompiled."""
    logging.getLogger("calflow").warning("slower, without machine code: %s", reason)
