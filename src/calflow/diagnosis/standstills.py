"""Standstills: joints that do not repeat.

Their errors are independent from standstill to standstill, which no input explains: play is one where the approach was not
recorded. Each joint's variance (see `variance_components`), beside the model and the smooth background, moves the tool in the
joint's direction and by its moment arm, and all markers together, as neither noise nor a pose's own error does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from calflow.diagnosis.background import (
    BackgroundBasis,
    components_beside,
    each_pose,
    uneven_causes,
    uneven_or_other_forms,
)
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Background, principal
from calflow.diagnosis.unexplained import POSE, SUSPECTED, UnexplainedStructure
from calflow.effects.cause import Cause
from calflow.effects.wording import UNITS
from calflow.estimation.accuracy import judged_unit
from calflow.estimation.smooth_functions import SIZE, JointField
from calflow.estimation.variance_components import USUAL, VarianceComponents
from calflow.files.words import rounded
from calflow.observations import leading_units

MOST_POSES = 200  # poses at which the errors of standstills are estimated
INTERVAL = (0.975, 0.025)


@dataclass(frozen=True, eq=False)
class Standstills:
    """Variance components of the joints' errors at each standstill, beside all other errors that a fitted model leaves.

    components: of the rows of some poses, the joints' parts before the last of_axes, which are errors of the pose as a whole along,
    or about, each axis of what is reported: a device that is noisier along one scatters like a joint that moves the tool along it.
    functions (n_joints, n, n_poses): the joints' basis functions; reach (n_joints,): change of the measured value by 1 rad, or m,
    of a joint, root mean square, in its leading unit.
    """

    fitted: Fitted
    components: VarianceComponents
    of_axes: int
    functions: np.ndarray
    reach: np.ndarray

    @staticmethod
    def of(fitted: Fitted, basis: BackgroundBasis) -> Standstills:
        """Return the variance components beside a fitted model; a subset of very many poses."""
        apart, n = replace(fitted, background=None, shared=0.0), fitted.data.robot.n_joints
        problem, weight = apart.problem, apart.problem.weight
        whole = apart.regressors([JointField(fitted.data.robot, orders=0)])
        numbers = np.unique(fitted.poses)
        rows = np.flatnonzero(np.isin(fitted.poses, numbers[:: -(-len(numbers) // MOST_POSES)])[problem.row])
        pose = np.unique(fitted.poses[problem.row[rows]], return_inverse=True)[1]
        ways, leading = whole.matrix.times(np.eye(n))[rows], problem.leading[rows, None]
        axes = (problem.place[rows, None] == np.unique(problem.place)) * weight[rows, None]
        moving = np.split(np.hstack([ways, axes]), n + axes.shape[1], axis=1)
        functions = [each_pose(SIZE * USUAL**-0.5 * moved, pose) for moved in moving]
        unevenly = [part[rows] for part in uneven_causes(fitted)]
        some = replace(whole, residual=whole.residual[rows], jacobian=whole.jacobian[rows])
        squared = (leading * ways / weight[rows, None]) ** 2
        reach = np.sqrt(squared.sum(axis=0) / len(np.unique(problem.row[rows])))
        modes = basis.weighed(apart.problem)[rows]
        components = components_beside(some, modes, basis.parts, [*unevenly, *functions])[1]
        return Standstills(apart, components, axes.shape[1], np.array(functions[:n]), reach)

    @cached_property
    def variance(self) -> np.ndarray:
        """The accepted variances (n_parts,)."""
        return self.components.accepted()

    @property
    def _first(self) -> int:
        return len(self.variance) - self.of_axes - len(self.reach)

    @cached_property
    def joints(self) -> np.ndarray:
        """The joints (numbers from 0) whose variance is accepted: they do not repeat."""
        return np.flatnonzero(self.variance[self._first : -self.of_axes] > 0)

    @cached_property
    def gains(self) -> np.ndarray:
        """Twice the log likelihood ratio of these joints' errors (n_joints,), beside accepted errors along axes or all."""
        if not len(self.joints):
            return np.zeros(0)
        components, parts = self.components, np.arange(len(self.variance))
        usual = self.variance[self._first + self.joints].mean()
        axes = np.where(parts >= len(parts) - self.of_axes, usual, 0.0)

        def likeliest(variance: np.ndarray) -> np.ndarray:
            """Return the variances of the least cost that are reached from these, or from these and all axes'."""
            return min(map(components.most_likely, (variance, np.maximum(variance, axes))), key=components.cost)

        whole = likeliest(self.variance)
        without = [likeliest(np.where(parts == self._first + k, 0.0, whole)) for k in self.joints]
        return np.array([components.cost(variance) - components.cost(whole) for variance in without])

    @property
    def p(self) -> np.ndarray:
        """The p-values of these joints' errors (n_joints,), over the choice among all joints."""
        return np.minimum(1.0, len(self.reach) * 0.5 * scipy.stats.chi2.sf(self.gains, 1))

    def at_rest(self, significance: float) -> list[UnexplainedStructure]:
        """Return the findings that joints do not repeat, at a level of significance, the surest first."""
        return [self._unexplained(which) for which in np.argsort(self.p, kind="stable") if self.p[which] < significance]

    def varying(self, fitted: Fitted, alone: Cause | None = None) -> list[np.ndarray]:
        """Return how causes may vary (see `uneven_or_other_forms`), and the errors of the joints that do not repeat."""
        return [*uneven_or_other_forms(fitted, alone), *self.functions[self.joints]]

    def _unexplained(self, which: int) -> UnexplainedStructure:
        """Return the finding that one of these joints does not repeat, with the joints that could take its place."""
        components, k = self.components, self.joints[which]
        at, parts = self._first + k, np.arange(len(self.variance))
        size, without = self.variance[at], np.where(parts == at, 0.0, self.variance)
        others = [j for j in range(len(self.reach)) if j not in self.joints]
        in_its_place = [components.most_likely(without + size * (parts == self._first + j)) for j in others]
        instead = [components.cost(variance) - components.cost(self.variance) for variance in in_its_place]
        odds = np.exp(-np.array(instead) / 2)
        rivals = [j for j, odd in zip(others, odds, strict=True) if odd > SUSPECTED * (1 + odds.sum())]
        sd = SIZE * np.sqrt(size / USUAL * components.level_of(components.posterior(self.variance).chi2))
        freedom = components.degrees_of_freedom(self.variance)[at]
        factor, unit = UNITS[self.fitted.data.robot.joints[k].unit]
        low, high = (rounded(factor * end) for end in sd * np.sqrt(freedom / scipy.stats.chi2.ppf(INTERVAL, freedom)))
        seen = judged_unit(leading_units(self.fitted.data))
        moved = f"{rounded(float(seen.shown(sd * self.reach[k])))} {seen.label}"
        detail = f"{rounded(factor * sd)} {unit} ({low} to {high}), which moves what is measured by {moved}"
        share = -float(np.expm1(-self.gains[which] / self.functions.shape[1]))
        return UnexplainedStructure(
            (POSE, *(f"q{j + 1}" for j in (k, *rivals))), float(self.p[which]), share, (), detail
        )

    @property
    def background(self) -> Background | None:
        """These joints' errors as a background; None where there are none, or only some poses were used."""
        if not len(self.joints) or self.functions.shape[1] < self.fitted.problem.size:
            return None
        here = self._first + self.joints
        modes, triangle = np.linalg.qr(
            np.hstack([*np.sqrt(self.variance[here])[:, None, None] * self.functions[self.joints]])
        )
        inputs = tuple((POSE, f"q{k + 1}") for k in self.joints)
        return Background(inputs, (), principal(modes, [triangle]), self.fitted.problem.weight, 0.0, len(self.reach))
