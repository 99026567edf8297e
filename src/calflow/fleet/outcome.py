"""An outcome: what came of a robot of a fleet, in figures and in the words of its own report."""

from __future__ import annotations

import json
from collections.abc import Container, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from calflow.files.problems import refuse
from calflow.files.results import from_document, is_whole, sealed, to_document
from calflow.files.tables import column
from calflow.files.writing import write_text

Status = Literal["calibrated", "failed", "not run"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a robot of a fleet."""

    robot: str = column("its name")
    type: str = column("its type")
    status: Status = column("whether its run came to its end; not run: nothing is known of it yet")
    usable: bool | None = column("false: its report says not to use the model; empty: there is none", default=None)
    verdict: str = column("its report's verdict, in words", default="")
    judged_by: Literal["holdout", "train", ""] = column("poses that the errors are of: held out, or fitted", default="")
    points: int | None = column("number of measured points among them", default=None)
    before_mean_mm: float | None = column("mean position error of the robot as its maker states it", "mm", default=None)
    before_max_mm: float | None = column("largest such error", "mm", default=None)
    after_mean_mm: float | None = column("mean position error of the calibrated robot", "mm", default=None)
    after_max_mm: float | None = column("largest such error", "mm", default=None)
    causes: tuple[str, ...] = column(
        "what diagnose found that the model lacked, with its size", separator="; ", default=()
    )
    failed_stage: str = column("the stage in which it failed; empty: before the first", default="")
    reason: str = column("why it failed, or was not run", default="")


def worst_first(outcomes: Iterable[Outcome], odd: Container[str] = ()) -> list[Outcome]:
    """Return outcomes in the order in which they need a look: failed, not to be used, odd, and then the largest error first."""

    def rank(one: Outcome) -> tuple[bool, bool, bool, float, str]:
        error = one.after_mean_mm or 0.0
        return one.status == "calibrated", one.usable is not False, one.robot not in odd, -error, one.robot

    return sorted(outcomes, key=rank)


def write_outcome(path: Path, outcome: Outcome) -> None:
    """Write an outcome whole."""
    write_text(path, json.dumps(sealed(to_document(outcome)), indent=2, ensure_ascii=False) + "\n")


def read_outcome(path: Path) -> Outcome | None:
    """Return an outcome that was written; None where there is none.

    Raises:
        InputError: it was changed, or another version of calflow wrote it.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict) or not is_whole(content):
            raise ValueError("it was changed since it was written")
        return from_document(content, Outcome)
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise refuse(f"cannot be read ({error}); delete it and run the fleet again", path) from None
