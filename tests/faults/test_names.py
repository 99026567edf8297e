"""Sockets and planes that are named wrongly in single rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import calflow as cf
from calflow.faults import examined
from first_steps import ARM, FIRST_STEPS, head

STUDY = head("wire.toml")
NORMALS = {"floor": np.array([0, 0, 1.0]), "wall": np.array([1.0, 0, 0]), "slope": np.array([0.0, 0.6, 0.8])}


def study(folder: Path, kind: str, rows: list[list[str]]) -> cf.Study:
    """A study of one series, of rows with a header."""
    (folder / "m.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    text = STUDY + f'[[measurements]]\nkind = "{kind}"\nfile = "m.csv"\nsigma_mm = 0.05\n[split]\nholdout = 0.3\n'
    (folder / "study.toml").write_text(text)
    return cf.load_study(folder / "study.toml")


@pytest.mark.parametrize(("column", "wrong", "right"), [(0, "2", "1"), (1, "right", "left")])
def test_a_mistyped_socket_is_corrected(tmp_path, column, wrong, right):
    """Fails if its row is called an outlier, another name is put there, or a row that fits no socket is given a name."""
    rows = [line.split(",") for line in (FIRST_STEPS / "sockets.csv").read_text().splitlines()]
    assert rows[6][:2] == ["1", "left"]
    rows[6][column] = wrong
    rows[40][3] = str(float(rows[40][3]) + 3)
    data, (name, outlier) = examined(study(tmp_path, "same-point", rows).measurements())
    assert (name.cause, name.action, name.lines) == ("name-mistyped", "corrected", (7,))
    assert f"{('placement', 'socket')[column]} '{right}'" in name.statement
    assert data.table[["placement", "socket"]].iloc[5].tolist() == ["1", "left"]
    assert (outlier.cause, outlier.lines) == ("outlier", (41,))


def test_a_mistyped_plane_is_corrected_unless_two_others_fit(tmp_path):
    """Fails if a plane's row is called an outlier, or one as high over two others is given the name of one of these."""
    rng = np.random.default_rng(6)
    q, names = rng.uniform(ARM["LOW"], ARM["HIGH"], (180, 6)), np.repeat([*NORMALS], 60)

    def height(name: str, at: np.ndarray) -> float:
        return float(NORMALS[name] @ ARM["ball"](at[None])[0])

    def gap(part: float) -> float:
        at = q[0] + part * (q[other] - q[0])
        return height("floor", at) - height("wall", at)

    other = 1
    while gap(0) * gap(1) > 0:
        other += 1
    q[150] = q[0] + brentq(gap, 0, 1) * (q[other] - q[0])
    reading = [height(name, at) + rng.normal(0, 3e-5) for name, at in zip(names, q, strict=True)]
    reading[150] = height("floor", q[150])
    names[3] = "wall"
    header = ["plane", "reading_mm", *(f"q{i}_deg" for i in range(1, 7))]
    rows = [[name, f"{1e3 * r:.4f}", *ARM["degrees"](at)] for name, r, at in zip(names, reading, q, strict=True)]
    data, (name, outlier) = examined(study(tmp_path, "plane", [header, *rows]).measurements())
    assert (name.cause, name.action, name.lines) == ("name-mistyped", "corrected", (5,))
    assert data.table["plane"].iloc[3] == "floor"
    assert (outlier.cause, outlier.lines) == ("outlier", (152,))
