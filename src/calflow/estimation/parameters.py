"""Parameters by name: bounds and prior of each, its estimate, and the prior's share of the estimate's variance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calflow.effects import Effect, catalogue, effect_class, effects_given
from calflow.estimation.fit import Fit
from calflow.files.deferred import pd
from calflow.files.problems import Problem, nearest, refuse, refuse_any
from calflow.files.tables import column, from_frame, to_frame, typed
from calflow.files.toml import Positive, checked_arguments
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build, stated
from calflow.observations import observations
from calflow.robot.parts import Expected, Parameter
from calflow.robot.robot import Robot

UNIT = "as `unit` says"
# The columns of its display.
SHOWN = ["parameter", "estimate", "sd", "unit", "lower", "upper", "prior_mean", "prior_sd", "at_bound", "fixed"]


@dataclass(frozen=True, kw_only=True)
class FittedParameter:
    """A parameter of a model: bounds, prior, estimate and its standard deviation."""

    parameter: str = column("its name, unique in the model")
    effect: str = column("id of its effect")
    variant: str = column("the effect's variant")
    part: str = column("the part of the robot that it belongs to")
    symbol: str = column("its symbol within that part")
    joint: int | None = column("number of its joint or link")
    unit: str = column("unit of the figures in this row (SI)")
    nominal: float = column("its value where the effect is absent", UNIT)
    estimate: float = column("the fitted value", UNIT, sd="sd")
    sd: float = column(
        "standard deviation of the estimate, which includes the smooth errors that the model leaves; empty at a bound, 0 where it "
        "was held",
        UNIT,
    )
    lower: float = column("lower bound", UNIT)
    upper: float = column("upper bound", UNIT)
    prior_mean: float = column("mean of its prior", UNIT)
    prior_sd: float = column("standard deviation of its prior", UNIT)
    at_bound: bool = column("whether the estimate sits on a bound")
    fixed: bool = column("whether it was held at the estimate, and not fitted")
    prior_share: float = column("share of the estimate's variance that is the prior's; 1: the data do not determine it")
    figure: float = column("the maker's figure, to which the parameter's value is added", UNIT)
    calibrated: float = column("figure + estimate", UNIT, sd="sd")
    meaning: str = column("its meaning in words")
    of_size: bool = column("whether it is the relative error of the size of what is measured, such as a board's")

    @property
    def name(self) -> str:
        return self.parameter

    @property
    def value(self) -> float:
        """The estimate, or the value it is held at; before a fit the prior's mean."""
        return self.estimate

    @property
    def bounds(self) -> tuple[float, float]:
        return self.lower, self.upper

    @property
    def prior(self) -> tuple[float, float]:
        return self.prior_mean, self.prior_sd

    @staticmethod
    def of(parameter: Parameter) -> FittedParameter:
        """Return the row of a parameter before a fit, its value being the prior's mean or the value it is held at."""
        value = parameter.prior_mean if parameter.held is None else parameter.held
        return FittedParameter(
            parameter=parameter.name, effect=parameter.effect, variant=parameter.variant, part=parameter.part,
            symbol=parameter.symbol, joint=parameter.joint or None, unit=parameter.unit, nominal=parameter.nominal,
            estimate=value, sd=np.nan if parameter.held is None else 0.0, lower=parameter.lower, upper=parameter.upper,
            prior_mean=parameter.prior_mean, prior_sd=parameter.prior_sd, at_bound=False, fixed=parameter.held is not None,
            prior_share=1.0, figure=parameter.figure, calibrated=parameter.figure + value, meaning=parameter.meaning,
            of_size=parameter.of_size,
        )  # fmt: skip

    def as_parameter(self) -> Parameter:
        tag = self.parameter.removeprefix(f"{self.part}.").removesuffix(self.symbol).rstrip(".")
        return Parameter(
            self.effect, self.part, self.symbol, self.unit, self.prior_sd, self.lower, self.upper, self.nominal, self.figure,
            self.meaning, self.joint or 0, self.variant, tag, self.prior_mean, self.estimate if self.fixed else None,
            self.of_size,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Covariances:
    """A row of the covariance of the estimates, which includes the smooth errors that the model leaves (errors.csv)."""

    parameter: str = column("the row's parameter")
    of: Mapping[str, float] = column(
        "covariance with the column's parameter", "the units' product (SI)", name="{parameter}"
    )


@dataclass(frozen=True, eq=False, repr=False)
class Parameters(Mapping[str, FittedParameter]):
    """The parameters of a model by name, in its order (SI units); `fix`, `free`, `bound` and `prior` return changed copies.

    stated: bounds, priors and held values that override those of effects and observations in the next fit (`Robot.expected`).
    """

    rows: tuple[FittedParameter, ...]
    stated: tuple[Expected, ...] = ()

    @classmethod
    def of(cls, robot: Robot, data: Measurements, effects: Sequence[str | type[Effect] | Effect]) -> Self:
        """Return the parameters of a robot's model with effects (see `identify`) for measurements, before a fit.

        Raises:
            InputError: an effect is unknown.
        """
        return cls.of_model(stated(robot, effects_given(effects), data, observations(data)))

    @classmethod
    def of_model(cls, model: Model) -> Self:
        """Return a model's parameters before a fit."""
        return cls(tuple(map(FittedParameter.of, model.declared)), _by_name(model.robot))

    @classmethod
    def of_table(cls, table: pd.DataFrame, robot: Robot) -> Self:
        """Return the parameters of a robot's model from the table of `parameters.csv`."""
        return cls(tuple(from_frame(table, FittedParameter, "parameters.csv")), _by_name(robot))

    @classmethod
    def fitted(cls, result: Fit, covariance: np.ndarray) -> Self:
        """Return a fit's parameters, with standard deviations from a covariance, and the prior's share of each variance."""
        model, variance, free = result.model, np.diag(result.covariance), ~result.at_bound
        scale = np.outer(model.prior_sd, model.prior_sd)
        alone = np.diag(np.linalg.inv(result.information * scale))  # for a parameter at a bound: as if it were free
        share = np.minimum(1.0, np.where(free, variance / model.prior_sd**2, alone))
        sd = np.where(free, np.sqrt(np.diag(covariance)), np.nan)
        rows = [FittedParameter.of(parameter) for parameter in model.declared]
        for k, i in enumerate(model.free):
            estimate = float(result.estimate[k])
            rows[i] = replace(
                rows[i], estimate=estimate, sd=float(sd[k]), at_bound=bool(result.at_bound[k]),
                prior_share=float(share[k]), calibrated=rows[i].figure + estimate,
            )  # fmt: skip
        return cls(tuple(rows), _by_name(model.robot))

    def __getitem__(self, name: str) -> FittedParameter:
        return self.rows[self._at(name)]

    def __contains__(self, name: object) -> bool:
        return any(row.parameter == name for row in self.rows)

    def __iter__(self) -> Iterator[str]:
        return (row.parameter for row in self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    @checked_arguments
    def fix(self, name: str, value: float | None = None) -> Self:
        """Return a copy with one parameter held: at a value [SI], else at its estimate; before a fit at its nominal value.

        Raises:
            InputError: there is no such parameter, or it cannot have this value.
        """
        row = self[name]
        fitted = not np.isnan(row.sd) or row.at_bound
        at = value if value is not None else row.estimate if fitted else row.nominal
        return self._with(name, lambda row: replace(row, fixed=True, value=float(at)))

    def free(self, name: str) -> Self:
        """Return a copy in which one parameter is fitted again.

        Raises:
            InputError: there is no such parameter.
        """
        return self._with(name, lambda row: replace(row, fixed=False, value=None))

    @checked_arguments
    def bound(self, name: str, lower: float | None = None, upper: float | None = None) -> Self:
        """Return a copy with bounds of one parameter [SI]; None leaves a bound as it is.

        Raises:
            InputError: there is no such parameter, or its bounds, or prior's mean, are out of order.
        """
        row = self[name]
        low, high = (was if new is None else float(new) for was, new in ((row.lower, lower), (row.upper, upper)))
        return self._with(name, lambda row: replace(row, lower=low, upper=high))

    @checked_arguments
    def prior(self, name: str, mean: float, sd: Positive) -> Self:
        """Return a copy with the normal prior of one parameter [SI].

        Raises:
            InputError: there is no such parameter, the mean is not within the bounds, or sd is not above zero.
        """
        return self._with(name, lambda row: replace(row, mean=float(mean), sd=float(sd)))

    def _with(self, name: str, change: Callable[[Expected], Expected]) -> Self:
        at = self._at(name)
        before = next(
            (expected for expected in self.stated if expected.name == name),
            Expected(name=name, unit=self.rows[at].unit),
        )
        after, parameter = change(before), self.rows[at].as_parameter()
        if wrong := parameter.contradiction(after):
            raise refuse(wrong, key=name)
        kept = [expected for expected in self.stated if expected.name != name]
        row = FittedParameter.of(parameter.as_expected({name: after}))
        return replace(
            self, rows=(*self.rows[:at], row, *self.rows[at + 1 :]), stated=(*kept, *filter(_says_something, [after]))
        )

    def _at(self, name: str) -> int:
        names = list(self)
        if name not in names:
            raise refuse(f"unknown parameter '{name}'{nearest(name, names)}", key="parameters")
        return names.index(name)

    def on(self, robot: Robot, data: Measurements, effects: Sequence[str | Effect]) -> Robot:
        """Return the robot with these statements in place of those by name that it had.

        Raises:
            InputError: its model has no such parameters with these effects and measurements.
        """
        robot = replace(robot, expected=tuple(expected for expected in robot.expected if not expected.name))
        wrong = contradictions(self.stated, stated(robot, effects, data, observations(data)))
        refuse_any(Problem(message, key="parameters") for _, message in wrong)
        return replace(robot, expected=(*robot.expected, *self.stated))

    @property
    def table(self) -> pd.DataFrame:
        """One row per parameter, in the columns of `identify/parameters.csv`."""
        return to_frame(self.rows, FittedParameter)

    @property
    def _shown(self) -> pd.DataFrame:
        return self.table[SHOWN].rename(columns={"estimate": "value"})

    def __repr__(self) -> str:
        return self._shown.to_string(index=False, float_format="{:.6g}".format)

    def _repr_html_(self) -> str:
        return str(self._shown.to_html(index=False, float_format="{:.6g}".format))


def _by_name(robot: Robot) -> tuple[Expected, ...]:
    return tuple(expected for expected in robot.expected if expected.name)


def _says_something(expected: Expected) -> bool:
    return expected.fixed or any(value is not None for value in (expected.mean, expected.lower, expected.upper))


def contradictions(expected: Sequence[Expected], model: Model) -> Iterator[tuple[int, str]]:
    """Yield the index of each statement by name that a model cannot satisfy, and why."""
    parameters = {parameter.name: parameter for parameter in model.declared}
    for k, expectation in enumerate(expected):
        if expectation.name not in parameters:
            yield k, f"unknown parameter '{expectation.name}'{nearest(expectation.name, parameters)}"
        elif wrong := parameters[expectation.name].contradiction(expectation):
            yield k, wrong


def mistaken(robot: Robot, effects: Sequence[str | Effect]) -> Iterator[tuple[int, str]]:
    """Yield the index of each of a robot's statements that a study's effects cannot satisfy, and why.

    Statements of other effects are ignored, and so are those by name, which may need measurements (see `contradictions`).
    """
    asked = {expected.effect for expected in robot.expected if not expected.name}
    declared = {
        effect.id: {parameter.identity: parameter for parameter in effect.declared}
        for effect in build(robot, effects).effects
        if effect.id in asked
    }
    keys = [expected.key for expected in robot.expected]
    for k, expected in enumerate(robot.expected):
        if expected.name:
            continue
        if effect_class(expected.effect) is None:
            yield k, f"unknown effect '{expected.effect}'{nearest(expected.effect, catalogue())}"
        elif keys.index(expected.key) < k:
            yield k, f"parameter '{expected.part}.{expected.symbol}' of effect '{expected.effect}' is expected twice"
        elif expected.effect in declared:
            parameters, name = declared[expected.effect], f"{expected.part}.{expected.symbol}"
            if parameter := parameters.get((expected.effect, "", expected.part, expected.symbol)):
                yield from ((k, wrong) for wrong in [parameter.contradiction(expected)] if wrong)
            else:
                names = [f"{part}.{symbol}" for _, _, part, symbol in parameters]
                yield k, f"effect '{expected.effect}' has no parameter '{name}'{nearest(name, names)}"


def covariance_table(parameters: Sequence[Parameter], covariance: np.ndarray) -> pd.DataFrame:
    """Return the table of the estimates' covariance (SI units), rows and columns named by the parameters."""
    names = [parameter.name for parameter in parameters]
    table = pd.DataFrame(covariance, columns=names)
    table.insert(0, "parameter", names)
    return typed(table, Covariances)
