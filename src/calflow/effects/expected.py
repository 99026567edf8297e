"""What a robot file expects of parameters, checked against the parameters that there are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calflow.effects import catalogue
from calflow.files.problems import nearest
from calflow.robot.robot import Robot


def mistaken(robot: Robot, effects: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Yield which of a robot's expectations cannot be met by a study's effects, from 0, and why; others' are not looked at."""
    declared = {name: {one.identity: one for one in catalogue()[name](robot).declared} for name in effects}
    twice = [one.identity for one in robot.expected]
    for k, one in enumerate(robot.expected):
        if one.effect not in catalogue():
            yield k, f"unknown effect '{one.effect}'{nearest(one.effect, catalogue())}"
        elif twice.index(one.identity) < k:
            yield k, f"parameter '{one.part}.{one.symbol}' of effect '{one.effect}' is expected twice"
        elif one.effect in declared:
            known = declared[one.effect]
            own, name = known.get(one.identity), f"{one.part}.{one.symbol}"
            if own is None:
                names = [f"{part}.{symbol}" for _, _, part, symbol in known]
                yield k, f"effect '{one.effect}' has no parameter '{name}'{nearest(name, names)}"
            elif own.unit != one.unit:
                yield k, f"parameter '{name}' is in {own.unit}, not {one.unit}"
            elif not own.lower <= one.mean <= own.upper:
                yield (
                    k,
                    f"parameter '{name}' is between {own.lower:g} and {own.upper:g} {own.unit}, expected {one.mean:g}",
                )
