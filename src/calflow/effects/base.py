"""Base classes of effects (physical causes of error), what they need, and their catalogue.

`Effect` is a cause with its parameters, `JointError` an error of joint readings, `ActingEffect` one that acts as another.
`NEEDS` lists the requirements on robot file and data.
"""

from __future__ import annotations

import inspect
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.smooth_curve import Travel
from calflow.files import plugins
from calflow.files.problems import Problem, nearest, refuse, refuse_any
from calflow.files.toml import as_tuples
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Dimensions, Loads, Row, State, rated_torques
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

WINDUP_SD, WINDUP_BOUND = 10e-3, 50e-3  # rad (prismatic: m): wind-up of a joint's spring at its rated torque
NOTHING = 1e-300  # keeps the derivative of a norm finite at zero
TRANSMISSION = "transmission error"
# A step, also between sessions, a steady drift or a random one, of a camera's lens, too. A single device does not show which moved.
OF_THE_FRAME = "drift of the measuring set-up or the robot's foot"
LOST_MOTION = "lost motion"
NONLINEAR = "nonlinear compliance"
STRUCTURE = "structural compliance"
OF_THE_TOOL = "compliance of the tool"
IN_TIME = ("time", "order")  # the inputs on which a drift of the measuring set-up depends
ITS_ANGLE, ITS_TORQUE = "q", "tau"  # of the cause's own joint
# Families of curves of one input of the same joint or device: the sum of two members is another curve, so that data do not show
# whether one or two causes act.
SMOOTH_IN = {TRANSMISSION: (ITS_ANGLE,), NONLINEAR: (ITS_TORQUE,), OF_THE_FRAME: IN_TIME}
# Families whose members at one place are forms of one thing, and what they depend on: several that are found are one finding.
FORMS_OF_ONE = {
    TRANSMISSION: "the joint's reading", NONLINEAR: "the joint's load", OF_THE_FRAME: "time",
    OF_THE_TOOL: "the tool's load",
}  # fmt: skip
REVERSALS = "vary the travel since the last reversal, from tenths of a degree (a slide: of a millimetre) to many"
JOINT_ALONE = "move the joint alone over all its travel, and measure closely on the way"


@dataclass(frozen=True)
class Need:
    """A requirement, in terms of files and in plain words; met: whether robot or recorded conditions fulfil it.

    absent: of what no record can supply, why a robot cannot have the effect without it.
    """

    words: str
    plain: str
    met: Callable[[Robot, tuple[str, ...]], bool]
    recorded: bool = False
    absent: str = ""


def _recorded(words: str, plain: str, condition: str) -> Need:
    """Return the need for a condition that is recorded while poses are measured."""
    return Need(words, plain, lambda robot, given: condition in given, recorded=True)


NEEDS = {  # the least effort first
    "order": _recorded("rows in measuring order", "in which order poses are measured", "order"),
    "approach": _recorded(
        "columns approach1 … (or in_order = true in the study's [measurements])",
        "the side from which each joint comes to a pose",
        "approach",
    ),
    "time": _recorded("a column time_s", "the time of each reading", "time"),
    "warmth": Need(
        "a column temperature_degC (that changes), or time_s",
        "the time of each reading, or the temperature as it changes",
        lambda robot, given: "temperature" in given or "time" in given,
        recorded=True,
    ),
    "temperature": _recorded("a column temperature_degC", "the temperature at each reading", "temperature"),
    "range": _recorded(
        "the device's place, tracker_mm in the study's [measurements]", "where the instrument stands", "range"
    ),
    "session": _recorded("a column session", "in which session each pose is measured", "session"),
    "travel": _recorded(
        "columns travel1_deg (or _rad) … (or, without approach columns, in_order = true in the study's [measurements])",
        "how far each joint moves to get to a pose",
        "travel",
    ),
    "gear_ratio": Need(
        "gear_ratio of a joint in the robot file",
        "the joints' gear ratios",
        lambda robot, given: any(joint.gear_ratio for joint in robot.joints),
    ),
    "payload": Need(
        "a payload with a mass in the robot file",
        "the mass of a payload",
        lambda robot, given: any(load.mass != 0 for load in robot.payloads.values()),
    ),
    "floor": Need(
        "a chain that begins at what stands on the floor (ground = 0 in the robot file)",
        "that the chain begins at what stands on the floor",
        lambda robot, given: robot.ground == 0,
    ),
    "distances": Need(
        "relative_sd_mm of a marker in the robot file (its place beside the first, measured apart)",
        "the distances between the markers, measured apart",
        lambda robot, given: any(marker.relative_sd for marker in robot.markers.values()),
    ),
    "masses": Need(
        "mass_kg and com_mm of every link and payload in the robot file",
        "the mass and the centre of gravity of every link and payload",
        lambda robot, given: robot.has_masses,
    ),
    "torques": Need(
        "mass_kg and com_mm of every link and payload in the robot file, or measured torques tau1_Nm …",
        "the masses of all links and payloads, or the motors' torques",
        lambda robot, given: robot.has_masses or "torque" in given,
    ),
    "torque": _recorded("columns tau1_Nm …", "the motors' torques at each pose", "torque"),
    "speed": _recorded("columns speed1_deg_per_s …", "the joints' speeds at each reading", "speed"),
    "wrench": _recorded("columns fx_N … mz_Nm", "the forces on the tool at each pose", "wrench"),
    "slide": Need(
        "a prismatic joint in the robot file",
        "a linear axis",
        lambda robot, given: any(joint.kind == "prismatic" for joint in robot.joints),
        absent="the robot has no prismatic joint",
    ),
    "loop": Need(
        "a [loop] in the robot file",
        "the rods that drive a joint",
        lambda robot, given: robot.loop is not None,
        absent="no rods drive a joint",
    ),
}


