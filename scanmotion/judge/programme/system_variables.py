"""Which variables of KUKA's system a programme may set, and to what.

Anything else is an error: the machine would not know what the controller does then. $OV_PRO is the
operator's, machine data and software limits are the commissioner's.
"""

import math
from typing import Any

from scanmotion.core.errors import PlanFileError

_PERCENT = (1.0, 100.0)
_NUMBERS: dict[tuple[str, str], tuple[range | None, tuple[float, float]]] = {
    ("$VEL_AXIS", ""): (range(1, 7), _PERCENT),
    ("$ACC_AXIS", ""): (range(1, 7), _PERCENT),
    ("$VEL_EXTAX", ""): (range(1, 2), _PERCENT),
    ("$ACC_EXTAX", ""): (range(1, 2), _PERCENT),
    ("$VEL", "CP"): (None, (1e-4, 3.0)),
    ("$VEL", "ORI1"): (None, (1.0, 400.0)),
    ("$VEL", "ORI2"): (None, (1.0, 400.0)),
    ("$ACC", "CP"): (None, (1e-3, 10.0)),
    ("$ACC", "ORI1"): (None, (1.0, 1000.0)),
    ("$ACC", "ORI2"): (None, (1.0, 1000.0)),
    ("$APO", "CPTP"): (None, _PERCENT),
    ("$APO", "CDIS"): (None, (0.0, 1.0)),
    ("$ADVANCE", ""): (None, (1.0, 5.0)),
}
"""Index, least and greatest value, by word and field; of $APO.CDIS [mm], of $VEL.CP [m/s]."""
_FRAMES = ("TOOL_DATA", "LOAD_DATA", "BASE_DATA")
_MOST_NUMBER = 128


def check_setting(word: str, index: int | None, field: str, value: Any) -> None:
    """Whether a programme may set this variable so.

    Raises:
        PlanFileError: it may not, or it is no such variable.
    """
    told = f"{word}{'' if index is None else f'[{index}]'}{f'.{field}' if field else ''}"
    if word in _FRAMES and not field:
        if index is None or not 1 <= index <= _MOST_NUMBER or not isinstance(value, dict):
            raise PlanFileError(f"{told} is no place for such a value")
        return
    if (word, field) not in _NUMBERS:
        raise PlanFileError(f"{told} is not declared, or not for a programme to set")
    indices, (low, high) = _NUMBERS[word, field]
    if (index is None) != (indices is None) or (indices is not None and index not in indices):
        raise PlanFileError(f"{told} is no such variable")
    if isinstance(value, bool) or not isinstance(value, float | int) or not math.isfinite(value):
        raise PlanFileError(f"{told} is a number")
    if not low <= value <= high:
        raise PlanFileError(f"{told} of {value:g} is not between {low:g} and {high:g}")
