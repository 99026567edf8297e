"""Bases of effects: a physical cause with its parameters and the places where it may act, a cause at one place, an error of joints.

And the catalogue of all effects, and smooth curves: Gaussian processes (Matern 5/2) over an interval, written in sine waves with
their spectrum as priors. Needs: what an effect cannot do without, of the robot file or of the data.
"""

from __future__ import annotations

import inspect
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from math import gamma, pi, sqrt
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from calflow.files import plugins
from calflow.files.problems import Problem, nearest, refuse, refuse_any
from calflow.files.toml import as_tuples
from calflow.files.words import effect_words, listed, with_sd
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Dimensions, Loads, Row, State, rated_torques
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class Need:
    """What is needed, as files have it and in plain words; met says whether a robot, or the conditions that are given, have it."""

    words: str
    plain: str
    met: Callable[[Robot, tuple[str, ...]], bool]
    recorded: bool = False


def _recorded(words: str, plain: str, condition: str) -> Need:
    """What is written down while poses are measured."""
    return Need(words, plain, lambda robot, given: condition in given, recorded=True)


NEEDS = {
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
    "floor": Need(
        "a chain that begins at what stands on the floor (ground = 0 in the robot file)",
        "that the chain begins at what stands on the floor",
        lambda robot, given: robot.ground == 0,
    ),
    "payload": Need(
        "a payload with a mass in the robot file",
        "the mass of a payload",
        lambda robot, given: any(load.mass != 0 for load in robot.payloads.values()),
    ),
    "gear_ratio": Need(
        "gear_ratio of a joint in the robot file",
        "the joints' gear ratios",
        lambda robot, given: any(joint.gear_ratio for joint in robot.joints),
    ),
    "distances": Need(
        "relative_sd_mm of a marker in the robot file (its place beside the first, measured apart)",
        "the distances between the markers, measured apart",
        lambda robot, given: any(marker.relative_sd for marker in robot.markers.values()),
    ),
    "approach": _recorded(
        "columns approach1 … (or in_order = true in the study's [measurements])",
        "the side from which each joint comes to a pose",
        "approach",
    ),
    "travel": _recorded(
        "columns travel1_deg (or _rad) … (or, without approach columns, in_order = true in the study's [measurements])",
        "how far each joint moves to get to a pose",
        "travel",
    ),
    "wrench": _recorded("columns fx_N … mz_Nm", "the forces on the tool at each pose", "wrench"),
    "torque": _recorded("columns tau1_Nm …", "the motors' torques at each pose", "torque"),
    "speed": _recorded("columns speed1_deg_per_s …", "the joints' speeds at each reading", "speed"),
    "time": _recorded("a column time_s", "the time of each reading", "time"),
    "temperature": _recorded("a column temperature_degC", "the temperature at each reading", "temperature"),
    "order": _recorded("rows in measuring order", "in which order poses are measured", "order"),
    "session": _recorded("a column session", "in which session each pose is measured", "session"),
    "slide": Need(
        "a prismatic joint in the robot file",
        "a linear axis",
        lambda robot, given: any(joint.kind == "prismatic" for joint in robot.joints),
    ),
    "range": _recorded(
        "the device's place, tracker_mm in the study's [measurements]", "where the instrument stands", "range"
    ),
}


@dataclass(frozen=True)
class ShownBy:
    """Which rows show an effect, in words for whoever has none, and whether these do; plain where it is worth the asking."""

    words: str
    by: Callable[[Measurements], bool]
    plain: str = ""
    recorded: bool = True


SHOWN = {
    "": ShownBy("", lambda data: True),
    "images": ShownBy("images of a target", lambda data: data.in_images),
    "warmth": ShownBy(
        "a column temperature_degC (that changes), or time_s",
        lambda data: data.temperature_changes or "time" in data.given,
        "the time of each reading, or the temperature as it changes",
    ),
}


