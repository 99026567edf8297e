"""The table of commands: what a user gets of each target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.deployment.commands import Compensation
from calflow.files.tables import column, typed
from calflow.robot.readings import READINGS, reading_columns, shown_readings

AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class Command:
    """What is commanded to land on a target, and what is promised of it; the targets' own columns stand before."""

    reached: bool = column("whether the robot lands on the target, by the model; else no command is given")
    q: Mapping[str, float] = column("joint readings to command; empty where the target is out of reach", name=READINGS)
    expected_mm: float = column(
        "root mean square distance from the target to expect: remaining_mm and the standard deviations together", "mm"
    )
    remaining_mm: float = column(
        "distance from the target, by the model; out of reach: of the nearest pose within the limits", "mm"
    )
    remaining_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    sd_x_mm: float = column("how surely it is known where the tool will be, along the measuring frame's x", "mm")
    sd_y_mm: float = column("the same along y", "mm")
    sd_z_mm: float = column("the same along z", "mm")
    sd_rx_mrad: float = column(
        "how surely it is known how the tool will be turned about its own x; empty: not asked for", "mrad"
    )
    sd_ry_mrad: float = column("the same about its own y", "mrad")
    sd_rz_mrad: float = column("the same about its own z", "mrad")
    nominal_q: Mapping[str, float] = column(
        "readings that the nominal robot would be sent to", name=f"nominal_{READINGS}"
    )
    nominal_miss_mm: float = column("what these would miss the target by, by the model", "mm")
    nominal_miss_mrad: float = column("the same of the orientation; empty: none was asked for", "mrad")
    not_physical: Mapping[str, float] = column(
        "what of the position a residual field adds, which is not physical; only where the run has such a field", "mm",
        name="not_physical_{x|y|z}_mm",
    )  # fmt: skip
    limit_joint: int = column("the joint that is nearest to a limit, by share of its travel")
    to_limit: Mapping[str, float] = column(
        "how far it is from there; empty: it is of the other kind, or no joint has limits", name="to_limit_{deg|mm}"
    )
    to_singularity_deg: float = column(
        "how far all joints together are from a pose at which the tool cannot be moved in some direction, to first order",
        "deg",
    )
    approach: Mapping[str, int] = column(
        "with --in-order: the side from which each joint comes, by the order of the commands", name="approach{joint}"
    )


def command_table(found: Compensation, in_order: bool) -> pd.DataFrame:
    """Return the table of `Command`s, a row a target."""
    robot = found.data.robot
    names = reading_columns(robot)
    columns: dict[str, object] = {"reached": found.reached}
    given = shown_readings(robot, np.where(found.reached[:, None], found.readings, np.nan))
    columns |= dict(zip(names, given.T, strict=True))
    oriented, none = found.turn_sd is not None, np.full((len(given), 3), np.nan)
    columns |= {
        "expected_mm": 1e3 * found.expected,
        "remaining_mm": 1e3 * found.remaining,
        "remaining_mrad": 1e3 * found.turned if oriented else none[:, 0],
    }
    columns |= {f"sd_{axis}_mm": 1e3 * found.sd[:, k] for k, axis in enumerate(AXES)}
    turns = none if found.turn_sd is None else 1e3 * found.turn_sd
    columns |= {f"sd_r{axis}_mrad": turns[:, k] for k, axis in enumerate(AXES)}
    columns |= {
        f"nominal_{name}": values for name, values in zip(names, shown_readings(robot, found.nominal).T, strict=True)
    }
    columns |= {
        "nominal_miss_mm": 1e3 * found.nominal_miss,
        "nominal_miss_mrad": 1e3 * found.nominal_turned if oriented else none[:, 0],
        "limit_joint": found.clearance.joint + 1,
    }
    if found.not_physical is not None:
        columns |= {f"not_physical_{axis}_mm": 1e3 * found.not_physical[:, k] for k, axis in enumerate(AXES)}
    units = np.array([joint.shown[0] for joint in robot.joints])
    factors = np.array([joint.shown[1] for joint in robot.joints])
    for unit in dict.fromkeys(units):
        own = units[found.clearance.joint] == unit
        own &= np.isfinite(found.clearance.limit)
        columns[f"to_limit_{unit}"] = np.where(own, found.clearance.limit * factors[found.clearance.joint], np.nan)
    columns["to_singularity_deg"] = np.rad2deg(found.clearance.singular)
    sides = [f"approach{i + 1}" for i in robot.driven]
    if in_order and sides[0] in found.data.table:
        columns |= {name: found.data.table[name].astype(int).to_numpy() for name in sides}
    return typed(pd.DataFrame(columns), Command)
