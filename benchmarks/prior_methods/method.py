"""What every method is: it is fitted to measured rows, and then says where the robot will be."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, Protocol

import numpy as np

from calflow.measurements.measurements import Measurements

Predictor = Callable[[Measurements], np.ndarray]  # rows -> positions (n_rows, 3) [m]


@dataclass(frozen=True)
class Fitted:
    """A method after its fit, and the processor's time [s] that this took."""

    positions: Predictor
    seconds: float


class Method(Protocol):
    """A method. Its fit sees training rows only."""

    @property
    def name(self) -> str:
        """What a table calls it."""

    def lacking(self, train: Measurements) -> str:
        """Say what it cannot do without and lacks; empty where nothing."""

    def fit(self, train: Measurements) -> Fitted:
        """Fit it to all the rows given."""


def timed(fit: Callable[[Any, Measurements], Predictor]) -> Callable[[Any, Measurements], Fitted]:
    """Return a fit that also says how long it took."""

    @wraps(fit)
    def told(method: Any, train: Measurements) -> Fitted:
        started = processor_seconds()
        return Fitted(fit(method, train), processor_seconds() - started)

    return told


def processor_seconds() -> float:
    """Return the processor's time [s] of this process and of those that it waited for."""
    return sum(os.times()[:4])
