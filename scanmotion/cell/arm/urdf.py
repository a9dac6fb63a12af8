"""A robot's URDF made ready for Drake's parser, and for a plan's folder.

Drake reads no STL and no DAE, takes a link named `world` for its own world, and shares one space of names
with the cell around. So meshes become convex pieces as OBJ, names that are ours are changed, and everything
that is not of the robot itself (transmissions, ros2_control, gazebo) is left out. Nothing else is changed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError, SubElement, tostring

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from scanmotion.core.errors import CellError, PartError
from scanmotion.geometry.convex import Hull, convex_pieces
from scanmotion.geometry.files.collada import triangles_of_collada
from scanmotion.geometry.files.part_files import read_geometry

OURS = frozenset(
    {"world", "tool", "turntable", "turntable_base", "stand", "floor", "surroundings", "flange_F", "S", "O",
     "E1", "part", "table", "table_column", "pedestal", "scanner", "fixture_plate", "fixture_arm_a",
     "fixture_arm_b", "housing", "fixture"}
)  # fmt: skip
"""Names that the cell's plant has of its own; links, joints and solids of a URDF get others."""
MOST_TRIANGLES = 500_000
"""Of one collision mesh."""
_KEPT = ("link", "joint", "material")
_OTHERS = {
    ".sdf": "SDF", ".world": "SDF", ".xml": "MJCF", ".mjcf": "MJCF", ".yaml": "a file of Drake's directives",
    ".yml": "a file of Drake's directives", ".usd": "USD", ".usda": "USD", ".srdf": "SRDF",
}  # fmt: skip
"""Descriptions of robots that are not read, by the ending."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Urdf:
    """A URDF as Drake reads it, and as a plan's folder keeps it."""

    name: str
    text: str
    """For Drake: meshes are named by their file in `pieces`."""
    pieces: dict[str, bytes]
    """OBJ files of the convex pieces."""
    record: bytes
    """For a plan's folder: the file as it was, or with its collision meshes named as in `meshes`."""
    meshes: dict[str, bytes]
    """The collision meshes as they were, by plain names."""
    names: dict[str, str]
    """Links and joints that got another name, by the file's."""
    links: tuple[str, ...]
    """Links in the file's order."""
    mimic: frozenset[str]
    """Joints that follow another, by the file's names."""
    notes: tuple[str, ...]
    """What was repaired or left out, one line each."""


def urdf_from(path: Path, packages: tuple[Path, ...] = ()) -> Urdf:
    """Reads a URDF and the meshes of its collision geometry.

    Args:
        path: the file.
        packages: folders in which package:// is sought, beside those above the file.

    Raises:
        CellError: not a readable URDF; a mesh that is missing or cannot be read.
    """
    name = path.name
    check_kind(path)
    raw = _bytes(path)
    root = _parsed(raw, name)
    meshes, edited = _collect_meshes(root, path, packages)
    record = tostring(root, encoding="utf-8") if edited else raw
    mimic = frozenset(str(j.get("name")) for j in root.findall("joint") if j.find("mimic") is not None)
    for child in list(root):
        if child.tag not in _KEPT:
            root.remove(child)
    names = _rename(root)
    links = tuple(str(link.get("name")) for link in root.findall("link"))
    _check_unique(root, name)
    pieces: dict[str, bytes] = {}
    hulls: dict[tuple[str, str], list[Hull]] = {}
    for link in root.findall("link"):
        _draw(link, path)
        for n, collision in enumerate(link.findall("collision")):
            label = collision.get("name") or f"{link.get('name')}_{n}"
            collision.set("name", f"robot_{label}" if label in OURS else label)
            mesh = collision.find("geometry/mesh")
            if mesh is not None:
                _replace(link, collision, mesh, meshes, hulls, pieces, name)
        _unique_solids(link)
        if link.find("visual") is None:
            for solid in link.findall("collision"):
                visual = SubElement(link, "visual")
                visual.extend(element for element in solid if element.tag in ("origin", "geometry"))
    data = {key: value for key, (value, _) in meshes.items()}
    return Urdf(
        name=str(root.get("name")), text=tostring(root, encoding="unicode"), pieces=pieces, record=record,
        meshes=data, names=names, links=links, mimic=mimic, notes=_notes(root, hulls),
    )  # fmt: skip


