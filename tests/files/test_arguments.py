"""Arguments from Python: a wrong choice, number or object is refused by name, whatever else is wrong beside it.

A value that is handed on unlooked at, or a first problem that hides the second, would break these.
"""

from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field

from calflow import InputError, Robot
from calflow.files.toml import Count, checked_arguments


@checked_arguments
def asked(
    robot: Robot | None,
    number: Count = 3,
    *,
    loss: Literal["linear", "cauchy"] = "linear",
    share: Annotated[float, Field(ge=0, lt=1)] = 0.3,
    readings: list[float] | str = "",
) -> tuple[object, ...]:
    return robot, number, loss, share, readings


def test_all_that_is_wrong_is_said_at_once():
    with pytest.raises(InputError) as refused:
        asked("arm", 0, loss="huber", share=2, readings=5)
    assert str(refused.value).splitlines() == [
        "robot: expected a Robot, found 'arm'",
        "number: expected a number greater than or equal to 1, found 0",
        "loss: expected 'linear' or 'cauchy', found 'huber'",
        "share: expected a number less than 1, found 2",
    ]


def test_numbers_of_numpy_are_numbers():
    assert asked(None, np.int64(4), share=np.float64(0.5)) == (None, 4, "linear", 0.5, "")


def test_a_name_too_many_is_pythons_to_say():
    with pytest.raises(TypeError, match=r"asked\(\) got an unexpected keyword argument 'sharing'"):
        asked(None, sharing=1)
