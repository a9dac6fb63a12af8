"""Makers' own descriptions as they are: read, in closed form, kinematics against Drake, a box planned.

    pip install xacro
    python benchmarks/vendor_arms.py DIR [--only kr210 ur10e] [--plan all|none|NAME ...] [--box 330 200 600]

DIR holds clones of the makers' repositories, for instance of github.com/ros-industrial/abb_experimental, each
in a folder of its own; nothing of them belongs to scanmotion. What is done:

1. Every package.xml under DIR names a package. Every *.xacro that describes a robot, not only macros, is
   expanded into DIR/expanded/REPOSITORY__NAME.urdf, with `$(find package)` taken from these packages; a file
   that stands there already is left as it is. Universal Robots' one file is expanded for each of its types.
2. Each arm whose last link is moved by six turning joints is read as `scanmotion robots add` reads it, the
   packages' folders given. Said is which solver serves it.
3. Flange against base at `--configurations` random configurations inside the limits: our kinematics against
   a plant that Drake reads from the same file by itself, with nothing of ours between (solids and pictures
   are taken out of the text: Drake reads no STL). The greatest difference of an entry is said. The closed
   form has to find each of these configurations again.
4. `scanmotion robots add FILE`, then `scanmotion plan --cell FILE.yaml --box ...` with the YAML as it was
   written, in DIR/planned/NAME.

Exit status 1 where an arm that is read differs from Drake by more than 1e-9, a configuration is not found
again by the closed form, or a plan has a finding.
"""

import argparse
import io
import json
import os
import re
import resource
import subprocess
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.arm.robot import Robot, arm_poses, clean_angle, least_singular
from scanmotion.cell.ik.choice import has_closed_form, solver_of
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cell.suggest import suggestion
from scanmotion.core.errors import CellError

MAKERS = {
    "kuka": "KUKA", "kroshu": "KUKA", "abb": "ABB", "fanuc": "Fanuc", "motoman": "Motoman",
    "staubli": "Staubli", "universal": "Universal Robots", "denso": "Denso", "kawasaki": "Kawasaki",
    "khi": "Kawasaki", "doosan": "Doosan", "comau": "Comau", "ufactory": "uFactory", "xarm": "uFactory",
    "techman": "Techman", "epson": "Epson", "mitsubishi": "Mitsubishi", "melfa": "Mitsubishi",
    "kinova": "Kinova", "jaka": "JAKA", "hyundai": "Hyundai", "nachi": "Nachi", "aubo": "AUBO",
    "elite": "Elite", "han": "Han's", "igus": "igus", "neuromeka": "Neuromeka", "rokae": "Rokae",
    "borunte": "Borunte", "estun": "Estun", "annin": "Annin", "niryo": "Niryo", "tm": "Techman",
}  # fmt: skip
SINGULAR = 1e-3
"""Below this least singular value (m and rad mixed) the pose does not say where the joints are to 1e-5."""
UR_TYPES = ("ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30")
MADE = ("expanded", "planned")
NO_ROBOT = ("macro", "material", "common", "transmission", "gazebo", "srdf", "control", "test", "workcell")


def packages_in(folder: Path) -> dict[str, Path]:
    """Folder of each package under `folder`, by its name."""
    found: dict[str, Path] = {}
    for file in sorted(folder.rglob("package.xml")):
        name = re.search(r"<name>\s*([^<\s]+)\s*</name>", file.read_text(errors="replace"))
        if name:
            found.setdefault(name.group(1), file.parent)
    return found


def know_packages(known: dict[str, Path]) -> None:
    """Lets xacro find packages without ROS: it asks a module that only ROS has."""
    top, inner = types.ModuleType("ament_index_python"), types.ModuleType("ament_index_python.packages")
    module: Any = inner
    module.PackageNotFoundError = KeyError
    module.get_package_share_directory = lambda name: str(known[name])
    sys.modules |= {"ament_index_python": top, "ament_index_python.packages": inner}


