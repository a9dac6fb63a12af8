"""Clouds, holes, boxes and viewpoints as a static page or notebook cell, by the meshcat package.

meshcat's own window starts a server that listens on every interface. Nothing here listens at all: the drawing
commands are collected in memory and packed into the page that meshcat's viewer reads.
"""

import base64
from collections.abc import Iterable
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.sensing.holes.find import Hole

SURFACE, RIM, BOX, SCANNER = 0x9AA5B1, 0xC2410C, 0x1D4ED8, 0x0F766E
_EDGES = ((0, 1), (1, 3), (3, 2), (2, 0), (4, 5), (5, 7), (7, 6), (6, 4), (0, 4), (1, 5), (2, 6), (3, 7))


class PageScene:
    """What is to be drawn; made by `scene`, read by `page` and by notebooks."""

    def __init__(self) -> None:
        from meshcat import Visualizer

        self._commands: dict[str, list[bytes]] = {}
        self.root = Visualizer(window=self)
        """The meshcat tree: `scene.root["name"].set_object(..)` adds to it."""

    def send(self, command: Any) -> None:
        """Takes a drawing command, as meshcat's window does."""
        import umsgpack

        data = command.lower()
        self._commands.setdefault(data["path"], []).append(umsgpack.packb(data))

    @property
    def names(self) -> tuple[str, ...]:
        """Paths of what is drawn, in order."""
        return tuple(self._commands)

    def page(self) -> str:
        """One HTML page with everything in it: the viewer, the scene, no server."""
        calls = "".join(
            f'fetch("data:application/octet-binary;base64,{base64.b64encode(data).decode()}")'
            ".then(r => r.arrayBuffer()).then(b => viewer.handle_command_bytearray(new Uint8Array(b)));\n"
            for group in self._commands.values()
            for data in group
        )
        return (
            "<!DOCTYPE html><html><head><meta charset=utf-8><title>scanmotion</title>"
            "<style>body {margin: 0;} #pane {width: 100vw; height: 100vh; overflow: hidden;}</style></head>"
            f'<body><div id="pane"></div><script>{_viewer()}</script><script>'
            f'var viewer = new MeshCat.Viewer(document.getElementById("pane"));\n{calls}</script>'
            "</body></html>"
        )

    def _repr_html_(self, height: int = 480) -> str:
        """A static notebook cell."""
        return (
            f'<iframe srcdoc="{escape(self.page())}" '
            f'style="width: 100%; height: {height}px; border: none"></iframe>'
        )


@cache
def _viewer() -> str:
    from meshcat.servers.zmqserver import VIEWER_ROOT

    return (Path(VIEWER_ROOT) / "main.min.js").read_text(encoding="utf-8")


def scene(
    *,
    points: np.ndarray | None = None,
    triangles: np.ndarray | None = None,
    holes: Iterable[Hole] = (),
    viewpoints: Iterable[Viewpoint] = (),
    scanner: Scanner | None = None,
    most_points: int = 60000,
) -> PageScene:
    """A scene of any of: a cloud or mesh, holes with their boxes and normals, viewpoints with their fields.

    Args:
        points: cloud, or vertices of the mesh, shape (n, 3) [m].
        triangles: of the mesh, shape (m, 3).
        holes: rims are drawn as loops, boxes as wires, normals as strokes.
        viewpoints: drawn as pyramids from the optical centre to the aimed surface.
        scanner: gives the field of view of the pyramids; 30 x 21 degrees unless given.
        most_points: an evenly picked part of a larger cloud is drawn.

    Returns:
        The scene; the last line of a notebook cell shows it, `write_page` saves it.
    """
    import meshcat.geometry as mg

    out = PageScene()
    if points is not None and triangles is not None and len(triangles):
        paint = mg.MeshPhongMaterial(color=SURFACE, side=2)
        out.root["surface"].set_object(
            mg.TriangularMeshGeometry(np.asarray(points, np.float32), np.asarray(triangles, np.uint32)), paint
        )
    elif points is not None and len(points):
        out.root["cloud"].set_object(_cloud(points, most_points))
    for number, hole in enumerate(holes, start=1):
        _draw_hole(out.root["holes"][f"H{number}"], hole)
    tangents = _tangents(scanner)
    for view in viewpoints:
        out.root["viewpoints"][view.id].set_object(_lines(_pyramid(view, tangents), SCANNER))
    return out


def write_page(drawn: PageScene, path: str | Path) -> Path:
    """Saves the scene as one HTML file that needs no server and no network."""
    path = Path(path)
    path.write_text(drawn.page(), encoding="utf-8")
    return path


def _cloud(points: np.ndarray, most: int) -> Any:
    import meshcat.geometry as mg

    shown = np.asarray(points, np.float32)[:: max(1, -(-len(points) // most))]
    size = 0.002 * float(np.ptp(shown, axis=0).max())
    colour = np.tile(
        np.array([[(SURFACE >> s & 255) / 255.0] for s in (16, 8, 0)], np.float32), (1, len(shown))
    )
    return mg.PointCloud(shown.T, colour, size=size)


def _draw_hole(node: Any, hole: Hole) -> None:
    import meshcat.geometry as mg

    outer = hole.boundary[: hole.outer]
    for name, loop in [("rim", outer), *((f"island{i}", one) for i, one in enumerate(hole.islands, start=1))]:
        material: Any = mg.LineBasicMaterial(color=RIM, linewidth=3)
        node[name].set_object(mg.LineLoop(mg.PointsGeometry(loop.T.astype(np.float32)), material))
    signs = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
    corner = signs * hole.extent @ hole.X_OH[:3, :3].T + hole.center
    node["box"].set_object(_lines(corner[np.array(_EDGES)].reshape(-1, 3), BOX))
    tip = hole.center + hole.normal * 0.5 * float(hole.extent.max())
    node["normal"].set_object(_lines(np.stack([hole.center, tip]), RIM))


def _tangents(scanner: Scanner | None) -> tuple[float, float]:
    """Half-field tangents along x and y of S."""
    if scanner is None:
        return float(np.tan(np.radians(15.0))), float(np.tan(np.radians(10.5)))
    return float(np.tan(scanner.fov[0] / 2)), float(np.tan(scanner.fov[1] / 2))


def _pyramid(view: Viewpoint, tangents: tuple[float, float]) -> np.ndarray:
    """Line segments of the field of view, shape (16, 3) [m]."""
    x, y = tangents[0] * view.standoff, tangents[1] * view.standoff
    foot = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    corner = np.concatenate([foot, np.full((4, 1), view.standoff)], axis=1) @ view.X_OS[:3, :3].T + view.p_OS
    sides = [p for c in corner for p in (view.p_OS, c)]
    base = [p for i in range(4) for p in (corner[i], corner[i - 1])]
    return np.array(sides + base)


def _lines(points: np.ndarray, colour: int) -> Any:
    import meshcat.geometry as mg

    material: Any = mg.LineBasicMaterial(color=colour, linewidth=2)
    return mg.LineSegments(mg.PointsGeometry(points.T.astype(np.float32)), material)
