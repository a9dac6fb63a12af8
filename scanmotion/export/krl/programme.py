"""KUKA programmes (KRL) for KR C4 and KR C5: the checks on what goes into them, the steps, the files.

The conventions (names, header, folds, pages of 1400 lines, TIME_BLOCK) are those of public post-processors
and manuals, listed in docs/exports.md. No controller has run these programmes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.export.job import ExportJob, Files
from scanmotion.export.krl.moves import KrlBlock, axes, classic_block, frame, number, timed_block
from scanmotion.export.krl.names import krl_name, remark
from scanmotion.export.krl.text import DAT, FINISH, HEAD, INI, LEVEL, ROUTINES, filled
from scanmotion.export.source import Stretch

LINES_A_FILE = 1400
"""Longer programmes are split into pages of at most this many lines."""
KUKA_AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]])
"""About which axes of the base the joints turn where all are zero."""


@dataclass(frozen=True, kw_only=True)
class Manner:
    """One of the two ways to write a programme."""

    block: Callable[[Stretch, ExportJob], KrlBlock]
    says: tuple[str, ...]
    """Remarks for the programme's head; {away} and {cut} are filled in [deg]."""


CLASSIC = Manner(
    block=classic_block,
    says=(
        "PTP and LIN: the path of the plan without its times. Between two points neither a joint nor",
        "the scanner is faster than the plan at its fastest there, but for the least speed of 1 percent.",
        "The joints keep within {away} deg of the planned path, {cut} deg more where C_PTP rounds a corner.",
        "Percentages are of these greatest speeds [deg/s], A1..A6, E1:",
        "{speeds}",
        "If the machine data say otherwise, the speeds differ in proportion.",
    ),
)
TIMED = Manner(
    block=timed_block,
    says=(
        "PTP_SPLINE with TIME_BLOCK: path and times of the plan, {seconds} s in all.",
        "A cubic spline through the points keeps within {away} deg of the planned joints;",
        "the controller's own spline may differ between the points.",
    ),
)


@dataclass(frozen=True, kw_only=True)
class Step:
    """One operation in KRL: what stands in the main part, and the routines that it calls."""

    fold: tuple[str, ...]
    routines: tuple[str, ...] = ()
    number: int = 0
    """Of the step, where a way back belongs to it; 0 where none does."""


def classic_files(job: ExportJob) -> Files:
    """PTP and LIN with $VEL.CP; E6AXIS with E1."""
    return _files(job, CLASSIC)


def timed_files(job: ExportJob) -> Files:
    """PTP_SPLINE of SPTP with a TIME_BLOCK for each operation."""
    return _files(job, TIMED)


def _files(job: ExportJob, manner: Manner) -> Files:
    krl_name(job.name)
    record = job.source.record
    if np.abs(job.arm.axes_at_zero() - KUKA_AXES).max() > 1e-3:
        raise InputError(
            f"the joints of {remark(record.robot, 'robot')} do not turn as a KUKA arm's do (along x at "
            "zero, A1 about -z, A2, A3, A5 about y, A4, A6 about -x), so KRL cannot carry them"
        )
    blocks = [manner.block(s, job) for s in job.stretches]
    steps = [_step(n, s, b, job) for n, (s, b) in enumerate(zip(job.stretches, blocks, strict=True), 1)]
    facts, has = _facts(job), _signals(job)
    told = {
        "away": f"{max((b.away for b in blocks), default=0.0):.3f}",
        "cut": f"{max((b.cut for b in blocks), default=0.0):.3f}",
        "speeds": " ".join(f"{v:.1f}" for v in np.rad2deg(job.fastest)),
        "seconds": f"{job.source.trajectory.duration:.2f}",
    }
    remarks = [*_remarks(job), *(line.format(**told) for line in manner.says)]
    head = "".join(f"; {line}\n" for line in remarks) + filled(INI, job.name, facts, has)
    files = _programme(job, head, steps, facts, has)
    files[f"{job.name}.dat"] = filled(DAT, job.name, facts, has)
    # A controller's editor expects Windows line ends.
    return {file: text.replace("\n", "\r\n").encode("ascii") for file, text in files.items()}


