"""Frames: the elementary transforms that a chain is made of, and the conventions that make them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

Motion = Literal["rx", "ry", "rz", "tx", "ty", "tz"]
Place = Literal["first", "middle", "last", "alone"]

PARALLEL = 0.1  # axes within this angle [rad] count as nearly parallel: their distance along z is not defined


@dataclass(frozen=True)
class Step:
    """One elementary transform: a turn about an axis or a shift along it, by value [rad or m].

    free says at which places of the chain an error of the value is a parameter of its own: it is not where another figure
    moves the tool in exactly the same way whatever the pose.
    """

    motion: Motion
    symbol: str
    value: float = 0.0
    free: tuple[Place, ...] = ()

    @property
    def is_length(self) -> bool:
        """Whether its value is a length [m]."""
        return self.motion[0] == "t"

    @property
    def unit(self) -> str:
        """Its value's unit."""
        return "m" if self.is_length else "rad"


@dataclass(frozen=True)
class Frame:
    """The way from the link before to a joint's own link.

    reach leads along the link before to that link's end, which then gives way (the first joint's comes after the base gave
    way); mount leads from there to the joint's axis; turn is about that axis, and a revolute joint's variable is added to
    it, whereupon the bearing gives way; body leads from the axis to the link's own frame, and a prismatic joint's variable
    is added to its first shift along z. listed orders the symbols as tables do; those not in it follow as they come.
    """

    turn: Step
    reach: tuple[Step, ...] = ()
    mount: tuple[Step, ...] = ()
    body: tuple[Step, ...] = ()
    listed: tuple[str, ...] = ()

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """All steps, in the order in which they are taken."""
        return (*self.reach, *self.mount, self.turn, *self.body)

    def step(self, symbol: str) -> Step:
        """Return the step with a symbol; KeyError where there is none."""
        return {step.symbol: step for step in self.steps}[symbol]

    @property
    def figures(self) -> dict[str, float]:
        """Each step's value by its symbol."""
        return {step.symbol: step.value for step in self.steps}

    def free(self, place: Place) -> tuple[Step, ...]:
        """Return the steps whose errors are parameters of their own at a place of the chain, as tables list them."""
        return tuple(step for step in self.every if place in step.free)

    @property
    def every(self) -> tuple[Step, ...]:
        """All steps as tables list them."""
        order = {symbol: k for k, symbol in enumerate(self.listed)}
        return tuple(sorted(self.steps, key=lambda step: order.get(step.symbol, len(order))))

    @property
    def slide(self) -> Step | None:
        """The step that a prismatic joint's variable is added to, if there is one."""
        return next((step for step in self.body if step.motion == "tz"), None)


class Convention(Protocol):
    """A way to state a frame by five figures [rad and m]."""

    def __call__(
        self, *, alpha: float = ..., a: float = ..., d: float = ..., theta: float = ..., beta: float = ...
    ) -> Frame: ...


def dh(*, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0, beta: float = 0.0) -> Frame:
    """Return the frame Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) of Denavit and Hartenberg (1955).

    The first joint's theta and d are the base's. Where the next axis is nearly parallel, d along it is replaced by beta
    (Hayati 1983); the last link's d is kept, its a, alpha and beta are the tool's.
    """
    parallel = _parallel(alpha)
    return Frame(
        turn=Step("rz", "theta", float(theta), ("middle", "last")),
        body=(
            Step("tz", "d", float(d), ("last",) if parallel else ("middle", "last")),
            Step("tx", "a", float(a), ("first", "middle")),
            Step("rx", "alpha", float(alpha), ("first", "middle")),
            Step("ry", "beta", float(beta), ("first", "middle") if parallel else ()),
        ),
        listed=("theta", "d", "beta", "a", "alpha"),
    )


def modified_dh(*, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0, beta: float = 0.0) -> Frame:
    """Return the frame Tx(a) Rx(alpha) Ry(beta) Rz(theta + q) Tz(d) of Craig (1986).

    The first joint's figures are all the base's. Where the axis before is nearly parallel, d is replaced by beta (Hayati
    1983; equations 1 and 6 of the HH800 paper).
    """
    beyond: tuple[Place, ...] = ("middle", "last")
    parallel = _parallel(alpha)
    return Frame(
        reach=(Step("tx", "a", float(a), beyond),),
        mount=(Step("rx", "alpha", float(alpha), beyond), Step("ry", "beta", float(beta), beyond if parallel else ())),
        turn=Step("rz", "theta", float(theta), beyond),
        body=(Step("tz", "d", float(d), () if parallel else beyond),),
        listed=("alpha", "a", "beta", "d", "theta"),
    )


CONVENTIONS: Mapping[str, Convention] = {"dh": dh, "modified-dh": modified_dh}


def follows(frame: Frame, convention: str) -> bool:
    """Return whether a frame is what a convention makes of its figures."""
    figures = frame.figures
    return set(figures) == {"alpha", "a", "d", "theta", "beta"} and frame == CONVENTIONS[convention](**figures)


def convention_of(frames: Sequence[Frame]) -> str | None:
    """Return the convention that all frames follow; None where there is no such."""
    return next((name for name in CONVENTIONS if all(follows(frame, name) for frame in frames)), None)


def kinematics(frames: Sequence[Frame]) -> str:
    """Say what frames follow: a convention's name, or `frames of its own`."""
    return convention_of(frames) or "frames of its own"


def places(n_joints: int) -> Iterator[Place]:
    """Return each joint's place in a chain."""
    for i in range(n_joints):
        if n_joints == 1:
            yield "alone"
        else:
            yield "first" if i == 0 else "last" if i == n_joints - 1 else "middle"


def _parallel(alpha: float) -> bool:
    return bool(abs(np.sin(alpha)) < PARALLEL)
