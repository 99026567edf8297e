"""A reason: why a robot failed, in one line."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from calflow.files.problems import InputError, Problem


def reason(error: Exception) -> str:
    """Return why a robot failed; files are named as whoever wrote the fleet file knows them, not as seen from the robot's study."""
    problems = [_plainly(one) for one in error.problems] if isinstance(error, InputError) else [repr(error)]
    return "; ".join(map(str, problems))


def _plainly(problem: Problem) -> Problem:
    return problem if problem.file is None else replace(problem, file=Path(os.path.normpath(problem.file)))