def expanded(folder: Path, known: dict[str, Path], only: list[str]) -> list[tuple[str, Path]]:
    """(maker's repository, URDF) of every robot under `folder` whose name is asked for."""
    import xacro

    know_packages(known)
    out = folder / "expanded"
    out.mkdir(exist_ok=True)
    found = []
    for repository in sorted(
        p for p in folder.iterdir() if p.is_dir() and p.name not in ("expanded", "planned")
    ):
        files = sorted((*repository.rglob("*.xacro"), *repository.rglob("*.urdf")))
        for file in files:
            if any(word in file.name.lower() for word in NO_ROBOT):
                continue
            text = file.read_text(errors="replace")
            if "<robot" not in text or "<xacro:macro" in text:
                continue
            kinds = UR_TYPES if file.name == "ur.urdf.xacro" else ("",)
            for kind in kinds:
                name = kind or re.sub(r"(\.urdf)?(\.xacro)?$", "", file.name)
                target = out / f"{repository.name.replace('+', '_')}__{name}.urdf"
                if only and not any(re.search(word, target.stem) for word in only):
                    continue
                if not target.is_file():
                    try:
                        target.write_text(_expanded(xacro, file, kind))
                    except Exception as error:
                        print(f"{target.stem}: xacro: {' '.join(str(error).split())[:120]}", file=sys.stderr)
                        continue
                found.append((repository.name, target))
    return list(dict.fromkeys(found))


def _expanded(xacro: Any, file: Path, kind: str) -> str:
    if file.suffix == ".urdf":
        return file.read_text(errors="replace")
    mappings = {"ur_type": kind, "name": kind} if kind else {}
    return xacro.process_file(str(file), mappings=mappings).toprettyxml()


def drake_poses(file: Path, joints: tuple[str, ...], base: str, flange: str, q: np.ndarray) -> np.ndarray:
    """Flange in base by Drake's own reading of the file, shape (n, 4, 4); other joints stand at zero."""
    root = ElementTree.parse(file).getroot()
    for child in list(root):
        if child.tag not in ("link", "joint"):
            root.remove(child)
    for link in root.iter("link"):
        for part in (*link.findall("visual"), *link.findall("collision"), *link.findall("inertial")):
            link.remove(part)
    plant: Any = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(ElementTree.tostring(root, encoding="unicode"), "urdf")
    if base != "world":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(_root(root)))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    A, F = plant.GetFrameByName(base), plant.GetFrameByName(flange)
    out = []
    for row in q:
        for joint, angle in zip(joints, row, strict=True):
            plant.GetJointByName(joint).set_angle(context, angle)
        out.append(plant.CalcRelativeTransform(context, A, F).GetAsMatrix4())
    return np.array(out)


def _root(root: ElementTree.Element) -> str:
    """The link that nothing carries."""
    children = {j.find("child").get("link") for j in root.findall("joint")}  # type: ignore[union-attr]
    return next(str(link.get("name")) for link in root.findall("link") if link.get("name") not in children)


@dataclass(frozen=True, eq=False, kw_only=True)
class Row:
    """What came of one description."""

    maker: str
    name: str
    reading: str
    """"read", or the line that refuses it."""
    solver: str = ""
    fk: float = 0.0
    """Greatest difference of an entry of the flange's pose to Drake's."""
    missed: int = 0
    """Configurations that the closed form does not find again."""
    planned: str = ""
    fault: bool = False


def read_one(repository: str, file: Path, folders: tuple[str, ...], count: int) -> tuple[Row, str]:
    """The row of a description, and the YAML of its cell; "" where it is refused."""
    maker = next((m for key, m in MAKERS.items() if key in repository.lower()), repository)
    name = file.stem.partition("__")[2]
    try:
        found = suggestion(file, folders)
    except CellError as error:
        return Row(
            maker=maker, name=name, reading=str(error).partition(f"{file.name}: ")[2] or str(error)
        ), ""
    (file.with_suffix(".yaml")).write_text(found.yaml)
    settings = load_cell(file.with_suffix(".yaml"))
    from scanmotion.cell.build import robot_of

    robot = robot_of(settings)
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, 6))
    ours = arm_poses(robot, q)
    X = ours[:, 6] @ robot.X_6F
    names = settings.robot
    theirs = drake_poses(file, names.joints, _root(ElementTree.parse(file).getroot()), names.flange, q)
    fk = float(np.abs(X - theirs).max())
    closed = has_closed_form(robot)
    missed = missed_by(robot, q, X) if closed else 0
    row = Row(
        maker=maker, name=name, reading="read", solver="closed form" if closed else "search", fk=fk,
        missed=missed, fault=fk > 1e-9 or missed > 0,
    )  # fmt: skip
    return row, found.yaml


