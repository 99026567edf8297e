"""The background: what rows near each other share, beside a fitted model and its causes.

It is a random smooth function of all joints' angles together (see `Field`), and such functions of payload, time and images
(see `smooth_functions`), as large as the data tell (see `variance_components`), along the modes in which all of them together are
largest.

A catalogue's forms are guesses: a cause of another form moves the robot as a cause of the catalogue would whose amplitude is
another one at each pose. So of few poses each cause has such *uneven* amplitudes beside it, a share of its own, as large as the
data tell; alone, they are what nobody can name that moves the same part.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Background, Held, Regressors
from calflow.diagnosis.screening import Screening
from calflow.effects.base import Cause
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.residual_field import learnt
from calflow.estimation.smooth_functions import Field, JointField, SmoothFunction, beside_joints, moved_together
from calflow.estimation.variance_components import USUAL, VarianceComponents

MODES = 400  # directions in which all functions together are largest: the rest is lost in the noise
NOTHING = 1e-12  # of the square of the largest: what is less is rounding
FAINT = 1e-4  # of the largest of a part's functions: smaller ones, turned to be apart, are lost in the noise as well
FEW_POSES = 32  # up to which amplitudes may differ from pose to pose: of more these would be another form of the cause
NODES = 150  # poses by which a field's lengths are learnt, at most: time grows with the cube
FEW_AMPLITUDES = 4  # of a cause that is no smooth function itself


@dataclass(frozen=True, eq=False)
class BackgroundBasis:
    """What a background may be made of, for the rows of one diagnosis: modes (n, n_modes), orthonormal over the noise.

    kinds are inputs and functions of each part, parts hold these in the modes, (n_modes, n_waves), of a decoy's size. weight (n,)
    is what the rows' residuals were multiplied by when they were worked out. sized are the backgrounds that were sized beside a
    model, by its causes and the correlation of what markers of a standstill err.
    """

    modes: np.ndarray
    kinds: tuple[tuple[tuple[str, ...], list[SmoothFunction]], ...]
    parts: tuple[np.ndarray, ...]
    weight: np.ndarray
    sized: dict[tuple[frozenset[Cause], float], Sizes] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(fitted: Fitted) -> BackgroundBasis:
        """Work out all functions at a fitted model, without inputs on which nothing here depends."""
        kinds = [*((("joints",), [field]) for field in fields(fitted)), *beside_joints(fitted.data)]
        regressors = replace(fitted, background=None, shared=0.0).regressors(
            [effect for _, effects in kinds for effect in effects]
        )
        spectrum = np.concatenate([effect.spectrum for _, effects in kinds for effect in effects])
        scale = regressors.prior_sd * spectrum
        shown = regressors.matrix.products(np.arange(len(scale))) * scale[:, None] * scale
        ends = np.cumsum([0, *(sum(len(effect.declared) for effect in effects) for _, effects in kinds)])
        spans = [slice(i, j) for i, j in pairwise(ends)]
        # A wire, or a socket, asks for no place that a device would report: what errs with that place moves nothing here.
        moving = [k for k, span in enumerate(spans) if shown.diagonal()[span].any()]
        root = _root(shown)
        square, axes = np.linalg.eigh(root.T @ root)
        kept = np.argsort(-square)[: min(MODES, int(np.count_nonzero(square > NOTHING * square[-1])))]
        whole = (root @ axes[:, kept]).T
        parts = tuple(_few(whole[:, spans[k]]) for k in moving)
        modes = regressors.matrix.times(scale[:, None] * whole.T / square[kept])
        return BackgroundBasis(modes, tuple(kinds[k] for k in moving), parts, fitted.problem.weight)

    def weighed(self, problem: LeastSquares) -> np.ndarray:
        """Return the modes of the residuals of a problem, which has weights of its own, and what rows of a standstill share."""
        ratio = problem.weight / self.weight
        return problem.decorrelated((ratio / np.median(ratio))[:, None] * self.modes)


def fields(fitted: Fitted) -> list[SmoothFunction]:
    """Return what a fitted model may leave by all angles together of joints that a residual depends on, each group's.

    One process takes the place of functions of each joint, and of two: a sum of so many explains a cause in another form at the
    cost of one size, and true causes gave way to it. Over which lengths it is alike is the likeliest beside the model's own
    parameters.
    """
    robot, row = fitted.data.robot, fitted.problem.stacking.row
    first, pose = np.unique(fitted.poses, return_index=True, return_inverse=True)[1:]
    some = np.unique(np.linspace(0, len(first) - 1, NODES).astype(int))
    # The same everywhere: a cosine, and a sine of nothing, along each axis.
    shift = Field(robot, (0,), (np.inf,), 1)
    regressors = replace(fitted, background=None, shared=0.0).regressors([shift])
    columns = np.column_stack([regressors.residual, regressors.jacobian * regressors.precision**-0.5])
    moved = at_poses(regressors.matrix.times(np.eye(len(shift.declared))[:, ::2]), columns, pose[row])[some]
    together, groups = list[SmoothFunction](), moved_together(fitted.problem, fitted.fit.estimate)
    # Of several arms, a wire between them asks for no place that a shift would show in.
    if not moved.any():
        return [JointField(robot, (i,)) for i in sorted(set().union(*groups))]
    for group in map(sorted, groups):
        nodes, rng = fitted.data.joints[first[some]][:, group], np.random.default_rng(0)
        likeliest = learnt(nodes, moved[:, :, 0], 0.0, 0.0, rng, moved[:, :, 1:])
        lengths = tuple((likeliest.length * likeliest.range).tolist())
        together.append(Field(robot, tuple(group), lengths))
    return together


def at_poses(shifts: np.ndarray, columns: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return the shifts of poses that are most like columns (n, n_columns) in the residuals, (n_poses, 3, n_columns).

    shifts (n, 3) are what the residuals do by shifts along three axes; residuals are numbered by pose (n,).
    """
    seen = np.zeros((pose.max() + 1, 3, 3 + columns.shape[1]))
    np.add.at(seen, pose, shifts[:, :, None] * np.hstack([shifts, columns])[:, None])
    return np.asarray(np.linalg.pinv(seen[:, :, :3], hermitian=True) @ seen[:, :, 3:])


