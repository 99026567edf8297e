"""Session frame: a measuring device, or a robot, that was set up anew between sessions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import NOTHING, OF_THE_FRAME, Effect, Words
from calflow.effects.displacement import displaced
from calflow.measurements.measurements import Measurements, borders, sessions_of
from calflow.robot.mechanism import Row, name_number
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SHIFT_SD, TURN_SD = 2e-3, 1e-3  # m and rad: repeatability of setting up by the old marks
BOUND = 100.0  # standard deviations


@dataclass(frozen=True)
class SessionFrame(Effect):
    """Reported position + (x, y, z), and with turning + r x position (about the measuring frame's origin), session by session.

    sessions are in measuring order, and the first defines the measuring frame. From session since on (counted from 0) all
    share one displaced frame; with since = 0 each session has a frame of its own. Where there are several devices it is of one
    of them, or of all: then the robot was set up anew.
    """

    sessions: tuple[str, ...] = ()
    turning: bool = True
    since: int = 0
    of: str = ""

    id = "session-frame"
    title = "frame of a session"
    words = Words("frame of a session", "the device, or the robot, was set up anew between sessions", "largest shift")
    whole = "sessions"
    family = OF_THE_FRAME
    needs = ("session",)
    dated = True
    told_by = "measure points fixed to the floor, and some poses again, in each session"

    @classmethod
    def stated(cls, robot: Robot, data: Measurements) -> Self:
        """Return the variant with a frame (shift and rotation) for each session."""
        return cls(robot, sessions_of(data))

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return a frame per session, and one frame from a session on, without and with rotation, of whatever may have moved."""
        sessions = sessions_of(data)
        later = range(1, len(sessions)) if len(sessions) > 2 and len(borders(data)) else ()
        return tuple(
            cls(robot, sessions, turning, since, of) for since in (0, *later) for turning in (False, True) for of in _movable(data)
        )  # fmt: skip

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return why no test is possible: there is one session, or the stations have a frame per session already."""
        if all(series.station.by_session for series in data.series):
            return "nothing: the station's frames are found session by session already (by_session = true)"
        several = len(sessions_of(data)) != 1 and next(_movable(data), None) is not None
        return "" if several else "two sessions or more with rows to fit"

    @property
    def detail(self) -> str:
        """The sessions concerned, and whether the frames rotate."""
        which = f"from session {self.sessions[self.since]} on" if self.since else "each session"
        return f"{which}, {'shifted and turned' if self.turning else 'shifted'}{self.of and f', of {self.of}'}"

    @property
    def variant(self) -> str:
        """Short name of the form, without the sessions, which come from the data."""
        return " ".join(
            filter(None, ("turning" if self.turning else "", f"since {self.since + 1}" if self.since else "", self.of))
        )

    def parameters(self) -> tuple[Parameter, ...]:
        """Return a shift, and a rotation, per frame."""
        kinds = [("", "m", SHIFT_SD, "shift along"), *([("r", "rad", TURN_SD, "turn about")] if self.turning else [])]
        return tuple(
            Parameter(self.id, "sessions", f"{symbol}{axis}{'' if self.since else f'-{name}'}", unit, sd, -BOUND * sd, BOUND * sd,
                      meaning=f"frame of session {name}: {meaning} {axis}")
            for name in self._moved for symbol, unit, sd, meaning in kinds for axis in "xyz"
        )  # fmt: skip

    @property
    def _moved(self) -> tuple[str, ...]:
        """The sessions with a frame of their own; the first one after a move stands for all later ones."""
        return self.sessions[self.since : self.since + 1] if self.since else self.sessions[1:]

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the largest shift of a session."""
        return ca.mmax(ca.sqrt(ca.sum1(self._frames(p)[:3, :] ** 2) + NOTHING))

    def _frames(self, p: ca.SX) -> ca.SX:
        """Return each frame's shift, and rotation, (3 or 6, n_frames)."""
        return ca.reshape(p, 6 if self.turning else 3, len(self._moved))

    def concerns(self, device: str) -> bool:
        """Whether it is of this device."""
        return self.of in ("", device)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, displaced by its session's frame."""
        if not row.session.nnz():
            return point
        within = ca.vertcat(ca.SX(0, 1), *(self._within(name, row) for name in self._moved))
        return point + displaced(self._frames(p) @ within, point)

    def _within(self, session: str, row: Row) -> ca.SX:
        """Return 1 for a row of the session, or of a later one that shares its frame, else 0."""
        alike = self.sessions[self.since :] if self.since else (session,)
        return sum((row.session == name_number(name) for name in alike), ca.SX(0))

    def completing(self, data: Measurements) -> tuple[Effect, ...]:
        """Return the frames of those sessions of the data without a fitted row."""
        new = tuple(name for name in sessions_of(data) if name not in self.sessions)
        return (type(self)(self.robot, ("", *new), of=self.of),) if new and self.sessions else ()


def _movable(data: Measurements) -> Iterator[str]:
    """Yield what may stand elsewhere in another session: the only device, or each that was used in several, and all ("") of these.

    A device whose frames are found session by session anyway does not tell.
    """
    stays = np.array([not series.station.by_session for series in data.series])[data.series_number]
    if len(data.devices) == 1:
        yield from ([""] if stays.any() else [])
        return
    used = [name for name in data.devices if len(sessions_of(data.only(stays & (data.device == name)))) > 1]
    yield from used
    if len(used) > 1:
        yield ""