def check_kind(path: Path) -> None:
    """Refuses what is by its ending no URDF.

    Raises:
        CellError: with what it is.
    """
    suffix = path.suffix.lower()
    if suffix == ".xacro":
        text = f"{path.name}: is xacro; expand it first (xacro {path.name} > my.urdf)"
        raise CellError(text, key="robot.model")
    if suffix in _OTHERS:
        text = f"{path.name}: {_OTHERS[suffix]} is not read as a robot, a URDF is; convert it first"
        raise CellError(text, key="robot.model")


def _bytes(path: Path) -> bytes:
    if not path.is_file():
        raise CellError(f"{path.name}: no such URDF", key="robot.model")
    if path.stat().st_size > 8 << 20:
        raise CellError(f"{path.name}: more than 8 MiB is not a robot's URDF", key="robot.model")
    return path.read_bytes()


def _parsed(raw: bytes, name: str) -> Element:
    try:
        root = fromstring(raw.decode("utf-8"))
    except (ParseError, DefusedXmlException, UnicodeDecodeError, ValueError) as error:
        line = " ".join(str(error).split())[:120]
        raise CellError(f"{name}: is not a readable URDF ({line})", key="robot.model") from None
    if root.tag != "robot":
        hint = "; expand the xacro first" if "xacro" in raw[:2000].decode("utf-8", "replace") else ""
        raise CellError(f"{name}: its root is <{root.tag}>, not <robot>{hint}", key="robot.model")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise CellError(
            f"{name}: holds xacro macros; expand them first (xacro file > my.urdf)", key="robot.model"
        )
    return root


def mesh_path(filename: str, path: Path, packages: tuple[Path, ...]) -> Path | None:
    """The file that a URDF at `path` names, or None: package://, file:// or relative to the URDF."""
    if not filename.startswith("package://"):
        found = Path(filename.removeprefix("file://"))
        found = found if found.is_absolute() else path.parent / found
        return found if found.is_file() else None
    package, _, rest = filename.removeprefix("package://").partition("/")
    for folder in _package_folders(package, path, packages):
        if (folder / rest).is_file():
            return folder / rest
    return None


def _package_folders(package: str, path: Path, packages: tuple[Path, ...]) -> Iterator[Path]:
    for folder in (*packages, *path.resolve().parents):
        if folder.name == package or _is_package(folder, package):
            yield folder
        yield folder / package


def _is_package(folder: Path, package: str) -> bool:
    """Whether a folder, whatever it is called, says that it is the package."""
    file = folder / "package.xml"
    try:
        return file.is_file() and f"<name>{package}</name>" in file.read_text(encoding="utf-8").replace(
            " ", ""
        )
    except (OSError, UnicodeDecodeError):
        return False


def _collect_meshes(
    root: Element, path: Path, packages: tuple[Path, ...]
) -> tuple[dict[str, tuple[bytes, str]], bool]:
    """Contents of all collision meshes by the plain name that the element is given, and their first names."""
    found: dict[str, tuple[bytes, str]] = {}
    of: dict[str, str] = {}
    missing = []
    for mesh in root.findall("link/collision/geometry/mesh"):
        filename = str(mesh.get("filename", ""))
        if filename not in of:
            file = mesh_path(filename, path, packages)
            if file is None:
                missing.append(filename)
                continue
            suffix = file.suffix.lower()
            if suffix not in (".stl", ".obj", ".dae"):
                text = f"{path.name}: mesh {filename!r} is not read; STL, OBJ and DAE are"
                raise CellError(text, key="robot.model")
            of[filename] = f"robot_mesh_{len(of):02d}{suffix}"
            found[of[filename]] = file.read_bytes(), filename
        mesh.set("filename", of[filename])
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        text = f"{path.name}: mesh {missing[0]!r}{more} not found"
        if missing[0].startswith("package://"):
            package = missing[0].removeprefix("package://").partition("/")[0]
            text += f"; name the folder that holds the package {package!r} in robot.packages"
        raise CellError(text, key="robot.packages")
    return found, bool(found)


def mesh_from(data: bytes, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m] and triangles (m, 3) of an STL, OBJ or DAE.

    Raises:
        CellError: not readable, or without triangles.
    """
    import tempfile

    try:
        if name.lower().endswith(".dae"):
            geometry = triangles_of_collada(data, name)
        else:
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / f"mesh{Path(name).suffix.lower()}"
                file.write_bytes(data)
                geometry = read_geometry(file)
    except PartError as error:
        text = str(error).rpartition("mesh.")[2].partition(": ")[2] or str(error)
        raise CellError(f"{name}: {text}", key="robot.model") from None
    vertices, triangles = geometry.vertices, geometry.triangles
    if len(triangles) == 0 or not np.isfinite(vertices).all():
        raise CellError(f"{name}: a mesh without triangles", key="robot.model")
    if len(triangles) > MOST_TRIANGLES:
        text = f"{name}: {len(triangles)} triangles; collision meshes of up to {MOST_TRIANGLES} are read"
        raise CellError(text, key="robot.model")
    return vertices, triangles


def obj_text(hull: Hull) -> bytes:
    """A hull as an OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in hull.points.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in hull.faces.tolist()]
    return ("\n".join(lines) + "\n").encode()


