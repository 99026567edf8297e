"""The causes that the tests hide, those included that the tests leave out to be quick, each found by the whole catalogue.

    python benchmarks/hidden_cases.py [WORDS]

WORDS choose the cases whose name has one of them. Ends with 1 where a cause is missed, or something else is found.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from effects import test_link_bending, test_link_torsion, test_rod_play
from hidden import test_base, test_frames, test_hidden, test_joint_causes, test_steps, test_tool
from hidden.case import Case
from hidden.test_hidden import Findings, case, found


@dataclass(frozen=True)
class Stated:
    """A case, the seed of its test, and what is to be found in it: causes and joints (0: wherever it is)."""

    name: str
    case: Case
    seed: int
    causes: tuple[tuple[str, int], ...]

    def right(self, seen: Findings) -> bool:
        """Whether all of it is found, and nothing else."""
        return len(seen.causes) == len(self.causes) and all(seen.has(*cause) for cause in self.causes)


def stated() -> Iterator[Stated]:
    """Every case of the tests of causes."""
    several = test_hidden.SEVERAL | test_joint_causes.LOADED | {"heavier payload": test_steps.HEAVIER}
    for name, one in several.items():
        yield Stated(name, one, 11, tuple((h.cause, h.joint) for h in one.hidden))
    for name, one in test_steps.STEPS.items():
        yield Stated(name, one, 31, tuple((h.cause, h.joint) for h in one.hidden))
    for name, one in test_base.FEET.items():
        yield Stated(f"{name} foot", one, 31, ((one.hidden[0].cause, 0),))
    for name, one in test_link_bending.BENT.items():
        yield Stated(f"bending, {name}", one, 33, (("link-bending", one.hidden[0].joint),))
    for name, one in test_link_torsion.TWISTED.items():
        yield Stated(f"twisting, {name}", one, 33, (("link-torsion", one.hidden[0].joint),))
    for name, one in test_rod_play.WORN.items():
        yield Stated(f"worn {name}", one, 32, ((one.hidden[0].cause, 3),))
    for joint, one in test_base.BEARINGS.items():
        yield Stated(f"worn bearing {joint}", one, 31, (("bearing-play", joint),))
    yield Stated("table 2 of the paper", test_hidden.TABLE_2, 18, tuple(("joint-compliance", k) for k in (2, 3, 4, 5)))
    for name, (one, _) in test_frames.EVERY.items():
        yield Stated(name, one, 21, ((name.split()[0], 0),))
    for name, forms in test_joint_causes.FORMS.items():
        hidden = tuple(form for form, _ in forms)
        yield Stated(name, case("serial", *hidden), 11, tuple((cause, form.joint) for form, cause in forms))
    for name, (cause, _, one) in test_tool.CASES.items():
        yield Stated(name, one, 11, ((cause, 0),))


def main(words: list[str]) -> int:
    """Run the cases, and say of each what is found."""
    wrong = 0
    for one in stated():
        if words and not any(word in one.name for word in words):
            continue
        with tempfile.TemporaryDirectory() as folder:
            seen = found(Path(folder), replace(one.case, settings=""), one.seed)
        right = one.right(seen)
        wrong += not right
        told = ", ".join(f"{row['cause']} {row['joint']:.0f}" for _, row in seen.causes.iterrows())
        print(f"{'found' if right else 'WRONG'}  {one.name}: {told}", flush=True)
    print(f"{wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
