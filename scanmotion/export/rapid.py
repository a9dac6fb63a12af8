"""RAPID for ABB controllers (IRC5, OmniCore): timed joint moves of arm and table, handshake, error handler.

MoveAbsJ takes all seven joints and, as argument T, its seconds: path and times are the plan's. The syntax
follows public post-processors and notes on ABB's manuals; no controller has run these programmes.
"""

import re

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import InputError
from scanmotion.export.job import DRY_PERCENT, ExportJob, Files
from scanmotion.export.knots import timed_knots
from scanmotion.export.source import Stretch

ABB_AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]])
"""About which axes of the base the joints turn where all are zero."""
LONGEST_NAME = 24
"""A name of RAPID has up to 32 characters; "_tool" and "M_" are added."""
POINT_DEG, SHORTEST_S, LONGEST_S = 0.03, 0.05, 0.5
"""How far evenly timed moves may be from the planned joints [deg]; least and greatest seconds of a move."""
PATH_SHORTEST_S = 0.02
"""The same in a continuous motion, which scans while its joints speed up and slow down."""
BACK_S, BACK_POINT_S = 0.5, 0.2
"""Least time of a way back after a fault, and of each of its moves between counted points [s]."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ODD = re.compile(r"[^A-Za-z0-9 ._()-]")
RESERVED = frozenset(
    "ALIAS AND BACKWARD CASE CONNECT CONST DEFAULT DIV DO ELSE ELSEIF ENDFOR ENDFUNC ENDIF ENDMODULE ENDPROC "
    "ENDRECORD ENDTEST ENDTRAP ENDWHILE ERROR EXIT FALSE FOR FROM FUNC GOTO IF INOUT LOCAL MAIN MOD MODULE "
    "NOSTEPIN NOT NOVIEW OR PERS PROC RAISE READONLY RECORD RETRY RETURN STEP SYSMODULE TASK TEST THEN TO "
    "TRAP TRUE TRYNEXT UNDO VAR VIEWONLY WHILE WITH WITHIN XOR USER BASE".split()
)
MOVE = "MoveAbsJ {target}\\T:={seconds:.3f},v100,{zone},{name}_tool\\WObj:={name}_base;"


def rapid_files(job: ExportJob) -> Files:
    """One module `NAME.mod` whose procedure NAME runs the scan.

    Raises:
        InputError: the joints do not turn as an ABB arm's, or a name that RAPID cannot carry.
    """
    if not _NAME.fullmatch(job.name) or len(job.name) > LONGEST_NAME or job.name.upper() in RESERVED:
        raise InputError(
            f"--name {job.name[:80]!r}: a RAPID procedure has up to {LONGEST_NAME} letters, digits and _, "
            "starts with a letter and is no word of the language"
        )
    if np.abs(job.arm.axes_at_zero() - ABB_AXES).max() > 1e-3:
        robot = _plain(job.source.record.robot)
        raise InputError(
            f"the joints of {robot} do not turn as an ABB arm's do (A1 about z, A2, A3, A5 about y, A4, A6 "
            "about x at zero), so RAPID cannot carry them"
        )
    lines = [
        f"MODULE M_{job.name}",
        *(f"! {x}" for x in _remarks(job)),
        *_data(job),
        *_main(job),
        *_shared(job),
    ]
    for n, stretch in enumerate(job.stretches, 1):
        if stretch.operation.scanning and not job.dry_run:
            lines += _scan(n, stretch, job)
    text = "\r\n".join([*lines, "ENDMODULE"]) + "\r\n"
    return {f"{job.name}.mod": text.encode("ascii")}


def _plain(text: str) -> str:
    return _ODD.sub("_", text)[:60]


def _remarks(job: ExportJob) -> list[str]:
    record, s = job.source.record, job.signals
    q = np.rad2deg(job.source.trajectory.q[:, 6])
    told = [
        "WARNING: no controller has run this programme. Try it in RobotStudio first, then at reduced speed.",
        f"part {_plain(record.part)}, robot {_plain(record.robot)}, {_plain(record.software)}",
        f"MoveAbsJ with T: path and times of the plan, {job.source.trajectory.duration:.2f} s in all.",
        f"The table is eax_a, positive counterclockwise from above, {q.min():.1f} to {q.max():.1f} deg.",
        "Signals are named di33, do33, go41 after the numbers in the cell's section programme.",
    ]
    if job.dry_run:
        return [*told, "DRY RUN: the scanner stays off, speeds are a tenth, it halts at each view."]
    return [*told, f"The output {s.start_out} is on then."] if s.start_out else told


def target_text(degrees: np.ndarray) -> str:
    """A jointtarget of seven joints [deg]."""
    six = ",".join(f"{v + 0.0:.5f}" for v in np.round(degrees[:6], 5))
    return f"[[{six}],[{round(float(degrees[6]), 5) + 0.0:.5f},9E9,9E9,9E9,9E9,9E9]]"


def _data(job: ExportJob) -> list[str]:
    w = Rotation.from_matrix(job.X_FS[:3, :3]).as_quat(canonical=True, scalar_first=True)
    place = ",".join(f"{v * 1e3 + 0.0:.3f}" for v in job.X_FS[:3, 3])
    turn = ",".join(f"{v + 0.0:.8f}" for v in w)
    centre = ",".join(f"{v * 1e3 + 0.0:.2f}" for v in job.centre_of_mass)
    inertia = ",".join(f"{v:.4f}" for v in job.inertia)
    start = target_text(np.rad2deg(job.source.trajectory.q[0]))
    return [
        f"PERS tooldata {job.name}_tool:=[TRUE,[[{place}],[{turn}]],"
        f"[{job.mass:.3f},[{centre}],[1,0,0,0],{inertia}]];",
        f'PERS wobjdata {job.name}_base:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
        f"PERS num {job.name}_step:=0;",
        f"LOCAL CONST jointtarget jStart:={start};",
        "LOCAL CONST speeddata vSlow:=[100,10,100,10];",
        "LOCAL CONST zonedata zScan:=[FALSE,1,1,1,0.1,1,0.1];",
        "LOCAL VAR jointtarget jNow:=[[0,0,0,0,0,0],[0,9E9,9E9,9E9,9E9,9E9]];",
        "LOCAL VAR bool bBad:=FALSE;",
        "LOCAL VAR bool bLate:=FALSE;",
        "LOCAL VAR num nAt:=0;",
        "LOCAL VAR intnum iFault:=0;",
        "LOCAL VAR intnum iFrame:=0;",
    ]


def _main(job: ExportJob) -> list[str]:
    s, name = job.signals, job.name
    lines = [f"PROC {name}()", "CheckStart;"]
    lines += [f"SetDO do{s.start_out},0;"] if s.start_out and not job.dry_run else []
    lines += ["Now 0;"]
    if s.fault_in and not job.dry_run:
        lines += ["CONNECT iFault WITH tFault;", f"ISignalDI di{s.fault_in},1,iFault;", "ISleep iFault;"]
    lines += [f"MoveAbsJ jStart,vSlow,fine,{name}_tool\\WObj:={name}_base;"]
    for n, stretch in enumerate(job.stretches, 1):
        o = stretch.operation
        state = "scanner on" if o.scanning else "scanner off"
        lines += [f"! {n} {o.kind} {' '.join(o.viewpoints[:3])}, {stretch.t[0]:.3f} s, {state}", f"Now {n};"]
        if not o.scanning or job.dry_run:
            if o.scanning:
                lines += ['TPWrite "dry run: at the view";', "Stop;"]
            lines += _moves(stretch, job)
            continue
        lines += ["bBad:=TRUE;", "WHILE bBad DO", f"S{n};", "IF bBad THEN", "Stop;", "ENDIF", "ENDWHILE"]
    lines += ["Now 0;"]
    if s.fault_in and not job.dry_run:
        lines += ["IDelete iFault;"]
    return [*lines, "ENDPROC"]


def points_of(stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of each move, (k,), and the joints at its end, (k, 7) [deg]."""
    q = np.rad2deg(stretch.q)
    shortest = PATH_SHORTEST_S if stretch.operation.kind == "path" else SHORTEST_S
    knots = timed_knots(stretch.t, q, POINT_DEG, shortest=shortest, longest=LONGEST_S)
    return np.diff(stretch.t[knots]), q[knots[1:]]


