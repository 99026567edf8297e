"""What joints and links do that is not as textbooks draw it, hidden by the independent simulator: `calflow run` has to find it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hidden.causes import Hidden
from hidden.test_hidden import case, found, only

IN_JOINTS = only(
    "joint-backlash", "friction-wind-up", "torque-backlash", "loaded-transmission-error", "nonlinear-joint-stiffness",
    "joint-eccentricity", "gear-ratio-error", "gravity-compensator", "link-bending", "link-torsion", "bearing-compliance",
)  # fmt: skip
LOADED = {  # benchmarks/hidden_cases.py has all of them, and of the forms below
    "friction wind-up, and wave under load": case(
        "serial", Hidden("friction-wind-up", 3, 2e-4), Hidden("loaded-transmission-error", 2, 4e-4, 2)
    ),
    "wave when warm, and early knee": case(
        "serial", Hidden("loaded-transmission-error", 1, 3e-4, "warm"), Hidden("nonlinear-joint-stiffness", 2, 1.5e-3, 0.1),
        columns=("approach", "temperature"), settings=IN_JOINTS,
    ),
}  # fmt: skip


def test_what_goes_with_the_load_is_found(tmp_path) -> None:
    """Breaks if a cause that its load drives is missed, called something else with certainty, or found at another joint."""
    loaded = replace(LOADED["friction wind-up, and wave under load"], settings=IN_JOINTS)
    seen = found(tmp_path, loaded, 11)
    assert len(seen.causes) == len(loaded.hidden), seen.causes
    for hidden in loaded.hidden:
        assert seen.has(hidden.cause, hidden.joint), seen.causes
    assert seen.unexplained.empty


def test_a_drive_that_is_softer_to_one_side_is_no_wave_under_load(tmp_path) -> None:
    """Breaks if stiffness that changes where the load changes its sign is put down to the angle at which it does."""
    seen = found(
        tmp_path, case("serial", Hidden("nonlinear-joint-stiffness", 2, 6e-4, "sides"), settings=IN_JOINTS), 11
    )
    assert len(seen.causes) == 1, seen.causes
    assert "nonlinear-joint-stiffness" in seen.could_be(0)
    assert seen.causes.iloc[0]["joint"] == 2


def test_an_axis_that_wobbles_is_no_eccentricity(tmp_path) -> None:
    """Breaks if a bearing that does not run true is called an error of the angle, or missed where none of these can be it."""
    wobbling = only("axis-wobble", "joint-eccentricity", "periodic-joint-error", "bearing-compliance", "link-bending")
    seen = found(tmp_path, case("serial", Hidden("axis-wobble", 2, 2e-4), settings=wobbling), 11)
    assert list(zip(seen.causes["cause"], seen.causes["joint"].astype(int), strict=True)) == [("axis-wobble", 2)], (
        seen.causes
    )
    assert seen.unexplained.empty


def test_a_disc_that_is_off_centre_and_oval_is_one_eccentricity(tmp_path) -> None:
    """Breaks if two orders of a joint are put down to the larger one alone, with a wrong size, or to a curve of any form."""
    discs = only("joint-eccentricity", "periodic-joint-error", "joint-error-map", "gear-ratio-error", "axis-wobble")
    first, second = Hidden("joint-eccentricity", 3, 2e-4, 1), Hidden("joint-eccentricity", 3, 1.6e-4, 2, seed=1)
    seen = found(tmp_path, case("serial", first, second, settings=discs), 11).causes
    assert list(zip(seen["cause"], seen["joint"], seen["detail"], strict=True)) == [
        ("joint-eccentricity", 3, "orders 1 and 2")
    ]
    (finding,) = seen.itertuples()
    assert abs(finding.estimate - np.hypot(first.size, second.size)) < 3 * finding.sd


FORMS = {  # a spring is no eccentricity, and a bearing's pivot not its joint's frame
    "spring, and bearing aside": (
        (Hidden("spring-compensator", 2, 2e4), "gravity-compensator"),
        (Hidden("offset-bearing", 3, 2e-7, 0.3), "bearing-compliance"),
    ),
    "crooked link": ((Hidden("oblique-beam", 2, 1e-7), "link-bending"),),
}
