"""The arm of the first steps, by NumPy and SciPy alone, and the beginning of its study files for other measurements of it."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

FIRST_STEPS = Path(__file__).parents[1] / "studies" / "first-steps"
ARM = runpy.run_path(str(FIRST_STEPS / "measured.py"))


def head(study: str, *catalogue: str) -> str:
    """What a study file says before its measurements, for a copy that stands in any folder, and the causes to look for."""
    text = (FIRST_STEPS / study).read_text()
    begin = text[: text.index("\n[") + 1].replace("arm.toml", str(FIRST_STEPS / "arm.toml"))
    once = "[stages.identify]\nstarts = 1\n"
    return begin + once + (f"[stages.diagnose]\ncatalogue = {json.dumps(catalogue)}\n" if catalogue else "")