def uneven_causes(fitted: Fitted, alone: Cause | None = None) -> list[np.ndarray]:
    """Return what a fitted model's causes of few parameters do whose values are others at each pose, (n, …) each.

    They are as large as the cause, that they are a share of; one of them may be alone, without the cause. Of more than FEW_POSES
    there are none.
    """
    poses, pose = np.unique(fitted.poses[fitted.problem.stacking.row], return_inverse=True)
    if len(poses) > FEW_POSES:
        return []
    free = np.flatnonzero(~fitted.fit.at_bound)
    regressors, value, unevenly = fitted.alone, fitted.fit.estimate[free], []
    for cause in fitted.causes:
        columns = np.flatnonzero(np.isin(free, fitted.model.columns(cause)))
        if not 0 < len(columns) <= FEW_AMPLITUDES:
            continue
        unit = regressors.precision[columns] ** -0.5
        size = np.linalg.norm(value[columns] / unit) / np.sqrt(len(columns))
        share = USUAL**-0.5 if cause == alone else 1.0
        unevenly.append(each_pose(regressors.jacobian[:, columns] * (unit * size * share), pose))
    return unevenly


def each_pose(functions: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return functions (n, n_functions) that are others at each pose, by which rows are numbered (n,), side by side."""
    apart = np.zeros((*functions.shape, pose.max() + 1))
    apart[np.arange(len(pose)), :, pose] = functions
    return apart.reshape(len(pose), -1)


# By which what rows of a standstill have in common counts more, from what the residual alone says to all of it.
STEPS = 3


def beside_background(fitted: Fitted, basis: BackgroundBasis) -> Fitted:
    """Return a fitted model, what rows of a standstill have in common counted as is likeliest beside a background.

    The residual alone takes for an error of the pose what is smooth from pose to pose.
    """
    alone = replace(fitted, shared=None).intraclass
    best = replace(fitted, background=None, shared=alone)
    if not alone:
        return best
    freedom = Sizes.beside(best, basis).components.total
    cost = _cost(best, basis, freedom)
    for shared in 1 - (1 - alone) ** (1 - np.arange(1, STEPS + 1) / STEPS):
        more = replace(best, shared=float(shared))
        if (less := _cost(more, basis, freedom)) > cost:
            break
        best, cost = more, less
    return best


def _cost(fitted: Fitted, basis: BackgroundBasis, freedom: float) -> float:
    sizes = Sizes.beside(fitted, basis)
    return sizes.evidence(sizes.believed(_named_in(fitted)), freedom)


def _named_in(fitted: Fitted) -> list[str]:
    """Inputs of which one of its causes, or of its family, is any smooth function."""
    return [name for cause in fitted.causes for name in cause.effect.named_in()]


def _root(products: np.ndarray) -> np.ndarray:
    """Return a matrix (n, rank) whose product with its own transpose are these (n, n): no more columns than there are residuals."""
    factor, order, rank, _ = scipy.linalg.lapack.dpstrf(products, lower=1, tol=NOTHING * products.diagonal().max())
    root = np.zeros((len(products), rank))
    root[order - 1] = np.tril(factor)[:, :rank]
    return root


def _few(waves: np.ndarray) -> np.ndarray:
    """Return fewer functions (n_modes, …) of the same covariance as these (n_modes, n_waves)."""
    # By the smaller of both products: of waves that are nearly dependent LAPACK's gesdd may find no singular values.
    fewer_modes = len(waves) < waves.shape[1]
    square, axes = np.linalg.eigh(waves @ waves.T if fewer_modes else waves.T @ waves)
    kept = square > FAINT**2 * square[-1]
    return np.asarray(axes[:, kept] * np.sqrt(square[kept]) if fewer_modes else waves @ axes[:, kept])


def background(fitted: Fitted, basis: BackgroundBasis) -> Background | None:
    """Return the smooth background that a fitted model leaves; none where the data show none.

    Along an input of which one of its causes, or of its family, is any smooth function there is none: that is its name. What causes
    do unevenly is not in it either: tests beside that would ask whether a cause acts everywhere alike.
    """
    sizes = Sizes.beside(fitted, basis)
    variance = sizes.believed(_named_in(fitted))
    variance[len(basis.parts) :] = 0.0
    return sizes.background(variance) if variance.any() else None


def components_beside(
    regressors: Regressors[Cause], modes: np.ndarray, parts: Sequence[np.ndarray], smooth: int
) -> tuple[Screening[Cause], VarianceComponents]:
    """Return the components beside a linearised model, and what it leaves; smooth: how many parts, the first, are along modes."""
    held = Held(np.hstack([modes, *parts[smooth:]]))
    seen = Screening(replace(regressors, candidates=()).moving(held))
    shown = seen.information(np.arange(held.shape[1]))
    # Only smooth parts are along modes: products of the others, which are far more columns of few poses, stay as they are.
    n, waves = modes.shape[1], np.hstack(parts[:smooth])
    both = waves.T @ shown[:n, n:]
    number = [functions.shape[1] for functions in parts]
    components = VarianceComponents(
        np.repeat(np.arange(len(number)), number),
        len(number),
        np.block([[waves.T @ (shown[:n, :n] @ waves), both], [both.T, shown[n:, n:]]]),
        np.concatenate([waves.T @ seen.score[:n], seen.score[n:]]),
        seen.chi2,
        seen.degrees_of_freedom,
    )
    return seen, components


@dataclass(frozen=True, eq=False)
class Sizes:
    """A background's variance components beside a linearised model.

    Its parts are those of the basis, along its modes (n, n_modes) of the problem's residuals, and after them what each cause does
    unevenly. narrowed is what the model's own parameters cost.
    """

    basis: BackgroundBasis
    problem: LeastSquares
    modes: np.ndarray
    narrowed: float
    components: VarianceComponents

    @staticmethod
    def beside(fitted: Fitted, basis: BackgroundBasis) -> Sizes:
        """Take a fitted model's own parameters out of the modes; once for each model."""
        state = frozenset(fitted.causes), fitted.intraclass
        if state not in basis.sized:
            basis.sized[state] = Sizes.of(fitted.alone, basis, fitted.problem, uneven_causes(fitted))
        return basis.sized[state]

    @staticmethod
    def of(
        regressors: Regressors[Cause],
        basis: BackgroundBasis,
        problem: LeastSquares,
        unevenly: Sequence[np.ndarray] = (),
    ) -> Sizes:
        """Take the model's own parameters out of the modes, and of what causes do unevenly, (n, …) each."""
        modes = basis.weighed(problem)
        seen, components = components_beside(regressors, modes, (*basis.parts, *unevenly), len(basis.parts))
        return Sizes(basis, problem, modes, seen.narrowed, components)

    def believed(self, without: Collection[str] = ()) -> np.ndarray:
        """Return the variances (n_parts,) that are believed, parts of some inputs left out."""
        left_out = np.zeros(self.components.n_parts, dtype=bool)
        left_out[: len(self.basis.kinds)] = [bool(set(inputs) & set(without)) for inputs, _ in self.basis.kinds]
        return self.components.believed(left_out) if left_out.any() else self._believed

    @cached_property
    def _believed(self) -> np.ndarray:
        return self.components.believed()

    def background(self, variance: np.ndarray) -> Background:
        """Return the background of these variances (n_parts,) of smooth functions, without parts that have none."""
        kept = np.flatnonzero(variance > 0)
        return Background(
            tuple(self.basis.kinds[k][0] for k in kept),
            tuple(function for k in kept for function in self.basis.kinds[k][1]),
            self.modes,
            tuple(self.basis.parts[k] * np.sqrt(variance[k]) for k in kept),
            self.problem.weight,
            tuple(map(float, self.components.degrees_of_freedom(variance)[kept])),
            self.components.cost(np.zeros(len(variance))) - self.components.cost(variance),
            len(variance),
        )

    def evidence(self, variance: np.ndarray, freedom: float) -> float:
        """Twice minus the logarithm of the likelihood, to be compared with models of other parameters.

        The model's own parameters are integrated out as the functions' amplitudes are. freedom are the degrees of freedom of what
        the least of the models leaves (see `log_likelihood`).
        """
        beside = self.components.beside(variance)
        shared = self.problem.log_determinant
        return freedom * float(np.log(beside.chi2)) + beside.log_determinant + self.narrowed + shared
