"""Looks for the system libraries that Open3D and Drake need, before anything is downloaded.

Where it may (root, and a system with apt-get) it installs what is missing; else it says the exact command and
ends with status 2. It needs nothing but Python itself.
"""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys

LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libglib-2.0.so.0": "libglib2.0-0",
}
"""What `ldd` finds missing from the wheels of Drake and Open3D on a Debian of nothing but Python and make."""


def missing() -> list[str]:
    """Debian packages whose library cannot be loaded, and python3-venv where Python lacks it."""
    packages = []
    for library, package in LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            packages.append(package)
    if importlib.util.find_spec("ensurepip") is None:
        packages.append(f"python3.{sys.version_info.minor}-venv")
    return packages


def install(packages: list[str]) -> None:
    """Installs Debian packages where that may be done: as root, with apt-get."""
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        return
    print(f"installing system libraries: apt-get install {' '.join(packages)}", flush=True)
    env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    update = ["apt-get", "update", "-qq"]
    fetch = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *packages]
    for command in (update, fetch):
        # What it says is of interest only where something is missing afterwards, and that is said then.
        subprocess.run(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)


def command_for(packages: list[str]) -> str:
    """The line that says what is missing and how to get it."""
    if shutil.which("apt-get") is None:
        files = [library for library, package in LIBRARIES.items() if package in packages]
        return f"scanmotion needs system libraries that are not here: {' '.join(files or packages)}"
    sudo = "" if os.geteuid() == 0 else "sudo "
    return f"system libraries are missing; install them with: {sudo}apt-get install -y {' '.join(packages)}"


if __name__ == "__main__" and sys.platform.startswith("linux"):
    absent = missing()
    if absent:
        install(absent)
        absent = missing()
    if absent:
        print(command_for(absent), file=sys.stderr)
        sys.exit(2)
