"""An arm read by Drake: links, solids, joints, limits and names come from a MultibodyPlant.

Guarantees: six turning joints in one chain from base to flange; every solid that moves with the chain is
among the bodies, whatever branch it hangs on; what Drake would take for something else is refused by name.
"""

import functools
import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Convex, Mesh, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.arm.robot import Robot
from scanmotion.cell.arm.robot_solids import robot_bodies
from scanmotion.cell.arm.urdf import Urdf, urdf_from
from scanmotion.core.errors import CellError

_KINDS = {
    "prismatic": "slides", "planar": "moves in a plane", "ball_rpy": "is a ball", "universal": "is universal",
    "screw": "is a screw", "quaternion_floating": "floats", "rpy_floating": "floats",
}  # fmt: skip


def robot_from_file(
    path: Path,
    joints: tuple[str, ...],
    flange: str,
    *,
    packages: tuple[Path, ...] = (),
    turns: float = 1.0,
    speed: tuple[float, ...] | None = None,
) -> Robot:
    """Reads a six-axis arm.

    Args:
        path: the URDF.
        joints: names of its six turning joints from base to flange.
        flange: link whose frame is the flange.
        packages: folders in which package:// is sought.
        turns: an endless joint is bounded by so many turns each way.
        speed: greatest speeds to take in place of those that the file lacks, shape (6,) [rad/s].

    Raises:
        CellError: unreadable, other than six turning joints in one chain, limits or shapes not usable.
    """
    stamp = path.stat() if path.is_file() else None
    key = (stamp.st_mtime_ns, stamp.st_size) if stamp else None
    return _robot(path, joints, flange, packages, turns, speed, key)


@functools.lru_cache(maxsize=32)
def _robot(
    path: Path,
    joints: tuple[str, ...],
    flange: str,
    packages: tuple[Path, ...],
    turns: float,
    speed: tuple[float, ...] | None,
    stamp: tuple[int, int] | None,
) -> Robot:
    urdf = urdf_from(path, packages)
    plant, inspector, heard = _plant(urdf, path.name)
    own = {str(joint.name()): joint for joint in _joints(plant)}
    file_name = {new: old for old, new in urdf.names.items()}
    named = tuple(urdf.names.get(j, j) for j in joints)
    missing = [j for j, n in zip(joints, named, strict=True) if n not in own]
    if missing or len(set(joints)) != 6:
        known = sorted(file_name.get(n, n) for n in own)
        raise CellError(
            f"{path.name}: joint {missing or list(joints)} not found; known: {known}", key="robot.joints"
        )
    _check_kinds(own, named, urdf, path.name, file_name)
    chain = _chain(plant, urdf.names.get(flange, flange), flange, path.name)
    moving = [str(j.name()) for j in chain if j.type_name() != "weld"]
    if moving != list(named):
        _refuse_chain(chain, named, [file_name.get(n, n) for n in moving], joints, flange, path.name)
    X_PJ, axes, X_6F, places, at_joints = _kinematics(chain)
    low, high, velocity = _limits([own[n] for n in named], joints, turns, speed, path.name)
    places = _with_branches(_joints(plant), places)
    bodies = robot_bodies(plant, inspector, urdf, places, at_joints, path.name)
    return Robot(
        name=urdf.name, urdf=path, X_PJ=X_PJ, axes=axes, X_6F=X_6F, lower=low, upper=high, velocity=velocity,
        bodies=bodies, joined=_joined(chain), joints=named, flange=urdf.names.get(flange, flange),
        text=urdf.text, pieces=urdf.pieces, record=urdf.record, meshes=urdf.meshes,
        notes=(*urdf.notes, *heard),
    )  # fmt: skip


def ends_of_six(path: Path, packages: tuple[Path, ...] = ()) -> list[tuple[str, tuple[str, ...]]]:
    """Links that six turning joints move, with those joints from the base on, in the plant's order.

    Raises:
        CellError: there is none, or there are several arms.
    """
    urdf = urdf_from(path, packages)
    plant, _, _ = _plant(urdf, path.name)
    old = {new: name for name, new in urdf.names.items()}
    longest: list[str] = []
    ends = []
    for link in urdf.links:
        body = plant.GetBodyByName(link)
        by_child = {joint.child_body().index(): joint for joint in _joints(plant)}
        moving = []
        while body.index() in by_child:
            joint = by_child[body.index()]
            moving += [joint] if joint.type_name() != "weld" else []
            body = joint.parent_body()
        names = [old.get(j.name(), str(j.name())) for j in reversed(moving)]
        longest = max(longest, names, key=len)
        if len(moving) == 6 and all(j.type_name() == "revolute" for j in moving):
            ends.append((old.get(link, link), tuple(names)))
    if not ends:
        text = f"{path.name}: no link is moved by six turning joints; the longest chain moves by {longest}"
        raise CellError(text, key="robot.joints")
    if len({joints for _, joints in ends}) > 1:
        raise CellError(f"{path.name}: more than one arm; write robot.joints and robot.flange by hand")
    return ends


