"""How a fleet stands, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from calflow.files.words import first_up, listed, mm, plural
from calflow.fleet.outcome import Outcome


def fleet_lines(found: Sequence[Outcome]) -> list[str]:
    """Return how a fleet stands in sentences."""
    lines = [f"{_count(found)}."]
    after = {one.robot: one.after_mean_mm for one in found if one.after_mean_mm is not None}
    before = [one.before_mean_mm for one in found if one.before_mean_mm is not None]
    if after and before:
        worst = max(after, key=lambda robot: after[robot])
        lines.append(
            f"Half of them have a mean position error of {mm(median(after.values()))} mm or less (before: "
            f"{mm(median(before))} mm); the worst one, {worst}, is left with {mm(after[worst])} mm."
        )
    return lines


def _count(found: Sequence[Outcome]) -> str:
    """Say how many robots are calibrated, and how many are not."""
    failed = [one.robot for one in found if one.status == "failed"]
    waiting = [one.robot for one in found if one.status == "not run"]
    useless = [one.robot for one in found if one.usable is False]
    said = [f"{sum(one.status == 'calibrated' for one in found)} of {plural(len(found), 'robot')} calibrated"]
    said += [f"{len(failed)} failed ({listed(failed, 6)})"] if failed else []
    said += [f"{len(waiting)} not run ({listed(waiting, 6)})"] if waiting else []
    said += [f"{len(useless)} with a model that is not to be used ({listed(useless, 6)})"] if useless else []
    return "; ".join(said)


def why(one: Outcome) -> str:
    """Say why there is no calibrated robot."""
    where = f" in {one.failed_stage}" if one.failed_stage else ""
    return f"{first_up(one.status)}{where}: {one.reason}"


def error(value: float | None) -> str:
    """Return an error as a table shows it."""
    return "–" if value is None else mm(value)
