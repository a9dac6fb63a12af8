"""The text of a KRL programme around the moves: data, checks, handshake, messages, interrupts.

`@` stands for the programme's name: routines and variables that pages share are global on a controller, so
they carry it. Lines that begin with `?word ` are kept where the cell has that signal.
"""

DAT = """&ACCESS RVP
&REL 1
&COMMENT scanmotion, not tried on a controller
DEFDAT @ PUBLIC
;FOLD EXTERNAL DECLARATIONS
EXT BAS (BAS_COMMAND :IN,REAL :IN )
DECL INT SUCCESS
;ENDFOLD (EXTERNAL DECLARATIONS)
; where the programme starts; the scanner's frame S on the flange; mass, centre of mass, inertia of the tool
DECL GLOBAL E6AXIS @_POS={start}
DECL GLOBAL FRAME @_TCP={scanner}
DECL GLOBAL LOAD @_LOAD={load}
; number of the step that runs or ran last; whether the scanner broke it off; points passed of a helix
DECL GLOBAL INT @_STEP=0
DECL GLOBAL BOOL @_BAD=FALSE
DECL GLOBAL INT @_AT=0
DECL GLOBAL REAL @_VCP=0.1
DECL GLOBAL REAL @_ACP=0.1
DECL GLOBAL REAL @_VO1=30.0
DECL GLOBAL REAL @_VO2=30.0
DECL GLOBAL REAL @_AO1=60.0
DECL GLOBAL REAL @_AO2=60.0
?frames ; frames taken: how many, when [ms], and the joints then
?frames DECL GLOBAL INT @_N=0
?frames DECL GLOBAL REAL @_LT[{log}]
?frames DECL GLOBAL E6AXIS @_LQ[{log}]
ENDDAT
"""

HEAD = """&ACCESS RVP
&REL 1
&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe
&PARAM EDITMASK = *
&COMMENT scanmotion, not tried on a controller
DEF {own} ( )
"""

INI = """;FOLD INI
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
;ENDFOLD (INI)
;FOLD CHECKS
@_CHK ( )
;ENDFOLD (CHECKS)
;FOLD SETTINGS
TOOL_DATA[{tool}]=@_TCP
LOAD_DATA[{tool}]=@_LOAD
BASE_DATA[{base}]=$ROBROOT
BAS (#TOOL,{tool} )
BAS (#BASE,{base} )
@_CP (TRUE)
$ADVANCE=3
$APO.CDIS=0.5
?start $OUT[{start_out}]=FALSE
@_BAD=FALSE
@_NOW (0)
?frames @_N=0
?frames $TIMER[7]=0
?frames $TIMER_STOP[7]=FALSE
;ENDFOLD (SETTINGS)
;FOLD START
@_SPD (10)
PTP @_POS
@_SPD (100)
;ENDFOLD (START)
"""

LEVEL = """?fault INTERRUPT DECL 4 WHEN $IN[{fault_in}]==TRUE DO IR ( )
?pulse INTERRUPT DECL 5 WHEN $TIMER_FLAG[6]==TRUE DO @_FRM ( )
?input INTERRUPT DECL 5 WHEN $IN[{frame_in}]==TRUE DO @_FRM ( )
"""
"""Declared where RESUME is to return to."""

FINISH = """;FOLD END
@_NOW (0)
?start $OUT[{start_out}]=FALSE
?frames $TIMER_STOP[7]=TRUE
BAS (#INITMOV,0 )
;ENDFOLD (END)
END
"""

