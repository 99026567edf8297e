"""The listener: who is told how a run goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from calflow.stages.stage import Stage


class Listener(Protocol):
    """Who is told how a run goes on."""

    def start(self, stage: Stage, reason: str) -> None:
        """A stage begins, and why."""

    def reuse(self, stage: Stage, reason: str) -> None:
        """A stage's results are reused, and why."""

    def say(self, line: str) -> None:
        """A stage has something to tell."""

    def advance(self, share: float) -> None:
        """This share of the stage's work is done; it never falls."""

    def stop(self, stage: Stage) -> None:
        """A stage ends before it is done."""

    def finish(self, stage: Stage, seconds: float) -> None:
        """A stage is done."""


class Silent:
    """A listener that does nothing."""

    def start(self, stage: Stage, reason: str) -> None:
        """Do nothing."""

    def reuse(self, stage: Stage, reason: str) -> None:
        """Do nothing."""

    def say(self, line: str) -> None:
        """Do nothing."""

    def advance(self, share: float) -> None:
        """Do nothing."""

    def stop(self, stage: Stage) -> None:
        """Do nothing."""

    def finish(self, stage: Stage, seconds: float) -> None:
        """Do nothing."""


def onward(advance: Callable[[float], None]) -> Callable[[float], None]:
    """Return advance for shares that may fall: it is told the largest so far."""
    furthest = 0.0

    def told(share: float) -> None:
        nonlocal furthest
        furthest = max(furthest, share)
        advance(furthest)

    return told