def unmet_needs(needs: tuple[str, ...], robot: Robot, given: tuple[str, ...]) -> tuple[str, ...]:
    """Return the needs, by their keys in `NEEDS`, that neither the robot nor the recorded conditions meet."""
    return tuple(need for need in needs if not NEEDS[need].met(robot, given))


def unmet(needs: tuple[str, ...], robot: Robot, given: tuple[str, ...]) -> list[str]:
    """Return the unmet needs in words."""
    return [NEEDS[need].words for need in unmet_needs(needs, robot, given)]


Readable = Mapping[str, tuple[float, str]]  # SI unit -> factor and display unit of an effect's size


@dataclass(frozen=True)
class Words:
    """An effect's wording in reports: its name, what happens physically, and the meaning of its size."""

    name: str
    what: str = ""
    size: str = "size"


@dataclass(frozen=True)
class Variable:
    """The abscissa of a cause's error in plots: label, display unit, value in SI and its factor to that unit."""

    label: str
    unit: str
    value: Callable[[State, Row], ca.SX]
    factor: float = 1.0


IN_ORDER = Variable("place in measuring order", "", lambda state, row: row.order)


def joint_variable(effect: Effect, joint: int) -> Variable:
    """Return a joint's (from 1) angle, or a prismatic joint's position, as the abscissa of its error."""
    of = effect.robot.joints[joint - 1]
    unit, factor = of.shown
    return Variable(f"{of.noun} of joint {joint}", unit, lambda state, row: state.q[joint - 1], factor)


def torque_variable(effect: Effect, joint: int) -> Variable:
    """Return the torque on a joint (from 1), or the force on a prismatic joint, as the abscissa of its error."""
    unit = effect.robot.joints[joint - 1].load_unit
    noun = "torque" if unit == "Nm" else "force"
    return Variable(f"{noun} of joint {joint}", unit, lambda state, row: state.torque[joint - 1])


def payload_variable(effect: Effect, joint: int) -> Variable:
    """Return the mass of a row's payload as the abscissa of an error; an unknown mass counts as zero."""
    masses = ca.DM([load.mass or 0.0 for load in effect.robot.payloads.values()])
    return Variable("payload", "kg", lambda state, row: ca.dot(masses, row.payload))


def around(value: float, reach: float) -> list[float]:
    """Return values within reach on either side of a value, geometrically denser near it: a grid for `Effect.finer`."""
    steps = reach * np.geomspace(1 / 1024, 1.0, 21)
    return [float(value + step) for step in (*-steps[::-1], 0.0, *steps)]