def unmet(needs: tuple[str, ...], robot: Robot, given: tuple[str, ...]) -> list[str]:
    """Return in words which needs robot file and data leave unmet."""
    return [NEEDS[need].words for need in needs if not NEEDS[need].met(robot, given)]


Readable = Mapping[str, tuple[float, str]]  # SI unit -> factor and unit in which an effect's size is easy to read
WINDUP_SD, WINDUP_BOUND = 10e-3, 50e-3  # rad (a slide: m) of a spring at its joint's rated torque
NOTHING = 1e-300  # keeps the slope of a length finite where the length is zero


@dataclass(frozen=True)
class Words:
    """An effect as a report tells it: its name, what happens, and what the figure for its size is."""

    name: str
    what: str = ""
    size: str = "size"


@dataclass(frozen=True)
class Variable:
    """What a cause's error is drawn against: its label, the unit drawn in, and its value times factor in that unit."""

    label: str
    unit: str
    value: Callable[[State, Row], ca.SX]
    factor: float = 1.0


def joint_variable(effect: Effect, joint: int) -> Variable:
    """Return a joint's (from 1) own angle, or a slide's position, as what an error is drawn against."""
    of = effect.robot.joints[joint - 1]
    unit, factor = of.shown
    return Variable(f"{of.noun} of joint {joint}", unit, lambda state, row: state.q[joint - 1], factor)


def torque_variable(effect: Effect, joint: int) -> Variable:
    """Return the torque on a joint (from 1), or the force on a slide, as what an error is drawn against."""
    unit = effect.robot.joints[joint - 1].load_unit
    noun = "torque" if unit == "Nm" else "force"
    return Variable(f"{noun} of joint {joint}", unit, lambda state, row: state.torque[joint - 1])


def payload_variable(effect: Effect, joint: int) -> Variable:
    """Return the mass of a row's payload as what an error is drawn against; one that nobody knows counts as none."""
    masses = ca.DM([load.mass or 0.0 for load in effect.robot.payloads.values()])
    return Variable("payload", "kg", lambda state, row: ca.dot(masses, row.payload))


def around(value: float, reach: float) -> list[float]:
    """Return values about one as far as reach on either side, the denser the nearer: for `Effect.finer`."""
    steps = reach * np.geomspace(1 / 1024, 1.0, 21)
    return [float(value + step) for step in (*-steps[::-1], 0.0, *steps)]


def several_imaged(data: Measurements, what: str) -> str:
    """Say that images are not all of one thing (camera, target), of points that are stated; empty where they are."""
    if "px_z" not in data.table:
        return "images of points stated as px_x, px_y and px_z"
    alone = len(data.series) == 1 and (what not in data.table or data.table[what].nunique() == 1)
    return "" if alone else f"images of one {what} alone"


def displaced(p: ca.SX, point: ca.SX) -> ca.SX:
    """Return by how much a shift p (3,), or a shift and a small turn about the origin (6,), moves a point."""
    return p[:3] + (ca.cross(p[3:], point) if p.numel() == 6 else 0)


