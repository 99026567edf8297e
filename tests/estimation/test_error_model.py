"""Smooth errors beside a fit: as sure as generalised least squares, and promises that grow away from what was measured."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import calflow as cf
from calflow.deployment.prediction import predict_rows
from calflow.effects.cause import Cause
from calflow.effects.frame_drift import FrameDrift
from calflow.effects.frame_step import FrameStep
from calflow.effects.joint_error_map import JointErrorMap
from calflow.effects.thermal_growth import ThermalGrowth
from calflow.estimation.calibrated_model import CalibratedModel, SeriesNoise
from calflow.estimation.error_model import (
    ErrorModel,
    SmoothVariances,
    beside_smooth_errors,
    error_table,
    read_errors,
    root_of,
)
from calflow.estimation.extrapolation import DEPENDS, Elsewhere, beyond_measured
from calflow.estimation.fit import Fit, fit_reweighted
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.model_tables import FUNCTIONS
from calflow.estimation.needed_conditions import needed_conditions
from calflow.estimation.noise import PerUnit
from calflow.estimation.smooth_functions import AlongSlides, InPlace, JointField, Shift, is_mean
from calflow.files.problems import InputError
from calflow.files.units import METRE
from calflow.model import build
from calflow.robot.parts import Expected
from estimation.data import POSES, SIGMA, measured, stated, variance, wavering
from robots import industrial, robot


def continued(errors, result, data):
    """Continue an error model beyond the measurement, with the variances that the data let one expect."""
    sizes = SmoothVariances.of(result, data, True)
    return beyond_measured(errors, sizes, sizes.variance)


def fitted(data):
    """The geometry fitted to rows of stated noise, without smooth errors beside it and with them."""
    model = build(data.robot, ("geometry",), data.given)
    result = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")[0]
    sizes = SmoothVariances.of(result, data, True)
    return (result, *beside_smooth_errors(sizes, sizes.variance, PerUnit()))


def dense(result, errors, rows):
    """Derivatives (3 n, n_parameters) of what a device reports of rows, and what each function of its size does."""
    beside = replace(result.model, probes=errors.functions)
    n = len(result.estimate)
    jacobian = beside.position_jacobian(np.append(result.estimate, beside.nominal[n:]), rows.conditions)
    jacobian = jacobian.reshape(-1, jacobian.shape[2])
    return jacobian[:, :n], jacobian[:, n:] * errors.sd


def test_parameters_are_as_sure_as_by_the_whole_covariance():
    """Fails if errors that rows share are forgotten, or the covariance or the offset is not that of generalised least squares."""
    data = wavering(1)
    before, result, errors = fitted(data)
    assert (result.estimate == before.estimate).all()
    jacobian, functions = dense(result, errors, data)
    whole = (errors.rest[METRE] ** 2 + SIGMA**2) * np.eye(len(jacobian)) + functions @ functions.T
    precision = np.diag(result.model.prior_sd**-2.0)
    covariance = np.linalg.inv(jacobian.T @ np.linalg.solve(whole, jacobian) + precision)
    left = (result.model.position(result.estimate, data.conditions) - data.position).ravel()
    pull = precision @ (result.estimate - result.model.prior_mean)
    offset = -covariance @ (jacobian.T @ np.linalg.solve(whole, left) + pull)
    assert errors.offset == pytest.approx(offset, rel=1e-2, abs=1e-2 * np.sqrt(np.diag(covariance)).min())
    sd = np.sqrt(np.diag(covariance) + offset**2)
    assert np.sqrt(np.diag(result.covariance)) == pytest.approx(sd, rel=1e-2)


def test_a_promise_is_of_parameters_and_functions_given_the_data():
    """Fails if a prediction's mean square error is not that of both together, as all rows tell them."""
    data, new = wavering(2), wavering(3)
    _, result, errors = fitted(data)
    (jacobian, functions), (slopes, moved) = (dense(result, errors, rows) for rows in (data, new))
    both, there = np.hstack([jacobian, functions]), np.hstack([slopes, moved])
    prior = np.diag(np.append(result.model.prior_sd**-2.0, np.ones(len(errors.sd))))
    noise = errors.rest[METRE] ** 2 + SIGMA**2
    covariance = np.linalg.inv(both.T @ both / noise + prior)
    inside = new.table["time"].between(data.table["time"].min(), data.table["time"].max()).to_numpy()
    off = slopes @ errors.offset + moved @ errors.mean
    expected = np.einsum("ni,ij,nj->n", there, covariance, there) + errors.rest[METRE] ** 2 + off**2
    given = variance(errors, result.model, result.estimate, result.covariance, new.conditions)
    assert given[inside] == pytest.approx(expected.reshape(-1, 3)[inside], rel=0.05)


