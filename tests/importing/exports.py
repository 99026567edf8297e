"""Exports as people have them, of one calibration each: files of a UR10e's joints and of its reflector as a tracker saw it.

The robot that was measured is not the nominal one: joint zeros are off by up to a milliradian, and it stands anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import openpyxl
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.model import build

NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
ALPHABETICAL = np.argsort(NAMES)  # as ROS orders joint states


@dataclass(frozen=True)
class Campaign:
    """What was measured: readings (n, 6) [rad], points (n, 3) [m] in the tracker's frame, and the nominal robot's (n, 3) [m]."""

    q: np.ndarray
    points: np.ndarray
    nominal: np.ndarray

    @property
    def numbers(self) -> range:
        return range(1, len(self.q) + 1)


def campaign(robot: cf.Robot, seed: int, n: int = 40) -> Campaign:
    """Measure a robot that is nearly as its file says, with 20 µm of noise."""
    rng = np.random.default_rng(seed)
    low, high = np.clip(robot.limits, -2.6, 2.6).T
    q = np.round(rng.uniform(low, high, (n, robot.n_joints)), 6)
    model = build(robot, ())
    packed = np.zeros((model.n_conditions, n))
    packed[-1] = 1.0

    def at(readings: np.ndarray) -> np.ndarray:
        packed[: robot.n_joints] = readings.T
        return model.point(model.nominal, packed)

    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-3, 3, 3)
    real = at(q + rng.uniform(-1e-3, 1e-3, robot.n_joints)) @ turn.T + shift
    return Campaign(q, real + rng.normal(0, 2e-5, (n, 3)), at(q) @ turn.T + shift)


def recorded(of: Campaign, rate: float, seed: int, start: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A recording at a rate [1/s]: times (m,), readings (m, 6) and points (m, 3); 2 s still and 1.5 s of motion each."""
    rng = np.random.default_rng(seed)
    still, moving = round(2.0 * rate), round(1.5 * rate)
    way = (1 - np.cos(np.pi * np.arange(moving) / moving)) / 2
    q, p = [], []
    for k in range(len(of.q)):
        q.append(np.repeat(of.q[k : k + 1], still, axis=0))
        p.append(np.repeat(of.points[k : k + 1], still, axis=0))
        if k + 1 < len(of.q):
            q.append(of.q[k] + way[:, None] * (of.q[k + 1] - of.q[k]))
            p.append(of.points[k] + way[:, None] * (of.points[k + 1] - of.points[k]))
    joints, points = np.vstack(q), np.vstack(p)
    time = start + np.arange(len(joints)) / rate
    return time, joints + rng.normal(0, 2e-5, joints.shape), points + rng.normal(0, 1e-5, points.shape)


