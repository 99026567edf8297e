"""Slips: hidden in photographs whose camera, or board, really stands elsewhere from an image on, by physics of their own.

More of them are in benchmarks/slow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from calflow.diagnosis.screening import Catalogue
from calflow.effects.camera_slip import CameraSlip
from calflow.measurements.measurements import Measurements, combined
from conftest import in_process
from observations.photographed import IN_HAND, ON_TABLE, UR5E, Arm, Photographs, board, frame, photographed
from observations.test_camera import study

IMAGES, BEFORE = 20, 13  # the images beside the slip are fitted, so that they tell where it is
SHIFT = np.array([3e-4, -2e-4, 4e-4])
BOARD = board(5, 4, 0.05)  # as large as the usual one, with fewer points
CAUSES = ("camera-slip", "target-slip", "lens-step", "frame-step", "frame-drift", "joint-eccentricity")
ONLY = f"\n[stages.diagnose]\ncatalogue = {[*CAUSES]}\n".replace("'", '"')


STILL = frame()
SLIP = frame(Rotation.from_rotvec((1.5e-3, -1e-3, 2e-3)), SHIFT)


def slipped(
    seed: int,
    camera: np.ndarray = STILL,
    target: np.ndarray = STILL,
    images: int = IMAGES,
    of: slice = slice(BEFORE, None),
) -> Photographs:
    """Photographs of a worn arm whose camera, or board, stands elsewhere in its own frame in some images: those after a slip."""

    class Slipping(Arm):
        def links(self, q):
            found = super().links(q)
            if len(q) == images:
                back = ON_TABLE @ np.linalg.inv(target) @ np.linalg.inv(ON_TABLE)
                found[-1][of] = back @ found[-1][of] @ IN_HAND @ camera @ np.linalg.inv(IN_HAND)
            return found

    rng = np.random.default_rng(seed)
    worn = Slipping(UR5E.worn(rng).figures, False, UR5E.limits)
    return photographed(UR5E, True, images, rng, points=BOARD, worn=worn)


def findings(folder, made: Photographs) -> pd.DataFrame:
    """What a run names."""
    study(folder, made, "ur5e", True, ONLY)
    assert in_process("run", folder / "study.toml", "--out", folder / "runs").code == 0
    return pd.read_csv(folder / "runs" / "diagnose" / "findings.csv")


def test_a_camera_that_slipped_is_found_between_its_images(tmp_path):
    """Fails if the slip is missed, called a device's step, put within an image, or is of another size than the camera's."""
    assert_slipped(tmp_path, slipped(4, camera=SLIP), "camera-slip")


def assert_slipped(folder, made: Photographs, cause: str, last: str = f"the image of pose {BEFORE}") -> None:
    """One slip is named, its moment and size are the hidden one's, and it carries over."""
    found = findings(folder, made).set_index("cause")
    only = found.loc[cause]
    assert "slip" not in "".join(found.index.drop(cause))
    assert only["status"] == "named"
    assert f"after {last})" in only["statement"]
    assert only["estimate"] == pytest.approx(np.linalg.norm(SHIFT), abs=4 * only["sd"])
    assert only["heldout_mean"] < 0.3


def test_a_slip_is_of_one_of_several_series(tmp_path):
    """Fails if no slip is looked for where each camera is a series of its own, or it moves the images of another one."""
    data = study(tmp_path, slipped(6), "ur5e", True).measurements()
    halves = [(data.table["pose"].astype(int) % 2 == odd).to_numpy() for odd in (0, 1)]
    parts = [
        replace(data.only(rows), series=(replace(data.series[0], name=name),))
        for rows, name in zip(halves, "ab", strict=True)
    ]
    both = combined(parts)
    variants = CameraSlip.variants(data.robot, both)
    assert {one.of for one in variants} == {"a", "b"}
    numbers = both.table.groupby(both.device)["camera_number"].unique()
    assert numbers.map(len).tolist() == [1, 1]
    assert numbers["a"][0] != numbers["b"][0]


def test_later_images_of_one_camera_alone_are_known_as_its_own(tmp_path):
    """Fails if a file of one camera does not say which of several it is, so that no cause of that camera acts in it."""
    made = slipped(6)
    rows = made.rows.assign(camera=np.where(made.rows["pose"] % 2, "left", "right"))
    numbers = []
    for name, kept in (("both", rows), ("one", rows[rows["camera"] == "right"])):
        (tmp_path / name).mkdir()
        table = study(tmp_path / name, replace(made, rows=kept), "ur5e", True).measurements().table
        numbers.append(table.groupby("camera")["camera_number"].unique()["right"].tolist())
    assert numbers[0] == numbers[1]


def test_a_slip_is_between_images(tmp_path):
    """Fails if a moment parts the points of an image, or leaves fewer than three fitted images on either side."""
    made = slipped(6)
    data = study(tmp_path, made, "ur5e", True).measurements()
    ends = data.table.groupby("pose")["order"].max().to_numpy() + 0.5
    fitted = np.sort(data.table[data.train].groupby("pose")["order"].max().to_numpy()) + 0.5
    variants = CameraSlip.variants(data.robot, data)
    reached = {one.moment for slip in variants for one in (slip, *slip.finer(data))}
    assert reached == {*ends[(ends >= fitted[2]) & (ends < fitted[-3])]}


def test_no_cause_of_a_device_that_was_not_used_counts_as_untested(tmp_path):
    """Fails if `next` lists causes of a camera as untested where a tracker measured, or those of a tracker beside images."""
    images = study(tmp_path, slipped(6), "ur5e", True).measurements()
    positions = Measurements(images.robot, images.table.drop(columns=["u", "v"]))
    of_cameras = {"board-bent", "camera-slip", "lens-growth", "lens-step", "print-scale", "target-slip"}
    of_others = {"frame-step", "tool-slip"}
    for data, absent in ((positions, of_cameras), (images, of_others)):
        found = Catalogue.of(data, ("geometry",))
        assert absent <= found.superseded.keys()
        assert not absent & found.lacking.keys()
        assert not absent & {effect.id for effect in found.effects}
    assert not of_cameras & Catalogue.of(images, ("geometry",)).superseded.keys()
