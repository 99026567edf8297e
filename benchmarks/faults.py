"""What goes wrong with machines and files: runs killed and gone on with, and files spoilt in every way, counted.

    python benchmarks/faults.py kills --cases 200          kill -9 and SIGTERM at random moments of a whole run, then run again
    python benchmarks/faults.py mutations --cases 10000    spoilt study, robot, workflow, truth and measurement files and URDFs

    --seed 1  --first 0 (the number of the first case)  --processes 1  --out FILE.csv (a row a case)

Files that made something go wrong are kept beside the CSV. What is counted as wrong is said in tests/trouble, whose tests are a
short version. Ends with 1 where anything is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("CALFLOW_DATA", None)  # the user's data must not stand in for a case's own
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import pandas as pd

from trouble import campaign, kills

Row = dict[str, Any]


def killed(numbers: range, seed: int, kept: Path) -> Iterator[Row]:
    """Kill runs."""
    with tempfile.TemporaryDirectory() as folder:
        whole = kills.unbroken(Path(folder))
        for number in numbers:
            yield asdict(kills.killed(whole, Path(folder, "run"), seed, number))


def mutated(numbers: range, seed: int, kept: Path) -> Iterator[Row]:
    """Spoil files."""
    with tempfile.TemporaryDirectory() as folder:
        verdicts = campaign.Campaign(Path(folder, "studies")).verdicts(seed, numbers.start)
        for verdict in islice(verdicts, len(numbers)):
            if verdict.wrong:
                campaign.keep(verdict, kept)
            row = asdict(verdict)
            del row["content"]
            yield row


PARTS: dict[str, Callable[[range, int, Path], Iterator[Row]]] = {"kills": killed, "mutations": mutated}


def main() -> None:
    """Run a part of the campaign and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("faults.csv"))
    asked = parser.parse_args()
    ends = [asked.first + k * asked.cases // asked.processes for k in range(asked.processes + 1)]
    shares = [range(start, end) for start, end in pairwise(ends)]
    work = partial(_share, asked.part, asked.seed, asked.out)
    with ProcessPoolExecutor(asked.processes) as pool:
        rows = [row for share in pool.map(work, shares) for row in share]
    table = pd.DataFrame(rows)
    table.to_csv(asked.out, index=False)
    by = ["file", "code"] if asked.part == "mutations" else ["signal", "within", "code"]
    print(table.groupby(by).size().to_string())
    wrong = table[table["wrong"] != ""]
    print(f"{len(table)} cases, {len(wrong)} wrong")
    sys.exit(int(len(wrong) > 0))


def _share(part: str, seed: int, out: Path, numbers: range) -> list[Row]:
    """Work through some cases; each is told as it ends in a file of its own, so that a long campaign can be looked at."""
    rows, told = [], out.with_name(f"{out.stem}-{numbers.start}.log")
    with told.open("w", encoding="utf-8") as log:
        for row in PARTS[part](numbers, seed, out.with_suffix("")):
            rows.append(row)
            print(*row.values(), sep="\t", file=log, flush=True)
    return rows


if __name__ == "__main__":
    main()