ROUTINES = """
GLOBAL DEF @_CHK ( )
; nothing moves before these hold
LOOP
IF $EX_AX_NUM>=1 THEN
EXIT
ENDIF
@_SAY (1)
HALT
ENDLOOP
?range LOOP
?range IF ($SOFTN_END[7]<={e1_low}) AND ($SOFTP_END[7]>={e1_high}) THEN
?range EXIT
?range ENDIF
?range @_SAY (2)
?range HALT
?range ENDLOOP
LOOP
IF ABS($AXIS_ACT.A1-@_POS.A1)<={near} THEN
IF ABS($AXIS_ACT.A2-@_POS.A2)<={near} THEN
IF ABS($AXIS_ACT.A3-@_POS.A3)<={near} THEN
IF ABS($AXIS_ACT.A4-@_POS.A4)<={near} THEN
IF ABS($AXIS_ACT.A5-@_POS.A5)<={near} THEN
IF ABS($AXIS_ACT.A6-@_POS.A6)<={near} THEN
IF ABS($AXIS_ACT.E1-@_POS.E1)<={near} THEN
EXIT
ENDIF
ENDIF
ENDIF
ENDIF
ENDIF
ENDIF
ENDIF
@_SAY (3)
HALT
ENDLOOP
END

GLOBAL DEF @_SPD (P:IN)
; percent of the machine data, for every axis
DECL INT P
DECL INT I
FOR I=1 TO 6
$VEL_AXIS[I]=P
$ACC_AXIS[I]=100
ENDFOR
$VEL_EXTAX[1]=P
$ACC_EXTAX[1]=100
END

GLOBAL DEF @_CP (KEEP:IN)
; keeps what holds for LIN, or puts it back
DECL BOOL KEEP
IF KEEP THEN
@_VCP=$VEL.CP
@_ACP=$ACC.CP
@_VO1=$VEL.ORI1
@_VO2=$VEL.ORI2
@_AO1=$ACC.ORI1
@_AO2=$ACC.ORI2
ELSE
$VEL.CP=@_VCP
$ACC.CP=@_ACP
$VEL.ORI1=@_VO1
$VEL.ORI2=@_VO2
$ACC.ORI1=@_AO1
$ACC.ORI2=@_AO2
ENDIF
END

GLOBAL DEF @_NOW (N:IN)
; the step that begins
DECL INT N
?word SIGNAL @_WORD $OUT[{word_first}] TO $OUT[{word_last}]
@_STEP=N
@_AT=0
?word @_WORD=N
END

GLOBAL DEF @_ON ( )
; the scanner is ready and records
@_BAD=FALSE
?ready LOOP
?ready $TIMER[5]=-{ready_ms}
?ready $TIMER_STOP[5]=FALSE
?ready WAIT FOR ($IN[{ready_in}]) OR ($TIMER_FLAG[5])
?ready $TIMER_STOP[5]=TRUE
?ready IF $IN[{ready_in}] THEN
?ready EXIT
?ready ENDIF
?ready @_SAY (4)
?ready HALT
?ready ENDLOOP
?fault INTERRUPT ON 4
?start $OUT[{start_out}]=TRUE
?pulse $TIMER[6]=-1
?pulse $TIMER_STOP[6]=FALSE
?frames INTERRUPT ON 5
END

GLOBAL DEF @_OFF ( )
; the scanner has recorded and stored
WAIT SEC 0.0
?frames INTERRUPT OFF 5
?pulse $TIMER_STOP[6]=TRUE
?start $OUT[{start_out}]=FALSE
?done LOOP
?done $TIMER[5]=-{done_ms}
?done $TIMER_STOP[5]=FALSE
?done WAIT FOR ($IN[{done_in}]) OR ($TIMER_FLAG[5])
?done $TIMER_STOP[5]=TRUE
?done IF $IN[{done_in}] THEN
?done EXIT
?done ENDIF
?done @_SAY (5)
?done HALT
?done ENDLOOP
?fault INTERRUPT OFF 4
END

?frames GLOBAL DEF @_FRM ( )
?frames ; one frame: a pulse for the scanner, a line for the log
?pulse CONTINUE
?pulse PULSE ($OUT[{frame_out}],TRUE,0.02)
?pulse $TIMER[6]=$TIMER[6]-{frame_ms}
?frames IF @_N<{log} THEN
?frames @_N=@_N+1
?frames @_LT[@_N]=$TIMER[7]
?frames @_LQ[@_N]=$AXIS_INT
?frames ENDIF
?frames END

GLOBAL DEF @_SAY (N:IN)
; a message that has to be acknowledged
DECL INT N
DECL INT H
DECL KRLMSG_T M
DECL KRLMSGPAR_T P[3]
DECL KRLMSGOPT_T O
SWITCH N
CASE 1
M={{MODUL[] "SCAN",NR 1,MSG_TXT[] "no external axis: E1, the turntable, is missing"}}
CASE 2
M={{MODUL[] "SCAN",NR 2,MSG_TXT[] "E1 needs {e1_low} to {e1_high} deg, its software limits allow less"}}
CASE 3
M={{MODUL[] "SCAN",NR 3,MSG_TXT[] "the robot is not at the start: drive to @_POS by hand, E1 too"}}
CASE 4
M={{MODUL[] "SCAN",NR 4,MSG_TXT[] "scanner not ready: input {ready_in} not on within {ready_s} s"}}
CASE 5
M={{MODUL[] "SCAN",NR 5,MSG_TXT[] "scanner not done: input {done_in} not on within {done_s} s"}}
CASE 6
M={{MODUL[] "SCAN",NR 6,MSG_TXT[] "scanner fault: back at the start of the step, which is repeated"}}
CASE 7
M={{MODUL[] "SCAN",NR 7,MSG_TXT[] "dry run: at the view"}}
ENDSWITCH
P[1]={{PAR_TYPE #EMPTY}}
P[2]={{PAR_TYPE #EMPTY}}
P[3]={{PAR_TYPE #EMPTY}}
O={{VL_STOP FALSE,CLEAR_P_RESET TRUE,CLEAR_P_SAW FALSE,LOG_TO_DB TRUE}}
H=SET_KRLMSG(#NOTIFY,M,P[],O)
END
"""


def filled(template: str, name: str, facts: dict[str, str], has: frozenset[str]) -> str:
    """The template with the name and the facts put in, without the lines of signals that the cell has not.

    Args:
        template: of this module.
        name: of the programme.
        facts: what stands in braces.
        has: words after `?` whose lines are kept.
    """
    lines = []
    for line in template.split("\n"):
        if line.startswith("?"):
            word, line = line[1:].split(" ", 1)
            if word not in has:
                continue
        lines.append(line)
    return "\n".join(lines).replace("@", name).format(**facts)
