"""What the report says of the task: whether the robot is accurate enough where it works."""

from __future__ import annotations

from calflow.files.results import Results
from calflow.reporting.words import mm
from calflow.sampling.task_tables import LIKELY, TaskSummary

SURE = 0.999  # probability from which no further digits are told


def task_of(results: Results) -> TaskSummary | None:
    """Return the summary of the task, None where the study names none."""
    path = "sample/task_summary.json"
    return results.document(path, TaskSummary) if path in results else None


def asked(task: TaskSummary) -> str:
    """Say what is asked of it."""
    parts = []
    if task.tolerance_mm is not None:
        parts.append(f"{mm(task.tolerance_mm)} mm")
    if task.turn_tolerance_mrad is not None:
        parts.append(f"{mm(task.turn_tolerance_mrad)} mrad")
    return " and ".join(parts)


def answer(task: TaskSummary) -> str | None:
    """Say in a sentence or two whether the task's tolerances are met; None where none is asked."""
    if task.likely_points is None or task.all_within is None or task.all_within_alike is None:
        return None
    where = "points of the path" if task.in_order else "points of the task"
    together = sorted((task.all_within, task.all_within_alike))
    low, high = map(chance, together)
    chances = low if low == high else f"{low} to {high}"
    sentence = (
        f"Task: {task.likely_points} of {task.points} {where} are within {asked(task)} with at least {100 * LIKELY:.0f} % "
        f"probability{_apart(task)}; all of them together with {chances}."
    )
    return sentence + (f" {strange(task)}" if task.beyond_measured else "")


def _apart(task: TaskSummary) -> str:
    """Say how many points meet each of two tolerances alone."""
    if task.likely_positions is None or task.likely_turns is None:
        return ""
    return f" ({task.likely_positions} in position alone, {task.likely_turns} in orientation alone)"


def task_lines(results: Results) -> list[str]:
    """Return the answer where a tolerance is asked of a task."""
    task = task_of(results)
    said = answer(task) if task else None
    return [said] if said else []


def strange(task: TaskSummary) -> str:
    """Say how many points are unlike what was measured."""
    return (
        f"{task.beyond_measured} of {task.points} points of the task are unlike what was measured, in joint readings or payload: "
        "what is said of them is extrapolated."
    )


def chance(probability: float) -> str:
    """Say a probability that draws tell to about a per cent."""
    if probability > SURE:
        return f"more than {100 * SURE:.1f} %"
    if probability < 1 - SURE:
        return f"less than {100 * (1 - SURE):.1f} %"
    return f"{100 * probability:.0f} %" if 0.01 < probability < 0.99 else f"{100 * probability:.1f} %"
