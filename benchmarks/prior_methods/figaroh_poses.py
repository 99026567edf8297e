"""figaroh's two searches for poses, run by an interpreter that has figaroh: DetMax and its second-order cone program.

python figaroh_poses.py CANDIDATES.npz FOLDER: jacobians (n, 3, n_parameters), number of poses; writes detmax.npz, socp.npz.
"""

from __future__ import annotations

import random
import sys
import time
from pathlib import Path

import numpy as np
from figaroh.optimal.base_optimal_calibration import Detmax, SOCPOptimizer


def main() -> None:
    """Run both on the same information matrices."""
    held = np.load(sys.argv[1])
    folder, poses = Path(sys.argv[2]), int(held["poses"])
    pool = {k: one.T @ one for k, one in enumerate(held["jacobians"])}
    random.seed(1)
    began = time.process_time()
    detmax = Detmax(pool, poses)
    detmax.main_algo()
    np.savez(folder / "detmax.npz", chosen=np.array(detmax.cur_set), seconds=time.process_time() - began)
    began = time.process_time()
    weights, _ = SOCPOptimizer(pool, {"NbSample": len(pool)}).solve()
    chosen = np.argsort(weights)[::-1][:poses]
    np.savez(folder / "socp.npz", chosen=chosen, seconds=time.process_time() - began)


if __name__ == "__main__":
    main()
