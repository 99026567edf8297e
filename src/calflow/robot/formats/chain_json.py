"""JSON: a robot with all its figures, its rigid chain, and whatever else is said of it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from calflow.robot.formats.rigid_chain import RigidChain


def json_text(chain: RigidChain, more: dict[str, Any]) -> str:
    """Return a rigid chain as JSON in SI units, every transform as four rows; more is said beside it."""
    joints = [
        {
            "name": joint.name,
            "kind": joint.kind,
            "origin": _rows(joint.origin),
            "axis": joint.axis.tolist(),
            "limits": joint.limits,
            **({"follows": {"joint": joint.leader[0], "multiplier": joint.leader[1]}} if joint.leader else {}),
        }
        for joint in chain.joints
    ]
    document = {
        "robot": chain.name,
        "units": "m, rad",
        "base_in_measuring_frame": _rows(chain.base),
        "joints": joints,
        "flange_in_last_joint": _rows(chain.flange),
        "tool_in_flange": _rows(chain.tool),
        "markers_in_flange": {name: point.tolist() for name, point in chain.markers.items()},
        **more,
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _rows(transform: np.ndarray) -> list[list[float]]:
    return transform.tolist()
