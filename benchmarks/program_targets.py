"""Programs: the time that `calflow filter` takes for many targets, from files to files, and whether no correction keeps all bytes.

python benchmarks/program_targets.py [--targets 10000] [--files 20]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calflow.programs.aims import FilterSettings
from calflow.programs.correction import filtered
from calflow.programs.formats import read_project
from programs.interpreter import ERRORS
from programs.test_projects import FRAMES, TOOLS, as_fanuc, as_krl, as_rapid, as_urscript, corrector


def rapid(states) -> dict[str, str]:
    """A task of modules whose tools and work objects stand in another."""
    files = {"user.sys": """MODULE user(SYSMODULE)
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.7071068,0,0,0.7071068]]];
ENDMODULE
"""}  # fmt: skip
    for k, part in enumerate(states):
        data = [f"  LOCAL CONST robtarget p{i}:={state};" for i, state in enumerate(part)]
        moves = [f"    MoveL p{i},v100,fine,gun\\WObj:=fixture;" for i in range(len(part))]
        files[f"m{k}.mod"] = "\n".join([f"MODULE m{k}", *data, f"PROC go{k}()", *moves, "ENDPROC", "ENDMODULE", ""])
    return files


def krl(states) -> dict[str, str]:
    """Modules and data lists, tool and base in $config.dat."""
    files = {"$config.dat": "DEFDAT $CONFIG\nTOOL_DATA[1]={X 97.4,Y 0,Z 223.1,A 0,B 45.03,C 0}\n"
                            "BASE_DATA[1]={X 300,Y 800,Z 230,A 90,B 0,C 0}\nENDDAT\n"}  # fmt: skip
    for k, part in enumerate(states):
        data = [
            f"DECL E6POS XP{i}={state}\nDECL FDAT FP{i}={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}}"
            for i, state in enumerate(part)
        ]
        files[f"m{k}.dat"] = "\n".join([f"DEFDAT m{k}", *data, "ENDDAT", ""])
        moves = [f"FDAT_ACT=FP{i}\nLIN XP{i}" for i in range(len(part))]
        files[f"m{k}.src"] = "\n".join([f"DEF m{k}( )", *moves, "END", ""])
    return files


def fanuc(states) -> dict[str, str]:
    """Programs, and a listing of tools and frames."""
    group = "     [1,1] =\n  Group: 1   Config: N D B, 0, 0, 0\n  X: {} Y: {} Z: {}\n  W: {} P: {} R: {}\n"
    tables = (("TOOL", (97.4, 0, 223.1, 0, 45.03, 0)), ("FRAME", (300, 800, 230, 0, 0, 90)))
    files = {"sysframe.va": "".join(f"[*SYSTEM*]$MNU{what}  Storage: CMOS\n{group.format(*f)}" for what, f in tables)}
    for k, part in enumerate(states):
        moves = [f"  {i}:L P[{i}] 100mm/sec FINE ;" for i in range(1, len(part) + 1)]
        data = [f"P[{i}]{{\n   GP1:\n\tUF : 1, UT : 1,\t{state}\n}};" for i, state in enumerate(part, start=1)]
        files[f"m{k}.ls"] = "\n".join([f"/PROG m{k}", "/MN", *moves, "/POS", *data, "/END", ""])
    return files


def urscript(states) -> dict[str, str]:
    """Scripts that set their tool; each target is told by the one before."""
    files = {}
    for k, part in enumerate(states):
        moves = [f"  movel(pose_trans(fixture, {state}))" for state in part]
        head = [f"def m{k}():", "  set_tcp(p[0.0974,0,0.2231,0,0.7859,0])", "  fixture = p[0.3,0.8,0.23,0,0,1.5707963]"]
        files[f"m{k}.script"] = "\n".join([*head, *moves, "end", ""])
    return files


def main() -> None:
    """Print the processor's and the clock's seconds by maker."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--targets", type=int, default=10_000)
    asked.add_argument("--files", type=int, default=20)
    asked.add_argument("--makers", nargs="*", default=["rapid", "krl", "fanuc", "urscript"])
    options = asked.parse_args()
    rng = np.random.default_rng(5)
    ways = np.cumsum(rng.normal(0, 0.01, (options.targets, 6)), axis=0) * (1, 0.3, 0.3, 1, 0.2, 1)
    ways = np.clip(ways, -1, 1) * (1.2, 0.6, 0.6, 1.2, 0.5, 1.5) + (0, 0, 0, 0, 0.9, 0)
    for maker, state, project in (
        ("rapid", as_rapid, rapid), ("krl", as_krl, krl), ("fanuc", as_fanuc, fanuc), ("urscript", as_urscript, urscript)
    ):  # fmt: skip
        if maker not in options.makers:
            continue
        arm = corrector(ERRORS)
        texts = [state(q, TOOLS["gun"], FRAMES["fixture"], arm) for q in ways]
        files = {name: text.encode() for name, text in project(np.array_split(np.array(texts), options.files)).items()}
        for told, errors in (("corrected", ERRORS), ("nothing", {})):
            arm = corrector(errors)
            begun, clock = time.process_time(), time.perf_counter()
            programs, _ = read_project(files, Path())
            read = time.process_time() - begun
            done = filtered(programs, arm, FilterSettings({}, {}, start=tuple(ways[0])))
            spent, passed = time.process_time() - begun, time.perf_counter() - clock
            same = sum(done.files[name] == content for name, content in files.items())
            outcomes = dict(Counter(row.outcome for row in done.rows))
            print(f"{maker} {told}: {outcomes}, {same} of {len(files)} files as before; {spent:.1f} s of the processor "
                  f"({read:.1f} to read), {passed:.1f} by the clock", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