@dataclass(frozen=True)
class Effect(ABC):
    """One physical cause. A subclass declares its parameters and overrides the one place where it acts.

    p is the column of this effect's parameters in the order declared; every default below means "does not act here".
    Fields besides the robot are what cannot be a decision variable, such as the order of a periodic error: numbers, text
    or tuples of them; `variants` says which values to try.
    """

    robot: Robot

    id: ClassVar[str]
    title: ClassVar[str]
    forms: ClassVar[Mapping[Any, str]] = {}  # what its one field besides the robot may be, each in words
    needs: ClassVar[tuple[str, ...]] = ()  # what it cannot do without: see `NEEDS`
    shown_by: ClassVar[str] = ""  # which rows can show it: see `SHOWN`
    stands_in: ClassVar[str] = ""  # id of the effect that stands for it where the masses are known
    family: ClassVar[str] = ""  # what to call it when the data do not tell it from others of its family
    alike: ClassVar[tuple[str, ...]] = ()  # ids that no pose tells from it: only another sensor or load would
    taken_for: ClassVar[tuple[str, ...]] = ()  # ids of causes that it may be behind where data lack what would test it
    told_by: ClassVar[str] = ""  # what to do at the robot to tell it from its rivals where no pose does
    words: ClassVar[Words | None] = None  # for reports; without them they show the title
    readable: ClassVar[Readable] = {}  # for units that reports would turn into others
    place_word: ClassVar[str] = "joint"  # what the number of its place counts
    whole: ClassVar[str] = ""  # the part that its name says already: a tilt of the base has no other
    tag: ClassVar[str] = "{id}{variant}"  # in its parameters' names; empty where they are the maker's own figures
    inevitable: ClassVar[bool] = False  # whether any robot has it, in about its usual size
    side_by_side: ClassVar[bool] = False  # whether two variants may act at one place: no forms of the same thing
    grows_with: ClassVar[str] = ""  # of a noise: the condition of a row that it grows with

    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters for this robot."""

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The parameters with what makes them this effect's in this variant."""
        return _declared(self)

    @property
    def figures(self) -> dict[str, Any]:
        """What makes its variant: its fields besides the robot."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "robot"}

    @property
    def figures_text(self) -> str:
        """The same as JSON, for a table."""
        return json.dumps(self.figures)

    @classmethod
    def of_figures(cls, robot: Robot, text: str) -> Self:
        """Rebuild an effect from its `figures_text`."""
        return cls(robot, **{name: as_tuples(value) for name, value in json.loads(text).items()})

    @property
    def variant(self) -> str:
        """Name the variant in short, e.g. `order 2`: its figures other than zero; empty where there are none."""
        return " ".join(text for name, value in self.figures.items() if (text := _figure(name, value)))

    @classmethod
    def stated(cls, robot: Robot, data: Measurements) -> Self:
        """Return the form that a study means by its id, for these rows; it may be of what the rows are of."""
        return cls(robot)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the forms in which to look for it in these data; none where the data cannot show it (see `lacking`)."""
        plain = cls(robot)
        name = next(iter(plain.figures), "")
        return tuple(replace(plain, **{name: form}) for form in cls.forms) or (plain,)

    @classmethod
    def lacking(cls, robot: Robot, data: Measurements) -> str:
        """Say what these data lack for a test of it: what it needs, rows that show it, or else; empty where nothing."""
        if missing := unmet(cls.needs, robot, data.given):
            return ", ".join(missing)
        shown = SHOWN[cls.shown_by]
        return cls.unfit(robot, data) if shown.by(data) else shown.words

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Say why data that have what it needs are none to test it on; empty where they are."""
        return ""

    @classmethod
    def superseded(cls, robot: Robot) -> str:
        """Say why nobody needs it for this robot: another effect stands for it, or no rail is there; empty where that is not so."""
        if "slide" in cls.needs and not NEEDS["slide"].met(robot, ()):
            return "the robot has no prismatic joint"
        replaced = cls.stands_in and robot.has_masses
        return f"the masses are known, so {cls.stands_in} stands for it" if replaced else ""

    @classmethod
    def is_noise(cls) -> bool:
        """Whether it widens the noise and shifts nothing, so that it is tested by what the fit leaves."""
        return cls.scatter is not Effect.scatter

    @classmethod
    def of_device(cls) -> bool:
        """Whether it is the measuring device's: the robot itself is where it would be without it."""
        return cls.device is not Effect.device or cls.target is not Effect.target or cls.is_noise()

    @property
    def smooth_in(self) -> tuple[str, ...]:
        """Inputs (`time`, `order`) of which it is any smooth function: what nobody can name would be the same there."""
        return ()

    @classmethod
    def named_in(cls) -> tuple[str, ...]:
        """Inputs of which one of its family is any smooth function: what errs there has a name."""
        return SMOOTH_IN.get(cls.family, ())

    def travel(self, joint: int) -> tuple[float, float, float] | None:
        """Return the travel of a joint (from 1) over which rows told of a curve that is nothing beyond: nobody knows there.

        It is from where, to where, and how far along it the curve is alike.
        """
        return None

    @classmethod
    def springs(cls, robot: Robot) -> bool:
        """Whether it is how this robot's joints give way, which even a rough model must have."""
        return False

    @classmethod
    def in_words(cls) -> Words:
        """Return its words, its title where nobody has written any."""
        return cls.words or Words(cls.title)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return variants between this one and its neighbours."""
        return ()

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return effects that place what these rows are of and the fit had no row of (a session, say) by the rows themselves."""
        return ()

    def same_as(self, other: Self) -> bool:
        """Whether another variant at the same place is another form of the same thing, so that they cannot both act."""
        return not self.side_by_side or other == self

    def variable(self, joint: int) -> Variable:
        """Return what explains it at a joint (0 for none): the row's place in measuring order unless it knows better."""
        return Variable("place in measuring order", "", lambda state, row: row.order)

    def size(self, p: ca.SX) -> ca.SX:
        """Return one figure for the parameters (n,) of one part: their length, of those with the first one's unit."""
        unit = self.declared[0].unit
        same = [k for k, parameter in enumerate(self.declared[: p.numel()]) if parameter.unit == unit]
        return ca.sqrt(ca.sumsqr(p[same]) + NOTHING)

    @property
    def detail(self) -> str:
        """Say which variant it is, e.g. `order 7`."""
        return self.forms.get(next(iter(self.figures.values()), None), "")

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Change lengths and angles."""
        return dims

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Change masses."""
        return loads

    @property
    def gives_way(self) -> bool:
        """Whether it may move joints, bearings or link ends: it has torques or deflections of its own."""
        return (type(self).torque, type(self).deflection) != (Effect.torque, Effect.deflection)

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Add torques to the driven joints, (n_joints,) [Nm]."""
        return 0.0

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Move joints, bearings or link ends; still is no motion, to be replaced in part."""
        return still

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Change the position that the measuring device reports, (3,) [m]."""
        return point

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Change where a point of a camera's target is, (3,) [m] in the target's frame."""
        return point

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Add to the standard deviation of the reported position, per axis [m]."""
        return 0.0


@lru_cache(maxsize=4096)
def _declared(effect: Effect) -> tuple[Parameter, ...]:
    """Work out what an effect declares, once for all that are equal to it: a search makes the same ones anew and anew."""
    variant = effect.variant
    tag = effect.tag.format(id=effect.id, variant=f"[{variant}]" if variant else "")
    stated = effect.robot.expectations
    return tuple(replace(parameter, variant=variant, tag=tag).as_expected(stated) for parameter in effect.parameters())


def _figure(name: str, value: object) -> str:
    """Name a figure; nothing where it is zero."""
    if not value or isinstance(value, bool):
        return name if value else ""
    if isinstance(value, tuple):
        return f"{name} {'/'.join(map(_number, value))}"
    return f"{name} {_number(value)}"


def _number(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, float) else str(value)


@lru_cache
def catalogue() -> dict[str, type[Effect]]:
    """Return every effect by its id: a new file in this folder is enough to add one, or another package's entry point.

    Raises:
        InputError: another package brings what cannot be used.
    """
    return plugins.catalogue_of(__package__, plugins.EFFECTS, Effect, _flaw)  # type: ignore[type-abstract]


def effect_class(effect: str) -> type[Effect] | None:
    """Return the effect of an id: the catalogue's, else the class that a program or a notebook has defined last, if any."""
    if effect in catalogue():
        return catalogue()[effect]
    every = plugins.subclasses(Effect)  # type: ignore[type-abstract]
    defined = [kind for kind in every if not kind.__module__.startswith("calflow.")]
    return next((kind for kind in defined[::-1] if getattr(kind, "id", "") == effect), None)


