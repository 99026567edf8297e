"""Many rows: what identify, and if asked report, take of processor and memory, part by part, against what was foreseen.

python benchmarks/scale.py --rows 10000 30000 100000 300000 1000000    rows to fit; 40 % more are held out
--markers 3 --repeats 3    as many rows, of several markers measured several times a pose
--report                   the report after it, with the sizes of its files
--seed 2021 --out FOLDER   of the simulated measurements, and where they and the runs are kept
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

STUDY = Path(__file__).parents[1] / "studies" / "hh800"
POINTS = ("[0.2, 0.2, 0.2]", "[-0.2, 0.2, 0.25]", "[0.1, -0.25, 0.3]")  # m, of markers on the flange
PARTS = {  # by the function that does it; those after `fits` are each a part of none before
    "reading": ("measurements/rows.py", "read_rows"),
    "splitting": ("measurements/measurements.py", "split"),
    "duplicates": ("faults/duplicate.py", "find"),
    "faults, with these": ("faults/__init__.py", "examined"),
    "noise": ("estimation/noise.py", "measured_noise"),
    "fits": ("estimation/fit.py", "fit_sharing"),
    "poses left out": ("estimation/leverage.py", "elsewhere"),
    "row tables": ("estimation/leverage.py", "judged"),
    "writing CSV": ("files/tables.py", "write_csv"),
    "hashes": ("measurements/source.py", "sha256"),
}
SIMULATE = """
import sys, time
from pathlib import Path
from calflow.files.tables import write_csv
from calflow.simulation import simulate

folder = Path(sys.argv[1])
write_csv(folder / "measurements.csv", simulate(folder / "truth.toml"))
print(time.process_time())
"""
RUN = """
import resource, sys, threading, time
from calflow.runs.planning import foreseen
from calflow.runs.run import run
from calflow.stages.catalogue import STAGES
from calflow.study import load_study

study, out, stage, parts = load_study(sys.argv[1]), sys.argv[2], sys.argv[3], eval(sys.argv[4])
main, clock = threading.main_thread().ident, time.pthread_getcpuclockid(threading.main_thread().ident)
taken = dict.fromkeys(parts, 0.0)

def watch():  # a profiler would slow down what is called once a cell
    before = time.clock_gettime(clock)
    while True:
        time.sleep(0.02)
        now, frame, there = time.clock_gettime(clock), sys._current_frames()[main], set()
        while frame:
            there.add((frame.f_code.co_filename.rpartition("calflow/")[2], frame.f_code.co_name))
            frame = frame.f_back
        for name, place in parts.items():
            taken[name] += (now - before) * (place in there)
        before = now

if stage == "identify":
    threading.Thread(target=watch, daemon=True).start()
begun = time.process_time()
run(study, out, stage, True)
seconds, peak = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
demand = foreseen(study, [STAGES["identify"]])["identify"]
print(len(study.measurements()), seconds, peak, demand.seconds, demand.memory / 1e9)
for name, value in taken.items():
    print(f"{name}|{value}")
"""


def main() -> None:
    """Print a line and the parts of each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--markers", type=int, choices=(1, 2, 3), default=1)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--seed", type=int, default=2021)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    print("  to fit    in all   s simulated | s identified  peak GB | foreseen s      GB   (seconds of the processor)")
    for rows in asked.rows:
        with tempfile.TemporaryDirectory() as made:
            folder = (asked.out or Path(made)) / f"{rows}-{asked.markers}-{asked.repeats}"
            simulated = simulate(folder, rows, asked.markers, asked.repeats, asked.seed)
            lines = measured(folder, "identify")
            in_all, seconds, peak, expected, gigabytes = map(float, lines[0].split())
            print(
                f"{rows:8} {in_all:9.0f} {simulated:13.1f} | {seconds:12.1f} {peak:8.2f} | {expected:10.1f} {gigabytes:7.2f}"
            )
            for line in lines[1:]:
                name, taken = line.split("|")
                print(f"{'':34}{name:20} {float(taken):6.1f}", flush=True)
            if asked.report:
                report(folder)


def report(folder: Path) -> None:
    """Print what the report takes, and how large it is."""
    _, seconds, peak, *_ = map(float, measured(folder, "report")[0].split())
    sizes = ", ".join(
        f"{name} {(folder / 'run' / name).stat().st_size / 1e6:.1f} MB" for name in ("report.pdf", "report.html")
    )
    print(f"{'':34}report {seconds:.1f} s, {peak:.2f} GB with reading: {sizes}", flush=True)


def simulate(folder: Path, rows: int, markers: int, repeats: int, seed: int) -> float:
    """Write a study whose measurements have so many rows to fit; return the processor's seconds of `calflow simulate`."""
    folder.mkdir(parents=True, exist_ok=True)
    robot, study, truth = ((STUDY / f"{name}.toml").read_text() for name in ("robot", "study", "truth"))
    further = "".join(f"\n[markers.M{k}]\npoint_m = {point}\n" for k, point in enumerate(POINTS[1:markers], start=2))
    (folder / "robot.toml").write_text(robot + further)
    (folder / "study.toml").write_text(study.split("[stages.identify.count]")[0])
    poses = rows // (markers * repeats)
    truth = truth.replace('split = "train"\nposes = "poses.csv"', f'split = "train"\nrandom = {poses}')
    truth = truth.replace("random = 60", f"random = {int(0.4 * poses)}")
    truth = truth.replace("repeats = 1", f"repeats = {repeats}").replace("seed = 2021", f"seed = {seed}")
    (folder / "truth.toml").write_text(truth)
    done = subprocess.run([sys.executable, "-c", SIMULATE, str(folder)], check=True, capture_output=True, text=True)
    return float(done.stdout)


def measured(folder: Path, stage: str) -> list[str]:
    """Run a stage in a process of its own; return the lines it prints of itself."""
    command = [sys.executable, "-c", RUN, str(folder), str(folder / "run"), stage, repr(PARTS)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()


if __name__ == "__main__":
    main()