def test_errors_lie_within_the_promise_where_nothing_was_measured():
    """Fails if a model that lacks something smooth is promised to be as good elsewhere as where it was fitted."""
    inside, ratio = [], []
    for seed in range(4):
        whole = wavering(10 + seed)
        first = whole.joints[:, 0]
        here = first < np.quantile(first, 0.5)
        _, result, errors = fitted(whole.only(here))
        there = whole.only(~here)
        at = result.model, result.estimate, result.covariance
        off = result.model.point(result.estimate, there.conditions) - there.position
        inside.append(np.abs(off) < 1.96 * np.sqrt(variance(errors, *at, there.conditions) + SIGMA**2))
        unknown = replace(errors, mean=0 * errors.mean, offset=0 * errors.offset)
        near, far = (variance(unknown, *at, rows.conditions).mean() for rows in (whole.only(here), there))
        ratio.append(far / near)
    assert np.mean(inside) > 0.85
    assert np.mean(ratio) > 3


def test_noise_is_taken_for_noise():
    """Fails if a clean fit is changed by smooth errors that nobody can see."""
    changed = 0
    for seed in range(6):
        robot, rng = industrial(), np.random.default_rng(seed)
        model = build(robot, ("geometry",))
        _, _, errors = fitted(measured(model, model.nominal, POSES, rng))
        changed += bool(errors.functions)
    assert changed <= 2


def walking(seed):
    """A device that walks at random while poses are measured, and what it has walked by (3,) when they are."""
    data = wavering(seed, 0.0)
    steps = np.random.default_rng(seed).standard_normal((POSES, 3)).cumsum(axis=0)
    walk = 1e-4 * (steps - steps[0]) / steps.std()
    data.table[["x", "y", "z"]] += walk
    return data, walk[-1]


def promised(errors, result, data, seconds):
    """The standard deviation per axis (3,) so long after the measurement, as `predict` works it out."""
    noise = (SeriesNoise(SIGMA, "file", SIGMA),)
    known = CalibratedModel(
        result.model, result.estimate, result.covariance, result.at_bound, noise, PerUnit(), "linear", errors
    )
    known = replace(known, needed=needed_conditions(result.model, result.estimate, data))
    rows = replace(data, table=data.table.assign(time=data.table["time"].max() + seconds))
    return np.sqrt((predict_rows(known, rows).sd ** 2).mean(axis=0))


def test_a_day_later_a_wander_has_gone_on():
    """Fails if a device that wandered by the minute is promised to be tomorrow where it was when measuring ended."""
    data, _ = walking(4)
    _, result, errors = fitted(data)
    errors = continued(errors, result, data)
    now, hour, day = (promised(errors, result, data, seconds).mean() for seconds in (-1000.0, 3600.0, 86400.0))
    assert now < hour < day
    assert day > 3 * hour


def test_a_device_that_is_placed_anew_has_not_walked_through_the_nights():
    """Fails if each day's place of a device counts as what it walked overnight, or its walk within a day is forgotten the next."""
    data, rng, day = wavering(4, 0.0), np.random.default_rng(4), np.arange(POSES) // 30
    steps = rng.standard_normal((3, 30, 3)).cumsum(axis=1)
    steps -= steps.mean(axis=1, keepdims=True)
    walk = 1e-4 * (steps / steps.std()).reshape(POSES, 3)
    data.table[["x", "y", "z"]] += walk + 1e-3 * rng.standard_normal((3, 3))[day]
    days = {"time": day * 86400.0 + np.arange(POSES) % 30 * 120.0, "session": np.array(["mon", "tue", "wed"])[day]}
    data = replace(data, table=data.table.assign(**days, sigma=SIGMA))
    known = cf.identify(data.robot, data, ["geometry", "session-frame"], starts=1)
    rows = data.table.drop(columns="session")
    later = [replace(data, table=rows.assign(time=rows["time"].max() + days * 86400.0)) for days in (1.0, 7.0)]
    tomorrow, next_week = (np.sqrt((predict_rows(known, each, "widen").sd ** 2).mean()) for each in later)
    assert tomorrow == pytest.approx(next_week)
    assert 0.8e-4 < tomorrow < 1.5e-4


