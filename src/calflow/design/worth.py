"""Worth: the reduction of the tool's expected error over the task by single additions to a plan, and by more poses.

All from Jacobians at the nominal robot; nuisance parameters of an addition (the pose of a second station, the position of a second
marker) are marginalised.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calflow.design.optimality import ToolError, information
from calflow.design.planned import SelectionRequest
from calflow.design.search import SHORTLIST, bound_allows, greedy, search_poses, sensitivities
from calflow.files.tables import column
from calflow.files.words import rounded
from calflow.measurements.series import Series, Station
from calflow.model import Model, build
from calflow.observations.position import Position
from calflow.robot.parts import Marker, Named

ASIDE = 0.3  # m: distance of a hypothetical second marker from the first
SECOND = "second"
EXACT = 1e6  # information of a size that counts as known, relative to its prior's
PARAMETERS_NAMED = 3  # largest number of parameters named
LEAST_GAIN = 1.0  # percent: least reduction of a named parameter's standard deviation
LEAST_SHARE = 0.01  # least contribution of a named parameter to the tool's error
FURTHER = 10  # further poses whose gain is reported
MOST_POSES = 1000  # largest number of poses considered


@dataclass(frozen=True, kw_only=True)
class Worth:
    """The expected accuracy of a plan with one addition."""

    addition: str = column("what is added, in words; empty: nothing, the plan as it is")
    n_poses: int = column("number of poses")
    n_points: int = column("number of points that are measured at them")
    expected_sd_mm: float = column(
        "root mean square over the task of the predicted position's standard deviation", "mm"
    )
    gain_mm: float = column("its reduction relative to the plan", "mm")
    gain_percent: float = column("the same, of the plan's", "%")
    parameters: tuple[str, ...] = column(
        "the parameters relevant to the tool whose standard deviations fall most, the largest reduction first"
    )
    falls_percent: tuple[float, ...] = column("reduction of each of these standard deviations", "%")


@dataclass(frozen=True, eq=False)
class PlanInformation:
    """A plan with readings (n, n_joints) and prior information (n_parameters, n_parameters), parameters scaled by their priors.

    own (n, n_units, n_parameters), further (n_further, n_units, n_parameters): whitened Jacobians of its poses, and of those
    that would be measured next, the best first.
    """

    model: Model
    request: SelectionRequest
    readings: np.ndarray
    own: np.ndarray
    prior: np.ndarray
    tool: ToolError
    further: np.ndarray

    @cached_property
    def covariance(self) -> np.ndarray:
        """The posterior covariance with the poses, (n_parameters, n_parameters)."""
        return np.linalg.inv(information(self.own, self.prior))

    @property
    def additions(self) -> Iterator[tuple[str, int, int, np.ndarray]]:
        """Yield each addition in words, the numbers of poses and points with it, and the information; first the plan as it is."""
        n, robot = len(self.readings), self.model.robot
        current = information(self.own, self.prior)
        yield "", n, n, current
        every_other = np.arange(n) % 2 == 1
        for name in robot.payloads:
            if name != self.request.payload:
                loaded = replace(self.request, payload=name).whitened(self.model, self.readings)
                mixed = np.where(every_other[:, None, None], loaded, self.own)
                yield f"payload '{name}' at every other pose", n, n, information(mixed, self.prior)
        others = [name for name in robot.markers if name != self.request.marker]
        for name in others if not self.model.tool_unseen else ():
            seen = replace(self.request, marker=name).whitened(self.model, self.readings)
            yield f"marker '{name}' measured at every pose too", n, 2 * n, information(seen, current)
        if not others and not self.model.tool_unseen:
            words = f"a second marker, {1e3 * ASIDE:.0f} mm beside the first, measured at every pose too"
            yield words, n, 2 * n, current + self._second_marker()
        if isinstance(self.request.planned.observation, Position):
            yield "a second station that measures every pose too", n, 2 * n, current + self._second_station()
        for k, parameter in enumerate(self.model.parameters):
            if parameter.of_size:
                exact = np.diag(EXACT * (np.arange(len(current)) == k))
                yield f"the size of '{parameter.part}' known exactly", n, n, current + exact
        yield "every pose measured twice", n, 2 * n, information(self.own, current)
        if more := len(self.further):
            yield f"{more} further poses", n + more, n + more, information(self.further, current)

    def _second_marker(self) -> np.ndarray:
        """Return the information of a marker not in the robot file, offset along the flange axis with the largest lever."""
        robot, effects = self.model.robot, [effect.id for effect in self.model.effects]
        first = np.array(robot.markers[self.request.marker].point)
        aside = np.where(np.arange(3) == np.argmin(np.abs(first[:2])), ASIDE, 0.0)
        markers = Named({**robot.markers, SECOND: Marker(tuple(first + aside))})
        model = build(replace(robot, markers=markers), effects, self.model.given, self.model.observations)
        return self._marginal_information(model, replace(self.request, marker=SECOND).whitened(model, self.readings))

    def _second_station(self) -> np.ndarray:
        """Return the information of a second device with the same noise at an unknown pose."""
        second = Position.at(Series(station=Station(SECOND)), (0.0,) * 6)
        model = replace(self.model, observations=(*self.model.observations, second))
        conditions = self.request.rows(model, self.readings)
        reported = np.vstack([model.point(model.nominal, conditions).T, np.ones(len(self.readings))])
        jacobian = model.observed_jacobian(second, model.nominal, conditions, reported)
        return self._marginal_information(model, jacobian * model.prior_sd / self.request.planned.sigma)

    def _marginal_information(self, model: Model, whitened: np.ndarray) -> np.ndarray:
        """Return the information of a wider model's Jacobians (n, n_units, n_wider) with its own parameters marginalised."""
        names = [parameter.name for parameter in model.parameters]
        shared = [names.index(parameter.name) for parameter in self.model.parameters]
        separate = np.setdiff1d(np.arange(len(names)), shared)
        flat = whitened.reshape(-1, len(names))
        kept, nuisance = flat[:, shared], flat[:, separate]
        mixed = nuisance.T @ kept
        return kept.T @ kept - mixed.T @ np.linalg.solve(nuisance.T @ nuisance + np.eye(len(separate)), mixed)

    @cached_property
    def worth(self) -> tuple[Worth, ...]:
        """The plan as it is, then with each addition, the most effective first."""
        plain, *rest = (self._row(*addition) for addition in self.additions)
        return (plain, *sorted(rest, key=lambda row: row.expected_sd_mm))

    def _row(self, words: str, poses: int, points: int, known_so_far: np.ndarray) -> Worth:
        before, after = self.covariance, np.linalg.inv(known_so_far)
        had, left = self.tool.loss(before), self.tool.loss(after)
        falls = 100 * (1 - np.sqrt(np.diag(after) / np.diag(before)))
        at_tool = np.sqrt(np.diag(before)) * np.linalg.norm(self.tool.root, axis=1)
        counts = (falls >= LEAST_GAIN) & (at_tool >= LEAST_SHARE * had)
        most = [k for k in np.argsort(-falls, kind="stable") if counts[k]][:PARAMETERS_NAMED]
        return Worth(
            addition=words, n_poses=poses, n_points=points, expected_sd_mm=1e3 * left, gain_mm=1e3 * (had - left),
            gain_percent=100 * (1 - left / had), parameters=tuple(self.model.parameters[k].name for k in most),
            falls_percent=tuple(round(float(falls[k]), 1) for k in most),
        )  # fmt: skip


