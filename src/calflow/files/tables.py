"""Tables: what a run keeps as CSV, by their path in the run folder."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

Tables = Mapping[str, pd.DataFrame]
