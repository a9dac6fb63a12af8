"""The meshcat scene: what it holds, and that nothing listens."""

import base64
import re
import socket

import numpy as np
import pytest
import umsgpack

from scanmotion.core.viewpoint import Viewpoint
from scanmotion.report.viewpoint_scene import scene, write_page
from scanmotion.sensing.holes.find import holes_from_cloud


@pytest.fixture
def parts():
    i = np.arange(3000) + 0.5
    z, a = 1 - 2 * i / 3000, np.pi * (1 + 5**0.5) * i
    points = 0.1 * np.stack([np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z], axis=1)
    points = points[points[:, 2] < 0.09]
    X = np.diag([1.0, -1, -1, 1])
    X[2, 3] = 0.8
    view = Viewpoint(id="L1.1", X_OS=X, standoff=0.7, step="local", kind="station")
    return points, holes_from_cloud(points).holes, view


def commands(page: str) -> dict[str, dict]:
    found = re.findall(r'octet-binary;base64,([A-Za-z0-9+/=]+)"\)\.then\(r ', page)
    drawn = [umsgpack.unpackb(base64.b64decode(one)) for one in found]
    return {one["path"]: one for one in drawn}


def test_the_page_holds_cloud_hole_box_normal_and_viewpoint(parts) -> None:
    points, holes, view = parts
    drawn = commands(scene(points=points, holes=holes, viewpoints=[view]).page())
    assert set(drawn) == {
        f"/meshcat/{name}"
        for name in ("cloud", "holes/H1/rim", "holes/H1/box", "holes/H1/normal", "viewpoints/L1.1")
    }
    assert drawn["/meshcat/holes/H1/rim"]["object"]["object"]["type"] == "LineLoop"
    field = drawn["/meshcat/viewpoints/L1.1"]["object"]["geometries"][0]["data"]["attributes"]["position"][
        "array"
    ]
    corner = np.abs(np.frombuffer(bytes(field.data), np.float32).reshape(-1, 3)).max(axis=0)
    assert np.allclose(corner, [0.7 * np.tan(np.radians(15)), 0.7 * np.tan(np.radians(10.5)), 0.8], atol=1e-5)


def test_nothing_listens(parts, monkeypatch, tmp_path) -> None:
    def refuse(*_):
        raise AssertionError("a socket was opened for listening")

    monkeypatch.setattr(socket.socket, "bind", refuse)
    monkeypatch.setattr(socket.socket, "listen", refuse)
    points, holes, view = parts
    drawn = scene(points=points, holes=holes, viewpoints=[view])
    path = write_page(drawn, tmp_path / "scene.html")
    assert path.read_text(encoding="utf-8").endswith("</html>")
    assert "<iframe srcdoc=" in drawn._repr_html_()


def test_no_meshcat_server_process_starts(parts, monkeypatch) -> None:
    import meshcat.servers.zmqserver as server

    def refuse(*_, **__):
        raise AssertionError("meshcat's server was started")

    monkeypatch.setattr(server, "start_zmq_server_as_subprocess", refuse)
    monkeypatch.setattr("meshcat.visualizer.start_zmq_server_as_subprocess", refuse)
    assert scene(points=parts[0]).names == ("/meshcat/cloud",)


def test_large_clouds_are_thinned(parts) -> None:
    drawn = commands(scene(points=np.tile(parts[0], (10, 1)), most_points=1000).page())
    array = drawn["/meshcat/cloud"]["object"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    assert len(bytes(array.data)) // 12 <= 1000
