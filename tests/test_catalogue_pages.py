"""The pages of the catalogue: what they say of a cause is what the code does, whoever wrote the cause."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from calflow.effects import catalogue
from calflow.effects.base import JointError, Term, Words
from calflow.observations.plane import Plane
from calflow.observations.position import Position
from made import pictures
from made.bench import benches
from made.effect_page import effect_page
from made.observation_page import observation_page, told
from made.rivals import likenesses

ARM = benches()[0]


@dataclass(frozen=True)
class Cubic(JointError):
    """dq = c q³.

    Nobody has seen it yet.
    """

    id: ClassVar[str] = "cubic"
    title: ClassVar[str] = "cubic error"
    words: ClassVar[Words] = Words("cubic error", "the angle is off by its cube")

    def terms(self, joint, state, row):
        return [Term("c", "rad", 1e-4, 0.1, state.q[joint] ** 3)]


def test_a_new_effect_has_its_page():
    """Fails if an effect needs more than its own file for a page with its equation, its parameters and its picture."""
    text, picture = effect_page(Cubic)
    assert text.startswith("# Cubic error\n")
    assert "```text\ndq = c q³.\n```\n\nNobody has seen it yet." in text
    assert "| `jointN.c` | rad | 0.0001 | -0.1 … 0.1 |" in text
    assert "![error by cubic](cubic.svg)" in text
    assert ElementTree.fromstring(picture).tag.endswith("svg")


@pytest.mark.parametrize("room", [0, 1, 2])
def test_every_effect_can_be_shown(room):
    """Fails if an effect can be looked for on none of the bench's robots, or its error there is not of the size that is stated."""
    for effect in list(catalogue().values())[room::3]:
        bench = next(bench for bench in benches() if bench.forms(effect))
        shown = pictures.shown(bench, bench.forms(effect)[0])
        assert np.sqrt((shown.error**2).sum(axis=1).mean()) == pytest.approx(pictures.MOVED), effect.id
        assert shown.part in {parameter.part for parameter in bench.forms(effect)[0].declared}


def test_a_spring_that_turns_a_link_looks_like_one_that_bends_it_askew():
    """Fails if a cause that another holds wholly is said to differ from it, or one that geometry takes is said to be left."""
    of = {one.part: one for one in likenesses(ARM, catalogue()["link-torsion"](ARM.robot))}
    assert ("link-bending", "link2", pytest.approx(1.0)) in of["link2"].rivals
    ratio = {one.part: one for one in likenesses(ARM, catalogue()["gear-ratio-error"](ARM.robot))}
    assert ratio["joint2"].taken > 0.9  # what is nearly straight over a short travel is the joint's zero
    assert ratio["joint4"].taken < 0.5


def test_an_observation_says_what_it_tells():
    """Fails if a plane is said to tell as much as a tracker, or anything to widen what was known before."""
    tracker, plane = told(Position), told(Plane)
    assert max(tracker.values()) <= 1 + 1e-9
    assert plane["joint2.a"] > 0.5 > 10 * tracker["joint2.a"]
    text, picture = observation_page(Plane)
    assert "| `reading` | may be there | length |" in text
    assert ElementTree.fromstring(picture).tag.endswith("svg")
