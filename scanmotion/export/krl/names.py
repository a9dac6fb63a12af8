"""Names and words of KRL: what a programme may be called, and what text may stand in its comments."""

import re

from scanmotion.core.errors import InputError
from scanmotion.export.source import checked_line

LONGEST_NAME = 19
"""KRL allows 24 characters; the names that the programme makes of its own ("_STEP") need five of them."""
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
SYSTEM = frozenset(
    """
    A10 A10_INI A20 A50 ARCSPS ARC_PS BAS BOSCH CELL CONFIG CORR CORR_T CORR_TOOL ERROR_PS FLT_SERV
    GLOBAL_POINTS H50 H70 INI IR_STOPM KRCIPCONFIG LOADDETERMINATION MACHINE MASREF MASREF_USER MOVE_FREE
    MSG_DEMO MSGLIB NEW_SERV P00 PERCEPT PROGRAM R1 ROBCOR SPS STEU SUBMIT SYSTEM TM_USERAPPL TM_USERCONFIG
    TOOL_WORK USERSPOT USERVACC USER_GRP USER_SPOT WEAV_DEF ZERO
    """.split()
)
"""Files of R1 and R1/System of a KR C4 (from memory of such controllers): a programme of the same name would
replace them; CELL is what Automatic External starts."""


def krl_name(name: str) -> str:
    """A name for a KRL programme.

    Raises:
        InputError: too long, with other characters, a word of the language, or a file of the system.
    """
    if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        raise InputError(
            f"--name {name[:80]!r}: a KRL programme has up to {LONGEST_NAME} letters, digits and _, "
            "and starts with no digit"
        )
    if name.upper() in RESERVED:
        raise InputError(f"--name {name!r}: is a word of the language KRL")
    if name.upper() in SYSTEM:
        raise InputError(f"--name {name!r}: is a file of KUKA's system, which the programme would replace")
    return name


def remark(text: str, what: str) -> str:
    """Free text as part of a comment: what is not a plain letter, digit or mark becomes _.

    Raises:
        InputError: it has a line break or another character that is not printed.
    """
    return _ODD.sub("_", checked_line(text, what))[:60]
