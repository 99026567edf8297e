"""Python in processes of their own that need load no library: each is forked from one that has loaded them and has run nothing."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

LOADED = (
    "calflow.runs.run",
    "calflow.runs.checking",
    "calflow.reporting.document",
    "calflow.reporting.terminal",
    "calflow.simulation",
    "matplotlib.pyplot",
    "matplotlib.backends.backend_svg",
    "emcee",
    "h5py",
    "typst",
    "arviz_stats",
    "calflow.cli",
    "scipy.signal",
)


def nothing() -> None:
    """Do nothing."""


def processes() -> multiprocessing.context.ForkServerContext:
    """Return what starts such processes: never a fork of this one, which may have set a report, by threads of typst's."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(LOADED))
    return context


def forked(
    *arguments: object,
    cwd: Path,
    env: Mapping[str, str] | None = None,
    begin: Callable[[], object] = nothing,
    timeout: float | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run `python -m calflow …` or `python -c SOURCE …`; what reads the environment before Python starts wants a real one.

    Args:
        arguments: those of python.
        cwd: the folder that it runs in.
        env: its environment; this process's own by default.
        begin: is called there first; a function that can be pickled.
        timeout: how long to wait for it [s].

    Raises:
        subprocess.TimeoutExpired: it takes longer; it is killed.
    """
    called = [str(argument) for argument in arguments]
    with TemporaryDirectory() as folder:
        out, err = Path(folder, "out"), Path(folder, "err")
        process = processes().Process(
            target=_run, args=(called, str(cwd), dict(os.environ if env is None else env), begin, (str(out), str(err)))
        )
        process.start()
        process.join(timeout)
        if process.exitcode is None:
            process.kill()
            process.join()
            raise subprocess.TimeoutExpired(called, timeout or 0.0)
        texts = (path.read_text(encoding="utf-8") if path.exists() else "" for path in (out, err))
        return subprocess.CompletedProcess(called, process.exitcode, *texts)


def _run(
    called: list[str], cwd: str, env: dict[str, str], begin: Callable[[], object], streams: tuple[str, str]
) -> None:
    for number, path in enumerate(streams, start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", buffering=1, closefd=False)
    os.environ.clear()
    os.environ.update(env)
    os.chdir(cwd)
    sys.path[:0] = [path for path in env.get("PYTHONPATH", "").split(os.pathsep) if path and path not in sys.path]
    how, what, *rest = called
    begin()
    if how == "-c":
        sys.argv = ["-c", *rest]
        exec(compile(what, "<string>", "exec"), {"__name__": "__main__"})
        return
    assert (how, what) == ("-m", "calflow")
    from calflow.cli import program

    sys.argv = ["calflow", *rest]
    program()