def _plant(urdf: Urdf, name: str) -> tuple[MultibodyPlant, Any, tuple[str, ...]]:
    """The parsed arm alone, not finalized, its inspector, and Drake's warnings in our words."""
    scene, plant = SceneGraph(), MultibodyPlant(time_step=0.0)
    plant.RegisterAsSourceForSceneGraph(scene)
    with tempfile.TemporaryDirectory() as folder, _listening() as warnings:
        write_arm(urdf.text, urdf.pieces, Path(folder))
        try:
            file: Any = str(Path(folder) / "arm.urdf")
            Parser(plant).AddModels(file)
        except (RuntimeError, SystemExit) as error:
            # Drake ends the process on sizes that its shapes refuse.
            text = str(error).replace(folder, "").replace("/arm.urdf", name)
            raise CellError(
                f"{name}: Drake cannot read it ({' '.join(text.split())[:200]})", key="robot.model"
            ) from None
        inspector = scene.model_inspector()
        # Hulls are made from files that are gone afterwards.
        for geometry in inspector.GetAllGeometryIds():
            if isinstance(inspector.GetShape(geometry), Convex | Mesh):
                inspector.GetShape(geometry).GetConvexHull()
    return plant, inspector, _in_our_words(warnings)


def write_arm(text: str, pieces: dict[str, bytes], folder: Path) -> None:
    """Writes the arm as Drake reads it, arm.urdf and its pieces, into a folder."""
    for file, data in pieces.items():
        (folder / file).write_bytes(data)
    (folder / "arm.urdf").write_text(text, encoding="utf-8")


@contextmanager
def _listening() -> Iterator[list[str]]:
    """Collects what Drake warns of, instead of letting it print."""
    heard: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: heard.append(record.getMessage())
    logger = logging.getLogger("drake")
    before, passes = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING)
    logger.propagate = False
    try:
        yield heard
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        logger.propagate = passes


def _in_our_words(warnings: list[str]) -> tuple[str, ...]:
    """Each kind of warning once."""
    out: list[str] = []
    mass = [w for w in warnings if "inertia" in w.lower() or "mass" in w.lower()]
    if mass:
        out.append(f"Drake finds the inertia of {len(mass)} links not physical; no plan depends on it")
    for warning in warnings:
        if warning not in mass:
            line = f"Drake warns: {' '.join(warning.rpartition(': warning: ')[2].split())[:160]}"
            out += [line] if line not in out else []
    return tuple(out)


def _joints(plant: MultibodyPlant) -> list[Any]:
    return [plant.get_joint(index) for index in plant.GetJointIndices()]


def _check_kinds(
    own: dict[str, Any], named: tuple[str, ...], urdf: Urdf, name: str, file_name: dict[str, str]
) -> None:
    for joint in named:
        label, kind = file_name.get(joint, joint), own[joint].type_name()
        if label in urdf.mimic:
            raise CellError(f"{name}: joint {label!r} mimics another; six joints of their own are planned",
                            key="robot.joints")  # fmt: skip
        if kind == "weld":
            raise CellError(
                f"{name}: joint {label!r} is fixed; six turning joints are planned", key="robot.joints"
            )
        if kind != "revolute":
            how = _KINDS.get(kind, f"is of the kind {kind}")
            raise CellError(
                f"{name}: joint {label!r} {how}; six turning joints are planned", key="robot.joints"
            )


def _chain(plant: MultibodyPlant, flange: str, label: str, name: str) -> list[Any]:
    """Joints from the root to the flange."""
    if not plant.HasBodyNamed(flange):
        ends = {end.name() for j in _joints(plant) for end in (j.parent_body(), j.child_body())}
        known = sorted(ends)
        raise CellError(f"{name}: no link {label!r}; known: {', '.join(known)}", key="robot.flange")
    by_child = {joint.child_body().index(): joint for joint in _joints(plant)}
    body, chain = plant.GetBodyByName(flange), []
    while body.index() in by_child:
        chain.append(by_child[body.index()])
        body = chain[-1].parent_body()
        if len(chain) > len(by_child):
            raise CellError(f"{name}: the links form a ring")
    if not chain:
        raise CellError(f"{name}: no joint leads to link {label!r}", key="robot.flange")
    return chain[::-1]