def _moves(stretch: Stretch, job: ExportJob, *, marks: bool = False) -> list[str]:
    if np.ptp(np.rad2deg(stretch.q), axis=0).max() < 1e-5:
        return [f"WaitTime {stretch.duration:.3f};"]
    seconds, points = points_of(stretch)
    slow = 100 / DRY_PERCENT if job.dry_run else 1.0
    lines = []
    for n, (s, q) in enumerate(zip(seconds, points, strict=True), 1):
        zone = "fine" if n == len(points) else "zScan"
        lines.append(MOVE.format(target=target_text(q), seconds=s * slow, zone=zone, name=job.name))
        if marks:
            lines.append(f"nAt:={n};")
    return lines


def _scan(n: int, stretch: Stretch, job: ExportJob) -> list[str]:
    """What scans is a procedure of its own, with an error handler that leads back to where it starts."""
    counts = bool(job.signals.fault_in) and stretch.operation.kind != "revolution"
    lines = [f"LOCAL PROC S{n}()", "nAt:=0;", "ScanOn;", *_moves(stretch, job, marks=counts), "ScanOff;"]
    if not job.signals.fault_in:
        return [*lines, "ENDPROC"]
    lines += ["ERROR", "ClearPath;", "StartMove;", "ScanBad;"]
    if np.ptp(np.rad2deg(stretch.q), axis=0).max() >= 1e-5:
        lines += _way_back(stretch, job)
    return [*lines, "RETURN;", "ENDPROC"]


