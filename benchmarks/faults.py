"""What goes wrong with machines and files: runs killed, disks full, run folders damaged, and files spoilt in every way, counted.

    python benchmarks/faults.py kills --cases 200          kill -9 and SIGTERM at random moments of a whole run, then run again
    python benchmarks/faults.py mutations --cases 10000    spoilt study, robot, workflow, truth and measurement files and URDFs
    python benchmarks/faults.py commands --cases 160       the same and targets, rows, frames, programs and plants, each before a
                                                           command in a process of its own
    python benchmarks/faults.py damages --cases 588        every file of a run folder cut, emptied, turned, zeroed, gone, a folder,
                                                           not to be read; every command that reads it asked
    python benchmarks/faults.py disk --cases 40            run, report, pack and fleet run on a disk with little space, then with
                                                           enough; only where this user may mount a file system

    --seed 1  --first 0 (the number of the first case)  --processes 1  --out FILE.csv (a row a case)

Files that made something go wrong are kept beside the CSV. What is counted as wrong is said in tests/trouble, whose tests are a
short version. Ends with 1 where anything is wrong, and with 2 where a part cannot be tried here.
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
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import pandas as pd

from conftest import SMALL
from trouble import campaign, commands, damage, disk, kills
from trouble.workplace import few_sections, workplace

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


def called(numbers: range, seed: int, kept: Path) -> Iterator[Row]:
    """Call commands with spoilt files."""
    with tempfile.TemporaryDirectory() as folder:
        place = workplace(Path(folder, "place"), SMALL["quick.toml"])
        for number in numbers:
            yield asdict(commands.called(place, seed, number, kept))


def damaged(numbers: range, seed: int, kept: Path) -> Iterator[Row]:
    """Damage a run's files."""
    with tempfile.TemporaryDirectory() as folder, few_sections():
        sound = damage.Sound.of(workplace(Path(folder, "place")))
        for number in numbers:
            yield asdict(damage.damaged(sound, seed, number))


def filled(numbers: range, seed: int, kept: Path) -> Iterator[Row]:
    """Fill disks."""
    with tempfile.TemporaryDirectory() as folder, few_sections():
        place = workplace(Path(folder, "place"))
        whole = disk.at_once(place, Path(folder, "disk"))
        for number in numbers:
            yield asdict(disk.filled(whole, place, Path(folder, "disk"), seed, number))


PARTS: dict[str, Callable[[range, int, Path], Iterator[Row]]] = {
    "kills": killed, "mutations": mutated, "commands": called, "damages": damaged, "disk": filled,
}  # fmt: skip
BY = {
    "kills": ["signal", "within", "code"], "mutations": ["file", "code"], "commands": ["command", "code"], "damages": ["damage"],
    "disk": ["command", "code"],
}  # fmt: skip


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
    os.environ.pop("CALFLOW_DATA", None)  # the user's data must not stand in for a case's own
    if asked.part == "damages" and damage.reads_everything():
        os.execvp(damage.AS_USER[0], [*damage.AS_USER, sys.executable, *sys.argv])
    ends = [asked.first + k * asked.cases // asked.processes for k in range(asked.processes + 1)]
    shares = [range(start, end) for start, end in pairwise(ends)]
    work = partial(_share, asked.part, asked.seed, asked.out)
    try:
        with ProcessPoolExecutor(asked.processes) as pool:
            rows = [row for share in pool.map(work, shares) for row in share]
    except disk.NoMount as reason:
        print(f"not tried: a file system of its own cannot be mounted here ({reason})")
        sys.exit(2)
    table = pd.DataFrame(rows)
    table.to_csv(asked.out, index=False)
    print(table.groupby(BY[asked.part]).size().to_string())
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
