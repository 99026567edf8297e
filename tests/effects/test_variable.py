"""What an effect is drawn against is what explains it."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.effects import catalogue
from calflow.model import Model, over_rows
from calflow.robot.mechanism import Deflection, Row, nominal_dimensions, nominal_loads, state
from effects.bench import ROBOTS, Bench, made
from effects.twins import SHARED, STEPS
from hidden.beams import beam

ANGLE = lambda bench, joint: np.rad2deg(bench.rows.q[:, joint - 1])  # noqa: E731
TORQUE = lambda bench, joint: bench.still.torque[:, joint - 1]  # noqa: E731
PLACE = lambda bench, joint: bench.table.table["order"].to_numpy()  # noqa: E731
LOAD = lambda bench, joint: bench.real.payload_mass[bench.rows.payload]  # noqa: E731
HOURS = lambda bench, joint: bench.rows.time / 3600  # noqa: E731
END = lambda bench, joint: np.linalg.norm(bench.still.tip_moment[:, joint - 1], axis=1)  # noqa: E731
LINE = lambda bench, joint: np.abs(bench.still.tip_moment[:, joint - 1] @ beam(bench.real, joint - 1)[1])  # noqa: E731


def by_rule(bench: Bench) -> np.ndarray:
    """Overturning moment of links of half the mass of those before, each in the middle between its axis and its end."""
    at, moment, most, beyond = bench.still.frames, 0.0, 0.0, sum(0.5**i for i in range(bench.real.n))
    for i, (joint, tip) in enumerate(zip(at.joints, at.tips, strict=True)):
        start, end = joint[:, :3, 3], tip[:, :3, 3]
        length = np.linalg.norm(end - start, axis=1)[0]
        moment = moment + 0.5**i * np.cross((start + end) / 2, [0.0, 0.0, -1.0])
        beyond -= 0.5**i
        most += 0.5**i * max(length, 0.1) / 2 + beyond * length
    return np.linalg.norm(moment, axis=1) / most


AGAINST: dict[str, tuple[str, Callable[[Bench, int], np.ndarray]]] = {
    **dict.fromkeys(("joint-eccentricity", "axis-wobble", "periodic-joint-error", "gear-transmission-error", "joint-error-map",
                     "loaded-transmission-error",
                     "gear-ratio-error", "gravity-deflection", "gravity-compensator"), ("deg", ANGLE)),
    "wrist-coupling": ("deg", lambda bench, joint: ANGLE(bench, joint - 1)),
    **dict.fromkeys(("joint-compliance", "nonlinear-joint-stiffness", "torque-backlash"), ("Nm", TORQUE)),
    "friction-wind-up": ("Nm", lambda bench, joint: bench.rows.approach[:, joint - 1] * np.abs(TORQUE(bench, joint))),
    "link-mass": ("Nm", lambda bench, joint: TORQUE(bench, 2)),
    "joint-backlash": ("", lambda bench, joint: bench.rows.approach[:, joint - 1]),
    "joint-hysteresis": ("deg", lambda bench, joint: np.rad2deg(bench.rows.approach * bench.rows.travel)[:, joint - 1]),
    **dict.fromkeys(("bearing-compliance", "bearing-play"),
                    ("Nm", lambda bench, joint: np.linalg.norm(bench.still.moment[:, joint - 1, :2], axis=1))),
    "base-play": ("Nm", lambda bench, joint: bench.still.base_moment[:, 0]),
    "base-compliance": ("Nm", lambda bench, joint: np.linalg.norm(bench.still.base_moment[:, :2], axis=1)),
    "link-bending": ("Nm", END),
    "link-torsion": ("Nm", LINE),
    "base-tilt": ("", lambda bench, joint: by_rule(bench)),
    "tool-sag": ("deg", lambda bench, joint: np.rad2deg(np.arccos(-bench.still.frames.tips[-1][:, 2, 2]))),
    **dict.fromkeys(("payload-mass", "payload-com", "tool-deflection"), ("kg", LOAD)),
    **dict.fromkeys(("thermal-growth", "housing-growth", "stand-growth", "scale-growth"),
                    ("K", lambda bench, joint: bench.rows.temperature - 20)),
    "frame-drift": ("h", HOURS),
    **dict.fromkeys((*STEPS, "session-frame", "tracker-scale", "marker-place", "range-noise", "geometry"),
                    ("", PLACE)),
}  # fmt: skip


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("effect", [name for name in catalogue() if name in SHARED])
def test_effects_are_drawn_against_what_explains_them(benches: dict[str, Bench], name: str, effect: str) -> None:
    """Breaks if a curve's variable is that of another joint, in another unit, or called so."""
    bench = benches[name]
    model = Model(bench.robot, (), bench.data.given)
    c = ca.SX.sym("c", model.n_conditions)
    row = Row.unpack(bench.robot, c, bench.data.given)
    nominal, still = (nominal_dimensions(bench.robot), nominal_loads(bench.robot)), Deflection.zero(6)
    loads = state(bench.robot, *nominal, row, still)
    if effect == "axis-straightness":
        return  # neither robot has a rail
    found = catalogue()[effect].variants(bench.robot, bench.data)[0]
    joints = sorted({parameter.joint for parameter in found.declared})
    shown = [found.variable(joint) for joint in joints]
    values = ca.vertcat(*(variable.value(loads, row) for variable in shown))
    found_at = over_rows(
        ca.Function("variables", [model.symbols[0], c], [ca.densify(values)]), np.zeros(0), bench.table.conditions
    )
    unit, expected = AGAINST[effect]
    for joint, variable, value in zip(joints, shown, found_at[0], strict=True):
        assert variable.unit == unit
        assert variable.label
        wanted = expected(bench, joint)
        finest = 6e-4 if effect == "joint-hysteresis" else 1e-6  # a file's travel is in thousandths of a degree
        assert_allclose(variable.factor * value, wanted, atol=finest * max(1.0, 1e-2 * np.abs(wanted).max()))


def test_warm_up_is_drawn_against_time(benches: dict[str, Bench]) -> None:
    """Breaks if growth in time is drawn against a temperature."""
    variable = made(benches["serial"], "thermal-growth", constant=1800.0).variable(0)
    assert (variable.label, variable.unit, variable.factor) == ("time", "h", 1 / 3600)