def worth_words(worth: Sequence[Worth]) -> list[str]:
    """Return in words the two most effective additions; worth: the plan itself first."""
    return [
        f"{row.addition}: the tool's standard deviation is {rounded(row.expected_sd_mm)} mm instead of "
        f"{rounded(worth[0].expected_sd_mm)} ({row.gain_percent:.0f} % less)"
        for row in worth[1:3]
    ]


@dataclass(frozen=True, kw_only=True)
class HowMany:
    """The number of poses: the knee of the curve, the gain by ten more, and the number that meets the tolerance."""

    n_poses: int = column("number of poses chosen")
    expected_sd_mm: float = column(
        "root mean square over the task of the predicted position's standard deviation with them", "mm"
    )
    next_ten_mm: float = column("its reduction by ten more of the candidates", "mm")
    knee_poses: int = column("knee of the curve of `observability.csv`, below which the error rises steeply")
    tolerance_mm: float | None = column("the standard deviation required by the study", "mm", default=None)
    enough_poses: int | None = column(
        "number of poses that meets it; null: no tolerance, or not met with all candidates", default=None
    )
    needed_poses: int | None = column("lower bound: no choice of fewer candidates meets it", default=None)


def next_best(jacobians: np.ndarray, gathered: np.ndarray, chosen: list[int], tool: ToolError) -> np.ndarray:
    """Return ten further candidates, each in turn the one that reduces the tool's error most."""
    promise = sensitivities(jacobians, tool.slope(np.linalg.inv(gathered)))
    promise[chosen] = -np.inf
    near = np.argsort(promise)[len(chosen) :][-SHORTLIST:]
    return np.asarray(near[greedy(jacobians[near], gathered, min(FURTHER, len(near)), tool)])


def knee(numbers: np.ndarray, errors: np.ndarray) -> int:
    """Return the number where a falling curve is furthest below its chord (Satopää et al. 2011)."""
    across = (numbers - numbers[0]) / max(1, numbers[-1] - numbers[0])
    up = (errors - errors[-1]) / max(errors[0] - errors[-1], 1e-300)
    return int(numbers[np.argmax(1 - across - up)])


def poses_for_tolerance(
    jacobians: np.ndarray, prior: np.ndarray, tool: ToolError, tolerance: float, rng: np.random.Generator
) -> tuple[int | None, int | None]:
    """Return the number of poses that meets a tolerance [m], and a lower bound for any choice (`bound_allows`); None: none do."""

    def possible(number: int) -> bool:
        return bound_allows(jacobians, prior, number, tool, tolerance)

    if tool.loss(np.linalg.inv(prior)) <= tolerance:
        return 0, 0
    most = min(MOST_POSES, len(jacobians))
    needed = 1 + bisect_left(range(1, most + 1), True, key=possible)
    chosen = (n for n in range(needed, most + 1) if search_poses(jacobians, prior, n, tool, rng).loss <= tolerance)
    return next(chosen, None), needed if needed <= most else None
