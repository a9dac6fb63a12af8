"""Says which Debian package is missing where Open3D cannot be loaded; silent when all is well."""

import ctypes
import sys

LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


def missing() -> list[str]:
    """Debian packages whose library cannot be loaded."""
    packages = []
    for library, package in LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            packages.append(package)
    return packages


if __name__ == "__main__" and sys.platform.startswith("linux"):
    absent = missing()
    if absent:
        sys.exit(f"Open3D needs system libraries that are not here: apt-get install {' '.join(absent)}")
