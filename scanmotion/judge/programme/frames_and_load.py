"""The frames and the load that a programme gives to its controller, against the plan and the cell."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.core.finding import Finding
from scanmotion.judge.programme.controller import Controller
from scanmotion.judge.programme.motions import pose_of
from scanmotion.judge.programme.world import Run

_FRAME, _MASS_KG, _CENTRE_M = 1e-5, 1e-3, 1e-4
"""How far frames [m, and entries of a rotation], mass and its centre may be off."""


def frames_and_load(controller: Controller, run: Run, system: dict[Any, Any]) -> list[Finding]:
    """Tool, base and load, as the programme sets them.

    Args:
        controller: what the programme is run on.
        run: a run of it.
        system: the controller's variables after the run.
    """
    if not run.ended:
        return []
    told = {"krl": _of_krl, "rapid": _of_rapid, "urscript": _of_urscript}[controller.programme.language]
    try:
        return told(controller, system)
    except (TypeError, KeyError, IndexError, ValueError):
        return [_finding("tool, base or load are not set", "tool")]


def _of_krl(controller: Controller, system: dict[Any, Any]) -> list[Finding]:
    s, findings = controller.signals, []
    tool, load = (system[name, s.tool_number, ""] for name in ("TOOL_DATA", "LOAD_DATA"))
    base = system["BASE_DATA", s.base_number, ""]
    if tool is not system["$TOOL", None, ""] or load is not system["$LOAD", None, ""]:
        findings.append(_finding("another tool is active", "tool"))
    if base is not system["$BASE", None, ""] or base is not system["$ROBROOT", None, ""]:
        findings.append(_finding("the base is not the robot's", "base"))
    centre = [load["CM"][k] * 1e-3 for k in "XYZ"]
    turned = any(load["CM"][k] for k in "ABC")
    inertia = [load["J"][k] for k in "XYZ"]
    return findings + _judged(controller, pose_of(tool), load["M"], centre, inertia, turned=turned)


def _of_rapid(controller: Controller, system: dict[Any, Any]) -> list[Finding]:
    data, main = controller.programme.data, controller.programme.main
    held, (place, turn), (mass, centre, axes, *inertia) = data[f"{main}_TOOL"]
    own, fixed, unit, *frames = data[f"{main}_BASE"]
    findings = []
    if held is not True or own is not False or fixed is not True or unit != "":
        findings.append(_finding("the tool is not held by the robot, or the base is held or moves", "base"))
    if any(list(f) != [[0, 0, 0], [1, 0, 0, 0]] for f in frames) or len(frames) != 2:
        findings.append(_finding("the base is not the robot's", "base"))
    if abs(np.linalg.norm(turn) - 1) > 1e-5:
        return [*findings, _finding("the tool's quaternion has not the length 1", "tool")]
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(turn, scalar_first=True).as_matrix()
    X[:3, 3] = np.array(place) * 1e-3
    centre = [v * 1e-3 for v in centre]
    return findings + _judged(controller, X, mass, centre, inertia, turned=list(axes) != [1, 0, 0, 0])


def _of_urscript(controller: Controller, system: dict[Any, Any]) -> list[Finding]:
    pose, (mass, centre) = np.array(system["TCP"], float), system["PAYLOAD"]
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec(pose[3:6]).as_matrix()
    X[:3, 3] = pose[:3]
    return _judged(controller, X, mass, centre, [0.0, 0.0, 0.0], turned=False)


def _judged(
    controller: Controller,
    X: np.ndarray,
    mass: float,
    centre: list[float],
    inertia: list[float],
    *,
    turned: bool,
) -> list[Finding]:
    """A tool's frame and load against the plan's scanner and the cell's tool."""
    findings, planned = [], np.array(controller.record.X_FS)
    if X.shape != (4, 4) or not np.abs(X - planned).max() <= _FRAME:
        findings.append(_finding("the tool's frame is not the scanner's", "tool"))
    wanted = controller.signals.centre_of_mass_m or tuple(planned[:3, 3] / 2)
    if abs(mass - controller.mass) > _MASS_KG or np.abs(np.subtract(centre, wanted)).max() > _CENTRE_M:
        text = f"the load is {mass} kg at {centre}, the cell's tool {controller.mass} kg at {wanted}"
        findings.append(_finding(text, "load"))
    half = planned[:3, 3] / 2
    most = 4 * controller.mass * max(float(half @ half), 0.02**2)
    if turned or len(inertia) != 3 or not all(0 <= v <= most for v in inertia):
        text = f"the load's inertia {inertia} kg m2 is none of {controller.mass} kg within the fixture"
        findings.append(_finding(text, "load"))
    return findings


def _finding(message: str, where: str) -> Finding:
    return Finding(code="limits", message=message, where=where)
