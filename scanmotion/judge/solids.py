"""Collisions and clearances of the written trajectory: FCL on the part's true triangles and on primitives."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fcl
import numpy as np

from scanmotion.errors import PartError, PlanFileError
from scanmotion.judge.finding import Finding
from scanmotion.judge.motion import Motion
from scanmotion.partfile import read_geometry
from scanmotion.planfile import PlanRecord

STEP_M = 0.008
"""A sample is checked when some point of the arm has moved this far since the last one that was."""
TOLERANCE_M = 1e-3
_TOOL = 7
_TOUCHING = {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 7), (0, 2), (4, 6), (5, 7)}
"""Links that meet by construction; base and link 2, links 4 and 6 by their boxes' excess."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Solid:
    """One solid, where it is at each sample, and FCL's object for it."""

    name: str
    group: int
    """0..6 links, 7 tool, -1 surroundings, -2 part."""
    shape: Any
    grown: Any
    """The same box grown by the clearance, for a quick no; None for what is not grown."""
    X: np.ndarray
    """Pose in W, shape (N, 4, 4), or (1, 4, 4) where it never moves."""
    radius: float
    """Of the sphere about its origin that holds it [m]."""


def _geometry(shape: str, size: tuple[float, ...]) -> tuple[Any, np.ndarray]:
    """FCL's shape and the half sides of its box."""
    if shape == "box":
        return fcl.Box(*size), np.array(size) / 2
    if shape == "cylinder":
        return fcl.Cylinder(*size), np.array([size[0], size[0], size[1] / 2])
    return fcl.Sphere(size[0]), np.full(3, size[0])


def _object(geometry: Any) -> Any:
    return fcl.CollisionObject(geometry, fcl.Transform())


def _solids(record: PlanRecord, motion: Motion) -> list[Solid]:
    clearance, out = record.process.clearance_m, []
    for name, link, shape, size, X_BG in motion.arm.solids:
        geometry, half = _geometry(shape, size)
        grown = _object(fcl.Box(*(2 * half + 2 * clearance)))
        out.append(
            Solid(
                name=name, group=link, shape=_object(geometry), grown=grown, X=motion.X_WL[:, link] @ X_BG,
                radius=float(np.linalg.norm(half)),
            )
        )  # fmt: skip
    for body in record.bodies:
        geometry, half = _geometry(body.shape, body.size_m)
        frame = {"flange": motion.X_WF, "table": np.array(record.X_WT)[None], "world": np.eye(4)[None]}[
            body.frame
        ]
        out.append(
            Solid(
                name=body.name, group=_TOOL if body.frame == "flange" else -1, shape=_object(geometry),
                grown=_object(fcl.Box(*(2 * half + 2 * clearance))), X=frame @ np.array(body.X),
                radius=float(np.linalg.norm(half)),
            )
        )  # fmt: skip
    return out


def _part(folder: Path, record: PlanRecord, motion: Motion) -> Solid:
    try:
        raw = read_geometry(folder / record.part_file)
    except PartError as error:
        raise PlanFileError(str(error)) from None
    if len(raw.triangles) == 0:
        raise PlanFileError(f"{record.part_file}: has no triangles")
    centre = raw.vertices.mean(axis=0)
    model = fcl.BVHModel()
    model.beginModel(len(raw.vertices), len(raw.triangles))
    model.addSubModel(raw.vertices - centre, raw.triangles)
    model.endModel()
    X = motion.X_WO.copy()
    X[:, :3, 3] += motion.X_WO[:, :3, :3] @ centre
    radius = float(np.linalg.norm(raw.vertices - centre, axis=1).max())
    return Solid(name="part", group=-2, shape=_object(model), grown=None, X=X, radius=radius)


def checked_samples(solids: list[Solid], step: float) -> np.ndarray:
    """Indices such that no point of any solid moves farther than `step` between two of them."""
    n = max(len(s.X) for s in solids)
    moved = np.zeros(n - 1)
    for s in solids:
        if len(s.X) == 1:
            continue
        shift = np.linalg.norm(np.diff(s.X[:, :3, 3], axis=0), axis=1)
        turn = np.linalg.norm(np.diff(s.X[:, :3, :3], axis=0), axis=(1, 2)) / np.sqrt(2)
        moved = np.maximum(moved, shift + turn * s.radius)
    way = np.concatenate([[0.0], np.cumsum(moved)])
    marks = np.searchsorted(way, np.arange(0.0, way[-1] + step, step))
    return np.unique(np.concatenate([np.clip(marks, 0, n - 1), [0, n - 1]]))


