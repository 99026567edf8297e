"""An interpreter of robot programs that shares nothing with calflow: which poses do moves go to, and where does the robot land?

Each language is turned into expressions of Python's and these are evaluated; the robot is plain numpy in modified DH. Lengths are
in mm in the programs, in m here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

# alpha, a, d, theta of the arm's nominal figures [rad, m], and what its true ones are more
NOMINAL = np.column_stack(
    [
        np.deg2rad((0, -90, 0, -90, 90, -90)), (0, 0.312, 1.075, 0.225, 0, 0), (0.67, 0, 0, 1.28, 0, 0.215),
        np.deg2rad((0, -90, 0, 0, 0, 180)),
    ]
)  # fmt: skip
FIGURES = ("alpha", "a", "d", "theta")
ERRORS = {
    "joint2.alpha": -1.2e-3, "joint2.a": -0.4e-3, "joint2.theta": 2.0e-3, "joint3.alpha": 0.4e-3, "joint3.a": -0.6e-3,
    "joint3.theta": -0.9e-3, "joint4.alpha": -0.6e-3, "joint4.a": -0.3e-3, "joint4.d": 0.5e-3, "joint4.theta": 1.1e-3,
    "joint5.alpha": 0.6e-3, "joint5.a": -0.2e-3, "joint5.theta": 0.9e-3, "joint6.a": -0.3e-3, "joint6.theta": 0.7e-3,
}  # fmt: skip


def transform(place=(0.0, 0.0, 0.0), turn=None) -> np.ndarray:
    """A transform (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, 3] = place
    if turn is not None:
        matrix[:3, :3] = turn.as_matrix()
    return matrix


def flange(q, errors=()) -> np.ndarray:
    """Where the flange is at readings (..., 6) [rad], with errors by name."""
    figures, q = NOMINAL.copy(), np.asarray(q)
    for name, value in dict(errors).items():
        joint, figure = name.split(".")
        figures[int(joint[-1]) - 1, FIGURES.index(figure)] += value
    pose = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for k, (alpha, a, d, theta) in enumerate(figures):
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta + q[..., k]), np.sin(theta + q[..., k])
        about_x = np.array([[1, 0, 0, a], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]])
        about_z = np.tile(transform((0, 0, d)), (*q.shape[:-1], 1, 1))
        about_z[..., :2, :2] = np.stack([np.stack([ct, -st], -1), np.stack([st, ct], -1)], -2)
        pose = pose @ about_x @ about_z
    return pose


