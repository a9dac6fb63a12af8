"""Files that are no part and no scan, or not of the kind that their ending says: by name and by content."""

import re

_PACKED = "is packed ({}): unpack it first"
_PICTURE = (
    "is a picture; a depth image is a scan only together with its camera: export points (PLY, E57, XYZ)"
)
_LAS = "is a LAS cloud, which is not read here: export it as E57, PLY or text"
_CAD = "is a {} file: export it as a mesh (PLY, STL, OBJ, 3MF)"
_PAGE = "is a web page, not the file itself: the download went wrong"
_PICTURES = ("png", "jpg", "jpeg", "tif", "tiff", "bmp", "exr", "pgm", "ppm", "hdr")
_ARCHIVES = ("zip", "gz", "bz2", "xz", "7z", "rar", "tar", "tgz", "zst", "lz4")
_PROJECTS = ("fls", "fws", "zfs", "rdbx", "rxp", "imp", "lsproj", "zfprj")
_MODELS = {
    "step": "STEP", "stp": "STEP", "stpz": "STEP", "igs": "IGES", "iges": "IGES", "brep": "BREP",
    "fbx": "FBX", "wrl": "VRML", "vrml": "VRML", "dae": "COLLADA", "blend": "Blender", "3ds": "3DS",
    "max": "3ds Max", "x3d": "X3D", "usd": "USD", "usda": "USD", "usdz": "USD", "dxf": "DXF", "dwg": "DWG",
    "skp": "SketchUp", "sldprt": "SolidWorks", "3dm": "Rhino", "ctm": "OpenCTM", "vtk": "VTK", "vtp": "VTK",
    "amf": "AMF", "ztl": "ZBrush", "ma": "Maya", "mb": "Maya", "c4d": "Cinema 4D",
}  # fmt: skip
_ARRAY = "is a NumPy array: save its points as text or PLY"
_NAMES = {
    **{f".{k}": _PICTURE for k in _PICTURES},
    **{f".{k}": _PACKED.format(k) for k in _ARCHIVES},
    **{f".{k}": f"is a scanner's own project ({k}): export it as E57, PTX or PLY" for k in _PROJECTS},
    **{f".{k}": _CAD.format(v) for k, v in _MODELS.items()},
    **dict.fromkeys((".las", ".laz"), _LAS),
    **dict.fromkeys((".npy", ".npz"), _ARRAY),
}
_CONTENTS = (
    (b"version https://git-lfs", "is a Git LFS pointer, not the file itself: `git lfs pull` fetches it"),
    (b"<!DOCTYPE html", _PAGE),
    (b"<html", _PAGE),
    (b"\x1f\x8b", _PACKED.format("gzip")),
    (b"7z\xbc\xaf", _PACKED.format("7-Zip")),
    (b"BZh", _PACKED.format("bzip2")),
    (b"\xfd7zXZ", _PACKED.format("xz")),
    (b"\x28\xb5\x2f\xfd", _PACKED.format("zstd")),
    (b"Rar!", _PACKED.format("RAR")),
    (b"ISO-10303-21", _CAD.format("STEP")),
    (b"Kaydara FBX", _CAD.format("FBX")),
    (b"#VRML", _CAD.format("VRML")),
    (b"BLENDER", _CAD.format("Blender")),
    (b"\x89PNG", _PICTURE),
    (b"\xff\xd8\xff", _PICTURE),
    (b"II*\0", _PICTURE),
    (b"MM\0*", _PICTURE),
    (b"LASF", _LAS),
    (b"%PDF", "is a PDF document, not a mesh"),
    (b"\x93NUMPY", _ARRAY),
)  # fmt: skip
_ZIP, _XML = b"PK\3\4", re.compile(rb"\s*<\?xml|\s*<(?:svg|VTKFile|amf|COLLADA|X3D)\b", re.IGNORECASE)
_MAGIC = (
    (b"ply\n", ".ply"),
    (b"ply\r", ".ply"),
    (b"# .PCD", ".pcd"),
    (b"glTF", ".glb"),
    (b"ASTM-E57", ".e57"),
)
_GLTF, _NUMBER = (".gltf", ".glb"), rb"[-+]?[.\d][^\s]*"
_COMMENTS = rb"(?:\xef\xbb\xbf)?(?:\s|#[^\n]*\n)*"
_TEXT_MAGIC = (
    (re.compile(_COMMENTS + rb"solid\b(?=[^\0]*facet)", re.IGNORECASE), ".stl"),
    (re.compile(_COMMENTS + rb"v\s+" + _NUMBER + rb"\s+" + _NUMBER + rb"\s+" + _NUMBER), ".obj"),
    (re.compile(_COMMENTS + rb"(?:ST)?C?N?4?n?OFF\s"), ".off"),
    (re.compile(_COMMENTS + rb"VERSION\s+0?\.\d\s+(?:FIELDS|COLUMNS)\s"), ".pcd"),
)


def stranger_by_name(suffix: str) -> str:
    """What a file of an ending that is not read is and what helps, or ""."""
    return _NAMES.get(suffix, "")


def stranger_by_content(head: bytes, suffix: str) -> str:
    """What a file is that is no mesh and no cloud by its first bytes, and what helps; or ""."""
    for magic, what in _CONTENTS:
        if head.lstrip()[: len(magic)].lower() == magic.lower():
            return what
    if head.startswith(_ZIP) and suffix != ".3mf":
        return _PACKED.format("ZIP")
    if suffix not in _GLTF and _XML.match(head.removeprefix(b"\xef\xbb\xbf")):
        return "holds XML, which no mesh or cloud that is read here does"
    return ""


def content_kind(head: bytes, suffix: str) -> str:
    """The ending that a file should have by its first bytes; its own where they do not tell."""
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    for pattern, kind in _TEXT_MAGIC:
        if kind != suffix and suffix != ".gltf" and pattern.match(head):
            return kind
    return suffix
