"""A finding: a fault of the data, a cause with its rivals, or what no cause explains, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from calflow.effects.words import UNEXPLAINED, NamedCause, amount, cause_family, cause_name
from calflow.estimation.parameters import UNIT
from calflow.files.tables import column, spread
from calflow.files.units import METRE
from calflow.files.words import listed

NAN = float("nan")
PLACE = {"x", "y", "z"}  # inputs that say where the tool is
INPUTS_IN_WORDS = {"pose": "the pose (its markers err alike)", "joints": "the angles of several joints together"}
OTHER_INPUTS = {*PLACE, *INPUTS_IN_WORDS, "order", "time", "payload"}  # than single joints


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A verdict: a fault of the data, a cause, or what no cause explains. No row: nothing was found that the model lacks."""

    status: Literal["named", "one_of", "unexplained", "data_fault"] = column(
        "a cause; one of several; structure without a cause (its gain is that of a Gaussian process of its inputs, which is not "
        "physical and in no model); a mistake in the file"
    )
    cause: str = column("id of the effect, or of the fault; empty: unexplained", default="")
    joint: int | None = column("number of its joint or link; empty: none", default=None)
    estimate: float = column("its size", UNIT, sd="sd", default=NAN)
    sd: float = column("standard deviation of the size, whichever form of the cause is true", UNIT, default=NAN)
    unit: str = column("of the size (SI)", default="")
    p_family: float = column("chance that noise alone makes any of all tests look like this", default=NAN)
    probability: float = column("that it is this cause rather than a rival", default=NAN)
    cannot_tell_from: tuple[str, ...] = column(
        "ids of what it may be instead, also of what these data could not test; `unexplained` where what nobody can name "
        "depends on the same input",
        default=(),
    )
    gain_mean_mm: float = column("what it takes off the mean error at held-out poses", "mm", default=NAN)
    gain_low_mm: float = column("lower end of the gain's 95 % interval", "mm", default=NAN)
    gain_high_mm: float = column("upper end of it", "mm", default=NAN)
    heldout_mean_mm: float = column("mean error at held-out poses with it", "mm", default=NAN)
    detail: str = column("the variant, in words", default="")
    rivals: tuple[NamedCause, ...] = spread(
        label=column("what else could explain the data: id and joint", name="rivals", separator="; "),
        cause=column("ids of the rivals, in their order", name="rival_causes"),
        joint=column("their joints; 0: none", name="rival_joints"),
    )
    rows: tuple[int, ...] = column("lines of the file, of a data fault", default=())
    statement: str = column("the verdict in words")
    inputs: tuple[str, ...] = column(
        "what something unexplained depends on: q1 … (joints), x, y, z, order, time, payload; empty: a lack of fit that is told "
        "whether an input explains it or not, with where it is largest in `detail`",
        default=(),
    )
    not_tested: tuple[str, ...] = column(
        "ids of `cannot_tell_from` that these data could not test; `statement` says what that would take", default=()
    )
    carries_over: bool | None = column(
        "whether it holds in blocks of the training poses that it was not fitted to; empty: not looked at", default=None
    )
    numbers: tuple[int, ...] = column(
        "its numbers among the causes of the extended model, as in `curves.csv`: several where several of one family at one place "
        "(orders of a joint, moves of the device) are told as one finding, whose gain is that of all of them and whose size the "
        "root of their squares' sum",
        default=(),
    )
    error_unit: str = column(
        "the unit by which the model is judged: mm, or where no lengths were measured mrad, px, …", default="mm"
    )
    gain_mean: float = column("as gain_mean_mm, in `error_unit` where that is another", default=NAN)
    gain_low: float = column("as gain_low_mm, likewise", default=NAN)
    gain_high: float = column("as gain_high_mm, likewise", default=NAN)
    heldout_mean: float = column("as heldout_mean_mm, likewise", default=NAN)

    @property
    def is_cause(self) -> bool:
        """Whether it is a cause, or one of several, not a fault of the data or something unexplained."""
        return self.status in ("named", "one_of")

    @property
    def is_misfit(self) -> bool:
        """Whether it is a lack of fit as such, told whether an input explains it or not."""
        return self.status == "unexplained" and not self.inputs

    @property
    def is_structure(self) -> bool:
        """Whether it is what no cause explains although it depends on an input."""
        return self.status == "unexplained" and bool(self.inputs)

    @property
    def gain(self) -> tuple[float, float, float]:
        """What it takes off the mean error at held-out poses, and the ends of its 95 % interval [error_unit]; nan: not known."""
        if self.error_unit == METRE.label:
            return self.gain_mean_mm, self.gain_low_mm, self.gain_high_mm
        return self.gain_mean, self.gain_low, self.gain_high

    @property
    def left(self) -> float:
        """Mean error at held-out poses with it [error_unit]."""
        return self.heldout_mean_mm if self.error_unit == METRE.label else self.heldout_mean

    @property
    def of_family(self) -> bool:
        """Whether its family is sure but not which of it: an error of one joint's angle, say, whose order is not resolved."""
        return bool(cause_family(self.cause)) and self.status == "one_of" and (bool(self.kin) or not self.rivals)

    @property
    def kin(self) -> tuple[str, ...]:
        """Ids of its own family, at its own joint, that it cannot be told from."""
        family = cause_family(self.cause)
        near = [rival.cause for rival in self.rivals if self._is_kin(rival)]
        elsewhere = {rival.cause for rival in self.rivals}
        more = [name for name in self.cannot_tell_from if name not in elsewhere and cause_family(name) == family]
        return tuple(dict.fromkeys([*near, *more])) if family else ()

    @property
    def others(self) -> tuple[NamedCause, ...]:
        """The rivals that a name of its family does not cover, what nobody can name last."""
        rivals = [rival for rival in self.rivals if not self._is_kin(rival)]
        return tuple(sorted(rivals, key=lambda rival: rival.cause == UNEXPLAINED))

    def _is_kin(self, rival: NamedCause) -> bool:
        family = cause_family(self.cause)
        return bool(family) and cause_family(rival.cause) == family and rival.joint == (self.joint or 0)

    @property
    def name(self) -> str:
        """Its name with its place, as far as it is sure."""
        if self.of_family:
            family = cause_family(self.cause)
            return f"{family} of joint {self.joint}" if self.joint else family
        return cause_name(self.cause, self.joint)

    @property
    def names(self) -> str:
        """Its name with its detail, and the names of what it cannot be told from."""
        own = f"{self.name} ({self.detail})" if self.detail and not self.of_family else self.name
        more = " or another cause" if len(self.others) > 2 else ""
        return " or ".join([own, *(rival.name for rival in self.others[:2])]) + more

    @property
    def amount(self) -> str:
        """Its size with its standard deviation, in a unit that is easy to read."""
        return amount(self.cause, self.estimate, self.sd, self.unit)

    @property
    def in_short(self) -> str:
        """What was found in a line: a cause with its size, what something unexplained depends on, else the verdict itself."""
        if self.is_cause:
            return f"{self.names}, {self.amount}"
        if self.is_structure:
            return f"something unexplained that depends on {self.inputs_in_words}"
        return self.statement

    @property
    def inputs_in_words(self) -> str:
        """What something unexplained depends on, in words."""
        joints = [name[1:] for name in self.inputs if name not in OTHER_INPUTS]
        if len(joints) == len(self.inputs):
            return f"the {'angle of joint' if len(joints) == 1 else 'angles of joints'} {listed(joints)}"
        if self.inputs[0] in INPUTS_IN_WORDS:
            return INPUTS_IN_WORDS[self.inputs[0]]
        if set(self.inputs) >= PLACE:
            return "where the tool is (x, y and z)"
        detail = f" ({self.detail})" if self.detail else ""
        if "payload" in self.inputs:
            return f"the payload{detail}"
        return f"when it was measured{detail}" if "order" in self.inputs else f"the time{detail}"