def test_an_arm_that_grows_goes_on_where_it_reaches_out():
    """Fails if links that grew at random are promised to have shifted all poses alike a day on."""
    data = wavering(4, 0.0)
    growth = np.random.default_rng(5).standard_normal(POSES).cumsum()
    reach = data.position.copy()
    data.table[["x", "y", "z"]] += 1e-4 * ((growth - growth[0]) / growth.std())[:, None] * reach
    _, result, errors = fitted(data)
    errors = continued(errors, result, data)
    far = np.linalg.norm(reach, axis=1)
    near, out = (data.only(which) for which in (far < np.quantile(far, 0.2), far > np.quantile(far, 0.8)))
    assert promised(errors, result, out, 86400.0).mean() > 2 * promised(errors, result, near, 86400.0).mean()


@pytest.mark.parametrize("hours", [6, 24, 168])
def test_an_arm_that_warms_up_again_and_again_is_once_more_what_it_was(hours):
    """Fails if an arm that grew as much in each of three shifts is promised to go on growing, and to be farther off than ever.

    Nor is it promised to stay nearer for longer pauses between them, in which it only rests.
    """
    data = wavering(4, 0.0)
    seconds = np.arange(POSES) % 30 * 120.0
    data.table["time"] = seconds + np.arange(POSES) // 30 * hours * 3600.0
    cold, grown = data.position.copy(), 3e-4 * data.position
    data.table[["x", "y", "z"]] += (1 - np.exp(-seconds / 1800.0))[:, None] * grown
    _, result, errors = fitted(data)
    errors = continued(errors, result, data)
    predicted = result.model.point(result.estimate, data.conditions)
    farthest = max(np.sqrt(((predicted - there) ** 2).mean()) for there in (cold, cold + grown))
    day = np.sqrt((promised(errors, result, data, 86400.0) ** 2).mean())
    assert 0.8 * farthest < day < 1.5 * farthest


def test_rows_of_one_time_do_not_wander():
    """Fails if rows whose times are all the same, as of a date alone, are no data to be fitted: a walk takes time."""
    data = wavering(4)
    data.table["time"] = 0.0
    _, result, errors = fitted(data)
    errors = continued(errors, result, data)
    assert {type(function) for function in errors.functions} <= {JointField, Shift, InPlace, Elsewhere}
    assert np.isfinite(promised(errors, result, data, 86400.0)).all()


def warming(robot):
    """Links that warm up in a quarter of an hour."""
    return ThermalGrowth(robot, constant=900.0)


@pytest.mark.parametrize("form", [FrameDrift, partial(FrameDrift, length=0.15, end=3000.0), warming])
def test_a_wander_that_is_named_goes_on_as_one_that_is_not(form):
    """Fails if a drift, a curve in time or a warm-up that was fitted to a random walk takes tomorrow for known, or for nothing."""
    data, walked = walking(4)
    _, result, errors = fitted(data)
    unnamed = continued(errors, result, data)
    model = build(data.robot, ("geometry",), data.given)
    model = replace(model, effects=(*model.effects, form(data.robot)))
    named = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")[0]
    left = ErrorModel.white(PerUnit(), len(named.estimate))
    before = continued(left, named, data)
    assert promised(before, named, data, -1000.0) == pytest.approx(promised(left, named, data, -1000.0))
    assert promised(before, named, data, 86400.0) == pytest.approx(promised(unnamed, result, data, 86400.0), rel=0.3)
    # What a warm-up has brought about is the robot's, and in the prediction.
    assert form is warming or (promised(before, named, data, 60.0) > 0.5 * np.abs(walked)).any()
    # Base and drift err together, as the device's last place does.
    end, then = (
        replace(data, table=data.table.assign(time=data.table["time"].max() + after)).conditions
        for after in (0.0, 60.0)
    )
    moved = before.moved(model, named.estimate, then)
    slopes = model.point_jacobian(named.estimate, then) - moved @ before.slope
    assert form is warming or slopes == pytest.approx(model.position_jacobian(named.estimate, end), abs=1e-9)


