"""Reads a KRL programme of scanmotion back, by a grammar of its own: a line unknown is an error."""

import re
from dataclasses import dataclass, field

import numpy as np

AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
NUMBER = r"-?\d+\.\d+"
HEAD = [
    r"&ACCESS RVP", r"&REL 1", r"&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe",
    r"&PARAM EDITMASK = \*", r"&COMMENT [\w ,.-]+",
]  # fmt: skip
SETTINGS = [
    "INTERRUPT ON 3", "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )", "BAS (#INITMOV,0 )",
    "BAS (#ACC_PTP,50 )", "$TOOL=FSCANNER", "$BASE=$ROBROOT", "$ADVANCE=3", "$APO.CPTP=50", "$APO.CDIS=0.5",
]  # fmt: skip


@dataclass
class Move:
    """PTP, LIN, SPTP or WAIT as it stands in a fold."""

    kind: str
    values: dict = field(default_factory=dict)
    about: str = ""
    """C_PTP, C_DIS or nothing."""
    percent: float = 0.0
    speed: float = 0.0
    t: float = 0.0
    """Since the start of its fold [s]; for SPTP and WAIT."""

    @property
    def joints(self):
        return np.array([self.values[a] for a in AXES])


@dataclass
class Fold:
    title: str
    moves: list


@dataclass
class Programme:
    start: np.ndarray
    tool: dict
    folds: list
    remarks: list


def aggregate(text):
    """{A1 1.0,A2 2.0} as a dictionary; a name that is there twice is an error."""
    assert re.fullmatch(r"\{[A-Z]\d? " + NUMBER + r"(,[A-Z]\d? " + NUMBER + r")*\}", text), text
    pairs = [item.split() for item in text[1:-1].split(",")]
    assert len(dict(pairs)) == len(pairs), text
    values = {k: float(v) for k, v in pairs}
    # KRL computes with 32 bits.
    assert all(abs(np.float32(v) - v) < 2e-5 * max(1, abs(v) / 180) for v in values.values()), text
    return values


def text_of(path):
    data = path.read_bytes()
    data.decode("ascii")
    assert data.count(b"\r\n") == data.count(b"\n") == data.count(b"\r")
    assert data.endswith(b"\r\n")
    return data.decode("ascii").split("\r\n")[:-1]


def read_programme(folder, name):
    lines = read_data(folder / f"{name}.dat", name)
    start = next(aggregate(x[len("DECL E6AXIS XSTART=") :]) for x in lines if x.startswith("DECL E6AXIS"))
    tool = next(aggregate(x[len("DECL FRAME FSCANNER=") :]) for x in lines if x.startswith("DECL FRAME"))
    assert list(start) == list(AXES) and list(tool) == list("XYZABC")
    body = read_module(folder / f"{name}.src")
    full = []
    for line in body:
        call = re.fullmatch(r"(\w+) \( \)", line)
        full += read_module(folder / f"{call[1]}.src") if call else [line]
    return Programme(
        start=np.array(list(start.values())), tool=tool, folds=folds(full),
        remarks=[x for x in full if re.match(r"; ", x)],
    )  # fmt: skip


def read_data(path, name):
    lines = text_of(path)
    assert lines[0] == "&ACCESS RVP" and lines[3] == f"DEFDAT {name} PUBLIC" and lines[-1] == "ENDDAT"
    for line in lines[4:-1]:
        assert re.fullmatch(
            r";.*|EXT BAS \(BAS_COMMAND :IN,REAL :IN \)|DECL INT SUCCESS|"
            r"DECL (E6AXIS|FRAME) [A-Z]\w{0,23}=\{.*\}",
            line,
        ), line
    return lines


def read_module(path):
    lines = text_of(path)
    for pattern, line in zip(HEAD, lines, strict=False):
        assert re.fullmatch(pattern, line), line
    assert re.fullmatch(r"[A-Za-z_]\w*", path.stem) and len(path.stem) <= 24
    assert lines[len(HEAD)] == f"DEF {path.stem} ( )" and lines[-1] == "END"
    assert sum(x.startswith("DEF ") for x in lines) == 1 and lines.count("END") == 1
    return lines[len(HEAD) + 1 : -1]


def folds(lines):
    """Operations in order; folds must be closed one after the other."""
    found, current, state = [], None, {"percent": 0.0, "speed": 0.0, "spline": None}
    for line in lines:
        if line.startswith(";FOLD "):
            assert current is None, line
            current = Fold(title=line[6:], moves=[])
        elif line.startswith(";ENDFOLD "):
            assert state["spline"] is None
            if not current.title.startswith(("INI", "SETTINGS", "START")):
                found.append(current)
            current = None
        elif line.startswith("; "):
            assert current is None
        else:
            take(line, current.moves, state)
    assert current is None
    return found


def take(line, moves, state):
    """One line of code."""
    if line in SETTINGS or line == "PTP XSTART":
        return
    if m := re.fullmatch(r"\$OUT\[(\d+)\]=(TRUE|FALSE)", line):
        assert state["spline"] is None
        moves.append(Move("OUT", {int(m[1]): m[2] == "TRUE"}))
        return
    if state["spline"] is not None:
        in_spline(line, moves, state)
    elif m := re.fullmatch(r"BAS \(#VEL_PTP,(\d+) \)", line):
        state["percent"] = int(m[1])
        assert 1 <= state["percent"] <= 100
    elif m := re.fullmatch(r"\$(VEL\.CP|ACC\.CP|VEL\.ORI[12]|ACC\.ORI[12])=(\d+(?:\.\d+)?)", line):
        if m[1] == "VEL.CP":
            state["speed"] = float(m[2])
    elif m := re.fullmatch(r"PTP (\{.*\})( C_PTP)?", line):
        values = aggregate(m[1])
        assert list(values) == list(AXES)
        moves.append(Move("PTP", values, (m[2] or "").strip(), percent=state["percent"]))
    elif m := re.fullmatch(r"LIN (\{.*\})( C_DIS)?", line):
        values = aggregate(m[1])
        assert list(values) == [*"XYZABC", "E1"]
        moves.append(Move("LIN", values, (m[2] or "").strip(), speed=state["speed"]))
    elif m := re.fullmatch(rf"WAIT SEC ({NUMBER})", line):
        moves.append(Move("WAIT", t=float(m[1])))
    else:
        assert line == "PTP_SPLINE", line
        state["spline"] = {"points": [], "parts": None}


def in_spline(line, moves, state):
    spline = state["spline"]
    if m := re.fullmatch(r" SPTP (\{.*\})", line):
        values = aggregate(m[1])
        assert list(values) == list(AXES)
        spline["points"].append(values)
    elif line == " TIME_BLOCK START":
        assert spline["parts"] is None and len(spline["points"]) == 1
        spline["parts"] = [0.0]
    elif m := re.fullmatch(rf" TIME_BLOCK PART = ({NUMBER})", line):
        assert float(m[1]) > 0
        spline["parts"].append(float(m[1]))
        assert len(spline["parts"]) == len(spline["points"])
    elif m := re.fullmatch(rf" TIME_BLOCK END = ({NUMBER})", line):
        share = np.cumsum(spline["parts"])
        assert abs(share[-1] - 100) < 1e-6
        for values, s in zip(spline["points"], share, strict=True):
            moves.append(Move("SPTP", values, t=float(m[1]) * s / 100))
        spline["ended"] = True
    else:
        assert line == "ENDSPLINE" and spline["ended"], line
        state["spline"] = None
