"""Faults planted in a programme's text, as an editor, a copy, a tired engineer or a broken transfer makes."""

import re

import numpy as np

_NUMBER = re.compile(r"(?<![\w.\[#])-?\d+\.?\d*(?![\w\]])")
_ANY_NUMBER = re.compile(r"-?\d+\.?\d*")
_REMARKS = (";", "&", "!", "#", "(*", "//")
_SETTING = re.compile(
    r"\$VEL|\$ACC|\$APO|\$ADVANCE|BAS |_SPD|TOOL_DATA|BASE_DATA|LOAD_DATA|_LOAD|_TCP|_tool|_base|speeddata|"
    r"zonedata|\$OUT|\$IN|SetDO|MaxTime|TIMER|set_|register|payload|tcp|servoj|movej|SIGNAL|TIME_BLOCK END",
    re.IGNORECASE,
)
_HANDSHAKE = re.compile(
    r"\$OUT|\$IN|WAIT|_ON|_OFF|_NOW|ScanOn|ScanOff|Now |SetDO|SetGO|PULSE|INTERRUPT|IWatch|ISleep|IDelete|"
    r"ITimer|register|digital|HALT|Stop;|popup|_CHK|_on|_off|_now|_table",
)
_WORDS = (
    ("TRUE", "FALSE"), ("FALSE", "TRUE"), ("True", "False"), ("False", "True"), (" AND ", " OR "),
    (" OR ", " AND "), (" and ", " or "), (" or ", " and "), ("NOT ", ""), ("not ", ""), (">=", "<="),
    ("<=", ">="), ("==", "<>"), (" ON ", " OFF "), (" OFF ", " ON "), ("fine", "zScan"),
    ("zScan", "fine"), (" C_PTP", ""), (" C_DIS", ""), ("IWatch", "ISleep"), ("ISleep", "IWatch"),
    ("A4 ", "A5 "), ("A1 ", "A2 "), ("E1 ", "E2 "), ("PTP ", "LIN "), ("SPTP", "PTP"), ("+", "-"),
    ("BRAKE", "CONTINUE"), ("#TOOL", "#BASE"), ("ROBROOT", "NULLFRAME"), ("SEC", "FOR"),
    ("stopj", "stopl"), ("\\T", "\\V"),
)  # fmt: skip
_LINES = {
    "krl": (
        "$OV_PRO=30", "$VEL.CP=2.0", "$ACC_AXIS[1]=30", "$VEL_AXIS[2]=50", "$BASE=$NULLFRAME",
        "$TOOL=$NULLFRAME", "HALT", "WAIT SEC 5.0", "$OUT[33]=TRUE", "$OUT[33]=FALSE", "$OUT[7]=TRUE",
        "$APO.CPTP=100", "$ADVANCE=0", "INTERRUPT OFF 4", "BAS (#VEL_PTP,10 )", "BAS (#BASE,2 )", "RETURN",
        "PTP scan_POS", "$SOFTP_END[7]=999.0", "scan_STEP=3", "scan_BAD=FALSE", "scan_N=0", "$LOAD.M=1.0",
    ),
    "rapid": (
        "VelSet 50,800;", "AccSet 30,30;", "Stop;", "WaitTime 5;", "SetDO do33,1;", "SetDO do33,0;",
        "SetDO do7,1;", "ISleep iFault;", "RETURN;", "scan_step:=3;", "bBad:=FALSE;", "StopMove;",
        "MoveAbsJ jStart,vSlow,fine,scan_tool\\WObj:=scan_base;", "IDelete iFrame;", "ClearPath;",
    ),
    "urscript": (
        "set_tcp(p[0,0,0,0,0,0])", "set_payload(10)", "halt", "sleep(5.0)", "scan_step = 3",
        "scan_bad = False",
        "write_output_boolean_register(33, True)", "write_output_boolean_register(33, False)",
        "write_output_boolean_register(35, True)", "set_standard_digital_out(5, True)", "return False",
        "stopj(2.0)", "movej(scan_start, a=0.3, v=0.1)", "scan_go(3)", "speedj([0,0,0,0,0,0], 1, 1)",
    ),
}  # fmt: skip

KINDS = (
    "digit", "sign", "units", "swap", "drop", "double", "page", "far", "setting", "handshake", "move", "word",
    "exchange", "insert", "cut", "remark", "letter", "routine",
)  # fmt: skip
"""What a fault does: see the functions below."""


def mutated(lines, kind, rng, language="krl"):
    """The lines with one fault, and a word on it; None where this place has no such fault.

    Args:
        lines: of a programme's file.
        kind: one of KINDS.
        rng: says where.
        language: krl, rapid or urscript; what a line would be written by mistake.
    """
    code = [i for i, x in enumerate(lines) if x.strip() and not x.lstrip().startswith(_REMARKS)]
    wanted = {"setting": _SETTING, "handshake": _HANDSHAKE, "move": _HANDSHAKE}.get(kind)
    places = [i for i in code if wanted is None or wanted.search(lines[i])]
    if not places:
        return None
    i = int(rng.choice(places))
    made = _FAULTS[kind](list(lines), i, code, rng, language)
    if made is None or made == list(lines):
        return None
    return made, f"{kind} at line {i + 1}: {lines[i].strip()[:90]}" + _became(lines, made, i)


