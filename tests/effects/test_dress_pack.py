"""Dress pack: hoses pull by the virtual work of their force, and are found where the simulator's pull an arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.effects.dress_pack import DressPack
from calflow.robot.mechanism import Row, State
from effects.bench import ROBOTS, Bench
from hidden.causes import Hidden
from hidden.simulator import Motion, frames
from hidden.test_hidden import case, found, only

PLACE = np.array([0.3, -0.2, 2.3])  # m from the base: where hoses come from
STEP = 1e-5


def ends(bench: Bench, link: int, q: np.ndarray) -> np.ndarray:
    """The simulator's places of a link's end (rows, 3) in the base frame."""
    return frames(bench.real, q, Motion.none(len(q), bench.real.n)).tips[link - 1][:, :3, 3]


def torques(bench: Bench, link: int, pull: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The torques (rows, n_joints) of a pull at the link's end: its work as each joint turns a little."""
    q, force = bench.rows.q, pull(ends(bench, link, bench.rows.q))
    ways = [
        (ends(bench, link, q + step) - ends(bench, link, q - step)) / (2 * STEP) for step in STEP * np.eye(q.shape[1])
    ]
    return np.stack([(way * force).sum(axis=1) for way in ways], axis=1)


def basis(bench: Bench, effect: DressPack, link: int) -> np.ndarray:
    """What each of a link's four parameters adds to the torques, shape (rows · n_joints, 4)."""
    state, p = State.symbols(bench.robot), ca.SX.sym("p", len(effect.declared))
    added = ca.Function("added", [state.q, p], [effect.torque(p, state, Row.symbols(bench.robot))])
    one = np.eye(len(effect.declared))[effect.parts[f"link{link}"]]
    return np.stack([np.array(added.map(len(bench.rows))(bench.rows.q.T, each)).T.ravel() for each in one], axis=1)


def fitted(
    bench: Bench, effect: DressPack, link: int, pull: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, float]:
    """The parameters (4,) nearest to a pull, and the share of its torques that they leave."""
    wanted, columns = torques(bench, link, pull).ravel(), basis(bench, effect, link)
    p = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    return p, float(np.linalg.norm(columns @ p - wanted) / np.linalg.norm(wanted))


def constant(end: np.ndarray) -> np.ndarray:
    """A pull of 100 N towards the place, wherever the end is."""
    return 100.0 * (PLACE - end) / np.linalg.norm(PLACE - end, axis=1)[:, None]


@pytest.mark.parametrize("name", ROBOTS)
def test_a_spring_pulls_by_its_stiffness(benches: dict[str, Bench], name: str) -> None:
    """Breaks if a force turns the wrong joint, a loop's motor by too much, or comes from elsewhere than said."""
    bench = benches[name]
    effect, stiffness = DressPack(bench.robot), 80.0
    reach, shoulder = effect._length, frames(bench.real, 0 * bench.rows.q[:1], Motion.none(1, 6)).joints[1][0, 2, 3]
    for link in [parameter.joint for parameter in effect.declared if parameter.symbol == "s"]:
        p, left = fitted(bench, effect, link, lambda end: stiffness * (PLACE - end))
        assert left < 1e-6
        assert_allclose(p[0], stiffness * reach, rtol=1e-6)
        assert_allclose(p[1:] / p[0] * reach + [0, 0, shoulder], PLACE, atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_constant_pull_is_met_by_refinement(benches: dict[str, Bench], name: str) -> None:
    """Breaks if hoses that pull as hard everywhere are no form of it, or the size stated is not how hard they pull."""
    bench = benches[name]
    forms = DressPack.variants(bench.robot, bench.data)
    link = max(forms[0].declared, key=lambda parameter: parameter.joint).joint
    left = lambda form: fitted(bench, form, link, constant)[1]  # noqa: E731
    spring, best = left(forms[0]), min(forms, key=left)
    for _ in range(4):
        best = min((best, *best.finer(bench.data)), key=left)
    p, remaining = fitted(bench, best, link, constant)
    assert remaining < 0.1 * spring
    own = [parameter for parameter in best.declared if parameter.joint == link]
    assert float(ca.DM(best.size(ca.DM(p), own))) == pytest.approx(100, rel=0.05)


@pytest.mark.parametrize(("slack", "behind"), [(0.5, -0.2), (0.75, 0.1)])
def test_a_hose_that_is_taut_far_out_is_met_by_refinement(
    benches: dict[str, Bench], slack: float, behind: float
) -> None:
    """Breaks if a hose that pulls beyond its length alone is no form of it, or its length and place are out of reach."""
    bench = benches["serial"]
    forms = DressPack.variants(bench.robot, bench.data)
    reach = forms[0]._length
    place = np.array([behind * reach, 0.0, 1.0])

    def pull(end: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(place - end, axis=1)[:, None]
        return 500.0 * np.maximum(1 - slack * reach / away, 0) * (place - end)

    left = lambda form: fitted(bench, form, 4, pull)[1]  # noqa: E731
    best = min((form for form in forms if form.slack), key=left)
    for _ in range(4):
        best = min((best, *best.finer(bench.data)), key=left)
    assert left(best) < 0.25 * min(left(form) for form in forms if not form.slack)


def test_heights_between_those_tried_are_reached(benches: dict[str, Bench]) -> None:
    """Breaks if a height between two that are tried is out of reach, or a spring that is never slack has one."""
    data = benches["serial"].data
    spring, *others = DressPack.variants(benches["serial"].robot, data)
    pulls = [form for form in others if not form.slack]
    assert spring.finer(data) == ()
    reached = np.log2(sorted(form.height for one in pulls for form in (one, *one.finer(data)) if not form.x))
    assert np.diff(reached).max() < 0.26


def test_up_is_against_gravity(benches: dict[str, Bench]) -> None:
    """Breaks if an arm that hangs, or whose joint 1 counts about a downward axis, has its hoses hung up below it."""
    bench = benches["serial"]
    hung = replace(bench, robot=replace(bench.robot, gravity=(0.0, 0.0, 9.80665)))
    *level, upwards = (basis(bench, DressPack(bench.robot), 4)[:, 1:]).T
    *also, downwards = (basis(hung, DressPack(hung.robot), 4)[:, 1:]).T
    assert_allclose(level, also)
    assert_allclose(upwards, -downwards)


def test_robots_that_cannot_show_it_say_why(benches: dict[str, Bench]) -> None:
    """Breaks if a robot of short links, or one that slides first, is asked for a force that it has no arm for."""
    bench = benches["serial"]
    short = replace(bench.robot, joints=bench.robot.joints[:2])
    assert DressPack.variants(short, bench.data) == ()
    assert "beyond joint 2" in DressPack.lacking(short, bench.data)


def test_hoses_that_pull_the_forearm_are_named(tmp_path) -> None:
    """Breaks if hoses are missed, called an eccentric or slack joint, or their pull is another than it is."""
    alike = only(
        "dress-pack", "joint-eccentricity", "torque-backlash", "link-mass", "gravity-compensator", "payload-mass",
        "gear-ratio-error", "nonlinear-joint-stiffness",
    )  # fmt: skip
    seen = found(tmp_path, case("serial", Hidden("dress-pack", 4, 150.0), poses=100, settings=alike), 11)
    assert list(seen.causes["cause"]) == ["dress-pack"], seen.causes
    assert seen.has("dress-pack", 4)
    assert abs(seen.causes.iloc[0]["estimate"] - 150.0) < 0.15 * 150.0
