"""Progress of long work: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING

from calflow.commands.console import say
from calflow.files.problems import seen

if TYPE_CHECKING:
    from calflow.stages.stage import Stage

AGAIN = 0.1  # s after which an interruption that was swallowed comes again


def progress() -> ProgressLines:
    """Return what shows progress where the command runs."""
    return ProgressBar() if sys.stderr.isatty() else ProgressLines()


class ProgressLines:
    """Progress as plain lines, for a log.

    Compiled code may swallow a KeyboardInterrupt that comes while it runs (CasADi's conversions do), so it comes again until
    the stage stops, and is raised at the next progress.
    """

    def __init__(self) -> None:
        self._told = 0.0
        self._interrupted = False
        self._again: threading.Timer | None = None

    def __enter__(self) -> ProgressLines:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._heeded()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _interrupt(self, *_: object) -> None:
        self._interrupted = True
        self._heeded()
        self._again = threading.Timer(AGAIN, _thread.interrupt_main)
        self._again.daemon = True
        self._again.start()
        raise KeyboardInterrupt

    def _heeded(self) -> None:
        if self._again:
            self._again.cancel()

    def start(self, stage: Stage, reason: str) -> None:
        self._told = time.monotonic()
        say(f"{stage.name}: {stage.title} ({reason})")

    def reuse(self, stage: Stage, reason: str) -> None:
        say(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        say(f"  {line}")

    def advance(self, share: float) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._show(share)

    def _show(self, share: float) -> None:
        if time.monotonic() - self._told > 10:
            self._told = time.monotonic()
            say(f"  {share:.0%}")

    def stop(self, stage: Stage) -> None:
        self._heeded()

    def finish(self, stage: Stage, seconds: float) -> None:
        say(f"  done in {seconds:.1f} s")


class ProgressBar(ProgressLines):
    """Progress as a bar, for a terminal."""

    def __enter__(self) -> ProgressBar:
        super().__enter__()
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self._console = Console(stderr=True, highlight=False)
        columns = (
            TextColumn("{task.description:10}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
        )
        self._progress = Progress(*columns, console=self._console)
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()
        super().__exit__()

    def start(self, stage: Stage, reason: str) -> None:
        self.say(f"{stage.name}: {stage.title} ({reason})")
        self._task = self._progress.add_task(stage.name, total=1.0)

    def reuse(self, stage: Stage, reason: str) -> None:
        self.say(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        self._progress.print(seen(line), markup=False)

    def _show(self, share: float) -> None:
        self._progress.update(self._task, completed=share)

    def finish(self, stage: Stage, seconds: float) -> None:
        self._progress.update(self._task, completed=1.0)