def after_a_step(data, moved, moment):
    """What is promised an hour on of a device that moved by so much (n, 3) in units of noise, with a step fitted over without."""
    data = replace(data, table=data.table.assign(order=np.arange(1.0, len(data) + 1)))
    data.table[["x", "y", "z"]] += SIGMA * moved
    _, result, errors = fitted(data)
    unnamed = promised(continued(errors, result, data), result, data, 3600.0)
    model = build(data.robot, ("geometry",), data.given)
    step = Cause(data.robot, FrameStep(data.robot, moment=moment), "device")
    model = replace(model, effects=(*model.effects, step))
    found = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")[0]
    beside = continued(ErrorModel.white(PerUnit(), len(found.estimate)), found, data)
    return float((promised(beside, found, data, 3600.0) / unnamed).mean())


def test_a_step_is_not_promised_to_recur():
    """Fails if a device that was moved once, and stood still before and after, is promised to walk."""
    after = np.arange(POSES) >= 0.4 * POSES
    assert after_a_step(wavering(4, 0.0), 8 * np.outer(after, [0.6, 0.0, -0.8]), 0.4 * POSES + 0.5) < 0.2


def test_a_walk_that_looks_like_a_step_goes_on():
    """Fails if a device that walked at random is promised to stand still since a step explains most of it, at its best moment."""
    ratios, rows = [], np.arange(5, 35)
    for seed in range(4, 10):
        walk = np.random.default_rng(seed).standard_normal((40, 3)).cumsum(axis=0)
        walk = (walk - walk.mean(axis=0)) / walk.std()
        apart = [m * (40 - m) * ((walk[:m].mean(axis=0) - walk[m:].mean(axis=0)) ** 2).sum() for m in rows]
        ratios.append(after_a_step(wavering(seed, 0.0, 40), walk, rows[np.argmax(apart)] + 0.5))
    assert np.mean(ratios) > 0.8


@pytest.mark.parametrize("held", [False, True])
def test_what_warming_brought_about_may_be_lost_when_the_robot_stands(held):
    """Fails if days later a robot is predicted, or promised, to be warm or cold, also where the size of a warm-up is held."""
    data = wavering(4, 0.0)
    until = float(data.table["time"].max())
    cause = Cause(data.robot, replace(warming(data.robot), until=until), "links")
    stated_size = Expected(name=cause.declared[0].name, value=1e-3, fixed=True)
    robot = replace(data.robot, expected=(stated_size,) if held else ())
    data, cause = data.on(robot), replace(cause, robot=robot, effect=replace(cause.effect, robot=robot))
    model = build(robot, ("geometry",), data.given)
    model = replace(model, effects=(*model.effects, cause))
    warm = np.where([parameter.name == stated_size.name for parameter in model.parameters], 1e-3, model.nominal)
    data.table[["x", "y", "z"]] = model.position(warm, data.conditions)
    found = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")[0]
    assert model.values(cause, found.estimate) == pytest.approx(1e-3, rel=0.02)
    known = ErrorModel.white(PerUnit(), len(found.estimate))
    later = continued(known, found, data)
    rows = replace(data, table=data.table.assign(time=1e6)).conditions
    cold = replace(data, table=data.table.assign(time=0.0)).conditions
    half, whole = (
        np.sqrt(((each.point(found.estimate, rows) - model.point(found.estimate, cold)) ** 2).mean(axis=0))
        for each in (model, replace(model, effects=(*model.effects[:-1], replace(cause, effect=warming(robot)))))
    )
    assert half == pytest.approx(whole / 2, rel=0.01)
    assert promised(later, found, data, 2 * 86400.0) == pytest.approx(half, rel=0.05)
    assert (promised(later, found, data, 60.0) < 0.1 * half).all()


def test_rows_in_order_wander_anew_in_another_measurement():
    """Fails if what rows err by in their order is known of other rows, stands still there, or is nothing."""
    data, _ = walking(4)
    table = data.table.rename(columns={"time": "order"}).assign(order=np.arange(float(POSES)))
    data = replace(data, table=table)
    _, result, errors = fitted(data)
    assert "order" in errors.inputs
    anew = continued(errors, result, data)
    nothing = np.zeros((len(result.estimate), len(result.estimate)))
    here, there = (variance(one, result.model, result.estimate, nothing, data.conditions) for one in (errors, anew))
    others = np.array([walking(seed)[0].position - wavering(seed, 0.0).position for seed in range(5, 25)])
    within = np.abs(others - others.mean(axis=1, keepdims=True)) < 1.96 * np.sqrt(there)
    assert within.mean() > 0.93
    assert there.mean() < 2 * here.mean()
    moved = anew.shared(anew.slopes(result.model, result.estimate, data.conditions), nothing)
    apart = np.linalg.norm(moved[0] - moved[-1], axis=1)
    assert (apart > 0.5 * np.linalg.norm(moved[0], axis=1)).all()