def _way_back(stretch: Stretch, job: ExportJob) -> list[str]:
    """Moves back to where a step starts: a turn in one move, all else through the counted points.

    A point is counted when the robot begins to round it, so the first move leads along what was planned.
    """
    seconds, points = points_of(stretch)
    way = np.vstack([np.rad2deg(stretch.q[:1]), points])

    def back(k: int, s: float) -> str:
        return MOVE.format(target=target_text(way[k]), seconds=s, zone="fine", name=job.name)

    if stretch.operation.kind == "revolution":
        return [back(0, max(float(seconds.sum()), BACK_S))]
    lines = []
    for k in range(len(way) - 2, 0, -1):
        lines += [f"IF nAt>={k} THEN", back(k, max(2 * float(seconds[k]), BACK_POINT_S)), "ENDIF"]
    return [*lines, back(0, max(2 * float(seconds[0]), BACK_POINT_S))]


def _shared(job: ExportJob) -> list[str]:
    s, name = job.signals, job.name
    near = f"{s.start_tolerance_deg:.3f}"
    fields = [*(f"robax.rax_{i}" for i in range(1, 7)), "extax.eax_a"]
    lines = ["LOCAL PROC CheckStart()", "WHILE TRUE DO", "jNow:=CJointT();"]
    lines += [f"IF Abs(jNow.{f}-jStart.{f})<={near} THEN" for f in fields]
    lines += [
        "RETURN;",
        *["ENDIF"] * 7,
        'TPWrite "the robot is not at the start: drive to jStart by hand";',
        "Stop;",
    ]
    lines += ["ENDWHILE", "ENDPROC", "LOCAL PROC Now(num n)", f"{name}_step:=n;"]
    lines += [f"SetGO go{s.step_out},n;"] if s.step_out else []
    lines += ["ENDPROC"]
    if job.dry_run:
        return lines
    lines += ["LOCAL PROC ScanOn()", "bBad:=FALSE;"]
    if s.ready_in:
        lines += _awaited(s.ready_in, s.ready_timeout_s, "ready")
    lines += ["IWatch iFault;"] if s.fault_in else []
    lines += [f"SetDO do{s.start_out},1;"] if s.start_out else []
    if s.frame_out and not s.frame_in:
        every = 1 / job.source.record.process.fps
        lines += [
            "CONNECT iFrame WITH tFrame;",
            f"PulseDO\\PLength:=0.02,do{s.frame_out};",
            f"ITimer {every:.4f},iFrame;",
        ]
    lines += ["ENDPROC", "LOCAL PROC ScanOff()"]
    lines += ["IDelete iFrame;"] if s.frame_out and not s.frame_in else []
    lines += [f"SetDO do{s.start_out},0;"] if s.start_out else []
    lines += _awaited(s.done_in, s.done_timeout_s, "done") if s.done_in else []
    lines += ["ISleep iFault;"] if s.fault_in else []
    lines += ["ENDPROC"]
    if s.fault_in:
        lines += ["LOCAL PROC ScanBad()", "ISleep iFault;"]
        lines += ["IDelete iFrame;"] if s.frame_out and not s.frame_in else []
        lines += [f"SetDO do{s.start_out},0;"] if s.start_out else []
        lines += ["bBad:=TRUE;", 'TPWrite "scanner fault: back to the start of the step, which is repeated";']
        lines += ["ENDPROC", "LOCAL TRAP tFault", "ProcerrRecovery\\SyncLastMoveInst;", "ENDTRAP"]
    if s.frame_out and not s.frame_in:
        lines += ["LOCAL TRAP tFrame", f"PulseDO\\PLength:=0.02,do{s.frame_out};", "ENDTRAP"]
    return lines


def _awaited(signal: int, seconds: float, what: str) -> list[str]:
    return [
        "bLate:=TRUE;", "WHILE bLate DO", f"WaitDI di{signal},1\\MaxTime:={seconds:g}\\TimeFlag:=bLate;",
        "IF bLate THEN", f'TPWrite "scanner not {what}: di{signal} not on within {seconds:g} s";', "Stop;",
        "ENDIF", "ENDWHILE",
    ]  # fmt: skip