@dataclass(frozen=True)
class Effect(ABC):
    """A physical cause of error. A subclass declares its parameters and overrides the one method in which it acts.

    p is the column vector of this effect's parameters in the order declared; each default below means "does not act here".
    Fields besides the robot hold what cannot be a decision variable, such as the order of a periodic error: numbers, text
    or tuples of them; `variants` returns the values to try.
    """

    robot: Robot

    id: ClassVar[str]
    title: ClassVar[str]
    forms: ClassVar[Mapping[Any, str]] = {}  # admissible values of its one field besides the robot, each in words
    needs: ClassVar[tuple[str, ...]] = ()  # requirements on robot and data: keys of `NEEDS`
    imaged: ClassVar[bool | None] = None  # whether it is of a camera or its target, or of another device
    stands_in: ClassVar[str] = ""  # id of the effect that replaces it where the masses are known
    family: ClassVar[str] = ""  # name used when the data do not distinguish it from other members of its family
    alike: ClassVar[tuple[str, ...]] = ()  # ids that no pose distinguishes from it, only another sensor or load
    taken_for: ClassVar[tuple[str, ...]] = ()  # ids of causes it is mistaken for where the data cannot test it
    told_by: ClassVar[str] = ""  # experiment that distinguishes it from its rivals where no pose does
    words: ClassVar[Words | None] = None  # wording in reports; by default the title
    readable: ClassVar[Readable] = {}  # display units that differ from the usual ones
    place_word: ClassVar[str] = "joint"  # what the number of its place counts
    whole: ClassVar[str] = ""  # the part that its name implies: a tilt of the base has no other
    tag: ClassVar[str] = "{id}{variant}"  # in its parameters' names; empty for the maker's own figures
    inevitable: ClassVar[bool] = False  # whether every robot has it, in about its usual size
    side_by_side: ClassVar[bool] = False  # whether two variants (two orders, say) may act at the same place
    dated: ClassVar[bool] = False  # whether its detail says since when it acts
    grows_with: ClassVar[str] = ""  # for noise: the condition of a row with which it grows
    unnamed: ClassVar[tuple[str, ...]] = ()  # fields without a place in its variant's name: they follow from the data

    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters for this robot."""

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The parameters, labelled with this effect and variant."""
        return _declared(self)

    @cached_property
    def parts(self) -> dict[str, list[int]]:
        """For each part, the indices of its parameters."""
        found = dict[str, list[int]]()
        for k, parameter in enumerate(self.declared):
            found.setdefault(parameter.part, []).append(k)
        return found

    @property
    def figures(self) -> dict[str, Any]:
        """The fields besides the robot, which define the variant."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "robot"}

    @property
    def figures_text(self) -> str:
        """`figures` as JSON, for a table."""
        return json.dumps(self.figures)

    @classmethod
    def of_figures(cls, robot: Robot, text: str) -> Self:
        """Return the effect rebuilt from its `figures_text`, in which a figure that it has no longer is zero.

        Raises:
            InputError: such a figure is not zero.
        """
        stated, own = json.loads(text), {field.name for field in fields(cls)}
        if gone := [_figure(name, value) for name, value in stated.items() if value and name not in own]:
            raise refuse(f"has '{cls.id}' of another version of calflow ({', '.join(gone)}); run the study again")
        return cls(robot, **{name: as_tuples(value) for name, value in stated.items() if name in own})

    @property
    def variant(self) -> str:
        """Short name of the variant, e.g. `order 2`: its nonzero figures, except `unnamed` ones; empty where there are none."""
        named = {name: value for name, value in self.figures.items() if name not in self.unnamed}
        return " ".join(text for name, value in named.items() if (text := _figure(name, value)))

    @classmethod
    def stated(cls, robot: Robot, data: Measurements) -> Self:
        """Return the variant that a study means by the id; it may depend on the rows (their sessions, say)."""
        return cls(robot)

    def unseen(self) -> Self:
        """Return the effect for measurements that do not depend on where the markers are."""
        return self

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the variants to search for in these data; none where the data cannot show it (see `lacking`).

        A form without parameters is none of this robot's.
        """
        plain = cls(robot)
        name = next(iter(plain.figures), "")
        forms = tuple(replace(plain, **{name: form}) for form in cls.forms) or (plain,)
        return tuple(form for form in forms if form.declared)

    @classmethod
    def lacking(cls, robot: Robot, data: Measurements) -> str:
        """Return, in words, what the data lack for a test of this effect; empty where nothing is missing."""
        return ", ".join(NEEDS[need].words for need in cls.asks(robot, data)) or cls.unfit(robot, data)

    @classmethod
    def asks(cls, robot: Robot, data: Measurements) -> tuple[str, ...]:
        """Return the unmet needs of a test of this effect, by their keys in `NEEDS`."""
        return unmet_needs(cls.needs, robot, data.given)

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return any further requirement that the data do not meet, in words; empty where they can test the effect."""
        return ""

    @classmethod
    def superseded(cls, robot: Robot, data: Measurements) -> str:
        """Return why this robot and its device cannot have it, whatever is recorded (no rail, no camera); empty where they may."""
        for need in unmet_needs(cls.needs, robot, ()):
            if NEEDS[need].absent:
                return NEEDS[need].absent
        if cls.imaged is not None and cls.imaged != data.in_images:
            return "no target is photographed" if cls.imaged else "what slips is the camera or its target"
        replaced = cls.stands_in and robot.has_masses
        return f"the masses are known, so {cls.stands_in} stands for it" if replaced else ""

    @classmethod
    def is_noise(cls) -> bool:
        """Whether it adds to the noise and shifts nothing, so that it is tested on the residuals."""
        return cls.scatter is not Effect.scatter

    @classmethod
    def unstatable(cls) -> str:
        """Return why a study cannot state it, so that it is found by diagnosis alone; empty where it can."""
        return "is a model of the noise, which no fit can have" if cls.is_noise() else ""

    @classmethod
    def of_measuring(cls) -> bool:
        """Whether it belongs to the measuring, not to the robot as it was left: an error of the device, or what is over since."""
        return cls.device is not Effect.device or cls.target is not Effect.target or cls.is_noise()

    @property
    def smooth_in(self) -> tuple[str, ...]:
        """Inputs (`time`, `order`) of which it is an arbitrary smooth function, like any unexplained error in them."""
        return ()

    @property
    def is_curve(self) -> bool:
        """Whether its figures are amplitudes of a smooth curve's waves, which mean nothing alone."""
        return bool(self.smooth_in)

    @classmethod
    def named_in(cls) -> tuple[str, ...]:
        """Return the inputs of which the members of its family are curves: errors in them are named."""
        return SMOOTH_IN.get(cls.family, ())

    def travel(self, joint: int) -> Travel | None:
        """Return the travel of a joint (from 1) over which rows determine a curve that is zero outside; None without one."""
        return None

    @classmethod
    def springs(cls, robot: Robot) -> bool:
        """Whether it is this robot's joint compliance, which even a rough model must contain."""
        return False

    @classmethod
    def in_words(cls) -> Words:
        """Return its wording, by default the title alone."""
        return cls.words or Words(cls.title)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return variants between this one and its neighbours, for refinement of the search."""
        return ()

    def concerns(self, device: str) -> bool:
        """Whether a device of this name (see `Series.device`; empty: any) has it."""
        return True

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows (n_rows,) in which the fitted rows do not tell whether it acts."""
        return np.zeros(len(data), dtype=bool)

    def later(self, series: Measurements | None) -> Self:
        """Return the effect for rows measured later, whose order counts anew, or those of a series with a clock of its own."""
        return self

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return effects that locate what the fit had no row of (a new session, say) from these rows themselves."""
        return ()

    def same_as(self, other: Self) -> bool:
        """Whether another variant at the same place is a form of the same cause, so that the two exclude each other."""
        return not self.side_by_side or other == self

    def variable(self, joint: int) -> Variable:
        """Return the abscissa for plots of its error at a joint (0 for none); by default the position in measuring order."""
        return IN_ORDER

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the size of one part's own parameters (n,): the norm of those that share the first one's unit."""
        same = [k for k, parameter in enumerate(own) if parameter.unit == own[0].unit]
        return ca.sqrt(ca.sumsqr(p[same]) + NOTHING)

    @property
    def detail(self) -> str:
        """The variant in words, e.g. `order 7`."""
        return self.forms.get(next(iter(self.figures.values()), None), "")

    def detail_at(self, joint: int) -> str:
        """Return the variant in words at a joint (0 for none), in the units in which it moves."""
        return self.detail

    def acts_as(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the effect that acts at a row and its parameters: this one, unless it acts as another one."""
        return self, p

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the robot's lengths and angles with this effect."""
        return dims

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Return masses, centres of mass and gravity with this effect."""
        return loads

    @property
    def gives_way(self) -> bool:
        """Whether it may deflect joints, bearings or link ends: it overrides `torque` or `deflection`."""
        return (type(self).torque, type(self).deflection) != (Effect.torque, Effect.deflection)

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Return the torques it adds on the driven joints, (n_joints,) [Nm]."""
        return 0.0

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection of joints, bearings and link ends; still is the zero deflection, to be replaced in part."""
        return still

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the position (3,) [m] that the measuring device reports for a point."""
        return point

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the true position (3,) [m] of a point of a camera's target, in the target's frame."""
        return point

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Return what it adds to the standard deviation of the reported position, per axis [m]."""
        return 0.0


@lru_cache(maxsize=4096)
def _declared(effect: Effect) -> tuple[Parameter, ...]:
    """Return an effect's labelled parameters; cached, since a search constructs equal effects many times."""
    variant = effect.variant
    tag = effect.tag.format(id=effect.id, variant=f"[{variant}]" if variant else "")
    stated = effect.robot.expectations
    return tuple(replace(parameter, variant=variant, tag=tag).as_expected(stated) for parameter in effect.parameters())


def _figure(name: str, value: object) -> str:
    """Return a figure's name and value; empty where it is zero."""
    if not value or isinstance(value, bool):
        return name if value else ""
    if isinstance(value, tuple):
        return f"{name} {'/'.join(map(_number, value))}"
    return f"{name} {_number(value)}"


def _number(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, float) else str(value)


@lru_cache
def catalogue() -> dict[str, type[Effect]]:
    """Return every effect class by its id, from the files of this folder and from other packages' entry points.

    Raises:
        InputError: an effect of another package cannot be used.
    """
    return plugins.catalogue_of(__package__, plugins.EFFECTS, Effect, _flaw)  # type: ignore[type-abstract]


def effect_class(effect: str) -> type[Effect] | None:
    """Return the effect class of an id: from the catalogue, else the one defined last in a program or notebook."""
    if effect in catalogue():
        return catalogue()[effect]
    every = plugins.subclasses(Effect)  # type: ignore[type-abstract]
    defined = [kind for kind in every if not kind.__module__.startswith("calflow.")]
    return next((kind for kind in defined[::-1] if getattr(kind, "id", "") == effect), None)


def effects_given(effects: Iterable[object]) -> tuple[str | type[Effect] | Effect, ...]:
    """Return effects given by id, as classes or as objects, unchanged, once they are checked.

    Raises:
        InputError: entries that are no effects or cannot be used, all in one message.
    """
    given = list(effects)
    if isinstance(effects, str):
        raise refuse(f"expected several, in a list: ['{effects}']", key="effects")
    refuse_any(
        Problem(message, key=f"effects[{k + 1}]") for k, effect in enumerate(given) if (message := unusable(effect))
    )
    return tuple(given)  # type: ignore[arg-type]


def effects_by_id(effects: Iterable[object]) -> tuple[str, ...]:
    """Return the ids of effects given as for `effects_given`, each of which leads back to its effect.

    Raises:
        InputError: as for `effects_given`, or an id leads to another class, defined later.
    """
    given = effects_given(effects)
    refuse_any(
        Problem(f"the id '{kind.id}' of {kind.__name__} is taken by {effect_class(kind.id)!r}", key=f"effects[{k + 1}]")
        for k, kind in enumerate(given)
        if inspect.isclass(kind) and effect_class(kind.id) is not kind
    )
    return effect_ids(given)


def effect_ids(effects: Sequence[str | type[Effect] | Effect]) -> tuple[str, ...]:
    """Return the ids of effects given by id, as classes or as objects."""
    return tuple(effect if isinstance(effect, str) else effect.id for effect in effects)


def unusable(given: object) -> str:
    """Return why an object cannot be used as an effect; empty where it can."""
    if isinstance(given, str):
        return "" if effect_class(given) else f"unknown effect '{given}'{nearest(given, catalogue())}"
    kind = given if inspect.isclass(given) else type(given)
    if not issubclass(kind, Effect):
        return f"expected the id of an effect, a subclass of calflow.effects.base.Effect or an object of one, found {given!r}"
    if lacking := sorted(getattr(kind, "__abstractmethods__", ())):
        return f"{kind.__name__} lacks {', '.join(lacking)}"
    if lacking := [name for name in ("id", "title") if not isinstance(getattr(kind, name, None), str)]:
        return f"{kind.__name__} lacks {' and '.join(lacking)}: expected texts"
    if catalogue().get(kind.id, kind) is not kind:
        return f"the id '{kind.id}' of {kind.__name__} is taken by {catalogue()[kind.id]!r}"
    return "" if kind.id in catalogue() else _flaw(kind)


def _flaw(effect: type[Effect]) -> str:
    """Return what is wrong with the declarations of an effect from another package; empty where nothing is."""
    if "{id}" not in effect.tag:
        return "its tag lacks {id}, so that its parameters' names are not its own"
    unknown = [f"'{need}'{nearest(need, NEEDS)}" for need in effect.needs if need not in NEEDS]
    return f"it needs {' and '.join(unknown)}; expected some of {', '.join(NEEDS)}" if unknown else ""


def _asked(question: str) -> Any:
    """Return a method that the effect it acts as answers (`concerns`, say)."""

    def ask(self: ActingEffect, *about: Any) -> Any:
        """Return what the effect that acts says."""
        return getattr(self._acting_effect, question)(*about)

    return ask


def _delegated(place: str) -> Any:
    """Return a method that delegates an effect's action (`deflection`, say) to the effect it acts as."""

    def act(self: ActingEffect, p: ca.SX, *around: Any) -> Any:
        """Call the method of the effect that acts, with its parameters."""
        effect, values = self.acting(p, next(each for each in around if isinstance(each, Row)))
        return getattr(effect, place)(values, *around)

    return act


@dataclass(frozen=True)
class ActingEffect(Effect):
    """An effect that delegates its action to another one, whose parameters it maps its own to."""

    @abstractmethod
    def acting(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the effect that acts and its parameters at a row, given the column vector of this effect's."""

    def acts_as(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        effect, values = self.acting(p, row)
        return effect.acts_as(values, row)

    @cached_property
    def _acting_effect(self) -> Effect:
        """The effect that acts, which no row changes."""
        return self.acting(ca.SX(len(self.declared), 1), _symbols(self.robot)[1])[0]

    completing, concerns, undecided, is_noise, of_measuring = map(
        _asked, ("completing", "concerns", "undecided", "is_noise", "of_measuring")
    )
    dimensions, loads, torque, deflection, device, target, scatter = map(
        _delegated, ("dimensions", "loads", "torque", "deflection", "device", "target", "scatter")
    )


@dataclass(frozen=True)
class Term:
    """A basis function of a joint's error, dq = parameter · value; unit, prior_sd and bound in SI (prismatic: m)."""

    symbol: str
    unit: str
    prior_sd: float
    bound: float
    value: ca.SX
    one_sided: bool = False


def phases(angle: ca.SX, unit: str, sd: float, bound: float) -> list[Term]:
    """Return the cosine and sine terms of a wave of any phase; sd and bound of its amplitudes are in the joint's unit."""
    return [Term("cos", unit, sd, bound, ca.cos(angle)), Term("sin", unit, sd, bound, ca.sin(angle))]


@lru_cache(maxsize=16)
def _symbols(robot: Robot) -> tuple[State, Row]:
    """Return symbols with which terms are built to read their names and sizes alone."""
    return State.symbols(robot), Row.symbols(robot)


@dataclass(frozen=True)
class JointError(Effect):
    """dq_i = sum of parameter · term, separately for every joint; a subclass returns the `terms`."""

    @abstractmethod
    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the terms of one joint (index from 0); none where the effect does not apply."""

    @cached_property
    def rated(self) -> np.ndarray:
        """Rated torques [Nm; prismatic: N], shape (n_joints,)."""
        return rated_torques(self.robot)

    def load(self, joint: int, state: State) -> ca.SX:
        """Return a joint's torque (index from 0) as a share of its rated torque."""
        return state.torque[joint] / self.rated[joint]

    def unit(self, joint: int) -> str:
        """Return the unit of a joint's error (index from 0): rad, or m for a prismatic joint."""
        return self.robot.joints[joint].unit

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each joint's parameters."""
        state, row = _symbols(self.robot)
        return tuple(
            Parameter(self.id, f"joint{i + 1}", term.symbol, term.unit, term.prior_sd,
                      0.0 if term.one_sided else -term.bound, term.bound,
                      meaning=f"{self.in_words().name} of joint {i + 1}", joint=i + 1)
            for i in range(self.robot.n_joints) for term in self.terms(i, state, row)
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection of each joint by its terms."""
        turned = []
        for i, amplitudes in enumerate(ca.vertsplit(p, self._ends)):
            values = [term.value for term in self.terms(i, state, row)] if amplitudes.nnz() else []
            turned.append(ca.dot(amplitudes, ca.vertcat(*values)) if values else ca.SX(1, 1))
        return replace(still, joint=ca.vertcat(*turned))

    @cached_property
    def _ends(self) -> list[int]:
        """Offsets at which the joints' parameters begin and end in the parameter vector."""
        counts = np.bincount([parameter.joint for parameter in self.declared], minlength=self.robot.n_joints + 1)
        return np.cumsum(counts).tolist()

    variable = joint_variable
