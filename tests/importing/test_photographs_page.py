"""The page on photographs, word for word, with photographs that are rendered here of a printed board and a worn arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from importing.test_target_detection import MARGIN, SCALE, flat_picture
from made.walk import follow
from observations.photographed import IN_HAND, ON_TABLE, SIZE, UR5E, Arm, Optics, frame, looking
from test_docs import page_text, run

cv2 = pytest.importorskip("cv2")
BOARD = {"kind": "charuco", "columns": 6, "rows": 5, "size_mm": 40, "marker_mm": 30, "dictionary": "DICT_5X5_100"}
IMAGES = 24
FACING = frame(Rotation.from_euler("x", np.pi))  # a detected board's z axis leads away from who looks at it
NOISE = 3.0  # grey levels


def urdf(arm: Arm) -> str:
    """A URDF of an arm of standard DH figures, from `base_link` to `tool0`."""
    ends = [
        '<origin xyz="0 0 0"/>',
        *(f'<origin xyz="{a} 0 {d}" rpy="{alpha} 0 0"/>' for alpha, a, _, d in arm.figures),
    ]
    links = ["base_link", *(f"link{k}" for k in range(1, len(ends))), "tool0"]
    text = "".join(f'<link name="{name}"/>\n' for name in links)
    for k, (end, (low, high)) in enumerate(zip(ends[:-1], arm.limits, strict=True)):
        limit = f'<axis xyz="0 0 1"/><limit lower="{low}" upper="{high}" effort="100" velocity="3"/>'
        between = f'<parent link="{links[k]}"/><child link="{links[k + 1]}"/>'
        text += f'<joint name="joint{k + 1}" type="revolute">{between}{end}{limit}</joint>\n'
    between = f'<parent link="{links[-2]}"/><child link="tool0"/>'
    return f'<robot name="arm">\n{text}<joint name="flange" type="fixed">{between}{ends[-1]}</joint>\n</robot>\n'


def photographs(folder: Path, worn: Arm, rng: np.random.Generator) -> pd.DataFrame:
    """Write what a camera in the arm's hand sees of the board on the table; the joint readings, a row an image."""
    lens, flat = Optics(), cv2.GaussianBlur(flat_picture(BOARD), (0, 0), SCALE / 2)
    pixels = np.stack(np.meshgrid(*map(np.arange, SIZE.astype(int))), axis=2).reshape(-1, 1, 2).astype(float)
    matrix = np.array([[lens.focal[0], 0, lens.centre[0]], [0, lens.focal[1], lens.centre[1]], [0, 0, 1]])
    rays = cv2.undistortPoints(pixels, matrix, np.array(lens.bend))[:, 0]
    corners = 1e-3 * BOARD["size_mm"] * np.array([(i, -j, 0.0) for j in range(1, 5) for i in range(1, 6)])
    q = looking(UR5E, corners, True, IMAGES, rng)
    for k, hand in enumerate(worn.links(q)[-1], start=1):
        seen = np.linalg.inv(hand @ IN_HAND) @ ON_TABLE @ FACING
        on_board = np.column_stack([rays, np.ones(len(rays))]) @ np.linalg.inv(seen[:3, [0, 1, 3]]).T
        there = MARGIN + 1e3 * SCALE * on_board[:, :2] / on_board[:, 2:] - 0.5
        shape = (*SIZE.astype(int)[::-1], 2)
        image = cv2.remap(flat, there.reshape(shape).astype(np.float32), None, cv2.INTER_LINEAR, borderValue=150)
        cv2.imwrite(
            str(folder / f"{k}.png"),
            np.clip(0.7 * image + 30 + rng.normal(0, NOISE, image.shape), 0, 255).astype(np.uint8),
        )
    readings = pd.DataFrame(np.degrees(q), columns=[f"q{i}_deg" for i in range(1, 7)]).round(4)
    return readings.assign(image=[f"{k}.png" for k in range(1, IMAGES + 1)])


def test_photographs_lead_to_a_calibrated_arm(tmp_path, monkeypatch):
    """Fails if a step of the page does not run, prints something else than it says, or does not better the arm."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(5)
    worn = UR5E.worn(rng)
    Path("arm.urdf").write_text(urdf(UR5E), encoding="utf-8")
    Path("photographs").mkdir()
    photographs(Path("photographs"), worn, rng).to_csv("joints.csv", index=False)
    follow(page_text("photographs"), run)
    errors = pd.read_csv("runs/my-arm/identify/in_space.csv").set_index(["model", "where"])["mean_mm"]
    assert errors["geometry", "holdout"] < 0.1 * errors["hand-eye alone", "holdout"]
    fitted = pd.read_csv("runs/my-arm/diagnose/parameters.csv").set_index("parameter")
    for name, true in zip(("fx", "fy", "cx", "cy"), (*Optics().focal, *Optics().centre), strict=True):
        assert abs(fitted["calibrated"][f"camera.{name}"] - true) < 5 * fitted["sd"][f"camera.{name}"] + 0.2
    assert Path("runs/my-arm/report.pdf").is_file()