def effects_given(effects: Iterable[object]) -> tuple[str | type[Effect] | Effect, ...]:
    """Return effects that are given by id, as a class or as an object, as they are.

    Raises:
        InputError: with all that is no effect, or cannot be used.
    """
    given = list(effects)
    if isinstance(effects, str):
        raise refuse(f"expected several, in a list: ['{effects}']", key="effects")
    refuse_any(
        Problem(message, key=f"effects[{k + 1}]") for k, effect in enumerate(given) if (message := unusable(effect))
    )
    return tuple(given)  # type: ignore[arg-type]


def effects_by_id(effects: Iterable[object]) -> tuple[str, ...]:
    """Return the ids of effects that are given as of `effects_given`, by which each is found again.

    Raises:
        InputError: as of `effects_given`; or an id leads to another class, which was defined later.
    """
    given = effects_given(effects)
    refuse_any(
        Problem(f"the id '{kind.id}' of {kind.__name__} is taken by {effect_class(kind.id)!r}", key=f"effects[{k + 1}]")
        for k, kind in enumerate(given)
        if inspect.isclass(kind) and effect_class(kind.id) is not kind
    )
    return effect_ids(given)


def effect_ids(effects: Sequence[str | type[Effect] | Effect]) -> tuple[str, ...]:
    """Return the effects' ids."""
    return tuple(effect if isinstance(effect, str) else effect.id for effect in effects)


