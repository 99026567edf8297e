"""A print that is longer one way (`print-scale`): what images do not tell of it; that it is found is in `test_board_bent.py`."""

from __future__ import annotations

import numpy as np

from calflow.calibration import identify
from effects.boards import BOARD, of_plates
from observations.test_camera import study


def test_a_print_that_is_too_large_all_over_is_not_told_from_longer_links(tmp_path):
    """Fails if images are taken to tell how large a print is all over, of which a larger robot leaves the same, or if they do not
    tell that it is as much longer one way as the other.
    """
    kept = study(tmp_path, of_plates(13, BOARD * [1.003, 1.003, 1.0]), "ur5e", True)
    found = identify(kept.robot, kept.measurements(), ["geometry", "print-scale"], starts=1)
    x, y = (k for k, parameter in enumerate(found.model.parameters) if parameter.effect == "print-scale")
    along = np.eye(len(found.estimate))[[x, y]]
    sd_x, sd_apart = (float(np.sqrt(way @ found.covariance @ way)) for way in (along[0], along[1] - along[0]))
    assert abs(found.estimate[y] - found.estimate[x]) < 4 * sd_apart < 1.2e-3
    assert sd_x > 10 * sd_apart