def test_beyond_a_measured_travel_a_curve_is_another_of_its_kind():
    """Fails if a curve is taken for known where no row told of it, for larger than it is, or for what a new base takes off."""
    data = wavering(6)
    low, high = (tuple(map(float, side)) for side in (data.joints.min(axis=0), np.quantile(data.joints, 0.5, axis=0)))
    cause = Cause(data.robot, JointErrorMap(data.robot, low, high, 0.5), "joint1")
    model = build(data.robot, ("geometry",), data.given)
    model = replace(model, effects=(*model.effects, cause))
    estimate, sure = model.nominal.copy(), 1e16 * np.eye(len(model.nominal))
    estimate[model.columns(cause)[:2]] = 3e-4
    result = Fit(LeastSquares.of(model, data, stated(data)), estimate, "linear", 0.0, np.zeros(0), 0 * estimate, sure)
    errors = continued(ErrorModel.white(PerUnit(((METRE, SIGMA),)), len(estimate)), result, data)
    inside = data.joints[:, 0] < high[0]
    beyond = data.joints[:, 0] > high[0] + 0.06 * (high[0] - low[0])
    moved = errors.moved(model, estimate, data.conditions)
    assert np.abs(moved[inside]).max() < 1e-3 * SIGMA
    lever = np.linalg.norm(data.position[:, :2], axis=1)
    curve = moved / lever[:, None, None]
    size = np.sqrt((curve**2).sum(axis=(1, 2)))
    assert size[beyond] == pytest.approx(np.full(beyond.sum(), size[beyond].mean()), rel=0.05)
    assert 3e-4 < size[beyond].mean() < 1.2 * 3e-4  # two waves of rms 1/sqrt(2) each; of few waves, so perhaps more
    across = np.column_stack([-data.position[:, 1], data.position[:, 0], 0 * lever]) / lever[:, None]
    alike = np.einsum("nak,na->nk", curve, across)[beyond]
    apart = alike - alike.mean(axis=0)
    assert (apart**2).sum() > 0.5 * (alike**2).sum()


def test_an_error_by_one_joint_may_be_another_where_another_joint_was_not_measured():
    """Fails if a joint's errors are known where another one never was, are unknown where it was, or change there at once."""
    data = wavering(6)
    data = data.only(data.joints[:, 0] < np.median(data.joints[:, 0]))
    model = build(data.robot, ("geometry",), data.given)
    start, sure = model.nominal, 1e16 * np.eye(len(model.nominal))
    result = Fit(LeastSquares.of(model, data, stated(data)), start, "linear", 0.0, np.zeros(0), 0 * start, sure)
    waves = JointField(data.robot, (1,), 2)
    known = ErrorModel.white(PerUnit(), len(start)).with_functions([waves], np.full(len(waves.declared), 1e-4))
    errors = continued(known, result, data)
    first, travel = data.joints[:, 0], np.ptp(data.joints[:, 0])
    rows = replace(data, table=data.table.assign(q1=first + travel))
    there = (errors.moved(model, start, rows.conditions) ** 2).sum(axis=1)
    n, beyond = len(waves.declared), first - first.min()
    whole, another = there[:, :n].sum(axis=1), there[:, n : 2 * n].sum(axis=1)
    assert another / whole == pytest.approx(DEPENDS * beyond / (travel + beyond))
    assert not errors.moved(model, start, data.conditions)[:, :, n : 2 * n].any()


def test_a_root_keeps_small_parameters_beside_large_ones():
    """Fails if a compensator's torque [Nm] drowns the compliances [rad/Nm] in rounding, and a tool is promised to 0.3 m."""
    rng = np.random.default_rng(3)
    correlation = np.corrcoef(rng.standard_normal((12, 6)), rowvar=False)
    sd = np.array([2e3, 1e3, 1e-9, 5e-9, 2e-5, 0.0])
    covariance = correlation * np.outer(sd, sd)
    root = root_of(covariance)
    assert (np.abs(root @ root.T - covariance) <= 1e-12 * np.outer(sd, sd)).all()
    assert np.isfinite(root_of(-covariance)).all()