def unusable(given: object) -> str:
    """Say what keeps something from being used as an effect; empty where nothing does."""
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
    """What an effect of another package says of itself that calflow cannot do with."""
    if "{id}" not in effect.tag:
        return "its tag lacks {id}, so that its parameters' names are not its own"
    unknown = [f"'{need}'{nearest(need, NEEDS)}" for need in effect.needs if need not in NEEDS]
    return f"it needs {' and '.join(unknown)}; expected some of {', '.join(NEEDS)}" if unknown else ""


UNEXPLAINED = "unexplained"  # stands for a cause where something without a name depends on the same input
UNITS = {
    "rad": (1e6, "µrad"), "m": (1e3, "mm"), "1": (100.0, "%"), "rad/Nm": (1e9, "µrad/kNm"), "m/N": (1e6, "µm/N"),
    "Nm2": (1e-6, "MNm²"), "1/Nm2": (1e6, "1/MNm²"), "Nm": (1e-3, "kNm"), "m/s": (3.6e6, "mm/h"), "rad/s": (3.6e6, "mrad/h"),
    "1/K": (1e6, "µm/m per °C"), "m/m": (1e6, "µm/m"),
}  # fmt: skip
FLEXIBILITY = "1/Nm2"
LARGE_ANGLE = 2e-3  # rad from which mrad are said


def _as_the_other(place: str) -> Any:
    """Return the method by which an effect acts at a place as another one does."""

    def act(self: ActingEffect, p: ca.SX, *around: Any) -> Any:
        """Act as the other does."""
        effect, values = self.acting(p)
        return getattr(effect, place)(values, *around)

    return act


@dataclass(frozen=True)
class ActingEffect(Effect):
    """An effect that acts as another one does, with a column of that one's parameters."""

    @abstractmethod
    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return what acts, and its parameters, for the column of this effect's."""

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return what the one that acts does."""
        return self._acts.completing(data)

    def is_noise(self) -> bool:  # type: ignore[override]
        """Whether the one that acts is a noise."""
        return self._acts.is_noise()

    def of_device(self) -> bool:  # type: ignore[override]
        """Whether the one that acts is the measuring device's."""
        return self._acts.of_device()

    @property
    def _acts(self) -> Effect:
        return self.acting(ca.SX(len(self.declared), 1))[0]

    dimensions, loads, torque, deflection, device, target = map(
        _as_the_other, ("dimensions", "loads", "torque", "deflection", "device", "target")
    )


