"""Effects that Python gives as classes or objects: like any other, and what is none is refused."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest

import calflow as cf
from calflow.calibration import identify
from calflow.effects import Effect, catalogue, effect_class, effects_given
from calflow.effects.base import JointError, Term, Words
from calflow.effects.wording import cause_name
from calflow.estimation.model_tables import ModelEffect, effect_table, read_effects
from calflow.estimation.parameters import Parameters
from calflow.files.tables import from_frame
from calflow.study import load_study


@dataclass(frozen=True)
class SpringPull(JointError):
    """dq1 = pull · tanh(q2 q3 / slack)."""

    slack: float = 0.2

    id: ClassVar[str] = "spring-pull"
    title: ClassVar[str] = "pull of a spring"
    words: ClassVar[Words] = Words("spring pull", "a spring turns the column")

    def terms(self, joint: int, state: object, row: object) -> Sequence[Term]:
        """Return the pull of the first joint."""
        return [Term("pull", "rad", 5e-4, 0.02, ca.tanh(state.q[1] * state.q[2] / self.slack))] if joint == 0 else []


@pytest.fixture
def measured(small):
    """A robot and its measurements."""
    data = load_study(small.path).measurements()
    return data.robot, data


@pytest.mark.parametrize("slack", [None, 0.7])
def test_a_class_or_an_object_is_an_effect_like_any_other(measured, slack):
    """Fails if an effect of a notebook's own is not fitted, loses its figures, or cannot be read from a run again."""
    robot, data = measured
    given = SpringPull if slack is None else SpringPull(robot, slack)
    name = f"joint1.spring-pull[slack {slack or 0.2}].pull"
    parameters = Parameters.of(robot, data, ["geometry", given]).bound(name, -1e-3, 1e-3)
    found = identify(robot, data, ["geometry", given], parameters=parameters, starts=1)
    assert found.parameters[name].bounds == (-1e-3, 1e-3)
    assert abs(found.parameters[name].value) < 1e-3
    assert found.accuracy.table["model"].iloc[-1] == "geometry + spring-pull"
    rows = from_frame(effect_table(found.model.effects), ModelEffect)
    assert read_effects(rows, found.model.robot) == found.model.effects
    assert cause_name("spring-pull", 1) == "spring pull of joint 1"


def test_it_is_looked_for_where_it_is_asked_for(measured):
    """Fails if a diagnosis passes over a class that it is given, or one that it is not given joins the catalogue."""
    robot, data = measured
    assert "spring-pull" not in catalogue()
    plain = identify(robot, data, ["geometry", "joint-compliance"], starts=1)
    asked = plain.diagnose(catalogue=[SpringPull, "joint-eccentricity"])
    assert set(asked.candidates.table["cause"]) >= {"spring-pull", "joint-eccentricity"}
    assert np.isfinite(asked.candidates.table.set_index("cause").loc["spring-pull", "estimate"])


class NoTerms(JointError):
    """An effect that does not say what it does."""

    id: ClassVar[str] = "no-terms"
    title: ClassVar[str] = "no terms"


@dataclass(frozen=True)
class Tagless(SpringPull):
    """An effect whose parameters would be called as the maker's figures."""

    id: ClassVar[str] = "tagless"
    tag: ClassVar[str] = ""


@dataclass(frozen=True)
class Taken(SpringPull):
    """An effect that goes by another's name."""

    id: ClassVar[str] = "geometry"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("spring-pul", "effects[2]: unknown effect 'spring-pul'"),
        (3, "expected the id of an effect, a subclass of calflow.effects.base.Effect or an object of one, found 3"),
        (
            dict,
            "expected the id of an effect, a subclass of calflow.effects.base.Effect or an object of one, found <class 'dict'>",
        ),
        (NoTerms, "NoTerms lacks terms"),
        (Tagless, "its tag lacks {id}"),
        (Taken, "the id 'geometry' of Taken is taken by <class 'calflow.effects.geometry.Geometry'>"),
    ],
)
def test_what_is_no_effect_is_refused(measured, given, message):
    """Fails if something that is no effect is fitted, or ends in a traceback that does not say what an effect is."""
    with pytest.raises(cf.InputError) as refused:
        identify(*measured, ["geometry", given])
    assert message in str(refused.value)


def test_all_that_is_no_effect_is_told_at_once(measured):
    """Fails if only the first problem is told, or the same effect may be there twice."""
    with pytest.raises(cf.InputError) as refused:
        effects_given([3, "geometry", 4])
    assert len(refused.value.problems) == 2
    with pytest.raises(cf.InputError, match="each once"):
        identify(*measured, ["geometry", SpringPull, SpringPull(measured[0], 0.5)])


def test_a_run_with_an_effect_that_nobody_defined_says_what_to_do(measured):
    """Fails if the message does not lead to the class, or a class that was defined again is the old one."""
    robot, _ = measured
    with pytest.raises(cf.InputError, match="define or import its class before you load it"):
        read_effects([ModelEffect(effect="gone", part="", variant="{}")], robot)

    def define() -> type[Effect]:
        @dataclass(frozen=True)
        class Again(SpringPull):
            id: ClassVar[str] = "again"

        return Again

    first, second = define(), define()
    assert effect_class("again") is second is not first
    del first, second
    gc.collect()


def test_two_classes_of_one_id_are_told_apart(measured):
    """Fails if a class that is given is fitted as the one of its id that was defined last, or that is left out without a word."""

    @dataclass(frozen=True)
    class First(SpringPull):
        slack: float = 0.3
        id: ClassVar[str] = "twice-defined"

    first = First

    @dataclass(frozen=True)
    class Second(SpringPull):
        slack: float = 0.9
        id: ClassVar[str] = "twice-defined"

    robot, data = measured
    assert effect_class("twice-defined") is Second
    for kind in (first, Second):
        asked = ["geometry", kind]
        assert {one.variant for one in Parameters.of(robot, data, asked).rows if one.effect == "twice-defined"} == {
            f"slack {kind.slack:g}"
        }
        assert type(identify(robot, data, asked, starts=1).model.effects[-1]) is kind
    plain = identify(robot, data, ["geometry"], starts=1)
    with pytest.raises(cf.InputError, match=r"effects\[1\]: the id 'twice-defined' of First is taken by"):
        plain.diagnose(catalogue=[first])
    del first, First, Second, plain
    gc.collect()
