"""Camera elsewhere: a stated place of a camera or its target that images contradict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.estimation.accuracy import distances, leading_errors
from calflow.estimation.registration import registered_model
from calflow.faults.rough import FAR_BETTER
from calflow.files.deferred import Rotation
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.observations.base import PLACE, Six
from calflow.observations.camera import Camera
from calflow.robot.frames import angles, placement_matrix

UNLIKE = 5.0  # standard deviations of a stated place, beyond which it is a mistake


def check_cameras(data: Measurements) -> None:
    """Refuse, by InputError, a stated place without which the nominal robot explains the images far better."""
    for k, series in enumerate(data.series):
        freed = {what: _without_place(series, what) for what in ("camera", "target") if series.kind == Camera.id}
        freed = {what: free for what, free in freed.items() if free != series}
        if not freed:
            continue
        before, stated = _nominal(data, k)
        for what, free in freed.items():
            after, found = _nominal(replace(data, series=(*data.series[:k], free, *data.series[k + 1 :])), k)
            far = [place for name, place in found.placements.items() if _is_unlike(stated, name, place)]
            if far and after < before / FAR_BETTER:
                said = f"expected about {_in_words(what, far[0])}, where the images are explained far better"
                raise refuse(f"the {what} is not where {what}_origin_mm and {what}_rotation_deg state it: {said}")


def _without_place(series: Series, what: str) -> Series:
    of_place = [f"{what}_{figure}" for figure in ("origin", "rotation", "origin_sd", "rotation_sd")]
    return replace(series, settings=tuple(item for item in series.settings if item[0] not in of_place))


def _nominal(data: Measurements, k: int) -> tuple[float, Camera]:
    """Return the nominal robot's median error [px] in series k, as registered to it, and the registered series."""
    model, here = registered_model(data)
    camera = model.observations[k]
    assert isinstance(camera, Camera)
    errors = distances(leading_errors(model, model.nominal, here))
    return float(np.nanmedian(errors[here.train & here.of_series(k)])), camera


def _is_unlike(stated: Camera, name: str, place: Six) -> bool:
    """Whether a place of a camera or target, by its name, is beyond what the series states, or has of its nominal robot, of it."""
    by = np.linalg.inv(placement_matrix(stated.placements[name])) @ placement_matrix(place)
    apart = [*by[:3, 3], *angles(Rotation.from_matrix(by[:3, :3]))]
    sd = {parameter.symbol: parameter.prior_sd for parameter in stated.parameters() if parameter.part == name}
    return any(abs(off) > UNLIKE * sd.get(symbol, 0.0) for off, symbol in zip(apart, PLACE, strict=True))


def _in_words(what: str, place: Six) -> str:
    origin, turn = (
        [float(f"{figure:.4g}") for figure in six] for six in (np.multiply(place[:3], 1e3), np.rad2deg(place[3:]))
    )
    return f"{what}_origin_mm = {origin} and {what}_rotation_deg = {turn}"
