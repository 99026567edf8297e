"""Causes hidden in data of the industrial robot, for the tests of what finds them."""

from __future__ import annotations

import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.fit import fit_reweighted
from calflow.model import Model, build
from estimation.data import measured, stated
from robots import industrial


def cause(name, part, **variant):
    """One cause on the industrial robot."""
    return Cause(robot := industrial(), catalogue()[name](robot, **variant), part)


def start(data):
    """Geometry alone, fitted."""
    model = build(data.robot, ("geometry",))
    fit, noise, lack, _ = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")
    return Fitted(fit, data, noise, lack, noise)


def hidden(values, poses=80, seed=4):
    """Poses of a robot with causes of these sizes."""
    robot = industrial()
    model = Model(robot, (*build(robot, ("geometry",)).effects, *(cause for cause, _ in values)))
    sizes = [size for _, value in values for size in value]
    truth = np.concatenate([np.zeros(len(model.parameters) - len(sizes)), sizes])
    return measured(model, truth, poses, np.random.default_rng(seed))
