"""The doctor: checks of this machine for requirements of calflow and causes of slowness, with remedies."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from packaging.utils import canonicalize_name

from calflow.files.plugins import packages
from calflow.files.problems import InputError
from calflow.measurements.source import data_folder
from calflow.model import NotCompiled, cache_folder, hindrance
from calflow.run_folder import code_digest
from calflow.runs.cache_key import machine, requirements

State = Literal["ok", "slow", "without", "trouble"]
NEEDED_BYTES = 200e6  # free disk space that a run of usual size needs, including its chain


@dataclass(frozen=True)
class Examined:
    """The result of one check: the object checked, its state, the finding, and the remedy.

    slow: everything works, but slowly; without: only this object's function is missing; trouble: calflow is unreliable.
    """

    what: str
    state: State
    found: str
    remedy: str = ""


def examine() -> list[Examined]:
    """Return the results of all checks of this machine, in order of importance."""
    return [
        _versions(), *_packages(), *_extras(), _plugins(), _compiler(), _folder("work folder", Path.cwd()), _temporary(),
        _fonts(), _data(), _threads(), _letters(),
    ]  # fmt: skip


def _versions() -> Examined:
    versions = (
        f"calflow {metadata.version('calflow')} (code {code_digest()}), Python {platform.python_version()}, {machine()}"
    )
    return Examined("versions", "ok", versions)


def _packages() -> Iterator[Examined]:
    """Yield a result for each required package that is missing or of a wrong version, or a single positive result."""
    wrong = []
    needs = requirements(metadata.distribution("calflow"))
    for need in needs:
        version = _version(need.name)
        if version is None or not need.specifier.contains(version, prereleases=True):
            wrong.append(
                Examined(need.name, "trouble", f"found {version or 'nothing'}, needed {need}", f"pip install '{need}'")
            )
    yield from wrong
    if not wrong:
        yield Examined("packages", "ok", ", ".join(f"{need.name} {_version(need.name)}" for need in needs))


def _extras() -> Iterator[Examined]:
    distribution = metadata.distribution("calflow")
    for extra in distribution.metadata.get_all("Provides-Extra") or ():
        needs = [need for need in requirements(distribution, extra) if canonicalize_name(need.name) != "calflow"]
        missing = [need for need in needs if _version(need.name) is None]
        if missing:
            names = ", ".join(need.name for need in missing)
            remedy = " ".join(f"'{need.name}{need.specifier}'" for need in missing)  # calflow itself is in no index
            yield Examined(f"extra {extra}", "without", f"not installed: {names}", f"pip install {remedy}")
        else:
            yield Examined(f"extra {extra}", "ok", "installed")


def _version(name: str) -> str | None:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(name)
    return None


def _plugins() -> Examined:
    try:
        versions = packages()
    except InputError as error:
        return Examined("plugins", "trouble", str(error), "fix or uninstall the package")
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    return Examined("plugins", "ok", listed or "no package brings effects or observations")


def _compiler() -> Examined:
    """Check that machine code can be compiled, which needs a compiler and a private cache folder."""
    if reason := hindrance():
        remedy = "install a C compiler (gcc, clang) or name one by CC; let XDG_CACHE_HOME name a folder that is yours"
        return Examined("compiler", "slow", f"{reason}: long fits, sampling and many poses take longer", remedy)
    try:
        folder = cache_folder()
        made = list(folder.glob("*.so"))
    except (NotCompiled, OSError) as error:  # removed in this very moment
        return Examined("compiler", "slow", str(error))
    size = sum(path.stat().st_size for path in made) / 1e6
    return Examined(
        "compiler", "ok", f"{os.environ.get('CC', 'cc')}; {len(made)} functions kept in {folder}, {size:.1f} MB"
    )


def _folder(what: str, folder: Path) -> Examined:
    """Check that a folder is writable and has enough free space."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return Examined(
            what, "trouble", f"cannot be written to: {error}", "work in another folder, or name one by --out"
        )
    room = f"{folder}, {free / 1e9:.1f} GB free"
    return Examined(what, "ok", room) if free > NEEDED_BYTES else Examined(what, "trouble", room, "make room")


def _temporary() -> Examined:
    try:
        folder = Path(tempfile.gettempdir())
    except OSError as error:
        return Examined("temporary files", "trouble", str(error), "let TMPDIR name a folder that can be written to")
    asked = os.environ.get("TMPDIR")
    if asked and folder != Path(asked).absolute():  # Python then uses another folder, a compiler does not
        return Examined("temporary files", "slow", f"TMPDIR={asked} is full or cannot be written to: {folder} is used instead",
                       "make room there, or let TMPDIR name another folder")  # fmt: skip
    return _folder("temporary files", folder)


def _fonts() -> Examined:
    """Check the fonts of reports, and that Matplotlib's list of them is cached, so that it is not rebuilt each time."""
    from matplotlib import get_cachedir
    from matplotlib.font_manager import fontManager

    number = len({entry.name for entry in fontManager.ttflist})
    kept = Path(get_cachedir())
    if kept.parent == Path(tempfile.gettempdir()) and "MPLCONFIGDIR" not in os.environ:
        return Examined("fonts", "slow", f"{number} families; their list is made anew for each report: no folder keeps it",
                       "let MPLCONFIGDIR name a folder that can be written to")  # fmt: skip
    return Examined("fonts", "ok", f"{number} families; letters that none has are shown by number")


def _data() -> Examined:
    folder = data_folder()
    if folder is None:
        return Examined("CALFLOW_DATA", "ok", "not set: measurements are looked for beside their study")
    if not folder.is_dir():
        return Examined("CALFLOW_DATA", "trouble", f"names no folder: {folder}", "correct or unset it")
    return Examined("CALFLOW_DATA", "ok", f"{folder} is looked in before the study's folder")


def _threads() -> Examined:
    asked, cores = os.environ.get("OMP_NUM_THREADS", ""), os.cpu_count() or 1
    if asked.isdigit() and int(asked) > 1:
        shared = f"{asked} threads for matrices too small to be shared, {cores} cores"
        return Examined("threads", "slow", shared, "unset OMP_NUM_THREADS")
    return Examined("threads", "ok", f"one for linear algebra, {cores} cores")


def _letters() -> Examined:
    encoding = (sys.stdout.encoding or "ascii").lower()
    if encoding.replace("-", "").replace("_", "") == "utf8":
        return Examined("letters", "ok", f"{encoding}; files are UTF-8 whatever the locale")
    return Examined("letters", "without", f"the terminal's are {encoding}: other letters may not be shown; files are UTF-8",
                   "set PYTHONIOENCODING=utf-8, or a UTF-8 locale")  # fmt: skip