def german(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def lines(rows: object, separator: str) -> str:
    return "".join(separator.join(map(str, row)) + "\n" for row in rows)


def workbook(folder: Path, of: Campaign) -> list[Path]:
    """A workbook: a sheet about the job, one with a title, names, a line of units and a mean below the figures."""
    book = openpyxl.Workbook()
    about = book.active
    about.title = "Auftrag"
    about.append(["Kunde", "Muster GmbH"])
    about.append(["Datum", "2025-11-22"])
    sheet = book.create_sheet("Messung")
    sheet.append(["Messprotokoll UR10e"])
    sheet.append([])
    sheet.append(["Nr", *(f"Achse {i}" for i in range(1, 7)), "X", "Y", "Z", "Temperatur"])
    sheet.append([None, *["[°]"] * 6, *["[mm]"] * 3, "[°C]"])
    for k in of.numbers:
        sheet.append([k, *np.rad2deg(of.q[k - 1]).tolist(), *(1e3 * of.points[k - 1]).tolist(), 21.5])
    sheet.append(["Mittel", *[None] * 7, "n/a"])
    book.save(folder / "protokoll.xlsx")
    return [folder / "protokoll.xlsx"]


def instrument(folder: Path, of: Campaign) -> list[Path]:
    """An instrument's report in Windows' encoding: a head, decimal commas, nominal, actual and deviation side by side."""
    head = "Gerät;AT960-MR;;\nPrüfer;Jürgen Groß;;\n\n"
    titles = ["Messpunkt", *(f"Achse {i} [°]" for i in range(1, 7)),
              *(f"{kind} {axis} [mm]" for axis in "XYZ" for kind in ("Soll", "Ist", "Abw."))]  # fmt: skip
    rows = []
    for k in of.numbers:
        both = 1e3 * np.array([of.nominal[k - 1], of.points[k - 1]])
        parts = [german(v) for axis in range(3) for v in (both[0, axis], both[1, axis], both[1, axis] - both[0, axis])]
        rows.append([f"P{k:03d}", *(german(v, 5) for v in np.rad2deg(of.q[k - 1])), *parts])
    text = head + ";".join(titles) + "\n" + lines(rows, ";")
    (folder / "bericht.csv").write_bytes(text.replace("\n", "\r\n").encode("cp1252"))
    return [folder / "bericht.csv"]


def bare(folder: Path, of: Campaign) -> list[Path]:
    """Figures alone: a clock, joints in rad as ROS orders them, points in metres."""
    rows = np.column_stack([1.7e9 + 7.3 * np.arange(len(of.q)), of.q[:, ALPHABETICAL], of.points])
    np.savetxt(folder / "states.csv", rows, delimiter=",", fmt="%.7f")
    return [folder / "states.csv"]


def log_and_tracker(folder: Path, of: Campaign) -> list[Path]:
    """A robot's log in blanks without names, and the tracker's points in a file of their own, as many."""
    log = "".join(f"  {' '.join(f'{v:10.5f}' for v in np.rad2deg(row))}\n" for row in of.q)
    (folder / "robot.log").write_text(f"# joint positions\n{log}")
    (folder / "tracker.txt").write_text(
        "Point,X,Y,Z\n" + lines(([k, *(1e3 * of.points[k - 1])] for k in of.numbers), ",")
    )
    return [folder / "robot.log", folder / "tracker.txt"]


def by_name(folder: Path, of: Campaign) -> list[Path]:
    """Joints and points in files of their own, the points in another order and not all of them; tabs, UTF-16."""
    (folder / "poses.csv").write_text(
        "pose;J1;J2;J3;J4;J5;J6\n" + lines(([k, *np.rad2deg(of.q[k - 1])] for k in of.numbers), ";")
    )
    order = np.random.default_rng(7).permutation(list(of.numbers))[3:]
    text = "Name\tx [inch]\ty [inch]\tz [inch]\n" + lines(
        ([f"P{k}", *(of.points[k - 1] / 0.0254)] for k in order), "\t"
    )
    (folder / "points.txt").write_bytes(text.replace("\n", "\r\n").encode("utf-16"))
    return [folder / "poses.csv", folder / "points.txt"]


def turned_signs(folder: Path, of: Campaign) -> list[Path]:
    """A controller that counts axes 2 and 5 the other way; thousands apart, the unit behind each figure."""
    sign = np.array([1, -1, 1, 1, -1, 1])
    rows = [
        [
            k,
            *(f"{v:.5f} °" for v in np.rad2deg(sign * of.q[k - 1])),
            *(f'"{1e3 * v:,.4f} mm"' for v in of.points[k - 1]),
        ]
        for k in of.numbers
    ]
    (folder / "controller.csv").write_text("No,A1,A2,A3,A4,A5,A6,X,Y,Z\n" + lines(rows, ","), encoding="utf-8")
    return [folder / "controller.csv"]


def repeated_names(folder: Path, of: Campaign) -> list[Path]:
    """Two lines of names: a group over each three of X, Y and Z."""
    over = ["", *["Gelenkwinkel [rad]", *[""] * 5], *["Nominal", "", ""], *["Actual", "", ""]]
    under = ["Punkt", *(f"q{i}" for i in range(1, 7)), *"XYZ", *"XYZ"]
    rows = [
        [k, *of.q[k - 1], *(f"{1e3 * v:.4f}" for v in of.nominal[k - 1]), *(f"{1e3 * v:.4f}" for v in of.points[k - 1])]
        for k in of.numbers
    ]
    (folder / "table.csv").write_text(lines([over, under, *rows], ";"), encoding="utf-8")
    return [folder / "table.csv"]


def rtde(folder: Path, of: Campaign) -> list[Path]:
    """A controller's recording with targets, speeds and the tracker's stream beside it, zero-based names."""
    time, q, p = recorded(of, 25.0, 3, 1234.5)
    names = ["timestamp", *(f"target_q_{i}" for i in range(6)), *(f"actual_q_{i}" for i in range(6)),
             *(f"actual_qd_{i}" for i in range(6)), "lt_x", "lt_y", "lt_z"]  # fmt: skip
    rows = np.column_stack([time, np.round(q, 4), q, np.gradient(q, axis=0), p])
    (folder / "rtde.csv").write_text(" ".join(names) + "\n" + lines(rows, " "))
    return [folder / "rtde.csv"]


def two_recordings(folder: Path, of: Campaign) -> list[Path]:
    """Joint states and the tracker's stream, each recorded on its own clock."""
    time, q, _ = recorded(of, 25.0, 4, 100.0)
    other, _, p = recorded(of, 20.0, 5, 1.7e9)
    (folder / "joints.csv").write_text(",".join(["time", *NAMES]) + "\n" + lines(np.column_stack([time, q]), ","))
    (folder / "stream.csv").write_text("t [ms];x;y;z\n" + lines(np.column_stack([1e3 * other, 1e3 * p]), ";"))
    return [folder / "joints.csv", folder / "stream.csv"]


def late_clock(folder: Path, of: Campaign) -> list[Path]:
    """Joint states, and a point of each standstill by a tracker whose clock is 1.6 s late, its axes in one word with `act`."""
    time, q, _ = recorded(of, 25.0, 9, 0.0)
    (folder / "joints.csv").write_text(",".join(["time", *NAMES]) + "\n" + lines(np.column_stack([time, q]), ","))
    rows = np.column_stack([1.0 + 1.6 + 3.5 * np.arange(len(of.q)), 1e3 * of.points])
    (folder / "points.csv").write_text("time,Xact,Yact,Zact\n" + lines(rows, ","))
    return [folder / "joints.csv", folder / "points.csv"]


def _stamped(store: object, time: float, seq: dict[str, int]) -> object:
    kinds = store.types  # type: ignore[attr-defined]
    stamp = kinds["builtin_interfaces/msg/Time"](sec=int(time), nanosec=round(1e9 * (time % 1)) % 10**9)
    return kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="tracker", **seq)