def _signals(job: ExportJob) -> frozenset[str]:
    s, has = job.signals, {"range"}
    if job.source.record.limits.position_min_rad[6] is None:
        has.discard("range")
    if s.step_out:
        has.add("word")
    if not job.dry_run:
        named = {"ready": s.ready_in, "done": s.done_in, "fault": s.fault_in, "start": s.start_out}
        has |= {word for word, signal in named.items() if signal}
        has |= {"frames", "input"} if s.frame_in else {"frames", "pulse"} if s.frame_out else set()
    return frozenset(has)


def _facts(job: ExportJob) -> dict[str, str]:
    """What the templates of the text have in braces."""
    s, q = job.signals, np.rad2deg(job.source.trajectory.q)
    frames = sum(
        int(x.duration * job.source.record.process.fps) + 2 for x in job.stretches if x.operation.scanning
    )
    centre = ",".join(f"{n} {number(v * 1e3, 2)}" for n, v in zip("XYZ", job.centre_of_mass, strict=True))
    inertia = ",".join(f"{n} {number(v, 4)}" for n, v in zip("XYZ", job.inertia, strict=True))
    return {
        "start": axes(q[0]), "scanner": frame(job.X_FS),
        "load": f"{{M {number(job.mass, 3)},CM {{{centre},A 0.0,B 0.0,C 0.0}},J {{{inertia}}}}}",
        "tool": str(s.tool_number), "base": str(s.base_number),
        "e1_low": number(np.floor(q[:, 6].min()), 1), "e1_high": number(np.ceil(q[:, 6].max()), 1),
        "near": number(s.start_tolerance_deg, 3),
        "ready_in": str(s.ready_in), "done_in": str(s.done_in), "fault_in": str(s.fault_in),
        "start_out": str(s.start_out), "frame_out": str(s.frame_out), "frame_in": str(s.frame_in),
        "ready_s": f"{s.ready_timeout_s:g}", "done_s": f"{s.done_timeout_s:g}",
        "ready_ms": str(round(s.ready_timeout_s * 1e3)), "done_ms": str(round(s.done_timeout_s * 1e3)),
        "frame_ms": str(round(1e3 / job.source.record.process.fps)),
        "word_first": str(s.step_out), "word_last": str(s.step_out + s.step_bits - 1),
        "log": str(max(2 * frames, 10)),
    }  # fmt: skip


def _remarks(job: ExportJob) -> list[str]:
    record, s, q = job.source.record, job.signals, np.rad2deg(job.source.trajectory.q[:, 6])
    told = [
        "WARNING: no controller has run this programme. Try it in the maker's simulator first,",
        "then in T1 with the override low and the table empty.",
        f"It is collision-free in the plan's model only, and only from {job.name}_POS on.",
        f"part {remark(record.part, 'part')}, robot {remark(record.robot, 'robot')}, "
        f"{remark(record.software, 'software')}",
        f"It writes tool, load {s.tool_number} and base {s.base_number}. E1 is the turntable, positive",
        f"counterclockwise seen from above, from {q.min():.1f} to {q.max():.1f} deg.",
    ]
    if job.dry_run:
        return [*told, "DRY RUN: the scanner stays off, speeds are a tenth, it halts at each view."]
    names = {"ready": s.ready_in, "done": s.done_in, "fault": s.fault_in, "frame": s.frame_in}
    outs = {"start": s.start_out, "frame": 0 if s.frame_in else s.frame_out}
    told.append("The scanner records where a fold says 'scanner on'. Inputs "
                + ", ".join(f"{k} {v}" for k, v in names.items() if v) + "; outputs "
                + ", ".join(f"{k} {v}" for k, v in outs.items() if v) + ".")  # fmt: skip
    if s.start_out:
        told.append(f"The output {s.start_out} is on then.")
    if s.step_out:
        told.append(f"Outputs {s.step_out} to {s.step_out + s.step_bits - 1} tell the step.")
    return told


