"""The judge's own kinematics: products of exponentials from the URDF (Lynch and Park 2017, chapter 4)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from scanmotion.core.errors import PlanFileError
from scanmotion.core.trajectory import Trajectory
from scanmotion.plan_io.read import read_text
from scanmotion.plan_io.schema import PlanRecord


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkSolid:
    """A solid of the URDF's collision geometry."""

    name: str
    carrier: str
    """Link of the URDF that has it."""
    group: int
    """Link 0..6 that it moves with."""
    side: bool
    """Whether no joint of the chain starts or ends at its carrier."""
    kind: str
    """box, cylinder, sphere or mesh."""
    size: tuple[float, ...]
    """As in the URDF [m]; the scale of a mesh."""
    X_BG: np.ndarray
    """Pose in the base at zero, shape (4, 4)."""
    file: str = ""
    """The mesh's file in the plan's folder."""


@dataclass(frozen=True, eq=False, kw_only=True)
class UrdfArm:
    """Screws of the joints in the base at zero, and what hangs on each link."""

    screws: np.ndarray
    """Angular and linear part (w, v) of each joint's screw, shape (6, 6)."""
    X_BF: np.ndarray
    """Flange in the base at zero."""
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    solids: tuple["LinkSolid", ...]
    """What hangs fixed on the chain, by side branches too."""
    joined: frozenset[frozenset[str]]
    """Links of the URDF at the two ends of each of the six joints."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """Where everything is at each sample of the trajectory."""

    arm: UrdfArm
    t: np.ndarray
    """Shape (N,) [s]."""
    X_WL: np.ndarray
    """Displacement of links 0..6 from zero, in W: X_WL @ (pose in the base at zero), shape (N, 7, 4, 4)."""
    X_WF: np.ndarray
    """Shape (N, 4, 4)."""
    X_WS: np.ndarray
    X_WO: np.ndarray
    X_OS: np.ndarray


def arm_from_urdf(text: str, joints: tuple[str, ...], flange: str) -> UrdfArm:
    """Reads screws, limits and collision solids.

    Raises:
        PlanFileError: not a URDF with these six joints in one chain.
    """
    try:
        root: Any = fromstring(text)
        by_child = {j.find("child").get("link"): j for j in root.findall("joint")}
        chain: list[Any] = []
        link: str = flange
        while link in by_child and len(chain) < 100:
            chain.append(by_child[link])
            link = by_child[link].find("parent").get("link")
        chain.reverse()
        names = [j.get("name") for j in chain if j.get("type") != "fixed"]
        if tuple(names) != joints:
            raise PlanFileError(f"the URDF's chain moves by {names}, the plan's by {list(joints)}")
        return _arm(root, chain, link)
    except (ParseError, DefusedXmlException, AttributeError, TypeError, ValueError) as error:
        raise PlanFileError(
            f"the plan's URDF cannot be read ({' '.join(str(error).split())[:120]})"
        ) from None


def _arm(root: Any, chain: list[Any], base: str) -> UrdfArm:
    X, screws, limits, links = np.eye(4), [], [], {base: (0, np.eye(4))}
    own, joined = set(), set()
    for joint in chain:
        X = X @ _origin(joint)
        if joint.get("type") != "fixed":
            w = X[:3, :3] @ _numbers(joint.find("axis").get("xyz"), 3)
            if np.linalg.norm(w) < 1e-9:
                raise ValueError("a joint without an axis")
            w = w / np.linalg.norm(w)
            screws.append(np.concatenate([w, -np.cross(w, X[:3, 3])]))
            limits.append(_limits(joint))
            ends = frozenset(joint.find(role).get("link") for role in ("parent", "child"))
            own |= ends
            joined.add(ends)
        links[joint.find("child").get("link")] = (len(screws), X)
    pending = [j for j in root.findall("joint") if j.find("child").get("link") not in links]
    solids = _solids(root, _with_branches(links, pending), own)
    low, high, speed = np.array(limits).T
    if np.isnan(limits).any() or (low > high).any() or (speed <= 0).any():
        raise ValueError("limits of the joints")
    return UrdfArm(
        screws=np.array(screws), X_BF=X, lower=low, upper=high, velocity=speed, solids=tuple(solids),
        joined=frozenset(joined),
    )  # fmt: skip


def _limits(joint: Any) -> list[float]:
    """Lower, upper [rad] and greatest speed [rad/s]; what turns for ever, or says no speed, is not bounded.

    Raises:
        ValueError: a joint that does not turn, or mimics another; values that are not finite.
    """
    if joint.get("type") not in ("revolute", "continuous") or joint.find("mimic") is not None:
        raise ValueError(f"joint {joint.get('name')} is not one that turns by itself")
    limit = joint.find("limit")
    values = [float(limit.get(k, "0")) for k in ("lower", "upper", "velocity")]
    if not np.isfinite(values).all():
        raise ValueError("limits of the joints")
    if joint.get("type") == "continuous":
        values[:2] = [-np.inf, np.inf]
    if values[2] == 0.0:
        values[2] = np.inf
    return values


def _with_branches(links: dict[str, tuple[int, np.ndarray]], joints: list[Any]) -> dict:
    """Adds what hangs on the links by fixed joints, one after the other until nothing is added."""
    while True:
        ready = [j for j in joints if j.get("type") == "fixed" and j.find("parent").get("link") in links]
        if not ready:
            return links
        for joint in ready:
            index, X_BL = links[joint.find("parent").get("link")]
            links[joint.find("child").get("link")] = (index, X_BL @ _origin(joint))
            joints.remove(joint)


def _solids(root: Any, links: dict[str, tuple[int, np.ndarray]], own: set[str]) -> list[LinkSolid]:
    """The collision geometry of all links; `own` are those at which a joint of the chain starts or ends.

    Raises:
        ValueError: a solid that does not move with the chain, or of a kind that is not read.
    """
    solids = []
    for link in root.findall("link"):
        carrier = link.get("name")
        if carrier not in links:
            if link.find("collision") is not None:
                raise ValueError(f"link {carrier!r} has solids and is not fixed to the chain")
            continue
        index, X_BL = links[carrier]
        for n, collision in enumerate(link.findall("collision")):
            shape = next(iter(collision.find("geometry")))
            if shape.tag == "box":
                size = tuple(_numbers(shape.get("size"), 3))
            elif shape.tag == "cylinder":
                size = (float(shape.get("radius")), float(shape.get("length")))
            elif shape.tag == "sphere":
                size = (float(shape.get("radius")),)
            elif shape.tag == "mesh":
                size = tuple(_numbers(shape.get("scale", "1 1 1"), 3))
            else:
                raise ValueError(f"collision geometry {shape.tag!r}")
            solids.append(
                LinkSolid(
                    name=collision.get("name") or f"{carrier}_{n}", carrier=carrier, group=index,
                    side=carrier not in own, kind=shape.tag, size=size, X_BG=X_BL @ _origin(collision),
                    file=shape.get("filename", ""),
                )
            )  # fmt: skip
    return solids


def _numbers(text: str, n: int) -> np.ndarray:
    values = np.array([float(word) for word in text.split()])
    if values.shape != (n,) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} instead of {n} numbers")
    return values


def _origin(element: Any) -> np.ndarray:
    X, origin = np.eye(4), element.find("origin")
    if origin is not None:
        X[:3, 3] = _numbers(origin.get("xyz", "0 0 0"), 3)
        r, p, y = _numbers(origin.get("rpy", "0 0 0"), 3)
        for w, angle in (((1.0, 0, 0), r), ((0, 1.0, 0), p), ((0, 0, 1.0), y)):
            # Fixed axes: later turns come from the left.
            X[:3, :3] = exponentials(np.array([*w, 0, 0, 0.0]), np.array([angle]))[0, :3, :3] @ X[:3, :3]
    return X


def exponentials(screw: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """exp([S] theta) for a unit screw (w, v), shape (n, 4, 4)."""
    w, v = screw[:3], screw[3:]
    W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    X = np.tile(np.eye(4), (len(angle), 1, 1))
    X[:, :3, :3] = np.eye(3) + s * W + (1 - c) * (W @ W)
    G = angle[:, None, None] * np.eye(3) + (1 - c) * W + (angle[:, None, None] - s) * (W @ W)
    X[:, :3, 3] = G @ v
    return X


def motion_from(folder: Path, record: PlanRecord, trajectory: Trajectory) -> Motion:
    """Poses of everything at each sample."""
    return motion_at(arm_of(folder, record), record, trajectory.t, trajectory.q)


def arm_of(folder: Path, record: PlanRecord) -> UrdfArm:
    """The arm of the plan's own URDF.

    Raises:
        PlanFileError: it cannot be read.
    """
    text = read_text(folder, record.urdf_file, limit=8 << 20)
    return arm_from_urdf(text, record.robot_joints, record.flange_link)


def motion_at(arm: UrdfArm, record: PlanRecord, t: np.ndarray, q: np.ndarray) -> Motion:
    """Poses of everything at the configurations q, shape (N, 7) [rad], passed at the times t [s]."""
    X = np.tile(np.array(record.X_WB), (len(t), 1, 1))
    links = [X]
    for i in range(6):
        X = X @ exponentials(arm.screws[i], q[:, i])
        links.append(X)
    X_WF = X @ arm.X_BF
    X_WS = X_WF @ np.array(record.X_FS)
    turn = exponentials(np.array([0, 0, 1.0, 0, 0, 0]), q[:, 6])
    X_WO = np.array(record.X_WT) @ turn @ np.array(record.X_TO)
    return Motion(
        arm=arm, t=t, X_WL=np.stack(links, axis=1), X_WF=X_WF, X_WS=X_WS, X_WO=X_WO,
        X_OS=np.linalg.inv(X_WO) @ X_WS,
    )  # fmt: skip