def check_clearance(
    folder: Path, record: PlanRecord, motion: Motion, *, progress: Callable[[float], None] | None = None
) -> list[Finding]:
    """Arm and tool against part, table, surroundings and themselves, at samples `STEP_M` apart.

    Between two checked samples nothing moves farther than STEP_M, so a distance found at one of them holds
    up to half of that in between; what is allowed is the clearance less this half and a millimetre.
    """
    solids = _solids(record, motion)
    part = _part(folder, record, motion)
    robot = [s for s in solids if s.group >= 1]
    still = [s for s in solids if s.group == -1]
    worst: dict[tuple[str, str], tuple[float, int]] = {}
    pairs = [(a, b) for a in robot for b in [part, *still] if not (a.group == 1 and b.name == "floor")]
    links = [s for s in solids if s.group >= 0]
    self_pairs = [
        (a, b)
        for i, a in enumerate(links)
        for b in links[i + 1 :]
        if a.group != b.group and (min(a.group, b.group), max(a.group, b.group)) not in _TOUCHING
    ]
    samples = checked_samples([*solids, part], STEP_M)
    allowed = record.process.clearance_m
    for n, k in enumerate(samples):
        for a, b in pairs:
            _judge_pair(a, b, int(k), allowed, worst)
        for a, b in self_pairs:
            _judge_pair(a, b, int(k), 0.0, worst)
        if progress is not None and n % 50 == 0:
            progress(n / len(samples))
    return _findings(worst, motion, allowed)


def _judge_pair(
    a: Solid, b: Solid, k: int, allowed: float, worst: dict[tuple[str, str], tuple[float, int]]
) -> None:
    """Notes the distance of a pair at sample k where it is less than allowed."""
    Xa, Xb = a.X[min(k, len(a.X) - 1)], b.X[min(k, len(b.X) - 1)]
    gap = Xa[:3, 3] - Xb[:3, 3]
    if gap @ gap > (a.radius + b.radius + allowed) ** 2:
        return
    quick = a.grown if allowed > 0 else a.shape
    quick.setTransform(fcl.Transform(Xa[:3, :3], Xa[:3, 3]))
    b.shape.setTransform(fcl.Transform(Xb[:3, :3], Xb[:3, 3]))
    if not fcl.collide(quick, b.shape, fcl.CollisionRequest(), fcl.CollisionResult()):
        return
    distance = -1e-6
    if allowed > 0:
        a.shape.setTransform(fcl.Transform(Xa[:3, :3], Xa[:3, 3]))
        if not fcl.collide(a.shape, b.shape, fcl.CollisionRequest(), fcl.CollisionResult()):
            distance = fcl.distance(a.shape, b.shape, fcl.DistanceRequest(), fcl.DistanceResult())
    if distance < allowed and distance < worst.get((a.name, b.name), (np.inf, 0))[0]:
        worst[(a.name, b.name)] = (float(distance), k)


def _findings(
    worst: dict[tuple[str, str], tuple[float, int]], motion: Motion, allowed: float
) -> list[Finding]:
    findings = []
    times = motion.t
    for (a, b), (distance, k) in sorted(worst.items(), key=lambda item: item[1][0]):
        least = allowed - STEP_M / 2 - TOLERANCE_M
        if distance <= 0:
            text, code = f"{a} and {b} touch at {times[k]:.2f} s", "collision"
        elif distance < least:
            code = "clearance"
            text = (
                f"{a} and {b} come within {distance * 1e3:.1f} mm at {times[k]:.2f} s, "
                f"{allowed * 1e3:.0f} mm are asked for"
            )
        else:
            continue
        findings.append(
            Finding(
                code=code, message=text, where=f"{a}, {b}", value=distance, limit=allowed, t=float(times[k])
            )
        )
    return findings
