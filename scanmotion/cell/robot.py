"""An arm read from its URDF: six revolute axes, limits, and the boxes that bound its links."""

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from scanmotion.core.errors import CellError

MOST_M = 20.0
"""Longest side of a solid of a robot [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """A solid fixed to a link: a box, or a cylinder about its z axis."""

    name: str
    link: int
    """0 for the base, 1..6 for the links, 7 for the tool (moves with link 6), 8 the table, 9 the world."""
    shape: str
    """"box" or "cylinder"."""
    size: tuple[float, ...]
    """Full sides (x, y, z), or (radius, length) [m]."""
    X_LG: np.ndarray
    """Pose of the solid in the link's frame, shape (4, 4)."""
    carrier: str = ""
    """Link of the URDF that has the solid; empty for the cell's own."""
    side: bool = False
    """Whether the carrier hangs by a side branch: before the base, on any link, past the flange."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Robot:
    """Kinematics, limits and collision bodies of a six-axis arm."""

    name: str
    urdf: Path
    X_PJ: np.ndarray
    """Pose of each joint's frame in its parent at zero, shape (6, 4, 4)."""
    axes: np.ndarray
    """Unit axis of each joint in its own frame, shape (6, 3)."""
    X_6F: np.ndarray
    """Flange in link 6, shape (4, 4)."""
    lower: np.ndarray
    """Shape (6,) [rad]."""
    upper: np.ndarray
    velocity: np.ndarray
    """Shape (6,) [rad/s]."""
    bodies: tuple[Body, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved:
    """What a solver of the inverse kinematics finds for a batch of flange poses, limits aside."""

    joints: np.ndarray
    """Shape (n, slots, 6) [rad]; a row of NaN where a branch does not exist."""
    sigma_min: np.ndarray
    """Least singular value of the flange's Jacobian (m and rad mixed), shape (n, slots)."""
    extension: np.ndarray
    """How far inside the arm's reach each wrist is, shape (n,) [m]; negative outside."""


def _floats(text: str | None, n: int, where: str) -> np.ndarray:
    try:
        values = np.array([float(word) for word in (text or " ".join("0" * n)).split()])
    except ValueError:
        raise CellError(f"{where}: {text!r} are not numbers") from None
    if values.shape != (n,) or not np.isfinite(values).all() or np.abs(values).max(initial=0.0) > 1e4:
        raise CellError(f"{where}: {n} finite numbers are expected, not {text!r}")
    return values


def rotation_from_rpy(rpy: np.ndarray) -> np.ndarray:
    """URDF's fixed-axis roll, pitch, yaw, shape (3,) [rad], as a rotation matrix."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _origin(element: Element, where: str) -> np.ndarray:
    origin = element.find("origin")
    X = np.eye(4)
    if origin is not None:
        X[:3, 3] = _floats(origin.get("xyz"), 3, where)
        X[:3, :3] = rotation_from_rpy(_floats(origin.get("rpy"), 3, where))
    return X


@functools.lru_cache(maxsize=16)
def robot_from_urdf(path: Path, joints: tuple[str, ...], flange: str) -> Robot:
    """Reads a six-axis arm.

    Args:
        path: the URDF.
        joints: names of its six revolute joints from base to flange.
        flange: link whose frame is the flange, z outward.

    Raises:
        CellError: unreadable, other than six joints in one chain, limits or shapes that are not usable.
    """
    name = path.name
    if not path.is_file():
        raise CellError(f"{name}: no such URDF", key="robot.model")
    if path.stat().st_size > 8 << 20:
        raise CellError(f"{name}: more than 8 MiB is not a robot's URDF", key="robot.model")
    try:
        root = fromstring(path.read_text(encoding="utf-8"))
    except (ParseError, DefusedXmlException, UnicodeDecodeError, ValueError) as error:
        raise CellError(f"{name}: is not a readable URDF ({' '.join(str(error).split())[:120]})") from None
    # Transmissions and ros2_control name joints, too: only those of the robot itself count.
    elements = {str(j.get("name")): j for j in root.findall("joint")}
    missing = [j for j in joints if j not in elements]
    if missing or len(joints) != 6:
        raise CellError(
            f"{name}: joint {missing or joints} not found; known: {sorted(elements)}", key="robot.joints"
        )
    parents = {_link(j, "child", name): j for j in elements.values()}
    chain = _chain(parents, flange, name)
    moving = [str(j.get("name")) for j in chain if j.get("type") != "fixed"]
    if moving != list(joints):
        raise CellError(
            f"{name}: the chain to {flange!r} moves by {moving}, not {list(joints)}", key="robot.joints"
        )
    X_PJ, axes, limits, links, X = [], [], [], {_link(chain[0], "parent", name): (0, np.eye(4))}, np.eye(4)
    own = set()
    for joint in chain:
        X = X @ _origin(joint, f"{name}: joint {joint.get('name')}")
        if joint.get("type") != "fixed":
            X_PJ.append(X)
            X = np.eye(4)
            axes.append(_axis(joint, name))
            limits.append(_limit(joint, name))
            own |= {_link(joint, "parent", name), _link(joint, "child", name)}
        links[_link(joint, "child", name)] = (len(axes), X.copy())
    _add_branches(links, elements.values(), name)
    low, high, speed = np.array(limits).T
    return Robot(
        name=str(root.get("name")), urdf=path, X_PJ=np.array(X_PJ), axes=np.array(axes), X_6F=X,
        lower=low, upper=high, velocity=speed, bodies=tuple(_bodies(root, links, own, name)),
    )  # fmt: skip


def _link(joint: Element, role: str, name: str) -> str:
    element = joint.find(role)
    if element is None or not element.get("link"):
        raise CellError(f"{name}: joint {joint.get('name')} has no {role}")
    return str(element.get("link"))


def _chain(parents: dict[str, Element], flange: str, name: str) -> list[Element]:
    chain, link = [], flange
    while link in parents:
        chain.append(parents[link])
        link = _link(parents[link], "parent", name)
        if len(chain) > 100:
            raise CellError(f"{name}: the links form a ring")
    if not chain:
        raise CellError(f"{name}: no joint leads to link {flange!r}", key="robot.flange")
    return chain[::-1]


def _axis(joint: Element, name: str) -> np.ndarray:
    element = joint.find("axis")
    axis = _floats(element.get("xyz") if element is not None else "1 0 0", 3, f"{name}: axis")
    if not np.linalg.norm(axis) > 1e-9:
        raise CellError(f"{name}: joint {joint.get('name')} has no axis")
    return axis / np.linalg.norm(axis)


def _limit(joint: Element, name: str) -> tuple[float, float, float]:
    where = f"{name}: joint {joint.get('name')}"
    element = joint.find("limit")
    if element is None:
        raise CellError(f"{where} has no limit")
    low, high, speed = (float(_floats(element.get(k), 1, where)[0]) for k in ("lower", "upper", "velocity"))
    if not (low < high and high - low <= 100 and 0 < speed < 100):
        raise CellError(f"{where}: limits {low:g} .. {high:g} rad at {speed:g} rad/s are not usable")
    return low, high, speed


def _add_branches(links: dict[str, tuple[int, np.ndarray]], joints: Iterable[Element], name: str) -> None:
    """Adds the links that hang on those of the chain by fixed joints, with the link that they move with."""
    fixed = [j for j in joints if j.get("type") == "fixed"]
    found = True
    while found:
        found = False
        for joint in fixed:
            parent, child = (_link(joint, role, name) for role in ("parent", "child"))
            if parent in links and child not in links:
                index, X_JL = links[parent]
                links[child] = (index, X_JL @ _origin(joint, f"{name}: joint {joint.get('name')}"))
                found = True


def _bodies(root: Element, links: dict[str, tuple[int, np.ndarray]], own: set[str], name: str) -> list[Body]:
    """The solids of all links; `own` are those that a joint of the chain has for parent or child.

    Raises:
        CellError: a solid that does not move with the chain; shapes that are not usable.
    """
    bodies = []
    for link in root.findall("link"):
        carrier = str(link.get("name"))
        if carrier not in links:
            if link.find("collision") is not None:
                raise CellError(
                    f"{name}: link {carrier!r} has solids and is not fixed to the chain; make its joint "
                    "fixed, or take its solids out",
                    key="robot.model",
                )
            continue
        index, X_JL = links[carrier]
        for n, collision in enumerate(link.findall("collision")):
            label = collision.get("name") or f"{carrier}_{n}"
            X = X_JL @ _origin(collision, f"{name}: {label}")
            geometry = collision.find("geometry")
            shape = geometry[0] if geometry is not None and len(geometry) else None
            body = _body(label, index, shape, X, name)
            bodies.append(replace(body, carrier=carrier, side=carrier not in own))
    if not bodies:
        raise CellError(f"{name}: no collision geometry; boxes, cylinders and spheres are read")
    return bodies


def _body(label: str, index: int, shape: Element | None, X: np.ndarray, name: str) -> Body:
    where = f"{name}: {label}"
    kind = shape.tag if shape is not None else "nothing"
    if shape is not None and kind == "box":
        return Body(name=label, link=index, shape="box", size=_size(shape, ("size",), 3, where), X_LG=X)
    if shape is not None and kind == "cylinder":
        size = _size(shape, ("radius", "length"), 1, where)
        return Body(name=label, link=index, shape="cylinder", size=size, X_LG=X)
    if shape is not None and kind == "sphere":
        side = 2 * _size(shape, ("radius",), 1, where)[0]
        return Body(name=label, link=index, shape="box", size=(side,) * 3, X_LG=X)
    raise CellError(f"{where}: collision geometry {kind!r} is not read; boxes, cylinders and spheres are")


def _size(shape: Element, keys: tuple[str, ...], n: int, where: str) -> tuple[float, ...]:
    sizes = tuple(float(v) for key in keys for v in _floats(shape.get(key), n, where))
    if not 0.0 < min(sizes) <= max(sizes) <= MOST_M:
        raise CellError(f"{where}: a {shape.tag} of {sizes} m is not usable; 0 to {MOST_M:g} m are")
    return sizes


def rotations(axes: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations by `angles` (n, k) about unit `axes` (k, 3) (Rodrigues), shape (n, k, 3, 3)."""
    K = np.zeros((len(axes), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axes[:, 2], axes[:, 1], -axes[:, 0]
    K = K - K.transpose(0, 2, 1)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


def arm_poses(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Poses in the base of base and links 1..6, shape (n, 7, 4, 4), for q of shape (n, 6)."""
    R = rotations(robot.axes, q)
    out = np.zeros((len(q), 7, 4, 4))
    out[:, 0] = np.eye(4)
    joint = np.zeros((len(q), 4, 4))
    joint[:, 3, 3] = 1.0
    for i in range(6):
        joint[:, :3, :3] = R[:, i]
        out[:, i + 1] = out[:, i] @ (robot.X_PJ[i] @ joint)
    return out


def arm_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Angular (rows 0..2) and linear velocity of the flange in the base per joint speed, shape (n, 6, 6)."""
    frames = arm_poses(robot, q)
    axes = np.einsum("nkij,kj->nki", frames[:, 1:, :3, :3], robot.axes)
    tip = (frames[:, 6] @ robot.X_6F)[:, None, :3, 3]
    J = np.concatenate([axes, np.cross(axes, tip - frames[:, 1:, :3, 3])], axis=2)
    return np.swapaxes(J, 1, 2)


def least_singular(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Least singular value of the flange's Jacobian (m and rad mixed) at each row of q (m, 6), shape (m,)."""
    J = arm_jacobian(robot, q)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(J @ np.swapaxes(J, 1, 2))[:, 0], 0.0))


def inverse_poses(X: np.ndarray) -> np.ndarray:
    """Inverses of rigid poses, shape (..., 4, 4)."""
    R = np.swapaxes(X[..., :3, :3], -1, -2)
    out = np.zeros_like(X)
    out[..., :3, :3] = R
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R, X[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def clean_angle(q: np.ndarray) -> np.ndarray:
    """Angles brought into (-pi, pi]."""
    return math.pi - np.mod(math.pi - q, 2 * math.pi)
