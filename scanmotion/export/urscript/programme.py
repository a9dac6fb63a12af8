"""URScript for the arm, and IEC 61131-3 Structured Text with PLCopen's MC_PositionProfile for its table.

An arm of Universal Robots has no further axis: the table's drive runs a programme of its own. For each step
in which the table moves the arm waits until it is ready and sets an output; both begin a stated time later
and go by their own clocks. The arm follows the plan's joints by servoj, so path and times are the plan's.
The syntax follows public post-processors and notes on manuals; no controller has run these programmes.
"""

import re
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import InputError
from scanmotion.export.job import DRY_PERCENT, ExportJob, Files
from scanmotion.export.knots import spline_knots
from scanmotion.export.source import Stretch
from scanmotion.export.urscript.text import (
    AWAITED,
    FINISH,
    HEAD,
    SERVO,
    START,
    TABLE,
    TABLE_STATES,
)

UR_AXES = np.array([[0, 0, 1], [0, -1, 0], [0, -1, 0], [0, -1, 0], [0, 0, -1], [0, -1, 0]])
"""About which axes of the base the joints turn where all are zero."""
LONGEST_NAME = 24
TICK_S, LAG_MS = 0.01, 50
"""Cycle of the arm's programme [s]; how long after the signal arm and table begin [ms]."""
ARM_DEG, TABLE_DEG, LONGEST_S, SHORTEST_S, MOST_POINTS = 0.005, 0.005, 0.25, 0.03, 900
"""How far cubics through the points may be from the plan [deg], their distances [s], points of one step."""
SCAN_LONGEST_S = 0.1
"""The same where the way back after a fault leads from point to point [s]."""
BACK_RAD_S, TABLE_BACK_DEG_S, TABLE_STOP_DEG_S2 = 0.1, 15.0, 30.0
"""Speeds of the way back after a fault, and how the table halts."""
DIGITAL, REGISTERS = 7, 63
"""Signals up to 7 are digital ones of the control box, above those of a field bus: boolean registers."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ODD = re.compile(r"[^A-Za-z0-9 ._()-]")
RESERVED = frozenset(
    "AND BREAK CONTINUE DEF ELIF ELSE END FALSE GLOBAL HALT IF KILL LOCAL NOT OR PAUSE RETURN RUN SEC SYNC "
    "THREAD TRUE WHILE XOR SLEEP POPUP MOVEJ MOVEL SERVOJ".split()
)


def urscript_files(job: ExportJob) -> Files:
    """`NAME.script` for the arm and `NAME_table.st` for the drive of its table.

    Raises:
        InputError: the joints do not turn as a UR's, a name or a signal that the controller does not have, or
            a step that scans while both arm and table move.
    """
    _checked(job)
    has, facts = _signals(job), _facts(job)
    steps, calls = [], []
    for n, stretch in enumerate(job.stretches, 1):
        function, call = _step(n, stretch, job)
        steps += function
        calls += call
    lines = [*(f"# {x}" for x in _remarks(job)), *_filled(HEAD, job, facts, has), *steps]
    lines += [*_filled(START, job, facts, has), *calls, *_filled(FINISH, job, facts, has)]
    return {
        f"{job.name}.script": ("\n".join(x for x in lines if x.strip()) + "\n").encode("ascii"),
        f"{job.name}_table.st": _table(job).encode("ascii"),
    }


def _checked(job: ExportJob) -> None:
    if not _NAME.fullmatch(job.name) or len(job.name) > LONGEST_NAME or job.name.upper() in RESERVED:
        raise InputError(
            f"--name {job.name[:80]!r}: a URScript programme has up to {LONGEST_NAME} letters, digits and _, "
            "starts with a letter and is no word of the language"
        )
    if np.abs(job.arm.axes_at_zero() - UR_AXES).max() > 1e-3:
        raise InputError(
            f"the joints of {_plain(job.source.record.robot)} do not turn as a UR arm's do (along x at zero, "
            "A1 about z, A2, A3, A4, A6 about -y, A5 about -z), so URScript cannot carry them"
        )
    s = job.signals
    last = s.step_out + s.step_bits - 1 if s.step_out else 0
    used = (s.ready_in, s.done_in, s.fault_in, s.start_out, s.frame_out, s.table_ready_in, s.table_fault_in,
            s.table_start_out, last)  # fmt: skip
    if max(used) > REGISTERS:
        raise InputError(f"signal {max(used)}: an arm of Universal Robots has the signals 1 to {REGISTERS}")
    if not (s.table_ready_in and s.table_start_out and s.table_fault_in):
        raise InputError(
            "the table of such an arm has a drive of its own: programme.table_ready_in, table_fault_in and "
            "table_start_out are needed"
        )
    for stretch in job.stretches:
        if stretch.operation.scanning and _moves(stretch.q[:, :6]) and _moves(stretch.q[:, 6:]):
            raise InputError(
                f"operation {stretch.operation.index} ({stretch.operation.kind}) scans while arm and table "
                "move; an arm and a drive with clocks of their own have no common way back after a fault: "
                "plan with --motion stops and a table that is not endless"
            )


def _plain(text: str) -> str:
    return _ODD.sub("_", text)[:60]


def _moves(q: np.ndarray) -> bool:
    """Whether anything moves by as much as the programme's last digits."""
    return bool(np.ptp(np.rad2deg(q), axis=0).max() >= 1e-4)