def bag_of_ros2(
    folder: Path, of: Campaign, plugin: rosbag2.StoragePlugin = rosbag2.StoragePlugin.SQLITE3
) -> list[Path]:
    """A bag of ROS 2: joint states as ROS orders them and points, on one clock, among other topics."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    still = {"velocity": np.zeros(0), "effort": np.zeros(0)}
    time, q, p = recorded(of, 20.0, 6, 1.7e9)
    with rosbag2.Writer(folder / "bag", version=9, storage_plugin=plugin) as writer:
        kinds_of = {"/joint_states": "sensor_msgs/msg/JointState", "/tracker": "geometry_msgs/msg/PointStamped",
                    "/note": "std_msgs/msg/String"}  # fmt: skip
        to = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds_of.items()}
        text = kinds["std_msgs/msg/String"](data="begin")
        writer.write(to["/note"], round(1e9 * time[0]), store.serialize_cdr(text, "std_msgs/msg/String"))
        for t, joints, point in zip(time, q, p, strict=True):
            header = _stamped(store, t, {})
            names = [NAMES[i] for i in ALPHABETICAL]
            state = kinds[kinds_of["/joint_states"]](header=header, name=names,
                                                     position=joints[ALPHABETICAL], **still)  # fmt: skip
            seen = kinds[kinds_of["/tracker"]](
                header=header, point=kinds["geometry_msgs/msg/Point"](*map(float, point))
            )
            for topic, message in (("/joint_states", state), ("/tracker", seen)):
                writer.write(to[topic], round(1e9 * t), store.serialize_cdr(message, kinds_of[topic]))
    return [folder / "bag"]


def bag_of_ros1(folder: Path, of: Campaign) -> list[Path]:
    """A bag of ROS 1: joint states and transforms of a target, slower and a little later."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    still = {"velocity": np.zeros(0), "effort": np.zeros(0)}
    time, q, p = recorded(of, 20.0, 8, 1.6e9)
    state_kind, seen_kind = "sensor_msgs/msg/JointState", "geometry_msgs/msg/TransformStamped"
    with rosbag1.Writer(folder / "run.bag") as writer:
        joints_to = writer.add_connection("/joint_states", state_kind, typestore=store)
        seen_to = writer.add_connection("/target", seen_kind, typestore=store)
        for k, (t, joints, point) in enumerate(zip(time, q, p, strict=True)):
            state = kinds[state_kind](header=_stamped(store, t, {"seq": k}), name=list(NAMES), position=joints,
                                      **still)  # fmt: skip
            writer.write(joints_to, round(1e9 * t), store.serialize_ros1(state, state_kind))
            if k % 2:
                continue
            place = kinds["geometry_msgs/msg/Transform"](
                translation=kinds["geometry_msgs/msg/Vector3"](*map(float, point)),
                rotation=kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            )
            seen = kinds[seen_kind](
                header=_stamped(store, t + 0.004, {"seq": k}), child_frame_id="target", transform=place
            )
            writer.write(seen_to, round(1e9 * t), store.serialize_ros1(seen, seen_kind))
    return [folder / "run.bag"]


EXPORTS: dict[str, Callable[[Path, Campaign], list[Path]]] = {
    "workbook": workbook,
    "instrument's report": instrument,
    "no names": bare,
    "log and tracker": log_and_tracker,
    "by the points' names": by_name,
    "signs turned": turned_signs,
    "names over names": repeated_names,
    "controller's recording": rtde,
    "two recordings": two_recordings,
    "a clock that is late": late_clock,
    "bag of ROS 2": bag_of_ros2,
    "bag of ROS 1": bag_of_ros1,
}


def of_another_robot(folder: Path, of: Campaign) -> list[Path]:
    """Rows whose points belong to other poses."""
    order = np.random.default_rng(1).permutation(len(of.q))
    rows = ([*np.rad2deg(of.q[k]), *(1e3 * of.points[j])] for k, j in enumerate(order))
    (folder / "mixed.csv").write_text("J1,J2,J3,J4,J5,J6,X,Y,Z\n" + lines(rows, ","))
    return [folder / "mixed.csv"]
