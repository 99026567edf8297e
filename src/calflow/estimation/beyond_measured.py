"""What a calibrated model errs by where, and when, nothing was measured: curves of joints beyond their travel, wanders later on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from calflow.effects.base import Cause, Effect
from calflow.effects.frame_drift import OF_THE_FRAME
from calflow.estimation.error_model import ErrorModel, SmoothSizes, usual_sizes
from calflow.estimation.fit import Fit
from calflow.estimation.smooth_functions import SIZE, BeyondTravel, InTime, Wander, in_time
from calflow.measurements.measurements import Measurements

# Cosines and sines of k half turns a span, of sizes 1/k, differ as a random walk does: in as long again as was measured by pi times
# their size.
WALK = np.pi


def beyond_measured(errors: ErrorModel, sizes: SmoothSizes) -> ErrorModel:
    """Return an error model with what errs beyond what was measured: a curve by as much as there, a wander as a random walk.

    What a cause says of the device's frame is a wander, too: it is as large as the data tell without that cause, and begins where
    that leaves it. In the measurement the cause says it, and it is none of the robot's.

    Args:
        errors: what the model leaves of rows.
        sizes: those of the smooth errors beside it.
    """
    return _beyond_time(_beyond_travel(errors, sizes.result, sizes.data), sizes)


def _beyond_travel(errors: ErrorModel, result: Fit, data: Measurements) -> ErrorModel:
    model, estimate = result.model, result.estimate
    travels = []
    for cause in (effect for effect in model.effects if isinstance(effect, Cause)):
        if cause.joint and (travel := cause.effect.travel(cause.joint)):
            own = model.columns(cause)
            found, unsure = estimate[own], np.sqrt(np.diag(result.covariance)[own])
            rms, its_sd = (float(ca.evalf(cause.effect.size(ca.SX(one)))) for one in (found, unsure))
            travels.append(BeyondTravel(data.robot, cause.joint - 1, *travel, float(np.hypot(rms, its_sd))))
    sd = usual_sizes(model, travels)
    return errors.with_functions(travels, sd, 0 * sd, sd < 0)


def _beyond_time(errors: ErrorModel, sizes: SmoothSizes) -> ErrorModel:
    result, data = sizes.result, sizes.data
    causes = [effect for effect in result.model.effects if effect.family == OF_THE_FRAME]
    left = _size(errors)
    if not (waves := in_time(data)) or not (left or causes):
        return errors
    walk = _usual(sizes.without(causes)) if causes else left
    if waves[0].clock == "order":
        # It counts anew in each measurement, also for causes: what they say of other rows and what is there are two wanders.
        kept = np.array([not isinstance(one, InTime) for one in errors.function_of], dtype=bool)
        again = walk * (np.sqrt(2) if causes else 1.0) * np.concatenate([one.spectrum for one in waves])
        return errors.only(kept).with_functions(waves, again, 0 * again, again < 0)
    moved = _moved(causes, result, data)
    wander = Wander(data.robot, waves[0].begin, waves[0].end)
    sd = np.concatenate(
        [np.abs(moved), np.full(3, WALK * walk), np.full(3, left * np.hypot.reduce([one.share for one in waves]))]
    )
    mean, shown = np.append(np.sign(moved), np.zeros(6)), np.arange(9) < 3
    return errors.with_functions([wander], sd, mean, shown)


def _size(errors: ErrorModel) -> float:
    """The usual amplitude of the longest wave in time that is left; 0 where none is."""
    of_time = (sd / one.share for one, sd in zip(errors.function_of, errors.sd, strict=True) if isinstance(one, InTime))
    return float(next(of_time, 0.0))


def _usual(sizes: SmoothSizes) -> float:
    """The same of the sizes beside a model."""
    of_time = next(k for k, (_, functions) in enumerate(sizes.kinds) if isinstance(functions[0], InTime))
    return float(np.sqrt(sizes.components.level(sizes.variance) * sizes.variance[of_time]) * SIZE)


def _moved(causes: Sequence[Effect], result: Fit, data: Measurements) -> np.ndarray:
    """By how much causes have moved what a device reports when the measurement ends, on average (3,) [m]."""
    model, still = result.model, result.estimate.copy()
    for cause in causes:
        still[model.columns(cause)] = 0.0
    last = {name: data.table[name].max() for name in ("time", "order") if name in data.table}
    rows = replace(data, table=data.table.assign(**last)).conditions
    return np.asarray((model.position(result.estimate, rows) - model.position(still, rows)).mean(axis=0))
