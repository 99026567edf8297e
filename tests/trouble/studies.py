"""Studies to be spoilt: small ones that say as much as files can, each written in another way."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from conftest import SMALL, in_process

COLUMNS = [
    "time_s",
    "temperature_degC",
    "session",
    "approach1",
    "approach2",
    "approach3",
]  # further ones of the first study

MAPPED = """
[measurements]
file = "measurements.csv"
name = "tracker"
separator = ";"
decimal = ","
missing = "skip"
sigma_mm = 0.04

[measurements.station]
known = true

[measurements.columns]
pose = "Nr"
repeat = "Wdh"
payload = "Last"
q1_deg = "J1"
q2_deg = "J2"
q3_rad = "J3"

[measurements.markers.left]
x_mm = "L x"
y_mm = "L y"
z_mm = "L z"

[measurements.markers.right]
x_m = "R x"
y_m = "R y"
z_m = "R z"
"""

URDF = """\
<?xml version="1.0"?>
<robot name="arm">
  <link name="base_link"/>
  <link name="shoulder">
    <inertial><origin xyz="0 0.01 -0.1" rpy="0 0 0"/><mass value="60"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><geometry><box size="0.1 0.1 0.5"/></geometry></visual>
  </link>
  <link name="upper">
    <inertial><origin xyz="0.35 0.02 0.05"/><mass value="30"/></inertial>
  </link>
  <link name="fore">
    <inertial><origin xyz="0.3 0.02 0.01"/><mass value="15"/></inertial>
  </link>
  <link name="tool0"/>
  <joint name="first" type="revolute">
    <parent link="base_link"/><child link="shoulder"/>
    <origin xyz="0 0 0.5" rpy="0 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.9" upper="2.9" effort="100" velocity="2"/>
  </joint>
  <joint name="second" type="revolute">
    <parent link="shoulder"/><child link="upper"/>
    <origin xyz="0.1 0 0" rpy="-1.5708 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1.7" upper="0.7" effort="100" velocity="2"/>
  </joint>
  <joint name="third" type="revolute">
    <parent link="upper"/><child link="fore"/>
    <origin xyz="0.7 0 0" rpy="0.1 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-0.3" upper="2.4" effort="100" velocity="2"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="fore"/><child link="tool0"/>
    <origin xyz="0.6 0.05 0.08" rpy="0 0.3 0"/>
  </joint>
</robot>
"""

ON_URDF = """\
notes = "an arm by its URDF"

[urdf]
file = "arm.urdf"
tip = "tool0"

[payloads.light]
mass_kg = 2

[payloads.heavy]
mass_kg = 30
com_mm = [20, 10, 40]

[markers.tool]
point_mm = [60, 50, 80]
"""


def write_studies(folder: Path) -> dict[str, Path]:
    """Write the three studies, and return the folder of each: calflow's own columns, foreign ones, and a URDF."""
    plain, mapped, urdf = (folder / name for name in ("plain", "mapped", "urdf"))
    _write(plain, SMALL)
    _measured(plain)
    own = plain / "measurements.csv"
    own.write_text(_with_more_columns(own.read_text()))
    two = SMALL["robot.toml"].replace("[markers.tool]", "[markers.right]\npoint_mm = [500, -50, 80]\n\n[markers.left]")
    old = '\n[measurements]\nfile = "measurements.csv"\n'
    _write(mapped, SMALL | {"robot.toml": two, "study.toml": SMALL["study.toml"].replace(old, MAPPED)})
    _measured(mapped)
    own = mapped / "measurements.csv"
    own.write_text(_side_by_side(own.read_text()))
    truth = SMALL["truth.toml"].replace("a_mm", "y_mm")  # what a URDF's frames call it
    _write(urdf, SMALL | {"robot.toml": ON_URDF, "arm.urdf": URDF, "truth.toml": truth})
    _measured(urdf)
    return {"plain": plain, "mapped": mapped, "urdf": urdf}


def _write(folder: Path, files: dict[str, str]) -> None:
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


def _measured(folder: Path) -> None:
    answer = in_process("simulate", folder / "truth.toml")
    assert answer.code == 0, answer


def _with_more_columns(text: str) -> str:
    """The table with time, temperature, session and approach; labels stand last, where a cell that lacks is most easily missed."""
    header, *rows = csv.reader(io.StringIO(text))
    further = [
        [f"{30.5 * k}", f"{20 + 0.05 * k:.2f}", "Mon" if k < len(rows) / 2 else "Tue", *["1", "-1", "0"]]
        for k in range(len(rows))
    ]
    whole = [[*header, *COLUMNS], *([*row, *more] for row, more in zip(rows, further, strict=True))]
    last = [whole[0].index(name) for name in ("session", "payload")]
    order = [k for k in range(len(whole[0])) if k not in last] + last
    return "".join(",".join(row[k] for k in order) + "\n" for row in whole)


def _side_by_side(text: str) -> str:
    """Two markers in a row, as a German spreadsheet writes them: semicolons, decimal commas, one marker in metres."""
    rows = list(csv.DictReader(io.StringIO(text)))
    places = {(row["pose"], row["repeat"], row["marker"]): row for row in rows}
    lines = ["Nr;Wdh;J1;J2;J3;L x;L y;L z;R x;R y;R z;Bemerkung;Last"]
    for (pose, repeat, marker), left in places.items():
        if marker == "left":
            right = places[pose, repeat, "right"]
            turn = f"{float(left['q3_deg']) / 57.29577951308232:.8f}"
            seen = [
                *(left[f"{axis}_mm"] for axis in "xyz"),
                *(f"{float(right[f'{axis}_mm']) / 1e3:.7f}" for axis in "xyz"),
            ]
            cells = [pose, repeat, left["q1_deg"], left["q2_deg"], turn, *seen, "gut", left["payload"]]
            lines.append(";".join(cells).replace(".", ","))
    return "\n".join(lines) + "\n"