def missed_by(robot: Robot, q: np.ndarray, X: np.ndarray) -> int:
    """How many of the configurations (n, 6) at the poses (n, 4, 4), singular ones aside, are not found."""
    found = solver_of(robot)(X).joints
    regular = least_singular(robot, q) > SINGULAR
    off = np.abs(clean_angle(found - q[:, None])).max(axis=2)
    return int((np.nanmin(np.where(np.isnan(off), np.inf, off), axis=1) > 1e-5)[regular].sum())


def planned(file: Path, yaml: str, folders: tuple[str, ...], box: list[str], out: Path) -> tuple[str, bool]:
    """What `robots add` and `plan --box` say of a description, and whether that is a fault."""
    out.mkdir(parents=True, exist_ok=True)
    own = out / file.name
    own.write_bytes(file.read_bytes())
    own.with_suffix(".yaml").unlink(missing_ok=True)
    given = [word for folder in folders for word in ("--packages", folder)]
    base, cell = [sys.executable, "-m", "scanmotion"], str(own.with_suffix(".yaml"))
    added = subprocess.run([*base, "robots", "add", str(own), *given], capture_output=True, text=True)
    if added.returncode:
        return _last(added), True
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = ["plan", "--cell", cell, "--box", *box, "--no-html", "--json", "--out", str(out / "plan")]
    done = subprocess.run([*base, *words], capture_output=True, text=True, env={**os.environ})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    took = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if not done.stdout.lstrip().startswith("{"):
        return _last(done), True
    told = json.loads(done.stdout)
    views, findings = told["viewpoints"], told["findings"]
    lost, seconds = len(views["unreachable"]), told["time_s"]["total"]
    text = f"{views['global']} global, {lost} unreachable, {seconds:.1f} s"
    what = "no finding" if not findings else f"{len(findings)} findings: {findings[0]}"
    return f"{text}, {what}; {took:.0f} s of CPU", bool(findings)


def _last(done: subprocess.CompletedProcess[str]) -> str:
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return lines[-1][:200] if lines else f"exit status {done.returncode}"


def table(rows: list[Row]) -> str:
    """The rows as Markdown."""
    out = io.StringIO()
    print("| maker | arm | read | solver | kinematics against Drake | plan --box |", file=out)
    print("|---|---|---|---|---|---|", file=out)
    for row in rows:
        fk = f"{row.fk:.1e}" if row.solver else ""
        lost = f", {row.missed} not found again" if row.missed else ""
        print(
            f"| {row.maker} | {row.name} | {row.reading[:160]} | {row.solver}{lost} | {fk} | {row.planned} |",
            file=out,
        )
    return out.getvalue()


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("folder", type=Path)
    asked.add_argument("--only", nargs="*", default=[], help="regular expressions of names")
    asked.add_argument("--plan", nargs="*", default=["none"], help="all, none, or names")
    asked.add_argument("--box", nargs=3, default=["330", "200", "600"])
    asked.add_argument("--configurations", type=int, default=200)
    given = asked.parse_args()
    folder = given.folder.resolve()
    known = packages_in(folder)
    rows = []
    for repository, file in expanded(folder, known, given.only):
        wanted = sorted(set(re.findall(r"package://([^/]+)/", file.read_text(errors="replace"))) & set(known))
        folders = tuple(str(known[name]) for name in wanted)
        row, yaml = read_one(repository, file, folders, given.configurations)
        if yaml and (given.plan == ["all"] or row.name in given.plan):
            said, fault = planned(file, yaml, folders, given.box, folder / "planned" / file.stem)
            row = Row(**{**vars(row), "planned": said, "fault": row.fault or fault})
        rows.append(row)
        print(
            f"{file.stem}: {row.reading} {row.solver} {row.fk:.1e} {row.planned}", file=sys.stderr, flush=True
        )
    print(table(rows))
    read = [row for row in rows if row.solver]
    print(f"{len(rows)} descriptions, {len(read)} read, of {len({r.maker for r in read})} makers; "
          f"{sum(r.solver == 'closed form' for r in read)} in closed form")  # fmt: skip
    return int(any(row.fault for row in rows))


if __name__ == "__main__":
    sys.exit(main())