@dataclass(frozen=True)
class Cause(ActingEffect):
    """One effect at one place: of its parameters only those of one part, the others at zero."""

    effect: Effect
    part: str

    @property
    def id(self) -> str:  # type: ignore[override]
        """The effect's id."""
        return self.effect.id

    @property
    def title(self) -> str:  # type: ignore[override]
        """The effect's name in reports."""
        return self.effect.in_words().name

    @property
    def detail(self) -> str:
        """The effect's variant, after the part where it has several and neither joint nor name says which."""
        alone = all(parameter.part == self.part for parameter in self.effect.declared)
        part = "" if alone or self.joint or self.part == self.effect.whole else self.part
        return ", ".join(filter(None, (part, self.effect.detail)))

    @property
    def variant(self) -> str:
        """The effect's variant in short."""
        return self.effect.variant

    @property
    def joint(self) -> int:
        """Number of the joint or link, 0 for none."""
        return self.declared[0].joint

    @property
    def place(self) -> tuple[str, str]:
        """What stays the same in all its variants."""
        return self.effect.id, self.part

    @property
    def n_parameters(self) -> int:
        """How many parameters it has."""
        return len(self.declared)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Least and largest values of its parameters, from nominal, shape (2, n_parameters)."""
        return np.array([(p.lower - p.nominal, p.upper - p.nominal) for p in self.declared]).T

    @property
    def family(self) -> str:  # type: ignore[override]
        """The effect's family."""
        return self.effect.family

    @property
    def alike(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the effect cannot be told from by any pose."""
        return self.effect.alike

    def same_form(self, other: Cause) -> bool:
        """Whether another is this cause, in this variant or one that cannot act beside it."""
        return self.place == other.place and self.effect.same_as(other.effect)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the part's parameters."""
        return self.declared

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The effect's parameters of the part, as the effect names them."""
        return tuple(parameter for parameter in self.effect.declared if parameter.part == self.part)

    @cached_property
    def _at(self) -> list[int]:
        return [k for k, parameter in enumerate(self.effect.declared) if parameter.part == self.part]

    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return the effect with all its parameters, those of other parts at zero."""
        whole = ca.SX(len(self.effect.declared), 1)
        whole[self._at] = p
        return self.effect, whole

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Act as the effect does."""
        return self.effect.scatter(self.acting(p)[1], row)


@dataclass(frozen=True)
class Carried(ActingEffect):
    """A cause with values that were found before, and nothing left to fit."""

    cause: Cause
    values: tuple[float, ...]

    title = "known beforehand"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """None."""
        return ()

    def acting(self, p: ca.SX) -> tuple[Effect, ca.SX]:
        """Return the cause with its values."""
        return self.cause, ca.SX(ca.DM(self.values))


def parts(effect: Effect) -> dict[str, np.ndarray]:
    """Return the indices of each part's parameters."""
    named = [parameter.part for parameter in effect.declared]
    return {part: np.flatnonzero(np.array(named) == part) for part in dict.fromkeys(named)}


@dataclass(frozen=True)
class NamedCause:
    """An effect by its id, at a joint or link (0 for none)."""

    cause: str
    joint: int

    @property
    def label(self) -> str:
        """Its id with its joint, if it has one."""
        return f"{self.cause} {self.joint}" if self.joint else self.cause

    @property
    def name(self) -> str:
        """Its name with its place, in words."""
        return cause_name(self.cause, self.joint)

    def covers(self, other: NamedCause) -> bool:
        """Whether another is the same, or of its family at its joint: told by one name where the data do not tell which."""
        family = cause_family(self.cause)
        return other == self or (bool(family) and (cause_family(other.cause), other.joint) == (family, self.joint))


def cause_family(cause: str) -> str:
    """Return the family that an effect belongs to; empty where it belongs to none."""
    kind = effect_class(cause)
    return kind.family if kind else ""


def cause_name(cause: str, joint: int | None = None, part: str = "") -> str:
    """Return a cause's name with its place; part is said where it is neither joint nor link."""
    name = cause_words(cause).name
    if joint:
        return f"{name} of {_place_word(cause)} {joint}"
    return f"{name} ({part})" if part else name


def place_name(cause: str, joint: int | None, part: str) -> str:
    """Return a cause's name with its place, from its joint or link, if it has one, and the part that it belongs to."""
    kind = effect_class(cause)
    return cause_name(cause, joint, "" if joint or (kind and kind.whole == part) else part)


def place_names(cause: str, places: Sequence[tuple[int | None, str]]) -> str:
    """Return a cause's name with all its places, each a joint or link, if it has one, and a part."""
    numbered = [joint for joint, _ in places if joint]
    if len(numbered) < 2 or len(numbered) < len(places):
        return listed([place_name(cause, joint, part) for joint, part in places])
    return f"{cause_words(cause).name} of {_place_word(cause)}s {listed(numbered)}"


def cause_words(cause: str) -> Words:
    """Return a cause in its effect's words."""
    if cause == UNEXPLAINED:
        return Words("something unexplained")
    kind = effect_class(cause)
    return kind.in_words() if kind else Words(effect_words(cause))


def _place_word(cause: str) -> str:
    kind = effect_class(cause)
    return kind.place_word if kind else "joint"


def readable_size(cause: str, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a cause's size is easy to read."""
    kind = effect_class(cause)
    return (kind.readable.get(unit) if kind else None) or UNITS.get(unit) or (1.0, unit)


def amount(cause: str, estimate: float, sd: float, unit: str) -> str:
    """Return a size with its standard deviation and unit; a flexibility as the stiffness that it is one over."""
    if unit == FLEXIBILITY and estimate > 0:
        estimate, sd, unit = 1 / estimate, sd / estimate**2, "Nm2"
    factor, unit_shown = readable_size(cause, unit)
    if unit_shown == "µrad" and abs(estimate) >= LARGE_ANGLE:
        factor, unit_shown = 1e3, "mrad"
    value, deviation = with_sd(factor * estimate, factor * sd)
    return f"{value} ± {deviation} {unit_shown}" if deviation != "–" else f"{value} {unit_shown}"


TRANSMISSION = "transmission error"
OF_THE_FRAME = "drift of the device's frame"  # what moves it in time: at once, steadily or not
LOST_MOTION = "lost motion"
NONLINEAR = "nonlinear compliance"
STRUCTURE = "structural compliance"
OF_THE_TOOL = "compliance of the tool"
IN_TIME = ("time", "order")  # the inputs that causes of the measuring device depend on
ITS_ANGLE = "q"  # of the joint that a cause is one of
SMOOTH_IN = {
    TRANSMISSION: (ITS_ANGLE,),
    OF_THE_FRAME: IN_TIME,
}  # families of which one member is any smooth function of these
REVERSALS = "vary the travel since the last reversal, from tenths of a degree (a slide: of a millimetre) to many"
JOINT_ALONE = "move the joint alone over all its travel, and measure closely on the way"


@dataclass(frozen=True)
class Term:
    """One parameter of a joint's error: dq = parameter · value; unit, prior_sd and bound are SI, so m for a slide."""

    symbol: str
    unit: str
    prior_sd: float
    bound: float
    value: ca.SX
    one_sided: bool = False


def phases(angle: ca.SX, unit: str, sd: float, bound: float) -> list[Term]:
    """Return cosine and sine of an angle, for a wave of any phase; sd and bound are in the joint's unit."""
    return [Term("cos", unit, sd, bound, ca.cos(angle)), Term("sin", unit, sd, bound, ca.sin(angle))]


@lru_cache(maxsize=16)
def _symbols(robot: Robot) -> tuple[State, Row]:
    """Symbols of which terms are made only to be asked for their names and sizes."""
    return State.symbols(robot), Row.symbols(robot)


@dataclass(frozen=True)
class JointError(Effect):
    """dq_i = sum of parameter · term, for every joint apart; a subclass says which terms."""

    @abstractmethod
    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the terms of one joint (index from 0); none where it does not apply."""

    @cached_property
    def rated(self) -> np.ndarray:
        """Rated torques [Nm, a slide's N], shape (n_joints,)."""
        return rated_torques(self.robot)

    def load(self, joint: int, state: State) -> ca.SX:
        """Return a joint's torque (index from 0) over its rated one."""
        return state.torque[joint] / self.rated[joint]

    def unit(self, joint: int) -> str:
        """Return the unit of a joint's error (index from 0): m for a slide."""
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
        """Turn each joint by its terms."""
        turned = []
        for i, amplitudes in enumerate(ca.vertsplit(p, self._ends)):
            values = [term.value for term in self.terms(i, state, row)] if amplitudes.nnz() else []
            turned.append(ca.dot(amplitudes, ca.vertcat(*values)) if values else ca.SX(1, 1))
        return replace(still, joint=ca.vertcat(*turned))

    @cached_property
    def _ends(self) -> list[int]:
        """Where each joint's parameters begin and end among all."""
        counts = np.bincount([parameter.joint for parameter in self.declared], minlength=self.robot.n_joints + 1)
        return np.cumsum(counts).tolist()

    variable = joint_variable


NEGLIGIBLE = 1e-3  # share of the largest prior standard deviation below which a wave is left out
MARGIN = 1.1  # times half the interval at which the waves are tied to zero
RMS = 1 / sqrt(2)  # of a wave of amplitude 1


@dataclass(frozen=True)
class Wave:
    """One wave of a curve of variance 1: its number from 1, its amplitude's prior sd, its value, and its mean over the interval."""

    number: int
    sd: float
    value: ca.SX
    mean: float


def waves(variable: ca.SX, low: float, high: float, length: float, finest: float) -> list[Wave]:
    """Return the waves of a curve of a variable (1,) from low to high, the longest first.

    Neighbours are alike as far as length, and nothing is resolved below finest; all in the variable's unit. The amplitudes
    are independent, so that smoothness is a prior like any other (Solin and Saerkkae 2020). Beyond the ends, by a twentieth of the
    interval, the curve is zero: waves that went on would tell there the mirror image of what was measured inside.
    """
    middle, half = (high + low) / 2, MARGIN * (high - low) / 2
    number = np.arange(1, int(2 * half / finest) + 1)
    sd = np.sqrt(_spectrum(pi * number / (2 * half), length) / half)
    inside = ca.fmax(middle - half, ca.fmin(middle + half, variable))
    angle = pi * (inside - middle + half) / (2 * half)
    kept = sd > NEGLIGIBLE * sd[0]
    # At once: one by one takes twenty times as long.
    values = ca.vertsplit(ca.sin(ca.DM(number[kept].astype(float)) * angle))
    begin, end = (pi * number[kept] * (0.5 + side * (high - low) / (4 * half)) for side in (-1, 1))
    mean = (np.cos(begin) - np.cos(end)) / (end - begin)
    every = zip(number[kept], sd[kept], values, mean, strict=True)
    return [Wave(int(k), float(s), value, float(m)) for k, s, value, m in every]


def _spectrum(omega: np.ndarray, length: float) -> np.ndarray:
    """Spectral density of a Matern 5/2 process of variance 1 (Rasmussen and Williams 2006, equation 4.15)."""
    rate = 5 / length**2
    return np.asarray(2 * sqrt(pi) * gamma(3) / gamma(2.5) * rate**2.5 * (rate + omega**2) ** -3)
