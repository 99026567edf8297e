"""Joints that do not repeat: errors independent from standstill to standstill, which no input explains.

Play is one where the approach was not recorded. Each joint has a random error at each standstill, whose variance is estimated by
restricted likelihood (see `variance_components`) beside the model and the smooth background. It moves the tool in the joint's
direction and by its moment arm, and all markers together, as neither noise nor an error of the pose as a whole does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.background import BackgroundBasis, components_beside, each_pose, uneven_causes
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Background
from calflow.diagnosis.unexplained import POSE, SUSPECTED, UnexplainedStructure
from calflow.effects.base import UNITS, JointError, Term
from calflow.estimation.accuracy import judged_unit
from calflow.estimation.smooth_functions import SIZE
from calflow.estimation.variance_components import USUAL, VarianceComponents
from calflow.files.words import rounded
from calflow.observations import leading_units
from calflow.robot.mechanism import Row, State

MOST_POSES = 200  # poses that are used
INTERVAL = (0.975, 0.025)


@dataclass(frozen=True)
class Lever(JointError):
    """An error of each joint's angle, to obtain the displacement it causes."""

    id: ClassVar[str] = "lever"
    title: ClassVar[str] = "lever"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the angle."""
        return [Term("angle", self.unit(joint), SIZE, 1.0, ca.SX(1))]


@dataclass(frozen=True, eq=False)
class Standstills:
    """Variance components of the joints' errors at each standstill, beside all other errors that a fitted model leaves.

    components: of the rows of some poses, the joints' parts before the last, which is an error of the pose as a whole; functions
    (n_joints, n, n_poses): the joints' basis functions; reach (n_joints,): change of the measured value by 1 rad, or m, of a joint,
    root mean square, in its leading unit.
    """

    fitted: Fitted
    components: VarianceComponents
    functions: np.ndarray
    reach: np.ndarray

    @staticmethod
    def of(fitted: Fitted, basis: BackgroundBasis) -> Standstills:
        """Return the variance components beside a fitted model; a subset of very many poses."""
        apart, n = replace(fitted, background=None, shared=0.0), fitted.data.robot.n_joints
        stacking, weight = apart.problem.stacking, apart.problem.weight
        whole = apart.regressors([Lever(fitted.data.robot)])
        numbers = np.unique(fitted.poses)
        rows = np.flatnonzero(np.isin(fitted.poses, numbers[:: -(-len(numbers) // MOST_POSES)])[stacking.row])
        pose = np.unique(fitted.poses[stacking.row[rows]], return_inverse=True)[1]
        ways, leading = whole.matrix.times(np.eye(n))[rows], stacking.leading[rows, None]
        shifts = leading * (stacking.place[rows, None] == np.arange(3)) * weight[rows, None]
        functions = [each_pose(SIZE * USUAL**-0.5 * moved, pose) for moved in (*np.split(ways, n, axis=1), shifts)]
        unevenly = [part[rows] for part in uneven_causes(fitted)]
        some = replace(whole, residual=whole.residual[rows], jacobian=whole.jacobian[rows], added_up=None)
        squared = (leading * ways / weight[rows, None]) ** 2
        reach = np.sqrt(squared.sum(axis=0) / len(np.unique(stacking.row[rows])))
        modes, parts = basis.weighed(apart.problem)[rows], (*basis.parts, *unevenly, *functions)
        components = components_beside(some, modes, parts, len(basis.parts))[1]
        return Standstills(apart, components, np.array(functions[:n]), reach)

    @cached_property
    def variance(self) -> np.ndarray:
        """The accepted variances (n_parts,)."""
        return self.components.accepted()

    @property
    def _first(self) -> int:
        """The index of the first joint's part."""
        return len(self.variance) - 1 - len(self.reach)

    @cached_property
    def joints(self) -> np.ndarray:
        """The joints (numbers from 0) whose variance is accepted: they do not repeat."""
        return np.flatnonzero(self.variance[self._first : -1] > 0)

    def unexplained(self, k: int) -> UnexplainedStructure:
        """Return the finding that joint k does not repeat, tested against none, with the joints that could take its place."""
        components, at = self.components, self._first + k
        size, fewer = self.variance[at], np.where(np.arange(len(self.variance)) == at, 0.0, self.variance)

        def costs(other: np.ndarray) -> float:
            return components.cost(components.most_likely(other)) - components.cost(self.variance)

        gain = costs(fewer)
        others = [j for j in range(len(self.reach)) if j not in self.joints]
        instead = [costs(fewer + size * (np.arange(len(fewer)) == self._first + j)) for j in others]
        odds = np.exp(-np.array(instead) / 2)
        rivals = [j for j, odd in zip(others, odds, strict=True) if odd > SUSPECTED * (1 + odds.sum())]
        sd = SIZE * np.sqrt(size / USUAL * components.level_of(components.posterior(self.variance).chi2))
        freedom = components.degrees_of_freedom(self.variance)[at]
        factor, unit = UNITS[self.fitted.data.robot.joints[k].unit]
        low, high = (rounded(factor * end) for end in sd * np.sqrt(freedom / scipy.stats.chi2.ppf(INTERVAL, freedom)))
        seen = judged_unit(leading_units(self.fitted.data))
        moved = f"{rounded(float(seen.shown(sd * self.reach[k])))} {seen.label}"
        detail = f"{rounded(factor * sd)} {unit} ({low} to {high}), which moves what is measured by {moved}"
        p = min(1.0, len(self.reach) * 0.5 * float(scipy.stats.chi2.sf(gain, 1)))
        share = -float(np.expm1(-gain / self.functions.shape[1]))
        return UnexplainedStructure((POSE, *(f"q{j + 1}" for j in (k, *rivals))), p, share, (), detail)

    @property
    def correlation(self) -> Background | None:
        """These joints' errors as a background; None where there are none, or only some poses were used."""
        if not len(self.joints) or self.functions.shape[1] < self.fitted.problem.size:
            return None
        here = self._first + self.joints
        modes, triangle = np.linalg.qr(np.hstack([*self.functions[self.joints]]))
        parts = np.sqrt(self.variance[here])[:, None, None] * np.split(triangle, len(here), axis=1)
        freedom = self.components.degrees_of_freedom(self.variance)[here]
        inputs, tried = tuple((POSE, f"q{k + 1}") for k in self.joints), len(self.reach)
        return Background(inputs, (), modes, tuple(parts), self.fitted.problem.weight, tuple(freedom), 0.0, tried)