def _step(n: int, stretch: Stretch, block: KrlBlock, job: ExportJob) -> Step:
    o, name = stretch.operation, job.name
    title = f"{n} {o.kind} {' '.join(o.viewpoints[:3])}".strip() + (" .." if len(o.viewpoints) > 3 else "")
    state = "scanner on" if o.scanning else "scanner off"
    top = (f";FOLD {title}, {stretch.t[0]:.3f} s, {state}", f"{name}_NOW ({n})")
    end = f";ENDFOLD ({n})"
    if not o.scanning:
        return Step(fold=(*top, *block.lines, end))
    if job.dry_run:
        return Step(fold=(*top, f"{name}_SAY (7)", "HALT", *block.lines, end))
    routine = ("", f"DEF S{n} ( )", f"{name}_ON ( )", *block.lines, f"{name}_OFF ( )", "END")
    if not job.signals.fault_in:
        return Step(fold=(*top, f"S{n} ( )", end), routines=routine)
    again = ("LOOP", f"S{n} ( )", f"IF NOT {name}_BAD THEN", "EXIT", "ENDIF", "HALT", "ENDLOOP")
    back = ("", f"DEF B{n} ( )", *block.back, "END") if block.back else ()
    return Step(fold=(*top, *again, end), routines=(*routine, *back), number=n if back else 0)


def _interrupt(steps: list[Step], job: ExportJob) -> tuple[str, ...]:
    """What a fault of the scanner sets off: stop, message, the way back, and again."""
    if job.dry_run or not job.signals.fault_in:
        return ()
    name, s = job.name, job.signals
    lines = ["", "DEF IR ( )", "BRAKE", "INTERRUPT OFF 4"]
    lines += ["INTERRUPT OFF 5"] if s.frame_in or s.frame_out else []
    lines += [f"$OUT[{s.start_out}]=FALSE"] if s.start_out else []
    lines += [f"{name}_BAD=TRUE", f"{name}_SAY (6)"]
    numbers = [step.number for step in steps if step.number]
    if numbers:
        lines += [f"SWITCH {name}_STEP"]
        for n in numbers:
            lines += [f"CASE {n}", f"B{n} ( )"]
        lines += ["ENDSWITCH"]
    return (*lines, f"{name}_SPD (100)", "RESUME", "END")


def _programme(
    job: ExportJob, head: str, steps: list[Step], facts: dict[str, str], has: frozenset[str]
) -> dict[str, str]:
    """The main file and, where it would become too long, pages that it calls."""

    def text(own: str, top: str, body: list[Step], bottom: str) -> str:
        level = filled(LEVEL, job.name, facts, has)
        folds = "".join("\n".join(s.fold) + "\n" for s in body)
        routines = [*(line for s in body for line in s.routines), *_interrupt(body, job)]
        return HEAD.format(own=own) + top + level + folds + bottom + "".join(f"{x}\n" for x in routines)

    name = job.name
    finish, shared = filled(FINISH, name, facts, has), filled(ROUTINES, name, facts, has)
    whole = text(name, head, steps, finish) + shared
    if whole.count("\n") <= LINES_A_FILE:
        return {f"{name}.src": whole}
    pages: list[list[Step]] = [[]]
    for step in steps:
        if pages[-1] and text(name, "\n", [*pages[-1], step], "END\n").count("\n") > LINES_A_FILE:
            pages.append([])
        pages[-1].append(step)
    if len(pages) > 999:
        raise InputError("the programme needs more than 999 files")
    files = {}
    for n, page in enumerate(pages, 1):
        own = f"{name}_{n:03d}"
        warning = f"; page {n} of {len(pages)} of {name}: start {name}, not this page\n"
        files[f"{own}.src"] = text(own, warning, page, "END\n")
    calls = "".join(f"{name}_{n:03d} ( )\n" for n in range(1, len(pages) + 1))
    return files | {f"{name}.src": HEAD.format(own=name) + head + calls + finish + shared}
