"""The measuring loop as a terminal tells it: what the measurements say, whether that is enough, and what is in doubt."""

from __future__ import annotations

from collections.abc import Iterator

from calflow.design.measuring.measuring_verdict import MeasuringVerdict, Suspect
from calflow.files.words import mm, number

TOLD = 4  # suspects in words
HOPELESS = 0.5  # probability at best below which more poses of the same kind are no way
MEASURES = {"rms": "root mean square", "worst": "worst point"}


def next_lines(verdict: MeasuringVerdict) -> list[str]:
    """Return the verdict in words, its first line the answer."""
    return [_answer(verdict), *_told(verdict), *(f"note: {note}" for note in verdict.notes)]


def _answer(verdict: MeasuringVerdict) -> str:
    """Stop, or go on, and why."""
    if verdict.status == "nothing measured":
        return "nothing measured yet: poses to begin with"
    if verdict.status == "too few":
        return f"{verdict.poses} poses are too few to identify anything"
    if verdict.tolerance_mm is None or verdict.probability is None:
        return "no tolerance stated (--tolerance-mm, or tolerance_mm in [stages.select]): nothing to stop at"
    within = f"the tool is within {mm(verdict.tolerance_mm)} mm over the task ({MEASURES[verdict.measure]})"
    sure = f"with probability {_probability(verdict.probability)}"
    if verdict.status == "stop":
        return f"stop: {within} {sure}"
    return f"go on: {within} {sure}, {verdict.confidence:.0%} is asked for"


def _told(verdict: MeasuringVerdict) -> Iterator[str]:
    if verdict.error_mm is None or verdict.error_most_mm is None:
        return
    yield (
        f"true error of the tool over the task: about {mm(verdict.error_mm)} mm, below {mm(verdict.error_most_mm)} mm with "
        f"{verdict.confidence:.0%}"
    )
    parts = [f"left out in turn {mm(verdict.leftout_rms_mm)} mm"] if verdict.leftout_rms_mm is not None else []
    parts += [f"held out {mm(verdict.heldout_rms_mm)} mm"] if verdict.heldout_rms_mm is not None else []
    noise = f"noise {mm(verdict.noise_mm)} mm per axis" if verdict.noise_mm is not None else ""
    yield f"{verdict.poses} poses, {verdict.fitted_poses} fitted; errors as measured (rms): {', '.join((*parts, noise))}"
    if not verdict.noise_known:
        yield (
            "the noise is not known apart from the fit, so all of it counts as the robot's own error: repeat some poses, or state "
            "sigma_mm in [measurements]"
        )
    yield from (f"found: {said}" for said in verdict.found or ("nothing that the model lacks",))
    if verdict.suspected:
        more = len(verdict.suspected) - TOLD
        said = ", ".join(map(_suspect, verdict.suspected[:TOLD]))
        yield f"suspected, not proven: {said}{f', and {more} more' if more > 0 else ''}"
    if verdict.untested:
        yield f"not tested, for want of what they need, and not in the probability: {', '.join(verdict.untested)}"
    best = verdict.probability_at_best
    if verdict.status == "measure" and best is not None and best < HOPELESS:
        yield (
            f"more poses of this kind will hardly do: with every parameter known it would be within with probability "
            f"{_probability(best)}. See what is suspected, or a wider tolerance"
        )


def _suspect(one: Suspect) -> str:
    what = {
        "cause": one.name,
        "background": f"a smooth error by {one.name}",
        "pose": "an error of each pose for itself",
        "rival": f"{one.name} instead of what was found",
    }[one.kind]
    return f"{what} ({number(one.probability, '.2g')})"


def _probability(value: float) -> str:
    """A probability of so many draws: never more than they can tell."""
    return "over 0.999" if value > 0.999 else "below 0.001" if value < 0.001 else f"{value:.3f}"
