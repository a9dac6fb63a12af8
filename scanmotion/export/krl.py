"""KUKA programmes (KRL): the text around the moves, the checks on what goes into it, the split into files.

The conventions (names, header, folds, pages of 1400 lines, TIME_BLOCK) are those of public post-processors
and manuals, listed in docs/exports.md. No controller has run these programmes.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.export.krl_moves import Block, axes, classic_block, frame, timed_block
from scanmotion.export.pose import arm_from_urdf
from scanmotion.export.source import Source, Stretch, checked_line
from scanmotion.plan_io.read import read_text

LINES_A_FILE = 1400
"""Longer programmes are split into pages of at most this many lines."""
MOST_SIGNALS = 8192
"""Digital outputs of a KR C4; what a controller has is a matter of its configuration."""
LONGEST_NAME = 20
"""KRL allows 24 characters; "_001" of a page needs four of them."""
KUKA_AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]])
"""About which axes of the base the joints turn where all are zero."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ODD = re.compile(r"[^A-Za-z0-9 ._()-]")
RESERVED = frozenset(
    """
    AND ANIN ANOUT AXIS BAS BASE BOOL BRAKE B_AND B_EXOR B_NOT B_OR CASE CAST_FROM CAST_TO CCLOSE
    CHANNEL CHAR CIRC CIRC_REL CONFIRM CONST CONST_VEL CONTINUE COPEN CREAD CWRITE C_DIS C_ORI C_PTP
    C_SPL C_VEL DECL DEF DEFAULT DEFDAT DEFFCT DELAY DIGIN DISTANCE DO E3AXIS E3POS E6AXIS E6POS ELSE
    END ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP ENDSPLINE ENDSWITCH ENDWHILE ENUM EXIT EXOR EXT EXTFCT EXTP
    FALSE FOR FRAME FSCANNER GLOBAL GOTO HALT IF IMPORT INT INTERRUPT INV_POS IR_STOPM IS LIN LIN_REL
    LOAD LOOP MAXIMUM MINIMUM NOT OFF ON OR PATH PTP PTP_REL PTP_SPLINE PUBLIC PULSE REAL REPEAT
    RESUME RETURN SCIRC SEC SIGNAL SLIN SPL SPLINE SPTP SREAD STRUC SUCCESS SWITCH SWRITE THEN
    TIME_BLOCK TO TRIGGER TRUE UNTIL WAIT WHEN WHILE WITH XSTART
    """.split()
)
"""Words of the language, and names that the programme itself uses."""

DAT = """&ACCESS RVP
&REL 1
&COMMENT scanmotion, not tried on a controller
DEFDAT {name} PUBLIC
;FOLD EXTERNAL DECLARATIONS
EXT BAS (BAS_COMMAND :IN,REAL :IN )
DECL INT SUCCESS
;ENDFOLD (EXTERNAL DECLARATIONS)
; where the programme starts, and the scanner's frame S on the flange
DECL E6AXIS XSTART={start}
DECL FRAME FSCANNER={scanner}
ENDDAT
"""

HEAD = """&ACCESS RVP
&REL 1
&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe
&PARAM EDITMASK = *
&COMMENT scanmotion, not tried on a controller
DEF {name} ( )
"""

INI = """;FOLD INI
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
;ENDFOLD (INI)
;FOLD SETTINGS
BAS (#VEL_PTP,10 )
BAS (#ACC_PTP,50 )
$TOOL=FSCANNER
$BASE=$ROBROOT
$ADVANCE=3
$APO.CPTP=50
$APO.CDIS=0.5
{off};ENDFOLD (SETTINGS)
;FOLD START, by hand at reduced speed: nothing was planned for the way to here
PTP XSTART
;ENDFOLD (START)
"""


@dataclass(frozen=True, kw_only=True)
class Manner:
    """One of the two ways to write a programme."""

    block: Callable[..., Block]
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


def classic_files(source: Source, name: str, signal: int | None = None) -> dict[str, bytes | str]:
    """PTP and LIN with $VEL.CP; E6AXIS with E1; `signal` is the output that is on while the scanner scans."""
    return _files(source, name, CLASSIC, signal)


def timed_files(source: Source, name: str, signal: int | None = None) -> dict[str, bytes | str]:
    """PTP_SPLINE of SPTP with a TIME_BLOCK for each operation; `signal` as in the classic programme."""
    return _files(source, name, TIMED, signal)