def test_a_table_brings_it_back():
    """Fails if what a run folder keeps of it promises another error, or one of another version ends in a traceback."""
    data = wavering(7)
    _, result, errors = fitted(data)
    with pytest.raises(InputError, match=r"of another version of calflow \(.+\); run the study again"):
        read_errors(error_table(errors, result.model), result.model, {})
    again = read_errors(error_table(errors, result.model), result.model, FUNCTIONS)
    assert again.functions == errors.functions
    assert again.rest == errors.rest
    for name in ("sd", "mean", "slope", "told", "offset"):
        assert (getattr(again, name) == getattr(errors, name)).all()


def test_whose_error_depends_on_an_angle_is_told():
    """Fails if a joint's own curve widens what the other joints, or the point, are promised by that joint's angle.

    Or if the joint's zero is surer than the mean of such a curve, or another joint's is as unsure.
    """
    data = wavering(5, size=0.0)
    model, turned = build(data.robot, ("geometry",), data.given), data.conditions.copy()
    turned[1] += 3e-4 * np.sin(2 * turned[1])
    moved = model.position(model.nominal, turned) - model.position(model.nominal, data.conditions)
    data.table[["x", "y", "z"]] += moved
    _, result, errors = fitted(data)
    of_amplitude = [function for function in errors.functions for _ in function.declared]
    every = dict(zip(of_amplitude, errors.sd, strict=True)).items()
    sizes = [(function, sd) for function, sd in every if not is_mean(function)]
    own = [sd for function, sd in sizes if isinstance(function, JointField) and function.erring == (1,)]
    others = [sd for function, sd in sizes if function.inputs == ("q2",) and sd not in own]
    assert len(own) == 1
    assert max(others, default=0.0) < 0.2 * own[0]
    ((mean, size),) = [(function, sd) for function, sd in every if is_mean(function)]
    zeros = dict(zip([p.name for p in result.model.parameters], np.sqrt(np.diag(result.covariance)), strict=True))
    assert mean.of == mean.erring == (1,)
    assert zeros["joint2.theta"] > 0.9 * size > 1.5 * zeros["joint3.theta"]


def test_a_tilt_of_a_slide_is_as_unsure_as_a_slope_of_errors_along_it():
    """Fails if a joint that errs along a slide's travel leaves the tilt of the slide's axis, which moves the tool alike, for sure.

    The straight line moves the slide's end, at half the travel, by its size times a of joint 3, and so does a tilt. The longest
    wave, half a turn over the travel, is nearly such a line and as large: both together make the tilt unsure by root two of that.
    """
    links = {"alpha_deg": (0, 0, 0, 0), "a_m": (0, 0.45, 0.4, 0), "d_m": (0.42, 0, 0, 0.05)}
    joints = [{name: values[i] for name, values in links.items()} for i in range(4)]
    joints[2] |= {"kind": "prismatic", "limits_m": [-0.35, 0.0]}
    scara = robot("modified-dh", joints, markers={"E": {"point_m": [0.0, 0.0, -0.05]}})
    model = build(scara, ("geometry",))
    data = measured(model, model.nominal, POSES, np.random.default_rng(3))
    model, turned = build(scara, ("geometry",), data.given), data.conditions.copy()
    turned[1] += 3e-4 * np.cos(2 * np.pi * turned[2] / 0.35)
    moved = model.position(model.nominal, turned) - model.position(model.nominal, data.conditions)
    data.table[["x", "y", "z"]] += moved
    _, result, errors = fitted(data)
    of_amplitude = [function for function in errors.functions for _ in function.declared]
    every = zip(of_amplitude, errors.sd, strict=True)
    sizes = [sd for function, sd in every if isinstance(function, AlongSlides) and 1 in function.erring]
    sds = np.sqrt(np.diag(errors.about_mean(result.covariance)))
    tilts = dict(zip([p.name for p in result.model.parameters], sds, strict=True))
    assert tilts["joint3.alpha"] > np.sqrt(2) * max(sizes) * 0.4 / (0.35 / 2)
