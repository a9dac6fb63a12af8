"""Faults planted in a programme's text, as an editor, a copy or a broken transfer makes them."""

import re

import numpy as np

KINDS = ("digit", "swap", "drop", "double", "page")


def mutated(lines, kind, rng):
    """The lines with one fault, and a word on it; None where the fault changes nothing.

    Args:
        lines: of a programme's file.
        kind: one of KINDS.
        rng: says where.
    """
    code = [i for i, x in enumerate(lines) if x.strip() and not x.lstrip().startswith((";", "&", "!", "#"))]
    made, i = list(lines), int(rng.choice(code))
    if kind == "digit":
        digits = [m.start() for m in re.finditer(r"\d", lines[i])]
        if not digits:
            return None
        at = int(rng.choice(digits))
        new = str((int(lines[i][at]) + int(rng.integers(1, 10))) % 10)
        made[i] = lines[i][:at] + new + lines[i][at + 1 :]
    elif kind == "swap":
        j = next((k for k in code if k > i), None)
        if j is None:
            return None
        made[i], made[j] = lines[j], lines[i]
    elif kind == "drop":
        del made[i]
    elif kind == "double":
        made.insert(i, lines[i])
    else:
        made[i:i] = lines[max(i - 20, 0) : i]
    return None if made == list(lines) else (made, f"{kind} at line {i + 1}: {lines[i][:90]}")


def numbers(line):
    """The numbers of a line."""
    return np.array([float(x) for x in re.findall(r"-?\d+\.?\d*", line)])