def _out(signal: int, *, on: bool) -> str:
    how = "set_standard_digital_out" if signal <= DIGITAL else "write_output_boolean_register"
    return f"{how}({signal}, {on})"


def _in(signal: int) -> str:
    return f"{'get_standard_digital_in' if signal <= DIGITAL else 'read_input_boolean_register'}({signal})"


def _signals(job: ExportJob) -> frozenset[str]:
    s, has = job.signals, {"tfault"}
    if s.step_out:
        has.add("word")
    if not job.dry_run:
        named = {"ready": s.ready_in, "done": s.done_in, "fault": s.fault_in, "start": s.start_out, "scan": 1}
        has |= {word for word, signal in named.items() if signal}
        has |= {"frame"} if s.frame_out and not s.frame_in else set()
    return frozenset(has)


def _awaited(signal: int, seconds: float, text: str) -> str:
    return AWAITED.format(signal=_in(signal), seconds=f"{seconds:g}", text=text)


def _facts(job: ExportJob) -> dict[str, str]:
    """What the templates of the text have in braces."""
    s, every = job.signals, 1 / job.source.record.process.fps
    terms = ", ".join(SERVO[1].format(d="d", i=i) for i in range(6))
    bits = range(s.step_bits) if s.step_out else ()
    return {
        "start": _six(job.source.trajectory.q[0]), "near": f"{np.deg2rad(s.start_tolerance_deg):.6f}",
        "word": "\n".join(
            "    " + _out(s.step_out + i, on=True).replace("True", f"bits[{i}]") for i in bits
        ),
        "servo": SERVO[0].format(terms=terms), "lag": f"{LAG_MS / 1e3:g}",
        "half": f"{every / 2:.5f}", "every": f"{every:.5f}",
        "frame_on": _out(s.frame_out, on=True), "frame_off": _out(s.frame_out, on=False),
        "fault_in": _in(s.fault_in), "table_fault_in": _in(s.table_fault_in),
        "table_ready_in": _in(s.table_ready_in), "table_start_on": _out(s.table_start_out, on=True),
        "table_start_off": _out(s.table_start_out, on=False),
        "start_on": _out(s.start_out, on=True), "start_off": _out(s.start_out, on=False),
        "ready": _awaited(s.ready_in, s.ready_timeout_s,
                          f"scanner not ready: input {s.ready_in} not on within {s.ready_timeout_s:g} s"),
        "done": _awaited(s.done_in, s.done_timeout_s,
                         f"scanner not done: input {s.done_in} not on within {s.done_timeout_s:g} s"),
        "table_ready": _awaited(s.table_ready_in, s.ready_timeout_s,
                                f"the table is not where the step begins: input {s.table_ready_in} not on"),
        "table_back": _awaited(s.table_ready_in, s.ready_timeout_s + _back_seconds(job),
                               f"the table is not back at the step's start: input {s.table_ready_in} not on"),
        "tcp": _pose(job.X_FS), "mass": f"{job.mass:.3f}",
        "centre": "[" + ", ".join(f"{v + 0.0:.5f}" for v in job.centre_of_mass) + "]",
    }  # fmt: skip


def _back_seconds(job: ExportJob) -> float:
    """How long the drive's longest way back to the start of a step takes [s]."""
    turns = [float(np.rad2deg(np.ptp(x.q[:, 6]))) for x in job.stretches if x.operation.scanning]
    return float(np.ceil(max(turns, default=0.0) / TABLE_BACK_DEG_S))