def difference(pose, other) -> np.ndarray:
    """By how much poses (..., 4, 4) differ from another [m, rad]."""
    turned = Rotation.from_matrix((other[:3, :3].T @ pose[..., :3, :3]).reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([pose[..., :3, 3] - other[:3, 3], turned.reshape(*pose.shape[:-2], 3)], axis=-1)


def readings(pose, near) -> np.ndarray:
    """The readings (k, 6) near others (n, 6) at which the controller has its flange at a pose, by Newton's method from each."""
    q, step = np.array(near, dtype=float), 1e-6
    for _ in range(30):
        off = difference(flange(q[:, None] + step * np.vstack([np.zeros(6), np.eye(6)])), pose)
        if np.abs(off[:, 0]).max() < 1e-12:
            break
        slopes = (off[:, 1:] - off[:, :1]).transpose(0, 2, 1) / step
        q = q - np.clip(np.linalg.solve(slopes, off[:, 0, :, None])[..., 0], -0.2, 0.2)
    return q[np.abs(difference(flange(q), pose)).max(axis=1) < 1e-9]


def with_ends(files: dict[str, str]) -> dict[str, str]:
    """Files whose lines all end alike."""
    return {file: re.sub(r"\r\n?", "\n", text) for file, text in files.items()}


@dataclass(frozen=True)
class Visit:
    """A move: the file, its line, how its place is called there, and where it brings flange and tool, or to which readings."""

    file: str
    line: int
    name: str
    flange: np.ndarray | None
    tool: np.ndarray
    joints: np.ndarray | None = None


MOVING = r"(?im)\b(Move(?:J|L|AbsJ|C|JDO|LDO)|ArcL|ArcLStart|SpotL|SpotJ|TriggL)\s+([^;]*);"
TOOL_AT = {"movec": 4, "triggl": 4, "arcl": -1, "arclstart": -1, "spotl": -1, "spotj": -1}  # of arguments; 3 of others


def rapid(files: dict[str, str]) -> list[Visit]:
    """The moves of RAPID modules, one after the other as they stand, in the order of the files' names."""
    files = with_ends(files)
    constants: dict[str, object] = {"true": True, "false": False, "tool0": tool_data([[0, 0, 0], [1, 0, 0, 0]])}
    constants["wobj0"] = work_object([[0, 0, 0], [1, 0, 0, 0]], [[0, 0, 0], [1, 0, 0, 0]])
    names = {file: dict[str, object]() for file in files}
    records = {
        name.lower(): [component.lower().split() for component in inner.split(";") if component.strip()]
        for text in files.values()
        for name, inner in re.findall(r"(?ims)^\s*RECORD\s+(\w+)(.*?)ENDRECORD", re.sub(r"![^\n]*", "", text))
    }
    moves, stated, code = [], [], {}
    for file, text in sorted(files.items()):
        plain = re.sub(r'(?m)"[^"\r\n]*"|![^\n]*', lambda m: '""' if m.group().startswith('"') else "", text)
        declared = re.finditer(
            r"(?is)\b(LOCAL\s+|TASK\s+)?(?:PERS|CONST|VAR)\s+(\w+)\s+(\w+)(\{[\d, ]+\})?\s*:=(.*?);", plain
        )
        stated += [(file, *one.groups()) for one in declared]
        code[file] = plain
        for found in re.finditer(MOVING, plain):
            moves.append((file, found.start(), *found.groups()))
    tries = len(stated) ** 2
    while stated:  # until all are known that others are made of
        file, local, kind, name, dimensions, value = stated.pop(0)
        tries -= 1
        scope = names[file] if (local or "").strip().upper() == "LOCAL" else constants
        try:
            known = evaluated(value, {**constants, **names[file]})
        except NameError:
            if tries < 0:
                raise
            stated.append((file, local, kind, name, dimensions, value))
            continue
        kind = kind.lower()
        if kind in ("tooldata", "wobjdata"):
            known = tool_data(known[1]) if kind == "tooldata" else work_object(*known[3:])
        scope[name.lower()] = (
            [recorded(kind, one, records) for one in known] if dimensions else recorded(kind, known, records)
        )
    visits, everything = [], "\n".join(code.values())
    for file, start, word, arguments in moves:
        line = 1 + code[file][:start].count("\n")
        turned = re.sub(r"(?i)\\(R[xyz]):=", r",\1=", arguments)
        parts = separated(re.sub(r"(?i)\\WObj:=", ",wobj=", turned))
        frame = next((part[5:] for part in parts if part.startswith("wobj=")), "wobj0")
        plain = [re.split(r"\\", part)[0].strip() for part in parts if not part.startswith("wobj=")]
        known = {**constants, **names[file]}
        tool_name = plain[TOOL_AT.get(word.lower(), 3)]
        for place in plain[: 2 if word.lower() == "movec" else 1]:
            for meant in meanings((place, tool_name, frame), code[file], everything, start, known):
                at = evaluated(meant[0], known)
                if word.lower() == "moveabsj":
                    visits.append(Visit(file, line, place, None, np.eye(4), np.deg2rad(at[0])))
                else:
                    tool, placed = (evaluated(one, known) for one in meant[1:])
                    pose = placed @ robtarget(at)
                    visits.append(Visit(file, line, place, pose @ np.linalg.inv(tool), tool))
    return visits


def recorded(kind: str, value, records: dict[str, list[list[str]]]):
    """A value with its components by name where it is a record, or has records inside."""
    if kind not in records:
        return value
    parts = zip(records[kind], value, strict=True)
    return type(kind, (), {name: recorded(inner, part, records) for (inner, name), part in parts})


def meanings(parts: tuple[str, ...], code: str, everything: str, start: int, known) -> list[tuple[str, ...]]:
    """What parts of a move that begins somewhere mean each time: by calls of its routine, loops, and what names are given."""
    routine = [*re.finditer(r"(?im)^\s*(?:LOCAL\s+)?PROC\s+(\w+)\s*\(([^)]*)\)", code[:start])][-1]
    given_always = (part.partition("\\")[0] for part in separated(routine.group(2)))
    names = [part.split()[-1].lower() for part in given_always if part]
    calls = re.findall(rf"(?im)^\s*{routine.group(1)}\s+([^;:]*);", everything)
    given = [[re.sub(r"\\.*", "", part) for part in separated(call)] for call in calls] if routine.group(2) else []
    every = [dict(zip(names, arguments, strict=False)) for arguments in given] or [{}]
    ways: dict[str, list[str]] = {}
    for name, first, last, array in re.findall(
        r"(?i)\bFOR (\w+) FROM (\d+) TO (?:(\d+)|Dim\((\w+) ?, ?1\)) DO", everything
    ):
        ways[name.lower()] = [str(k) for k in range(int(first), 1 + (int(last) if last else len(known[array.lower()])))]
    for name, other in re.findall(r"(?im)^\s*(\w+)\s*:=\s*(\w+)\s*;", code):
        if other.lower() in known:
            ways.setdefault(name.lower(), []).append(other)
    for name, others in ways.items():
        if any(
            re.search(rf"(?i)\b{name}\b", text)
            for text in (parts[0], *(text for one in every for text in one.values()))
        ):
            every = [{**one, name: other} for one in every for other in others]

    def spelled(part: str, one: dict[str, str]) -> str:
        return re.sub(r"\b[A-Za-z]\w*", lambda m: one.get(m.group().lower(), m.group()), part)

    # twice, since what is passed on may itself be counted by a loop
    return [tuple(spelled(spelled(part, one), one) for part in parts) for one in every]


def separated(text: str) -> list[str]:
    """What stands between commas that are in no brackets."""
    depth, found = 0, [""]
    for letter in text:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            found.append("")
        else:
            found[-1] += letter
    return [one.strip() for one in found]


def evaluated(expression: str, names: dict[str, object]) -> object:
    """An expression of RAPID's by Python: names in lower case, indices from 1."""
    text = re.sub(r"\{([\d, ]+)\}", lambda m: "".join(f"[{int(k) - 1}]" for k in m.group(1).split(",")), expression)
    return eval(
        text.strip().lower(), {"__builtins__": {}, "offs": offs, "reltool": reltool}, names
    )  # texts of the tests' own


def pose_of(place, turn) -> np.ndarray:
    return transform(1e-3 * np.array(place, dtype=float), Rotation.from_quat(turn, scalar_first=True))


def tool_data(pose) -> np.ndarray:
    return pose_of(*pose)


def work_object(user, own) -> np.ndarray:
    return pose_of(*user) @ pose_of(*own)


def robtarget(value) -> np.ndarray:
    return value if isinstance(value, np.ndarray) else pose_of(*value[:2])


def offs(target, x, y, z) -> np.ndarray:
    moved = robtarget(target).copy()
    moved[:3, 3] += 1e-3 * np.array([x, y, z])
    return moved


def reltool(target, x, y, z, rx=0.0, ry=0.0, rz=0.0) -> np.ndarray:
    turn = Rotation.from_euler("x", rx, True) * Rotation.from_euler("y", ry, True) * Rotation.from_euler("z", rz, True)
    return robtarget(target) @ transform(1e-3 * np.array([x, y, z]), turn)


def turned(figures, order: str) -> np.ndarray:
    """A pose of x, y, z in mm and three angles in degrees."""
    return transform(1e-3 * np.array(figures[:3]), Rotation.from_euler(order, figures[3:], degrees=True))


def krl(files: dict[str, str]) -> list[Visit]:
    """The moves of KRL modules: those of data lists are known in their module, those of $config.dat everywhere."""
    files = with_ends(files)
    everywhere: dict[str, object] = {"$NULLFRAME": np.eye(4), "$WORLD": np.eye(4), "TOOL_DATA[0]": np.eye(4)}
    everywhere["BASE_DATA[0]"] = np.eye(4)
    own: dict[str, dict[str, object]] = {}
    code = []
    for file, text in sorted(files.items()):
        if not file.lower().endswith((".src", ".dat")):
            continue
        stem = file.rpartition(".")[0].lower()
        lines = re.sub(r";[^\n]*", "", text).split("\n")
        if file.lower().endswith(".dat"):
            arrays = {name.upper() for name in re.findall(r"(?im)^\s*DECL GLOBAL \w+ (\w+)\[", text)}
            for line in lines:
                found = re.match(r"(?i)\s*(?:(DECL)\s+)?(GLOBAL\s+)?(?:\w+\s+)?([$\w]+(?:\[\d+\])?)\s*=\s*(.*)", line)
                if found:
                    shared = (
                        found.group(2) or stem.endswith("$config") or found.group(3).upper().partition("[")[0] in arrays
                    )
                    scope = everywhere if shared else own.setdefault(stem, {})
                    scope[found.group(3).upper()] = aggregate(found.group(4).strip())
        else:
            code.append((file, stem, lines))
    visits = []
    for file, stem, lines in code:
        known = everywhere | own.get(stem, {})
        tool = base = outside = None
        for number, line in enumerate(lines, start=1):
            word, _, settings = re.sub(r"(?i)\s+WITH\s+", "\0", line.strip(), count=1).partition("\0")
            if re.match(r"(?i)(GLOBAL\s+)?DEF\s", word):
                routine = word
            if found := re.match(r"(?i)BAS\s*\(\s*#(TOOL|BASE)\s*,\s*(\d+)\s*\)", word):
                here = operands(f"{found.group(1)}_DATA[{found.group(2)}]", known)
                tool, base = (here, base) if found.group(1).upper() == "TOOL" else (tool, here)
            elif found := re.match(r"(?i)FDAT_ACT\s*=\s*(\w+)", word):
                data = known[found.group(1).upper()]
                tool = operands(f"TOOL_DATA[{data['TOOL_NO']}]", known)
                base = operands(f"BASE_DATA[{data['BASE_NO']}]", known)
            elif found := re.match(r"(?i)\$(TOOL|BASE)\s*=\s*(.*)", word):
                here = operands(found.group(2), known)
                tool, base = (here, base) if found.group(1).upper() == "TOOL" else (tool, here)
            elif word.upper() == "SPLINE":
                outside, (tool, base) = (tool, base), with_settings(settings, tool, base, known)
            elif word.upper().startswith("ENDSPLINE"):
                tool, base = outside
            elif found := re.match(r"(?i)S?(PTP|LIN|CIRC|SPL)\s+(.*)", word):
                of_move, at_base = with_settings(settings, tool, base, known)
                parts = separated(found.group(2))
                asked = (
                    re.sub(r"(?i)\s+C_\w+", "", part).strip()
                    for part in parts[: 2 if found.group(1).upper() == "CIRC" else 1]
                )
                for place in (meant for one in asked for meant in krl_meanings(one, lines, known, routine, code)):
                    at = known[place.upper()] if re.fullmatch(r"\w+(\[\d+\])?", place) else aggregate(place)
                    if isinstance(at, dict) and "A1" in at:
                        joints = np.deg2rad([at[f"A{k}"] for k in range(1, 7)])
                        visits.append(Visit(file, number, place, None, np.eye(4), joints))
                    else:
                        pose = at_base @ operands(place, known)
                        visits.append(Visit(file, number, place, pose @ np.linalg.inv(of_move), of_move))
    return visits


def with_settings(settings: str, tool, base, known):
    """Tool and base of a move that sets its own, or those in force."""
    if found := re.search(r"(?i)\$TOOL\s*=\s*STOOL2\((\w+)\)", settings):
        tool = operands(f"TOOL_DATA[{known[found.group(1).upper()]['TOOL_NO']}]", known)
    if found := re.search(r"(?i)\$BASE\s*=\s*SBASE\((\w+)\.BASE_NO\)", settings):
        base = operands(f"BASE_DATA[{known[found.group(1).upper()]['BASE_NO']}]", known)
    return tool, base


def krl_meanings(place: str, lines: list[str], known, routine: str, code) -> list[str]:
    """What the place of a move means at each time: by calls of its routine, loops over an array, and what names are given."""
    ways: dict[str, list[str]] = {}
    head, _, parameters = routine.rstrip(") ").partition("(")
    for k, parameter in enumerate(part.partition(":")[0].strip() for part in parameters.split(",") if part.strip()):
        calls = (re.match(rf"(?i)\s*{head.split()[-1]}\s*\((.*)\)\s*$", one) for _, _, every in code for one in every)
        ways[parameter] = [separated(call.group(1))[k] for call in calls if call]
    for line in lines:
        if found := re.match(r"(?i)\s*FOR\s+(\w+)\s*=\s*(\d+)\s+TO\s+(\d+)", line):
            ways[found.group(1)] = [str(k) for k in range(int(found.group(2)), 1 + int(found.group(3)))]
        elif (found := re.match(r"\s*(\w+)\s*=\s*(\w+)\s*$", line)) and found.group(2).upper() in known:
            ways.setdefault(found.group(1).upper(), []).append(found.group(2))  # in whatever case it is written
    every = [place]
    for name, others in ways.items():
        if re.search(rf"(?i)\b{name}\b", place):
            every = [re.sub(rf"(?i)\b{name}\b", other, one) for one in every for other in others]
    return every


def aggregate(text: str) -> object:
    """{X 1,Y 2} as components by name, else the text."""
    if not text.startswith("{") or text.count("{") > 1:
        return text
    inner = text[1 : text.index("}")].partition(":")[2] or text[1 : text.index("}")]
    pairs = (part.split(None, 1) for part in separated(inner))
    return {
        name.upper(): float(value) if re.fullmatch(r"[-+\d.eE]+", value) and "NO" not in name.upper() else value
        for name, value in pairs
    }


def operands(text: str, known) -> np.ndarray:
    """What `:` makes of frames and targets."""
    pose = np.eye(4)
    for part in re.split(r":(?![^{]*\})", text):
        value = known[part.strip().upper()] if part.strip()[0] != "{" else aggregate(part.strip())
        value = operands(value, known) if isinstance(value, str) else value
        pose = pose @ (value if isinstance(value, np.ndarray) else turned([value[one] for one in "XYZABC"], "ZYX"))
    return pose


def fanuc(files: dict[str, str]) -> list[Visit]:
    """The moves of LS programs, with the tools and frames of listings."""
    files = with_ends(files)
    tables: dict[tuple[str, int], np.ndarray] = {("TOOL", 0): np.eye(4), ("FRAME", 0): np.eye(4)}
    number = r":\s*(-?[\d.]+)\s*"
    entry = rf"\[1,(\d+)\] =[^\[]*?X{number}Y{number}Z{number}W{number}P{number}R{number}"
    for file, text in files.items():
        if file.lower().endswith(".va"):
            for part in re.split(r"\[\*", text)[1:]:
                what = re.match(r"SYSTEM\*\]\$MNU(TOOL|FRAME) ", part)
                for found in re.finditer(entry, part) if what else ():
                    tables[what.group(1), int(found.group(1))] = turned([float(v) for v in found.groups()[1:]], "xyz")
    visits = []
    for file, text in sorted(files.items()):
        if not text.startswith("/PROG"):
            continue
        code, _, positions = text.partition("/POS")
        for line, statement in enumerate(code.split("\n"), start=1):
            found = re.match(r"\s*\d+:\s*[JL]\s+P\[(\d+)", statement)
            if not found:
                continue
            part = re.search(rf"(?s)P\[{found.group(1)}\b[^{{]*\{{(.*?)\}}", positions).group(1)
            frame, tool = (int(re.search(rf"{one} : (\d+)", part).group(1)) for one in ("UF", "UT"))
            if "CONFIG" in part:
                values = [float(re.search(rf"\b{one}\s*=\s*(-?[\d.]+)", part).group(1)) for one in "XYZWPR"]
                pose = tables["FRAME", frame] @ turned(values, "xyz")
                at = tables["TOOL", tool]
                visits.append(Visit(file, line, f"P[{found.group(1)}]", pose @ np.linalg.inv(at), at))
            else:
                joints = [float(re.search(rf"\bJ{k}\s*=\s*(-?[\d.]+)", part).group(1)) for k in range(1, 7)]
                visits.append(Visit(file, line, f"P[{found.group(1)}]", None, np.eye(4), np.deg2rad(joints)))
    return visits


class Pose(list):
    """Six figures of URScript's pose."""


def urscript(files: dict[str, str]) -> list[Visit]:
    """The moves of scripts in one function, by Python's own evaluation of their expressions."""
    files = with_ends(files)
    visits = []
    for file, text in sorted(files.items()):
        if not file.endswith(".script"):
            continue
        state = {"tool": np.eye(4), "line": 0, "text": ""}

        def pose(value) -> np.ndarray:
            return transform(value[:3], Rotation.from_rotvec(value[3:])) if isinstance(value, list) else value

        def pose_add(a, b):
            a, b = pose(a), pose(b)
            return transform(a[:3, 3] + b[:3, 3], Rotation.from_matrix(a[:3, :3] @ b[:3, :3]))

        def set_tcp(value, state=state):
            state["tool"] = pose(value)

        def move(*places, file=file, state=state, **_):
            for value in places:
                if isinstance(value, float):  # an acceleration or a speed without its name
                    continue
                if isinstance(value, list) and not isinstance(value, Pose):
                    visits.append(Visit(file, state["line"], state["text"], None, np.eye(4), np.array(value)))
                else:
                    tool = state["tool"]
                    visits.append(Visit(file, state["line"], state["text"], pose(value) @ np.linalg.inv(tool), tool))

        functions = {
            "Pose": Pose, "set_tcp": set_tcp, "movej": move, "movel": move, "movep": move, "movec": move, "pose_add": pose_add,
            "pose_trans": lambda a, b: pose(a) @ pose(b), "pose_inv": lambda a: np.linalg.inv(pose(a)), "d2r": np.deg2rad,
            "get_inverse_kin": lambda value, qnear=None: value,
        }  # fmt: skip
        names: dict[str, object] = {}
        begun, first = "", 0  # of a call over several lines
        for number, line in enumerate(text.split("\n"), start=1):
            first = first if begun else number
            whole = f"{begun} {line.partition('#')[0].strip()}".strip()
            begun = whole if whole.count("(") > whole.count(")") else ""
            if begun or " run " in whole:
                continue
            plain = re.sub(r"\bp\[([^\]]*)\]", r"Pose([\1])", whole)
            plain = re.sub(r"^(global|local) ", "", plain)
            state |= {"line": first, "text": re.sub(r"Pose\(.*?\)", "", plain)}
            if re.match(r"\w+\s*=(?!=)", plain) or plain.startswith(("mov", "set_tcp")):
                exec(plain, {"__builtins__": {}, **functions}, names)  # texts of the tests' own
    return visits
