"""Form errors: what a cause explains in another form than the catalogue's, beyond its own form.

A form is a guess: a compensator hinged elsewhere, or a gear whose stiffness grows otherwise, acts as the catalogue's cause with an
amplitude that varies smoothly with the variable through which it acts. So near rivals are weighed with such variations beside
them, a random share of each one's own effect that is integrated out as the amplitudes are. Else a small misfit of a large cause
would outweigh all doubts about its name.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.linear_model import LinearModel
from calflow.diagnosis.regressors import Regressors, Rows, TallMatrix
from calflow.diagnosis.screening import Score, by_place
from calflow.diagnosis.trial import Detection
from calflow.effects.base import IN_ORDER, Variable
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import MANY
from calflow.estimation.variance_components import HALF_NORMAL, SIZES, directions, explained, log_likelihood
from calflow.measurements.measurements import Measurements
from calflow.model import Model, consecutive, over_rows

SHARE = 0.1  # of a cause's effect: usual standard deviation of its form error
ORDERS = 4  # of the Legendre polynomials of a cause's variable
ORDERS_EACH = 2  # of those of each joint's reading, where a cause has no variable of its own
SHARES, WEIGHTS = SHARE * SIZES, SIZES * HALF_NORMAL / (SIZES @ HALF_NORMAL)  # and their prior: half-normal
MISFIT = 0.1  # share of what the likeliest cause explains that a rival's form error may make up for,
NEAR = 20.0  # and cost above it from which a rival does not matter
MOST = 40  # forms that are weighed so, the likeliest


def farthest(least: float) -> float:
    """Return the cost up to which a rival of the least cost may be as likely, given its form error."""
    return least - MISFIT * least + NEAR


def with_form_errors(finding: Detection[Cause], fitted: Fitted, apart: Regressors[Cause]) -> Detection[Cause]:
    """Return a finding with its near rivals, in each of their forms, weighed with form errors, as is its own cause.

    Only places are compared so: against nothing or an unnamed error the cause counts as it is, and which of its forms it has, and
    of what size it is then, is told by their evidence alone. Form errors bring odds nearer to even, and are no evidence beyond
    that: what else the model lacks looks like a form error, too.
    apart are the regressors of the fitted model without the cause.
    """
    columns = {candidate.cause: candidate.columns for candidate in apart.candidates}
    limit = farthest(min(score.cost for score in finding.scores))
    near = [score for score in finding.scores
            if score.cost < limit and score.cause in columns and score.cause.n_parameters <= MANY][:MOST]  # fmt: skip
    if finding.own not in near:
        return finding
    row = fitted.problem.row
    forms = [_Form(score, columns[score.cause], variations(score.cause, fitted)[row]) for score in near]

    def blocks() -> Iterator[tuple[Rows, np.ndarray]]:
        for rows, x in apart.matrix.blocks():
            yield rows, np.hstack([form.regressors(rows, x) for form in forms])

    width = sum(form.width for form in forms)
    seen = LinearModel(apart.moving(TallMatrix((len(row), width), blocks)))
    information = seen.information(np.arange(width))
    gains = {
        form.score.cause: form.gain(information[span, span], seen.score[span], apart.prior_sd, seen)
        for form, span in zip(forms, consecutive(form.width for form in forms), strict=True)
    }
    place, usual = finding.cause.place, gains[finding.cause]
    weighed = by_place([replace(score, cost=score.cost - gains.get(score.cause, usual)) for score in finding.scores])
    own = finding.cost - weighed[place][0]
    nearer = {
        other: float(np.median([cost, finding.cost, weighed[other][0] + own])) - cost
        for other, (cost, _) in finding.places.items()
    }
    scores = (replace(score, cost=score.cost + nearer[score.cause.place]) for score in finding.scores)
    return replace(finding, scores=tuple(sorted(scores, key=lambda score: score.cost)))


@dataclass(frozen=True, eq=False)
class _Form:
    """A cause's score, the columns of its regressors, and the smooth functions (n, n_variations) by which its effect may vary."""

    score: Score[Cause]
    columns: np.ndarray
    variations: np.ndarray

    @property
    def width(self) -> int:
        return len(self.columns) + self.variations.shape[1]

    def regressors(self, rows: Rows, x: np.ndarray) -> np.ndarray:
        own = x[:, self.columns]
        return np.hstack([own, (own @ self.score.estimate)[:, None] * self.variations[rows]])

    def gain(self, information: np.ndarray, score: np.ndarray, prior_sd: np.ndarray, seen: LinearModel[Cause]) -> float:
        """Return twice the log Bayes factor of its form error, by the information on its regressors and their score."""
        own, error = np.split(np.arange(self.width), [len(self.columns)])
        inverse = np.linalg.inv(information[np.ix_(own, own)] + np.diag(prior_sd[self.columns] ** -2.0))
        mixed = information[np.ix_(error, own)] @ inverse
        shown = information[np.ix_(error, error)] - mixed @ information[np.ix_(own, error)]
        fallen, narrowed = explained(*directions(shown, score[error] - mixed @ score[own]), SHARES)
        chi2 = seen.chi2 - score[own] @ inverse @ score[own]
        return 2 * float(np.log(WEIGHTS @ np.exp(log_likelihood(fallen / chi2, narrowed, seen.degrees_of_freedom))))


def variations(cause: Cause, fitted: Fitted) -> np.ndarray:
    """Return smooth functions (n_rows, n) of what a cause acts through, its form error at a standard deviation of one.

    They are Legendre polynomials of its variable over the measured range, the higher the smaller, or of each joint's reading.
    """
    variable = cause.effect.variable(cause.joint)
    alone = variable is not IN_ORDER or cause.of_measuring()
    inputs = variable_values(fitted.model, variable, fitted.data)[:, None] if alone else fitted.data.joints
    low, span = inputs.min(axis=0), np.ptp(inputs, axis=0)
    scaled = 2 * (inputs - low) / np.where(span > 0, span, 1.0) - 1
    orders = np.arange(1, 1 + (ORDERS if alone else ORDERS_EACH))
    waves = np.polynomial.legendre.legvander(scaled, orders[-1])[:, :, 1:] * np.sqrt(2 * orders + 1) / orders
    functions = waves.reshape(len(inputs), -1)
    return functions / np.sqrt((functions**2).sum(axis=1).mean())


def variable_values(model: Model, variable: Variable, data: Measurements) -> np.ndarray:
    """Return the values of a cause's variable by the nominal robot (n_rows,), in SI units."""
    rigid = Model(model.robot, (), model.given)
    p, c, at = rigid.symbols
    # Not by `figures`: it keeps functions by their code, which is the same for all variables.
    value = ca.Function("variable", [p, c], [ca.densify(variable.value(at.state, at.row))])
    return over_rows(value, rigid.nominal, data.conditions)[0].ravel()
