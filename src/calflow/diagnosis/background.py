"""The background: smooth random errors that a fitted model and its causes leave, correlated between nearby rows.

It is a Gaussian process over all joints' angles together (see `Field`), plus smooth functions of payload, time and images (see
`smooth_functions`), with variances by restricted likelihood (see `variance_components`), in a basis of their principal modes.

A catalogue's forms are approximations: a cause of another form acts as one of the catalogue whose amplitude varies from pose to
pose. With few poses each cause therefore has *uneven* amplitudes beside it, a random effect relative to its size, with a variance
component of its own; without the cause, they stand for an unnamed error that moves the same part.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.form_error import SHARE, variations
from calflow.diagnosis.linear_model import LinearModel
from calflow.diagnosis.regressors import Background, Regressors, TallMatrix, principal
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import MANY
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.residual_field import learnt
from calflow.estimation.smooth_functions import JointField, SmoothFunction, beside_joints, moved_together
from calflow.estimation.variance_components import USUAL, VarianceComponents
from calflow.model import consecutive
from calflow.robot.mechanism import Deflection, Row, State

JOINTS = ("joints",)  # inputs of the field
MODES = 400  # principal modes of all functions together: the others are lost in the noise
ROUNDING = 1e-12  # eigenvalue over the largest, below which it is rounding
FAINT = 1e-4  # singular value of a part's functions over the largest, below which it is lost in the noise as well
FEW_POSES = 32  # up to which uneven amplitudes are used: with more poses they would be another form of the cause
NODES = 150  # poses from which a field's correlation lengths are learnt, at most: time grows with the cube
FEW_AMPLITUDES = 4  # parameters at most of a cause that is not a smooth function itself
# Returns how the effects of a model's causes may vary beside a background (n, …), those of one alone where it is replaced.
Varying = Callable[[Fitted, Cause | None], Sequence[np.ndarray]]
# Steps of the intraclass correlation, from its estimate by the residual alone down to 0.
STEPS = 3


@dataclass(frozen=True)
class Field(SmoothFunction):
    """A shift of the whole arm as a Gaussian process of some joints' angles, with one correlation length per joint [rad or m].

    With several arms it shifts the reported point, since a shift of their common base would not change their relative position. The
    squared exponential kernel is approximated by Fourier features (Rahimi and Recht 2007) at quasi-random frequencies (Owen 1998).
    """

    of: tuple[int, ...]
    lengths: tuple[float, ...]
    n_waves: int = 128  # frequencies, each with cosine and sine

    inputs = ("joints",)

    @property
    def spectrum(self) -> np.ndarray:
        """Equal standard deviations, which make the whole as large as one function at a part's usual variance."""
        return np.full(len(self.declared), (USUAL * self.n_waves) ** -0.5)

    @property
    def units(self) -> Sequence[str]:
        return 6 * self.n_waves * ["m"]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        if len(self.robot.tips) > 1:
            return still
        link = ca.SX(still.link)
        link[:3, 0] = self._shift(p, state.q)
        return replace(still, link=link)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        return point + self._shift(p, row.q) if len(self.robot.tips) > 1 else point

    def _shift(self, p: ca.SX, q: ca.SX) -> ca.SX:
        even = scipy.stats.qmc.Sobol(len(self.of), seed=1).random(self.n_waves)
        angle = ca.DM(scipy.stats.norm.ppf(even) / self.lengths) @ q[list(self.of)]
        return ca.reshape(p, p.numel() // 3, 3).T @ ca.vertcat(ca.cos(angle), ca.sin(angle))


@dataclass(frozen=True, eq=False)
class BackgroundBasis:
    """The basis of a background for the rows of one diagnosis.

    modes (n, n_modes): orthonormal modes of the whitened residuals; kinds: inputs and functions of each part; parts: the basis
    functions of each part in the modes, (n_modes, n_waves), at a decoy's size; weight (n,): whitening factors of the residuals
    for which the modes were computed; sized: cache of variance components, by a model's causes, its intraclass correlation and
    how its causes vary.
    """

    modes: np.ndarray
    kinds: tuple[tuple[tuple[str, ...], list[SmoothFunction]], ...]
    parts: tuple[np.ndarray, ...]
    weight: np.ndarray
    sized: dict[tuple[frozenset[Cause], float, Varying], Sizes] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(fitted: Fitted) -> BackgroundBasis:
        """Return the basis at a fitted model, without inputs on which no residual depends."""
        kinds = [*((JOINTS, [field]) for field in fields(fitted)), *beside_joints(fitted.model, fitted.data)]
        regressors = replace(fitted, background=None, shared=0.0).regressors(
            [effect for _, effects in kinds for effect in effects]
        )
        spectrum = np.concatenate([effect.spectrum for _, effects in kinds for effect in effects])
        scale = regressors.prior_sd * spectrum
        shown = regressors.matrix.products(np.arange(len(scale))) * scale[:, None] * scale
        columns = consecutive(sum(len(effect.declared) for effect in effects) for _, effects in kinds)
        # A wire or a socket has no reported position: errors that depend on it move none of its residuals.
        moving = [k for k, span in enumerate(columns) if shown.diagonal()[span].any()]
        square, axes = np.linalg.eigh(shown)
        kept = np.argsort(-square)[: min(MODES, int(np.count_nonzero(square > ROUNDING * square[-1])))]
        whole = (axes[:, kept] * np.sqrt(square[kept])).T
        # LAPACK's gesdd may fail on nearly dependent functions.
        svds = (scipy.linalg.svd(whole[:, columns[k]], full_matrices=False, lapack_driver="gesvd") for k in moving)
        parts = tuple((left * value)[:, value > FAINT * value[0]] for left, value, _ in svds)
        modes = regressors.matrix.times(scale[:, None] * whole.T / square[kept])
        return BackgroundBasis(modes, tuple(kinds[k] for k in moving), parts, fitted.problem.weight)

    def weighed(self, problem: LeastSquares) -> np.ndarray:
        """Return the modes for the residuals of a problem, with its weights, and decorrelated within standstills."""
        ratio = problem.weight / self.weight
        return problem.decorrelated((ratio / np.median(ratio))[:, None] * self.modes)


def fields(fitted: Fitted) -> list[SmoothFunction]:
    """Return the Gaussian process over joint angles of each group of joints that residuals depend on together.

    One process replaces a sum of functions of single joints and pairs: such a sum can imitate a cause at the price of one
    variance, and true causes were rejected for it. Its correlation lengths maximise the marginal likelihood, with the model's
    parameters integrated out.
    """
    robot, row = fitted.data.robot, fitted.problem.row
    first, pose = np.unique(fitted.poses, return_index=True, return_inverse=True)[1:]
    some = np.unique(np.linspace(0, len(first) - 1, NODES).astype(int))
    # Infinite lengths make a constant shift along each axis: the cosine of zero, while the sine vanishes.
    shift = Field(robot, (0,), (np.inf,), 1)
    regressors = replace(fitted, background=None, shared=0.0).regressors([shift])
    columns = np.column_stack([regressors.residual, regressors.jacobian * regressors.precision**-0.5])
    moved = at_poses(regressors.matrix.times(np.eye(len(shift.declared))[:, ::2]), columns, pose[row])[some]
    together, groups = list[SmoothFunction](), moved_together(fitted.problem, fitted.fit.estimate)
    # A wire between several arms has no position in which a shift would show.
    if not moved.any():
        return [JointField(robot, (i,)) for i in sorted(set().union(*groups))]
    for group in map(sorted, groups):
        nodes, rng = fitted.data.joints[first[some]][:, group], np.random.default_rng(0)
        likeliest = learnt(nodes, moved[:, :, 0], 0.0, rng, moved[:, :, 1:])
        lengths = tuple((likeliest.length * likeliest.range).tolist())
        together.append(Field(robot, tuple(group), lengths))
    return together


def at_poses(shifts: np.ndarray, columns: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return the shifts of poses (n,) that match columns of residuals best, given the slopes (n, 3), (n_poses, 3, n_columns)."""
    seen = np.zeros((pose.max() + 1, 3, 3 + columns.shape[1]))
    np.add.at(seen, pose, shifts[:, :, None] * np.hstack([shifts, columns])[:, None])
    return np.asarray(np.linalg.pinv(seen[:, :, :3], hermitian=True) @ seen[:, :, 3:])


def uneven_causes(fitted: Fitted, alone: Cause | None = None) -> list[np.ndarray]:
    """Return the effects of the causes of few parameters with amplitudes that differ from pose to pose, (n, …) each.

    A part's usual variance makes them a share of the cause's size, and those of the cause alone, which replace it, as large as it.
    """
    poses, pose = np.unique(fitted.poses[fitted.problem.row], return_inverse=True)
    if len(poses) > FEW_POSES:
        return []
    regressors, unevenly = fitted.alone, []
    for cause in fitted.causes:
        columns, value = fitted.own(cause)
        if not 0 < len(columns) <= FEW_AMPLITUDES:
            continue
        unit = regressors.precision[columns] ** -0.5
        size = np.linalg.norm(value / unit) / np.sqrt(len(columns))
        share = USUAL**-0.5 if cause == alone else 1.0
        unevenly.append(each_pose(regressors.jacobian[:, columns] * (unit * size * share), pose))
    return unevenly


def uneven_or_other_forms(fitted: Fitted, alone: Cause | None = None) -> list[np.ndarray]:
    """Return the effects of `uneven_causes`; where there are none, as with more poses, the form errors of the other causes."""
    if unevenly := uneven_causes(fitted, alone):
        return unevenly
    regressors, forms = fitted.alone, []
    for cause in fitted.causes:
        columns, value = fitted.own(cause)
        if cause != alone and 0 < len(columns) <= MANY:
            smooth = variations(cause, fitted)[fitted.problem.row]
            forms.append((regressors.jacobian[:, columns] @ value)[:, None] * smooth * (SHARE * USUAL**-0.5))
    return forms


def each_pose(functions: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return functions (n, n_functions) with separate amplitudes at each pose (n,), as columns (n, n_functions n_poses)."""
    apart = np.zeros((*functions.shape, pose.max() + 1))
    apart[np.arange(len(pose)), :, pose] = functions
    return apart.reshape(len(pose), -1)


def beside_background(fitted: Fitted, basis: BackgroundBasis) -> Fitted:
    """Return a model with the likeliest intraclass correlation beside a background; else that also holds its smooth errors."""
    alone = replace(fitted, shared=None).intraclass
    best = replace(fitted, background=None, shared=alone)
    if not alone:
        return best
    freedom, named = Sizes.beside(best, basis).components.total, _named_in(fitted)
    cost = Sizes.beside(best, basis).likeliest(freedom, named)
    for shared in 1 - (1 - alone) ** (1 - np.arange(1, STEPS + 1) / STEPS):
        more = replace(best, shared=float(shared))
        if (less := Sizes.beside(more, basis).likeliest(freedom, named)) > cost:
            break
        best, cost = more, less
    return best


def _named_in(fitted: Fitted) -> list[str]:
    return [name for cause in fitted.causes for name in cause.effect.named_in()]


def background(fitted: Fitted, basis: BackgroundBasis, without: Collection[str] = ()) -> Background | None:
    """Return the smooth background that a fitted model leaves, without some inputs; None where the data show none.

    It has no part of an input of which one of the causes, or its family, is a general smooth function, nor uneven amplitudes:
    tests beside these would ask whether a cause acts alike at all poses.
    """
    sizes = Sizes.beside(fitted, basis)
    variance = sizes.accepted([*_named_in(fitted), *without])
    variance[len(basis.parts) :] = 0.0
    return sizes.background(variance) if variance.any() else None


def components_beside(
    regressors: Regressors[Cause], modes: np.ndarray, smooth: Sequence[np.ndarray], others: Sequence[np.ndarray]
) -> tuple[LinearModel[Cause], VarianceComponents]:
    """Return a linearised model and the variance components beside it, of smooth parts in modes and of others."""
    held = TallMatrix.held(np.hstack([modes, *others]))
    seen = LinearModel(regressors.moving(held))
    shown = seen.information(np.arange(held.shape[1]))
    # Smooth parts are given in modes; the others, which have many columns but few poses, enter by their products as they are.
    n, waves = modes.shape[1], np.hstack(smooth)
    both = waves.T @ shown[:n, n:]
    number = [functions.shape[1] for functions in (*smooth, *others)]
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

    Its parts are those of the basis, in modes (n, n_modes) of the problem's residuals, then the uneven amplitudes of each cause.
    narrowed is the log-determinant term of integrating out the model's parameters.
    """

    basis: BackgroundBasis
    problem: LeastSquares
    modes: np.ndarray
    narrowed: float
    components: VarianceComponents

    @staticmethod
    def beside(fitted: Fitted, basis: BackgroundBasis, varying: Varying = uneven_causes) -> Sizes:
        """Return the components beside a fitted model, whose parameters are integrated out; cached by model."""
        state = frozenset(fitted.causes), fitted.intraclass, varying
        if state not in basis.sized:
            basis.sized[state] = Sizes.of(fitted.alone, basis, fitted.problem, varying(fitted, None))
        return basis.sized[state]

    @staticmethod
    def of(
        regressors: Regressors[Cause],
        basis: BackgroundBasis,
        problem: LeastSquares,
        unevenly: Sequence[np.ndarray] = (),
    ) -> Sizes:
        """Return the components beside linearised parameters, which are integrated out; unevenly as of `uneven_causes`."""
        modes = basis.weighed(problem)
        seen, components = components_beside(regressors, modes, basis.parts, unevenly)
        return Sizes(basis, problem, modes, seen.narrowed, components)

    def accepted(self, without: Collection[str] = ()) -> np.ndarray:
        """Return the accepted variances (n_parts,), zero for some inputs (see `VarianceComponents.accepted`)."""
        left_out = [k for k, (inputs, _) in enumerate(self.basis.kinds) if set(inputs) & set(without)]
        return self.components.accepted(left_out) if left_out else self._accepted

    @cached_property
    def _accepted(self) -> np.ndarray:
        return self.components.accepted()

    def background(self, variance: np.ndarray) -> Background:
        """Return the background with these variances (n_parts,), without parts of zero variance."""
        kept = np.flatnonzero(variance > 0)
        return Background(
            tuple(self.basis.kinds[k][0] for k in kept),
            tuple(function for k in kept for function in self.basis.kinds[k][1]),
            principal(self.modes, [self.basis.parts[k] * np.sqrt(variance[k]) for k in kept]),
            self.problem.weight,
            self.components.cost(np.zeros(len(variance))) - self.components.cost(variance),
            len(variance),
        )

    def likeliest(self, freedom: float, without: Collection[str]) -> float:
        """Return the evidence with the accepted variances, zero for some inputs."""
        return self.evidence(self.accepted(without), freedom)

    def evidence(self, variance: np.ndarray, freedom: float) -> float:
        """Return minus twice the log marginal likelihood, the model's parameters integrated out, for comparison between models.

        freedom are the residual degrees of freedom of the smallest of the models compared (see `log_likelihood`).
        """
        posterior = self.components.posterior(variance)
        shared = self.problem.log_determinant
        return freedom * float(np.log(posterior.chi2)) + posterior.log_determinant + self.narrowed + shared
