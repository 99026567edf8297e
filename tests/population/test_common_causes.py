"""A cause is the type's where surely more than half of its robots have it, and the robots' own where surely fewer do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.population.common_causes import Shown, common_causes


def wave(size: float = 1e-4, detail: str = "order 101", joint: int = 3) -> Shown:
    return Shown("gear-transmission-error", joint, detail, size, 1e-5, "rad")


def test_what_all_robots_show_is_the_types():
    """Fails if a wave of the gear that all forty have is told as each robot's own, or its variant is lost."""
    shown = {f"r{k}": [wave()] for k in range(40)}
    shown["r7"] = [wave(), Shown("joint-backlash", 2, "", 3e-4, 1e-5, "rad")]
    first, second = common_causes(shown)
    assert (first.cause, first.joint, first.detail, first.whose, first.share) == (
        "gear-transmission-error", 3, "order 101", "type", 1.0
    )  # fmt: skip
    assert first.low > 0.9
    assert (second.cause, second.robots, second.whose) == ("joint-backlash", ("r7",), "robot")
    assert second.high < 0.15


@pytest.mark.parametrize(("having", "of"), [(2, 2), (1, 2), (4, 8), (5, 8)])
def test_few_robots_do_not_say_whose_it_is(having, of):
    """Fails if two robots that agree make a type, or a half of eight says anything."""
    shown = {f"r{k}": [wave()] if k < having else [] for k in range(of)}
    assert common_causes(shown)[0].whose == "cannot tell"


def test_the_spread_of_sizes_is_without_their_errors():
    """Fails if what the estimates scatter by chance is told as a difference between robots."""
    rng = np.random.default_rng(1)
    alike = {f"r{k}": [wave(1e-4 + 1e-5 * rng.standard_normal())] for k in range(200)}
    apart = {f"r{k}": [wave(1e-4 + 4e-5 * rng.standard_normal() + 1e-5 * rng.standard_normal())] for k in range(200)}
    assert common_causes(alike)[0].spread < 5e-6
    assert common_causes(apart)[0].spread == pytest.approx(4e-5, rel=0.15)


def test_variants_that_differ_are_not_told_as_one():
    """Fails if every robot's own order is told as the type's."""
    shown = {f"r{k}": [wave(detail=f"order {k}")] for k in range(30)}
    assert common_causes(shown)[0].detail == ""


def test_what_some_robots_show_by_a_rivals_name_is_one_cause_of_all():
    """Fails if a cause that all have is told as the own of those in which a rival came out a little likelier."""
    spring = Shown("gravity-compensator", 2, "", 60.0, 10.0, "Nm", (("joint-eccentricity", 2),))
    gear = Shown("joint-eccentricity", 2, "order 1", 4e-4, 1e-4, "rad", (("gravity-compensator", 2),))
    own = Shown("joint-eccentricity", 5, "order 1", 5e-4, 1e-5, "rad")
    shown = {f"r{k}": [gear] for k in range(8)} | {
        "r8": [spring],
        "r9": [own, replace(gear, detail="order 2", size=1e-4)],
    }
    first, second = common_causes(shown)
    assert (first.cause, first.joint, first.whose, len(first.robots)) == ("joint-eccentricity", 2, "type", 10)
    assert (first.detail, first.size, first.unit) == ("order 1", 4e-4, "rad")
    assert (second.cause, second.joint, second.robots, second.whose) == ("joint-eccentricity", 5, ("r9",), "robot")
