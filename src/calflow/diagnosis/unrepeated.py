"""Joints that do not repeat: they err at each standstill otherwise, in no way that any input explains.

Play does so where nobody recorded from which side the joint came. Such errors are random functions, one of each joint at each
standstill, of sizes by restricted likelihood (see `variance_components`) beside the model and what is smooth. They move the tool
along the joint's ways and by its reach, which noise does not, and all markers alike, and what a pose errs by as a whole does not.
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
from calflow.diagnosis.misfit import POSE, SUSPECTED, Remainder
from calflow.diagnosis.regressors import Background
from calflow.effects.base import UNITS, JointError, Term
from calflow.estimation.accuracy import judged_unit
from calflow.estimation.smooth_functions import SIZE
from calflow.estimation.variance_components import USUAL, VarianceComponents
from calflow.files.words import rounded
from calflow.observations import leading_units
from calflow.robot.mechanism import Row, State

MOST_POSES = 200  # that are looked at
INTERVAL = (0.975, 0.025)


@dataclass(frozen=True)
class Lever(JointError):
    """A turn of each joint by an angle of its own: how far a joint's error moves the tool."""

    id: ClassVar[str] = "lever"
    title: ClassVar[str] = "lever"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the angle."""
        return [Term("angle", self.unit(joint), SIZE, 1.0, ca.SX(1))]


@dataclass(frozen=True, eq=False)
class Standstills:
    """What joints err by at each standstill, sized beside all else that a fitted model leaves.

    components are of the rows of some poses, the parts of joints last but for what a pose errs by as a whole; functions
    (n_joints, n, n_poses) are those of joints, reach (n_joints,) is by how much 1 rad, or m, of each changes what is measured, in
    its leading unit.
    """

    fitted: Fitted
    components: VarianceComponents
    functions: np.ndarray
    reach: np.ndarray

    @staticmethod
    def of(fitted: Fitted, basis: BackgroundBasis) -> Standstills:
        """Work out the functions; of very many poses, at some of them."""
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
        """The sizes that are believed, (n_parts,)."""
        return self.components.believed()

    @property
    def _first(self) -> int:
        """The number of the first joint's part."""
        return len(self.variance) - 1 - len(self.reach)

    @cached_property
    def joints(self) -> np.ndarray:
        """The joints (their numbers, from 0) that are believed not to repeat."""
        return np.flatnonzero(self.variance[self._first : -1] > 0)

    def remainder(self, k: int) -> Remainder:
        """Weigh such a joint against none, and against each other in its place."""
        components, at = self.components, self._first + k
        size, fewer = self.variance[at], np.where(np.arange(len(self.variance)) == at, 0.0, self.variance)

        def costs(other: np.ndarray) -> float:
            return components.cost(components.most_likely(other)) - components.cost(self.variance)

        gain = costs(fewer)
        others = [j for j in range(len(self.reach)) if j not in self.joints]
        instead = [costs(fewer + size * (np.arange(len(fewer)) == self._first + j)) for j in others]
        odds = np.exp(-np.array(instead) / 2)
        rivals = [j for j, odd in zip(others, odds, strict=True) if odd > SUSPECTED * (1 + odds.sum())]
        sd = SIZE * np.sqrt(size / USUAL * components.level_of(components.beside(self.variance).chi2))
        freedom = components.degrees_of_freedom(self.variance)[at]
        factor, unit = UNITS[self.fitted.data.robot.joints[k].unit]
        low, high = (rounded(factor * end) for end in sd * np.sqrt(freedom / scipy.stats.chi2.ppf(INTERVAL, freedom)))
        seen = judged_unit(leading_units(self.fitted.data))
        moved = f"{rounded(float(seen.shown(sd * self.reach[k])))} {seen.label}"
        detail = f"{rounded(factor * sd)} {unit} ({low} to {high}), which moves what is measured by {moved}"
        p = min(1.0, len(self.reach) * 0.5 * float(scipy.stats.chi2.sf(gain, 1)))
        share = -float(np.expm1(-gain / self.functions.shape[1]))
        return Remainder((POSE, *(f"q{j + 1}" for j in (k, *rivals))), p, share, (), detail)

    @property
    def correlation(self) -> Background | None:
        """What these joints err by as a background; none where it is that of some poses alone."""
        if not len(self.joints) or self.functions.shape[1] < self.fitted.problem.size:
            return None
        here = self._first + self.joints
        modes, triangle = np.linalg.qr(np.hstack([*self.functions[self.joints]]))
        parts = np.sqrt(self.variance[here])[:, None, None] * np.split(triangle, len(here), axis=1)
        freedom = self.components.degrees_of_freedom(self.variance)[here]
        inputs, tried = tuple((POSE, f"q{k + 1}") for k in self.joints), len(self.reach)
        return Background(inputs, (), modes, tuple(parts), self.fitted.problem.weight, tuple(freedom), 0.0, tried)
