"""A package as another vendor would write it, installed by hand: a module, and what pip leaves beside it."""

from __future__ import annotations

from pathlib import Path

HOSES = '''\
"""Hoses that pull at the first joint."""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from calflow.effects.base import Readable, Words
from calflow.effects.base import JointError, Term


@dataclass(frozen=True)
class HosePull(JointError):
    """dq1 = pull · tanh(q2 q3 / slack): stretched hoses pull the column round."""

    slack: float = 0.2

    id: ClassVar[str] = "hose-pull"
    title: ClassVar[str] = "pull of the hoses"
    words: ClassVar[Words] = Words("hose pull", "stretched hoses turn the column", "turn at full stretch")
    readable: ClassVar[Readable] = {"rad": (1e3, "thousandths")}
    place_word: ClassVar[str] = "column"

    @classmethod
    def variants(cls, robot, data):
        return cls(robot, 0.2), cls(robot, 0.8)

    @property
    def detail(self):
        return f"slack of {self.slack:g} rad²"

    def terms(self, joint, state, row):
        if joint > 0:
            return []
        return [Term("pull", "rad", 5e-4, 0.02, ca.tanh(state.q[1] * state.q[2] / self.slack))]
'''


def install(
    site: Path, module: str, source: str, entries: str, group: str = "calflow.effects", version: str = "1.2"
) -> Path:
    """Install a package of one module, named as it is, that brings these entry points; return the folder for the path."""
    meta = site / f"{module}-{version}.dist-info"
    meta.mkdir(parents=True, exist_ok=True)
    (site / f"{module}.py").write_text(source, encoding="utf-8")
    (meta / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: {version}\n", encoding="utf-8")
    (meta / "entry_points.txt").write_text(f"[{group}]\n{entries}\n", encoding="utf-8")
    return site


def hoses(site: Path) -> Path:
    """Install the effect hose-pull."""
    return install(site, "calflow_hoses", HOSES, "hose-pull = calflow_hoses:HosePull")