def _replace(
    link: Element, collision: Element, mesh: Element, meshes: Any, hulls: Any, pieces: Any, name: str
) -> None:
    """Puts the mesh's convex pieces in place of it."""
    key = str(mesh.get("filename")), str(mesh.get("scale", "1 1 1"))
    if key not in hulls:
        data, filename = meshes[key[0]]
        vertices, triangles = mesh_from(data, f"{name}: {filename}")
        hulls[key] = convex_pieces(vertices * _scale(key[1], name), triangles)
        for n, hull in enumerate(hulls[key]):
            pieces[_piece(hulls, key, n)] = obj_text(hull)
    at = list(link).index(collision)
    link.remove(collision)
    several = len(hulls[key]) > 1
    for n in range(len(hulls[key])):
        new = Element(
            "collision", {"name": f"{collision.get('name')}_{n}" if several else str(collision.get("name"))}
        )
        origin = collision.find("origin")
        if origin is not None:
            new.append(origin)
        shape = SubElement(SubElement(new, "geometry"), "mesh", {"filename": _piece(hulls, key, n)})
        SubElement(shape, "drake:declare_convex")
        link.insert(at + n, new)


def _piece(hulls: Any, key: tuple[str, str], n: int) -> str:
    return f"piece_{list(hulls).index(key):02d}_{n}.obj"


def _scale(text: str, name: str) -> np.ndarray:
    try:
        scale = np.array([float(word) for word in text.split()])
    except ValueError:
        scale = np.zeros(0)
    if scale.shape != (3,) or not np.isfinite(scale).all() or not (np.abs(scale) > 1e-9).all():
        raise CellError(f"{name}: a mesh cannot have the scale {text!r}", key="robot.model")
    return scale


def _rename(root: Element) -> dict[str, str]:
    """Gives links and joints whose names are ours others, everywhere in the file."""
    taken = {str(e.get("name")) for e in root.iter() if e.tag in ("link", "joint")}
    names = {}
    for old in sorted(taken & OURS):
        new = f"robot_{old}"
        while new in taken:
            new = f"robot_{new}"
        names[old] = new
        taken.add(new)
    for element in (*root.findall("link"), *root.findall("joint")):
        element.set("name", names.get(str(element.get("name")), str(element.get("name"))))
    for joint in root.findall("joint"):
        for end in (*joint.findall("parent"), *joint.findall("child")):
            end.set("link", names.get(str(end.get("link")), str(end.get("link"))))
        for follow in joint.findall("mimic"):
            joint.remove(follow)
    return names


def _check_unique(root: Element, name: str) -> None:
    for kind in ("link", "joint"):
        names = [str(e.get("name")) for e in root.findall(kind)]
        double = sorted({n for n in names if names.count(n) > 1})
        if double:
            raise CellError(f"{name}: the {kind} {double[0]!r} is there twice", key="robot.model")


def _unique_solids(link: Element) -> None:
    seen: set[str] = set()
    for collision in link.findall("collision"):
        label = base = str(collision.get("name"))
        n = 1
        while label in seen:
            n += 1
            label = f"{base}_{n}"
        seen.add(label)
        collision.set("name", label)


def _draw(link: Element, path: Path) -> None:
    """Keeps pictures that Drake can find; a link without any is drawn as its solids."""
    for visual in link.findall("visual"):
        mesh = visual.find("geometry/mesh")
        if mesh is None:
            continue
        file = path.parent / str(mesh.get("filename", "")).removeprefix("file://")
        if file.suffix.lower() in (".obj", ".gltf", ".glb") and file.is_file():
            mesh.set("filename", file.resolve().as_uri())
        else:
            link.remove(visual)


def _notes(root: Element, hulls: dict[tuple[str, str], list[Hull]]) -> tuple[str, ...]:
    if not hulls:
        return ()
    count = sum(len(pieces) for pieces in hulls.values())
    return (f"{len(hulls)} collision meshes are taken as {count} convex pieces",)