def _refuse_chain(
    chain: list[Any],
    named: tuple[str, ...],
    moving: list[str],
    joints: tuple[str, ...],
    flange: str,
    name: str,
) -> None:
    turning = [joint for joint in chain if joint.type_name() != "weld"]
    extra = [(j, label) for j, label in zip(turning, moving, strict=True) if j.name() not in named]
    if extra and len(moving) > 6:
        joint, label = extra[0]
        what = "a rail" if joint.type_name() == "prismatic" else "one more axis"
        raise CellError(
            f"{name}: joint {label!r} moves the chain to {flange!r} beside the six ({what}); seven are "
            "not planned: make it fixed where it stands",
            key="robot.joints",
        )
    raise CellError(
        f"{name}: the chain to {flange!r} moves by {moving}, not {list(joints)}", key="robot.joints"
    )


def _kinematics(
    chain: list[Any],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[Any, tuple[int, np.ndarray]], set]:
    """Frames at zero and axes; each body of the chain with its link and its pose there; those at joints."""
    X, X_PJ, axes = np.eye(4), [], []
    places = {chain[0].parent_body().index(): (0, np.eye(4))}
    at_joints = set()
    for joint in chain:
        X = X @ joint.frame_on_parent().GetFixedPoseInBodyFrame().GetAsMatrix4()
        if joint.type_name() == "weld":
            X = X @ joint.X_FM().GetAsMatrix4()
        else:
            X_PJ.append(X)
            axes.append(joint.revolute_axis())
            X = np.eye(4)
            at_joints |= {joint.parent_body().index(), joint.child_body().index()}
        X = X @ joint.frame_on_child().GetFixedPoseInBodyFrame().inverse().GetAsMatrix4()
        places[joint.child_body().index()] = (len(axes), X)
    return np.array(X_PJ), np.array(axes), X, places, at_joints


def _joined(chain: list[Any]) -> frozenset[frozenset[str]]:
    """Links that a moving joint of the chain joins."""
    moving = [joint for joint in chain if joint.type_name() != "weld"]
    return frozenset(frozenset((str(j.parent_body().name()), str(j.child_body().name()))) for j in moving)


def _with_branches(
    joints: list[Any], places: dict[Any, tuple[int, np.ndarray]]
) -> dict[Any, tuple[int, np.ndarray]]:
    """Adds the bodies that hang on those of the chain by fixed joints, with the link that they move with."""
    pending = [j for j in joints if j.type_name() == "weld"]
    while ready := [
        j for j in pending if j.parent_body().index() in places and j.child_body().index() not in places
    ]:
        for joint in ready:
            link, X = places[joint.parent_body().index()]
            X = (
                X
                @ joint.frame_on_parent().GetFixedPoseInBodyFrame().GetAsMatrix4()
                @ joint.X_FM().GetAsMatrix4()
            )
            X = X @ joint.frame_on_child().GetFixedPoseInBodyFrame().inverse().GetAsMatrix4()
            places[joint.child_body().index()] = (link, X)
    return places


def _limits(
    joints: list[Any], labels: tuple[str, ...], turns: float, speed: tuple[float, ...] | None, name: str
) -> np.ndarray:
    """Lower, upper [rad] and greatest speed [rad/s], shape (3, 6)."""
    rows, slow = [], []
    for n, (joint, label) in enumerate(zip(joints, labels, strict=True)):
        low, high = float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])
        velocity = float(joint.velocity_upper_limits()[0])
        if np.isinf(low) and np.isinf(high):
            low, high = -2 * np.pi * turns, 2 * np.pi * turns
        if not 0 < velocity < 100:
            velocity = 0.0 if speed is None else speed[n]
            slow += [label] if speed is None else []
        if not (low < high and high - low <= 100):
            raise CellError(
                f"{name}: joint {label}: limits {low:g} .. {high:g} rad are not usable", key="robot.model"
            )
        rows.append((low, high, velocity))
    if slow:
        text = f"{name}: no usable speed for joint {', '.join(slow)}; set robot.velocity_deg_s, six values"
        raise CellError(text, key="robot.velocity_deg_s")
    return np.array(rows).T
