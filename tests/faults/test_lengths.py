"""A wire's lengths in another unit than their column says."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calflow as cf
from calflow.faults import examined
from calflow.files.problems import InputError
from conftest import in_process
from first_steps import ARM, head

ANCHORS = ([1.9, 0.3, -0.2], [-0.9, 0.8, 0.9])
STUDY = head("wire.toml")


def wires(folder: Path, inches: slice, of: int) -> cf.Study:
    """A study of two wires with unknown anchors, some lengths of one of which are in inches."""
    rng, text = np.random.default_rng(7), STUDY
    for k, anchor in enumerate(ANCHORS):
        q = rng.uniform(ARM["LOW"], ARM["HIGH"], (80, 6))
        length = 1e3 * (np.linalg.norm(ARM["ball"](q) - anchor, axis=1) + rng.normal(0, 5e-5, 80))
        length[inches if k == of else slice(0)] /= 25.4
        header = ",".join([*(f"q{i}_deg" for i in range(1, 7)), "length_mm"])
        np.savetxt(
            folder / f"{k}.csv", np.column_stack([np.degrees(q), length]), "%.5f", ",", header=header, comments=""
        )
        text += f'[[measurements]]\nkind = "distance"\nname = "wire {k}"\nfile = "{k}.csv"\nsigma_mm = 0.05\n'
        text += "[measurements.settings]\noffset_mm = 0\nscale_um_per_m = 0\n"
    (folder / "study.toml").write_text(text + "[split]\nholdout = 0.3\n")
    return cf.load_study(folder / "study.toml")


def test_lengths_in_inches_are_read_so(tmp_path):
    """Fails if some rows in inches are taken for single outliers, or more are corrected than these."""
    data, (fault,) = examined(wires(tmp_path, slice(20, 50), 1).measurements())
    assert (fault.cause, fault.action) == ("unit-mistake", "corrected")
    assert fault.statement.startswith("lengths are in inches instead of mm in lines 22 to 51 of measurements wire 1")
    assert data.table["length"].min() > 0.1


def test_a_tool_stated_far_off_is_told(tmp_path):
    """Fails if its figure ends at a bound of the fit without a word, or a tool that the fit can correct is refused."""
    data = wires(tmp_path, slice(0), 0).measurements()
    ((name, marker),) = data.robot.markers.items()
    longer = [replace(marker, point=(*marker.point[:2], marker.point[2] + by)) for by in (0.03, 0.27)]
    near, far = (data.on(replace(data.robot, markers={name: marker})) for marker in longer)
    assert examined(near)[1] == ()
    with pytest.raises(InputError, match=rf"marker {name} is mistyped, 27\d mm off; expected about point_mm"):
        examined(far)


def test_lengths_that_no_robot_explains_are_not_ok(tmp_path):
    """Fails if a check calls a study valid whose nominal robot is decimetres off, for no reason that is looked for."""
    wires(tmp_path, slice(0), 0)
    assert in_process("check", tmp_path / "study.toml").out.splitlines()[-1] == "ok"
    for name in ("0.csv", "1.csv"):
        first, *rows = (tmp_path / name).read_text().splitlines()
        shuffled = [
            row.rsplit(",", 1)[0] + "," + other.rsplit(",", 1)[1] for row, other in zip(rows, rows[::-1], strict=True)
        ]
        (tmp_path / name).write_text("\n".join([first, *shuffled]))
    told = in_process("check", tmp_path / "study.toml").out.splitlines()[-1]
    assert re.match(r"not ok: the nominal robot misses by [\d.]+ mm, which no robot does", told)


@pytest.mark.parametrize("of", [0, 1])
def test_a_wire_in_inches_is_refused(tmp_path, of):
    """Fails if a whole wire that the nominal robot misses by decimetres is calibrated with, or the other wire is blamed."""
    with pytest.raises(InputError) as refused:
        examined(wires(tmp_path, slice(None), of).measurements())
    assert f"'wire {of}' are in inches instead of mm" in str(refused.value)
    assert f"'wire {1 - of}'" not in str(refused.value)
