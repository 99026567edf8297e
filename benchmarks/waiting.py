"""How long a user waits: the processor's seconds of whole commands, imports and all, before a change and after it in turns.

    python benchmarks/waiting.py OTHER                 OTHER is the clone of an earlier version; without it only this one's
    python benchmarks/waiting.py OTHER --only hh800    some: help, new, status, check, plan, hh800

Seconds are user's and system's of all processes, the least of so many turns; ends with 1 where one is above what is wanted.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
STUDY = str(ROOT / "studies" / "hh800" / "study.toml")
COMMANDS = {  # words, turns, and the seconds and the ratio that are wanted
    "help": (("--help",), 3, 0.2, None),
    "new": (("new", "robot{turn}"), 3, 0.6, None),
    "hh800": (("run", STUDY, "--out", "hh800", "--force"), 2, None, 0.45),
    "status": (("status", "hh800"), 3, 0.7, None),
    "check": (("check", STUDY), 3, 1.2, None),
    "plan": (("run", "robot/plan.toml", "--out", "plan", "--force"), 1, 30.0, None),
}


def main() -> None:
    """Print one line a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", nargs="?", type=Path, help="clone of an earlier version")
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    options = parser.parse_args()
    versions = [ROOT, *([options.other.resolve()] if options.other else [])]
    print(f"{'command':8} {'now [s]':>8} {'before':>8} {'ratio':>6}   wanted", flush=True)
    missed = [name for name in options.only if not enough(name, versions)]
    sys.exit(f"missed: {', '.join(missed)}" if missed else 0)


def enough(name: str, versions: list[Path]) -> bool:
    """Time a command of all versions in turns, print its line, and say whether it is quick enough."""
    words, turns, wanted, wanted_ratio = COMMANDS[name]
    with tempfile.TemporaryDirectory() as folder:
        for k, version in enumerate(versions):
            prepare(name, version, Path(folder, str(k)))
        taken = [[seconds(version, words, turn, Path(folder, str(k))) for k, version in enumerate(versions)]
                 for turn in range(turns)]  # fmt: skip
    now, *before = (min(column) for column in zip(*taken, strict=True))
    ratio = now / before[0] if before else None
    shown = f"{before[0]:8.2f} {ratio:6.2f}" if before else f"{'':15}"
    print(f"{name:8} {now:8.2f} {shown}   {f'{wanted} s' if wanted else wanted_ratio}", flush=True)
    return (wanted is None or now <= wanted) and (wanted_ratio is None or ratio is None or ratio <= wanted_ratio)


def prepare(name: str, version: Path, folder: Path) -> None:
    """Make what a command needs: a finished run, or the robot and the plan of docs/select.md."""
    folder.mkdir()
    if name == "status":
        seconds(version, ("run", STUDY, "--out", "hh800", "--stage", "identify"), 0, folder)
    if name == "plan":
        seconds(version, ("new", "robot"), 0, folder)
        (plan,) = re.findall(r'^```toml\n(name = "plan"\n.*?)^```', (ROOT / "docs/select.md").read_text(), re.M | re.S)
        (folder / "robot" / "plan.toml").write_text(plan, encoding="utf-8")


def seconds(version: Path, words: tuple[str, ...], turn: int, folder: Path) -> float:
    """Run a command of a version in a process of its own in a folder; the processor's seconds of it and its children."""
    environment = {**os.environ, "PYTHONPATH": str(version / "src")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [sys.executable, "-c", "from calflow.cli import program; program()"]
    process = subprocess.Popen(
        [*command, *(word.format(turn=turn) for word in words)], cwd=folder, env=environment, stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{' '.join(words)} failed in {version}")
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
