"""Causes common to a type of robots, distinguished from causes of individual robots by the share that shows them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from calflow.estimation.parameters import UNIT
from calflow.files.tables import column
from calflow.population.type_prior import FEWEST_ROBOTS

BELOW = 0.05  # largest posterior probability that the share lies on the other side of one half

Whose = Literal["type", "robot", "cannot tell"]


@dataclass(frozen=True)
class Shown:
    """A cause found in one robot: effect id, joint (0: none), variant in words, size with standard deviation in `unit`.

    rivals: effect ids and joints of the causes that the robot's measurements cannot distinguish from it.
    """

    cause: str
    joint: int
    detail: str
    size: float
    sd: float
    unit: str
    rivals: tuple[tuple[str, int], ...] = ()

    @property
    def place(self) -> tuple[str, int]:
        """Effect id and joint."""
        return self.cause, self.joint

    @property
    def places(self) -> tuple[tuple[str, int], ...]:
        """Those of the cause and of its rivals."""
        return (self.place, *self.rivals)


@dataclass(frozen=True, kw_only=True)
class CommonCause:
    """A cause that diagnose found in robots of a type.

    low and high bound the Jeffreys interval of the share; the spread is corrected for the estimation errors of the sizes.
    """

    type: str = column("the type's name", default="")
    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none", default=None)
    detail: str = column("the variant that most of these robots show; empty: they differ")
    whose: Whose = column(
        "`type`: significantly more than half of the type's robots have it; `robot`: significantly fewer; else `cannot tell`"
    )
    robots: tuple[str, ...] = column(
        "the robots that show it, or a cause that cannot be told from it there", separator="; "
    )
    of: int = column("number of robots of the type examined")
    low: float = column("lower end of the 95 % interval of the share of the type's robots that show it")
    high: float = column("upper end of that interval")
    size: float = column("median of the sizes in robots that show it in this variant", UNIT)
    spread: float = column("standard deviation of the true sizes", UNIT)
    unit: str = column("SI unit of the size")

    @property
    def share(self) -> float:
        """Share of the robots that show it."""
        return len(self.robots) / self.of


def common_causes(shown: Mapping[str, Sequence[Shown]]) -> list[CommonCause]:
    """Return every cause shown by robots of a type, classified as the type's or the robots' own, the most frequent first.

    A cause is the type's if its share significantly exceeds one half, and the robots' own if it is significantly smaller;
    with fewer than FEWEST_ROBOTS robots it is not classified.
    """
    left = [(robot, cause) for robot, causes in shown.items() for cause in causes]
    common = []
    while left:
        # One cause that all have is named in some robots, and a rival of it in the others.
        named = Counter(cause.place for _, cause in left)
        may_be = Counter(place for _, place in {(robot, place) for robot, cause in left for place in cause.places})
        place = max(named, key=lambda place: (may_be[place], named[place]))
        those: dict[str, Shown] = {}
        for robot, cause in sorted(left, key=lambda found: found[1].place != place):
            if place in cause.places:
                those.setdefault(robot, cause)
        common.append(_common(place, those, len(shown)))
        left = [(robot, cause) for robot, cause in left if those.get(robot) is not cause]
    return sorted(common, key=lambda cause: (-len(cause.robots), cause.cause, cause.joint or 0))


def _common(place: tuple[str, int], those: Mapping[str, Shown], of: int) -> CommonCause:
    number = len(those)
    posterior = scipy.stats.beta(number + 0.5, of - number + 0.5)
    low, high = (float(bound) for bound in posterior.ppf([0.025, 0.975]))
    below = float(posterior.cdf(0.5))
    sure: Whose = "type" if below < BELOW else "robot" if below > 1 - BELOW else "cannot tell"
    whose = sure if of >= FEWEST_ROBOTS else "cannot tell"
    named = [cause for cause in those.values() if cause.place == place]
    detail, same = Counter(cause.detail for cause in named).most_common(1)[0]
    detail = detail if same > 0.5 * len(named) else ""
    alike = [cause for cause in named if cause.detail == detail] or named
    sizes, sds = (np.array([getattr(cause, name) for cause in alike]) for name in ("size", "sd"))
    sized = np.isfinite(sizes) & np.isfinite(sds)
    spread = float("nan")
    if sized.sum() > 1:
        spread = float(np.sqrt(max(0.0, np.var(sizes[sized], ddof=1) - np.mean(sds[sized] ** 2))))
    return CommonCause(
        cause=place[0], joint=place[1] or None, detail=detail, whose=whose, robots=tuple(those),
        of=of, low=low, high=high, size=float(np.nanmedian(sizes)) if sized.any() else float("nan"), spread=spread,
        unit=named[0].unit,
    )  # fmt: skip