def _became(lines, made, i):
    return f" -> {made[i].strip()[:90]}" if i < len(made) and made[i] != lines[i] else ""


def _with_number(lines, i, rng, change, pattern=_NUMBER):
    found = list(pattern.finditer(lines[i]))
    if not found:
        return None
    m = found[int(rng.integers(len(found)))]
    lines[i] = lines[i][: m.start()] + change(m[0]) + lines[i][m.end() :]
    return lines


def _digit(lines, i, code, rng, language):
    digits = [m.start() for m in re.finditer(r"\d", lines[i])]
    if not digits:
        return None
    at = int(rng.choice(digits))
    new = str((int(lines[i][at]) + int(rng.integers(1, 10))) % 10)
    lines[i] = lines[i][:at] + new + lines[i][at + 1 :]
    return lines


def _sign(lines, i, code, rng, language):
    return _with_number(lines, i, rng, lambda x: x[1:] if x.startswith("-") else f"-{x}")


def _units(lines, i, code, rng, language):
    """Metres for millimetres, radians for degrees, a point that slipped."""
    factor = float(rng.choice([10, 0.1, 1000, 0.001, np.pi / 180, 180 / np.pi]))
    return _with_number(lines, i, rng, lambda x: f"{float(x) * factor:.5f}" if "." in x else x + "0")


def _swap(lines, i, code, rng, language):
    j = next((k for k in code if k > i), None)
    if j is None:
        return None
    lines[i], lines[j] = lines[j], lines[i]
    return lines


def _far(lines, i, code, rng, language):
    j = int(rng.choice(code))
    lines[i], lines[j] = lines[j], lines[i]
    return lines


def _drop(lines, i, code, rng, language):
    del lines[i]
    return lines


def _double(lines, i, code, rng, language):
    lines.insert(i, lines[i])
    return lines


def _page(lines, i, code, rng, language):
    lines[i:i] = lines[max(i - 20, 0) : i]
    return lines


def _setting(lines, i, code, rng, language):
    """A percentage, a number of a signal, a tool, a base, a load, a time-out."""
    factor = float(rng.choice([0, 0.5, 1.3, 2, -1, 10]))
    change = lambda x: f"{float(x) * factor:.3f}" if "." in x else str(int(x) + int(rng.integers(1, 5)))  # noqa: E731
    return _with_number(lines, i, rng, change, _ANY_NUMBER)


def _move(lines, i, code, rng, language):
    """An output, a wait, an interrupt at another place."""
    line = lines.pop(i)
    lines.insert(int(np.clip(i + rng.choice([-5, -4, -3, -2, 2, 3, 4, 5]), 0, len(lines))), line)
    return lines


def _word(lines, i, code, rng, language):
    start = int(rng.integers(len(_WORDS)))
    order = [_WORDS[(start + k) % len(_WORDS)] for k in range(len(_WORDS))]
    for j in code[code.index(i) :]:
        for old, new in order[:8]:
            if old in lines[j]:
                lines[j] = lines[j].replace(old, new, 1)
                return lines
    return None


def _exchange(lines, i, code, rng, language):
    found = list(_NUMBER.finditer(lines[i]))
    if len(found) < 2:
        return None
    a, b = sorted(rng.choice(len(found), 2, replace=False))
    m, n = found[a], found[b]
    lines[i] = lines[i][: m.start()] + n[0] + lines[i][m.end() : n.start()] + m[0] + lines[i][n.end() :]
    return lines


def _insert(lines, i, code, rng, language):
    known = _LINES[language]
    lines.insert(i, known[int(rng.integers(len(known)))])
    return lines


def _cut(lines, i, code, rng, language):
    """The end of the file is lost, or what follows up to the end of the routine."""
    if rng.random() < 0.3:
        return lines[:i]
    end = next((k for k in code if k > i and re.match(r"END$|ENDPROC$|end$", lines[k].strip())), None)
    return None if end is None else lines[:i] + lines[end:]


def _remark(lines, i, code, rng, language):
    lines[i] = {"krl": ";", "rapid": "! ", "urscript": "# "}[language] + lines[i]
    return lines


def _letter(lines, i, code, rng, language):
    at = int(rng.integers(len(lines[i])))
    lines[i] = lines[i][:at] + lines[i][at + 1 :]
    return lines


def _routine(lines, i, code, rng, language):
    """Another routine, step or counter is named."""
    for j in code[code.index(i) :]:
        m = re.search(r"\b[SB](\d+)\b|scan_step_(\d+)|\w*[nN]ow ?\(?(\d+)|CASE (\d+)|_AT=(\d+)", lines[j])
        if m:
            at, old = next((m.start(k), m[k]) for k in range(1, 6) if m[k])
            lines[j] = lines[j][:at] + str(int(old) + int(rng.choice([-1, 1, 2]))) + lines[j][at + len(old) :]
            return lines
    return None


_FAULTS = {
    "digit": _digit, "sign": _sign, "units": _units, "swap": _swap, "drop": _drop, "double": _double,
    "page": _page, "far": _far, "setting": _setting, "handshake": _drop, "move": _move, "word": _word,
    "exchange": _exchange, "insert": _insert, "cut": _cut, "remark": _remark, "letter": _letter,
    "routine": _routine,
}  # fmt: skip


def numbers(line):
    """The numbers of a line."""
    return np.array([float(x) for x in re.findall(r"-?\d+\.?\d*", line)])
