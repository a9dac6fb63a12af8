"""Triangles of a COLLADA file (.dae), with the transforms of its scene, in metres.

The file's up axis is left as it is, as ROS tools do. Read by trimesh and pycollada after defusedxml has let
the text pass: no entity is expanded.
"""

import io
from xml.etree.ElementTree import ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.part_files import RawGeometry

_MOST_BYTES = 256 << 20


def triangles_of_collada(data: bytes, name: str) -> RawGeometry:
    """All triangles of the file's scene [m].

    Raises:
        PartError: not COLLADA, or without triangles.
    """
    if len(data) > _MOST_BYTES:
        raise PartError(f"more than {_MOST_BYTES >> 20} MiB is not a robot's mesh", path=name)
    try:
        root = fromstring(data)
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise PartError(
            f"is not a readable COLLADA file ({' '.join(str(error).split())[:100]})", path=name
        ) from None
    unit = next((e.get("meter") for e in root.iter() if e.tag.rpartition("}")[2] == "unit"), None)
    import trimesh

    try:
        metre = float(unit) if unit else 1.0
        scene = trimesh.load_scene(io.BytesIO(data), file_type="dae")
        mesh = scene.to_mesh()
        vertices, triangles = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # pycollada raises a family of its own, and others
        raise PartError(f"is not a readable COLLADA file ({type(error).__name__})", path=name) from None
    if len(triangles) == 0 or not np.isfinite(vertices).all() or not 0.0 < metre < 1e6:
        raise PartError("has no triangles", path=name)
    return RawGeometry(vertices=vertices * metre, triangles=triangles)