def _six(q: np.ndarray) -> str:
    return "[" + ", ".join(f"{v + 0.0:.6f}" for v in np.round(q[:6], 6)) + "]"


def _pose(X: np.ndarray) -> str:
    values = [*X[:3, 3], *Rotation.from_matrix(X[:3, :3]).as_rotvec()]
    return "p[" + ", ".join(f"{v + 0.0:.6f}" for v in values) + "]"


def _filled(template: str, job: ExportJob, facts: dict[str, str], has: frozenset[str]) -> list[str]:
    lines = []
    for line in template.split("\n"):
        if line.startswith("?"):
            word, line = line[1:].split(" ", 1)
            if word not in has:
                continue
        lines += line.format(**facts).replace("@", job.name).split("\n")
    return lines


def _remarks(job: ExportJob) -> list[str]:
    s, q = job.signals, np.rad2deg(job.source.trajectory.q[:, 6])
    told = [
        "WARNING: no controller has run this programme. Try it in URSim first, then at reduced speed.",
        f"part {_plain(job.source.record.part)}, robot {_plain(job.source.record.robot)}, "
        f"{_plain(job.source.record.software)}",
        f"servoj: path and times of the plan, {job.source.trajectory.duration:.2f} s in all.",
        f"The table runs {job.name}_table.st in its own drive, from {q.min():.1f} to {q.max():.1f} deg.",
        f"Signals up to {DIGITAL} are the control box's digital ones, others registers of a field bus.",
        "ArmRuns, an output of the installation that is high while this runs, has to stop the table.",
        "The speed slider does not slow servoj: try it with --dry-run first.",
    ]
    if job.dry_run:
        return [*told, "DRY RUN: the scanner stays off, speeds are a tenth, it halts at each view."]
    return [*told, f"The output {s.start_out} is on then."] if s.start_out else told