def _files(source: Source, name: str, manner: Manner, signal: int | None) -> dict[str, bytes | str]:
    krl_name(name)
    if signal is not None and not 1 <= signal <= MOST_SIGNALS:
        raise InputError(f"--signal {signal}: a digital output has a number from 1 to {MOST_SIGNALS}")
    record = source.record
    arm = arm_from_urdf(
        read_text(source.folder, record.urdf_file, limit=8 << 20), record.robot_joints, record.flange_link
    )
    if np.abs(arm.axes_at_zero() - KUKA_AXES).max() > 1e-3:
        raise InputError(
            f"the joints of {remark(record.robot, 'robot')} do not turn as a KUKA arm's do (along x at "
            "zero, A1 about -z, A2, A3, A5 about y, A4, A6 about -x), so KRL cannot carry them"
        )
    fastest = np.append(arm.velocity, record.limits.velocity_rad_s[6])
    if not (np.isfinite(fastest) & (fastest > 0)).all():
        raise InputError("the robot's greatest speeds are not positive numbers")
    stretches = source.stretches()
    blocks = [manner.block(s, arm, np.array(record.X_FS), fastest) for s in stretches]
    folds = [_fold(n, s, b, signal) for n, (s, b) in enumerate(zip(stretches, blocks, strict=True), 1)]
    facts = {
        "away": f"{max((b.away for b in blocks), default=0.0):.3f}",
        "cut": f"{max((b.cut for b in blocks), default=0.0):.3f}",
        "speeds": " ".join(f"{v:.1f}" for v in np.rad2deg(fastest)),
        "seconds": f"{source.trajectory.duration:.2f}",
    }
    remarks = [*_remarks(source, signal), *(line.format(**facts) for line in manner.says)]
    head = HEAD.format(name=name) + "".join(f"; {line}\n" for line in remarks)
    files = _programme(
        name, head + INI.format(off="" if signal is None else f"$OUT[{signal}]=FALSE\n"), folds
    )
    start = np.rad2deg(source.trajectory.q[0])
    files[f"{name}.dat"] = DAT.format(name=name, start=axes(start), scanner=frame(np.array(record.X_FS)))
    # A controller's editor expects Windows line ends.
    return {file: text.replace("\n", "\r\n").encode("ascii") for file, text in files.items()}


def krl_name(name: str) -> str:
    """A name for a KRL programme.

    Raises:
        InputError: too long, with other characters, or a word of the language.
    """
    if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        raise InputError(
            f"--name {name[:80]!r}: a KRL programme has up to {LONGEST_NAME} letters, digits and _, "
            "and starts with no digit"
        )
    if name.upper() in RESERVED:
        raise InputError(f"--name {name!r}: is a word of the language KRL")
    return name


def remark(text: str, what: str) -> str:
    """Free text as part of a comment: what is not a plain letter, digit or mark becomes _.

    Raises:
        InputError: it has a line break or another character that is not printed.
    """
    return _ODD.sub("_", checked_line(text, what))[:60]


def _remarks(source: Source, signal: int | None) -> list[str]:
    record = source.record
    trigger = "" if signal is None else f"; output {signal} is on then"
    return [
        "WARNING: no controller has run this programme. Try it in the maker's simulator first,",
        "then in T1 with the override low and the table empty.",
        "It is collision-free in the plan's model only, and only from XSTART on.",
        f"part {remark(record.part, 'part')}, robot {remark(record.robot, 'robot')}, "
        f"{remark(record.software, 'software')}",
        "Set $LOAD to the scanner and its fixture. E1 is the turntable, positive counterclockwise",
        f"seen from above. The scanner records where a fold says 'scanner on'{trigger}.",
    ]


def _fold(n: int, stretch: Stretch, block: Block, signal: int | None) -> list[str]:
    o = stretch.operation
    title = f"{n} {o.kind} {' '.join(o.viewpoints[:3])}".strip() + (" .." if len(o.viewpoints) > 3 else "")
    state = "scanner on" if o.scanning else "scanner off"
    lines = block.lines
    if o.scanning and signal is not None:
        # Setting an output stops the advance run: it comes on when the arm stands at the operation's start.
        lines = (f"$OUT[{signal}]=TRUE", *lines, f"$OUT[{signal}]=FALSE")
    return [f";FOLD {title}, {stretch.t[0]:.3f} s, {state}", *lines, f";ENDFOLD ({n})"]


def _programme(name: str, head: str, folds: list[list[str]]) -> dict[str, str]:
    """The main file and, where it would become too long, pages that it calls."""
    body = [line for fold in folds for line in fold]
    if head.count("\n") + len(body) + 1 <= LINES_A_FILE:
        return {f"{name}.src": head + "\n".join([*body, "END"]) + "\n"}
    pages: list[list[str]] = [[]]
    for fold in folds:
        if pages[-1] and HEAD.count("\n") + 2 + len(pages[-1]) + len(fold) > LINES_A_FILE:
            pages.append([])
        pages[-1] += fold
    if len(pages) > 999:
        raise InputError("the programme needs more than 999 files")
    files = {}
    for n, page in enumerate(pages, 1):
        own = f"{name}_{n:03d}"
        warning = f"; page {n} of {len(pages)} of {name}: start {name}, not this page"
        files[f"{own}.src"] = HEAD.format(name=own) + "\n".join([warning, *page, "END"]) + "\n"
    calls = [f"{name}_{n:03d} ( )" for n in range(1, len(pages) + 1)]
    return files | {f"{name}.src": head + "\n".join([*calls, "END"]) + "\n"}
