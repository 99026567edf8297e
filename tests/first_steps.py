"""The arm of the first steps, by NumPy and SciPy alone, and the beginning of its study files for other measurements of it."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np

FIRST_STEPS = Path(__file__).parents[1] / "studies" / "first-steps"
ARM = runpy.run_path(str(FIRST_STEPS / "measured.py"))


def touching(sockets: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Readings (n, 6) [rad] that put the ball into sockets (n, 3) [m]: Newton's steps from anywhere, within the limits."""
    q, step = rng.uniform(ARM["LOW"], ARM["HIGH"], (len(sockets), 6)), 1e-7
    while np.abs(off := ARM["ball"](q) - sockets).max() > 1e-8:
        slopes = [(ARM["ball"](q + step * axis) - sockets - off) / step for axis in np.eye(6)]
        q = q - np.einsum("nki,ni->nk", np.linalg.pinv(np.stack(slopes, axis=-1)), off)
        outside = ((q < ARM["LOW"]) | (q > ARM["HIGH"])).any(axis=1)
        q[outside] = rng.uniform(ARM["LOW"], ARM["HIGH"], (outside.sum(), 6))
    return q


def head(study: str, *catalogue: str) -> str:
    """What a study file says before its measurements, for a copy that stands in any folder, and the causes to look for."""
    text = (FIRST_STEPS / study).read_text()
    begin = text[: text.index("\n[") + 1].replace("arm.toml", str(FIRST_STEPS / "arm.toml"))
    once = "[stages.identify]\nstarts = 1\n"
    return begin + once + (f"[stages.diagnose]\ncatalogue = {json.dumps(catalogue)}\n" if catalogue else "")