def ticked_points(stretch: Stretch, ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of an arm's motion that lasts a whole number of ticks.

    Returns:
        ticks of each move, shape (k,); joints at its end, (k, 6) [rad]; their speeds, (k, 6) [rad/s].
    """
    grid, q, qd = _on_ticks(stretch, ticks)
    knots, _ = spline_knots(
        grid, np.rad2deg(q[:, :6]), ARM_DEG, shortest=SHORTEST_S, most=MOST_POINTS,
        longest=SCAN_LONGEST_S if stretch.operation.scanning else LONGEST_S,
    )  # fmt: skip
    return np.diff(np.round(grid[knots] / TICK_S)), q[knots[1:], :6], qd[knots[1:], :6]


def _on_ticks(stretch: Stretch, ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The motion in a time that is a whole number of ticks: instants, joints, speeds."""
    slower = ticks * TICK_S / stretch.duration
    curve = CubicHermiteSpline((stretch.t - stretch.t[0]) * slower, stretch.q, stretch.qd / slower)
    grid = np.arange(ticks + 1) * TICK_S
    qd = curve(grid, 1)
    qd[[0, -1]] = 0.0
    return grid, curve(grid), qd


def _ticks(stretch: Stretch) -> int:
    return max(int(np.ceil(stretch.duration / TICK_S - 1e-6)), 3)


def _arm(stretch: Stretch, job: ExportJob, *, marks: bool = False) -> list[str]:
    slow = 100 // DRY_PERCENT if job.dry_run else 1
    ticks = _ticks(stretch)
    if not _moves(stretch.q[:, :6]):
        return [f"{job.name}_hold({ticks * slow:.1f})"]
    lines = [f"global {job.name}_q = {_six(stretch.q[0])}", f"global {job.name}_v = {_six(np.zeros(6))}"]
    for k, (n, q, v) in enumerate(zip(*ticked_points(stretch, ticks), strict=True), 1):
        lines.append(f"{job.name}_to({_six(q)}, {_six(v / slow)}, {n * slow:.1f})")
        if marks:
            lines += [f"if not {job.name}_bad:", f"  global {job.name}_at = {k}", "end"]
    return lines


def _step(n: int, stretch: Stretch, job: ExportJob) -> tuple[list[str], list[str]]:
    """The function of a step that scans, and what stands in the main part."""
    o, name = stretch.operation, job.name
    table = _moves(stretch.q[:, 6:])
    go, end = ([f"{name}_table_go()"], [f"{name}_table_end()"]) if table else ([], [])
    state = "scanner on" if o.scanning else "scanner off"
    call = [f"# {n} {o.kind} {' '.join(o.viewpoints[:3])}, {stretch.t[0]:.3f} s, {state}", f"{name}_now({n})"]
    if not o.scanning or job.dry_run:
        halt = 'popup("dry run: at the view", title="scan", error=False, blocking=True)'
        call += [halt] if o.scanning else []
        return [], [f"  {x}" for x in [*call, *go, *_arm(stretch, job), *end]]
    faults = bool(job.signals.fault_in)
    body = [f"{name}_scan_on()", *go, *_arm(stretch, job, marks=faults and not table)]
    body += _ended(stretch, job, table) if faults else [f"{name}_scan_off()", *end]
    function = [f"  def {name}_step_{n}():", *(f"    {x}" for x in body), "  end"]
    loop = [f"{name}_step_{n}()"]
    if faults:
        loop = [f"global {name}_bad = True", f"while {name}_bad:", f"  {name}_step_{n}()", "end"]
    return function, [f"  {x}" for x in [*call, *loop]]


def _ended(stretch: Stretch, job: ExportJob, table: bool) -> list[str]:
    """After a step: its end, or the way back along what was driven."""
    name = job.name
    end = [f"{name}_table_back()"] if table else []
    lines = [f"if {name}_bad:", f"  {name}_broken()", *(f"  {x}" for x in end)]
    if _moves(stretch.q[:, :6]):
        _, q, _ = ticked_points(stretch, _ticks(stretch))
        way = [stretch.q[0], *q]
        for k in range(len(way) - 2, 0, -1):
            lines += [f"  if {name}_at >= {k}:", f"    {_back(way[k])}", "  end"]
        lines.append(f"  {_back(way[0])}")
    off = [f"{name}_scan_off()", *([f"{name}_table_end()"] if table else [])]
    return [*lines, "else:", *(f"  {x}" for x in off), "end"]


def _back(q: np.ndarray) -> str:
    return f"movej({_six(q)}, a=0.5, v={BACK_RAD_S})"


def _table(job: ExportJob) -> str:
    """The programme of the table's drive: where it is when, for each step in which it moves."""
    s, slow = job.signals, 100 // DRY_PERCENT if job.dry_run else 1
    remarks = [
        "WARNING: no drive has run this programme; MC_TP_REF and AXIS_REF are the drive's own types.",
        f"Start is the arm's output {s.table_start_out}, Ready and Fault its inputs {s.table_ready_in} and "
        f"{s.table_fault_in}, Step the word from output {s.step_out} on.",
        "Degrees, positive counterclockwise from above. ArmRuns is on while the arm's programme runs.",
    ]
    lines = [
        *(f"(* {x} *)" for x in remarks),
        *TABLE.replace("@", job.name).strip().split("\n"),
        "CASE Step OF",
    ]
    first = float(np.rad2deg(job.source.trajectory.q[0, 6]))
    lines += ["0:", f"First := {first + 0.0:.5f};"]
    for n, stretch in enumerate(job.stretches, 1):
        e1 = np.rad2deg(stretch.q[:, 6])
        lines += [f"{n}:", f"First := {e1[0] + 0.0:.5f};"]
        if not _moves(stretch.q[:, 6:]):
            continue
        grid, q, _ = _on_ticks(stretch, _ticks(stretch))
        deg = np.rad2deg(q[:, 6:])
        knots, _ = spline_knots(
            grid, deg, TABLE_DEG, longest=LONGEST_S, shortest=SHORTEST_S, most=MOST_POINTS
        )
        lines.append(f"Way.Number_of_pairs := {len(knots) - 1};")
        for k, (a, b) in enumerate(pairwise(knots), 1):
            milliseconds = round(float(grid[b] - grid[a]) * 1e3) * slow
            lines.append(f"Way.MC_TP_Array[{k}].delta_time := T#{milliseconds}ms;")
            lines.append(f"Way.MC_TP_Array[{k}].position := {deg[b, 0] + 0.0:.5f};")
    states = TABLE_STATES.format(
        lag=LAG_MS, near=f"{s.start_tolerance_deg:g}", slow=f"{TABLE_BACK_DEG_S:.1f}",
        slow_down=f"{TABLE_STOP_DEG_S2:.1f}",
    )  # fmt: skip
    return "\r\n".join([*lines, "END_CASE;", *states.strip().split("\n")]) + "\r\n"
