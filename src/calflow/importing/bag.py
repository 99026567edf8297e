"""ROS bags (bag, db3, mcap): topics of joint states, points or poses as foreign tables, timed by their headers."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calflow.files.deferred import pd
from calflow.files.problems import refuse
from calflow.importing.foreign_table import ForeignColumn, ForeignTable

BAGS = (".bag", ".db3", ".mcap")
QUATERNION = ("qx", "qy", "qz", "qw")
Values = dict[str, float]


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file with a bag's suffix, or a folder with the metadata that ROS 2 writes."""
    return path.suffix.lower() in BAGS or (path.is_dir() and (path / "metadata.yaml").is_file())


def bag_tables(path: Path) -> list[ForeignTable]:
    """Return one table for each topic of a bag with joint states, points or poses.

    Raises:
        InputError: the bag cannot be read or has no such topic, or the reader is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise refuse("is a ROS bag, which the extra 'bags' reads: pip install calflow[bags]", path) from None
    if path.suffix.lower() in BAGS[1:] and not (path.parent / "metadata.yaml").is_file():
        raise refuse("needs the metadata.yaml that ROS 2 writes beside it (ros2 bag reindex writes it anew)", path)
    folder = path.parent if path.suffix.lower() in BAGS[1:] else path
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            values: dict[str, list[Values]] = {}
            names: dict[str, str] = {}
            for connection, received, raw in reader.messages(
                [connection for connection in reader.connections if _plain(connection.msgtype) in READERS]
            ):
                message = reader.deserialize(raw, connection.msgtype)
                names[connection.topic] = _plain(connection.msgtype)
                values.setdefault(connection.topic, []).extend(
                    {"time_s": _time(message, received), **values}
                    for values in READERS[_plain(connection.msgtype)](message)
                )
            there = sorted({f"{connection.topic} ({_plain(connection.msgtype)})" for connection in reader.connections})
    except (AnyReaderError, OSError, ValueError, KeyError, AssertionError) as error:
        raise refuse(f"cannot be read as a ROS bag: {error}", path) from None
    tables = [_table(path, topic, rows, names[topic]) for topic, rows in values.items() if rows]
    if not tables:
        raise refuse(
            f"has no topic of joints or points ({', '.join(READERS)}); there are {', '.join(there) or 'no topics'}",
            path,
        )
    return tables


def _plain(kind: str) -> str:
    return kind.replace("/msg/", "/")


def _time(message: Any, received: int) -> float:
    """The header stamp of a message [s], or the time of its reception if it has none."""
    for holder in (message, *getattr(message, "transforms", ())):
        stamp = getattr(getattr(holder, "header", None), "stamp", None)
        if stamp is not None and (stamp.sec or stamp.nanosec):
            return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
    return 1e-9 * received


def _joints(message: Any) -> list[Values]:
    return [{f"{name} [joint]": float(q) for name, q in zip(message.name, message.position, strict=False)}]


def _xyz(point: Any) -> Values:
    return {"x": float(point.x), "y": float(point.y), "z": float(point.z)}


def _turn(turn: Any) -> Values:
    return {"qx": float(turn.x), "qy": float(turn.y), "qz": float(turn.z), "qw": float(turn.w)}


def _transforms(message: Any) -> list[Values]:
    """The pose columns of a message; those of several transforms are prefixed with the name of the child frame."""
    stamped = list(getattr(message, "transforms", [message]))
    named = len(stamped) > 1 or hasattr(message, "transforms")
    made: Values = {}
    for received in stamped:
        before = f"{re.sub(r'[^A-Za-z0-9]+', ' ', received.child_frame_id).strip()} " if named else ""
        values = _xyz(received.transform.translation) | _turn(received.transform.rotation)
        made |= {f"{before}{name}": value for name, value in values.items()}
    return [made]


READERS: Mapping[str, Callable[[Any], list[Values]]] = {
    "sensor_msgs/JointState": _joints,
    "geometry_msgs/PointStamped": lambda message: [_xyz(message.point)],
    "geometry_msgs/PoseStamped": lambda message: [_xyz(message.pose.position) | _turn(message.pose.orientation)],
    "geometry_msgs/TransformStamped": _transforms,
    "tf2_msgs/TFMessage": _transforms,
}


def _table(path: Path, topic: str, rows: list[Values], kind: str) -> ForeignTable:
    """The messages of a topic in order of time; joints that a message of joint states omits keep their latest value."""
    frame = pd.DataFrame(rows).sort_values("time_s", kind="stable").reset_index(drop=True)
    if "JointState" in kind:
        frame = frame.ffill()
    frame = frame.dropna(how="all", axis=1)
    columns = []
    for name in frame:
        figures = frame[name].to_numpy(float)
        plain = str(name).removesuffix(" [joint]")
        unit = "s" if name == "time_s" else "si" if plain != name else "" if plain.split()[-1] in QUATERNION else "m"
        cells = pd.Series(["" if np.isnan(figure) else repr(float(figure)) for figure in figures], dtype=object)
        columns.append(ForeignColumn("time" if name == "time_s" else plain, unit, cells, figures))
    reason = f"{len(frame)} messages {kind}, by the time of their headers"
    return ForeignTable(path, f"topic {topic}", tuple(columns), True, (reason,))
