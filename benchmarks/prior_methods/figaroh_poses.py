"""figaroh's two searches for poses, run by an interpreter that has figaroh: DetMax and its second-order cone program.

python figaroh_poses.py CANDIDATES.npz FOLDER [socp]: jacobians (n, 3, n_parameters) and the number of poses; writes O1 and
seconds to detmax.npz and, where asked for, socp.npz (100 candidates of 29 parameters did not end in 140 s of processor time).
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
    criterion = Detmax(pool, poses).main_algo()[-1]  # it keeps the set itself to itself
    seconds = time.process_time() - began
    np.savez(folder / "detmax.npz", o1=np.sqrt(criterion / poses), seconds=seconds)
    if "socp" in sys.argv:
        began = time.process_time()
        weights, _ = SOCPOptimizer(pool, {"NbSample": len(pool)}).solve()
        chosen = np.argsort(weights)[::-1][:poses]
        information = sum(pool[k] for k in chosen)
        o1 = np.exp(np.linalg.slogdet(information)[1] / (2 * len(information))) / np.sqrt(poses)
        np.savez(folder / "socp.npz", o1=o1, seconds=time.process_time() - began)


if __name__ == "__main__":
    main()
