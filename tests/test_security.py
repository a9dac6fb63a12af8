"""Nothing leaves this machine, and what a file claims is not believed."""

import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from scanmotion.cli import app

# Told of every address that the process connects to, binds or sends to, from Python or from a library.
SHIM = r"""
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
static void note(const char *call, const struct sockaddr *a) {
    char text[INET6_ADDRSTRLEN] = "?";
    if (!a || (a->sa_family != AF_INET && a->sa_family != AF_INET6)) return;
    if (a->sa_family == AF_INET) inet_ntop(AF_INET, &((struct sockaddr_in *)a)->sin_addr, text, sizeof text);
    else inet_ntop(AF_INET6, &((struct sockaddr_in6 *)a)->sin6_addr, text, sizeof text);
    FILE *f = fopen(getenv("SOCKET_LOG"), "a");
    if (f) { fprintf(f, "%s %s\n", call, text); fclose(f); }
}
int connect(int s, const struct sockaddr *a, socklen_t n) {
    note("connect", a);
    return ((int (*)(int, const struct sockaddr *, socklen_t))dlsym(RTLD_NEXT, "connect"))(s, a, n);
}
int bind(int s, const struct sockaddr *a, socklen_t n) {
    note("bind", a);
    return ((int (*)(int, const struct sockaddr *, socklen_t))dlsym(RTLD_NEXT, "bind"))(s, a, n);
}
ssize_t sendto(int s, const void *b, size_t m, int f, const struct sockaddr *a, socklen_t n) {
    note("sendto", a);
    return ((ssize_t (*)(int, const void *, size_t, int, const struct sockaddr *, socklen_t))
            dlsym(RTLD_NEXT, "sendto"))(s, b, m, f, a, n);
}
"""

# Python's own sockets are watched as well: names are looked up without a socket that the shim could see.
AUDITED = """
import os, sys
def watch(event, args):
    if event in ["socket." + call for call in ("bind", "connect", "sendto", "getaddrinfo", "gethostbyname")]:
        address = args if "get" in event else args[1]
        with open(os.environ["SOCKET_LOG"], "a") as log:
            log.write(f"{event} {address[0] if isinstance(address, tuple) else address}\\n")
sys.addaudithook(watch)
"""
RUN = "from scanmotion.cli import main\nmain()\n"
LOOPBACK = ("127.", "::1", "localhost")


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """Runs Python code in a process of its own; gives it, and the addresses that it asked the system for."""
    folder = tmp_path_factory.mktemp("watched")
    compiler = shutil.which("cc") or shutil.which("gcc")
    shim = folder / "shim.so"
    if compiler and sys.platform == "linux":
        (folder / "shim.c").write_text(SHIM)
        build = [compiler, "-shared", "-fPIC", "-o", str(shim), str(folder / "shim.c"), "-ldl"]
        subprocess.run(build, check=True, capture_output=True)

    def run(code: str, *args: object) -> tuple[subprocess.CompletedProcess[str], list[str]]:
        log = folder / "log.txt"
        log.write_text("")
        env = dict(os.environ, SOCKET_LOG=str(log))
        if shim.exists():
            env["LD_PRELOAD"] = str(shim)
        command = [sys.executable, "-c", AUDITED + code, *map(str, args)]
        done = subprocess.run(command, capture_output=True, text=True, env=env, cwd=folder)
        return done, log.read_text().splitlines()

    return SimpleNamespace(run=run, folder=folder, shim=shim.exists())


def test_the_watch_sees_sockets(watched):
    """Also those that no Python code opens: a watch that sees nothing would prove nothing."""
    _, seen = watched.run(
        "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(('192.0.2.1', 9))"
    )
    assert "socket.connect 192.0.2.1" in seen
    code = "from pydrake.geometry import Meshcat, MeshcatParams; Meshcat(MeshcatParams(host='localhost'))"
    _, seen = watched.run(code)
    assert not watched.shim or any(line.startswith("bind ") for line in seen)


def test_planning_and_showing_stay_on_this_machine(watched):
    planned, seen = watched.run(RUN, "plan", "--box", 200, 160, 150, "--out", "out", "--no-html")
    assert planned.returncode in (0, 1), planned.stderr
    assert planned.stderr == "", "libraries speak to the user"
    shown, more = watched.run(RUN, "show", "out", "--no-browser")
    assert shown.returncode == 0 and shown.stderr == ""
    for line in [*seen, *more]:
        assert line.split(maxsplit=1)[1].startswith(LOOPBACK), line


def billion_triangles(folder: Path) -> list[Path]:
    ply = (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1000000000\nproperty list uchar int vertex_indices\nend_header\n"
    )
    files = {"a.ply": ply + b"\0" * 100, "a.stl": b"\0" * 80 + struct.pack("<I", 1_000_000_000) + b"\0" * 100}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in files]


def test_a_billion_claimed_triangles_take_no_memory(watched):
    """The most memory that the process ever held grows by less than a megabyte."""
    code = (
        "import resource, sys, io, contextlib\n"
        "from scanmotion.geometry.parts.make_part import part_from_file\n"
        "from scanmotion.core.errors import ScanMotionError\n"
        "import open3d, scipy.spatial\n"
        "most = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "before = most()\n"
        "for file in sys.argv[1:]:\n"
        "    try:\n        part_from_file(file)\n"
        "    except ScanMotionError as error:\n        print(str(error).count('\\n'))\n"
        "print(most() - before)\n"
    )
    done, _ = watched.run(code, *billion_triangles(watched.folder))
    *lines, kilobytes = done.stdout.split()
    assert lines == ["0", "0"], done.stderr
    assert int(kilobytes) < 20_000


def arm(change=("", "")) -> str:
    from scanmotion.geometry.parts.make_part import models_dir

    text = (models_dir() / "robots" / "kr240.urdf").read_text()
    assert change[0] in text
    return text.replace(*change, 1)


def first(pattern: str) -> str:
    found = re.search(pattern, arm())
    assert found
    return found[0]


ABSURD = {
    "a limit beyond numbers": (r'upper="[^"]*"', 'upper="1e999"'),
    "a limit of a million turns": (r'upper="[^"]*"', 'upper="6e6"'),
    "a speed beyond numbers": (r'velocity="[^"]*"', 'velocity="1e300"'),
    "no number": (r'velocity="[^"]*"', 'velocity="fast"'),
    "nan": (r'lower="[^"]*"', 'lower="nan"'),
    "a box as large as a town": (r'<box size="[^"]*"', '<box size="9000 9000 9000"'),
    "a box turned inside out": (r'<box size="[^"]*"', '<box size="-1 1 1"'),
    "a box beyond numbers": (r'<box size="[^"]*"', '<box size="1e300 1 1"'),
    "a cylinder of no radius": (r'<cylinder radius="[^"]*"', '<cylinder radius="0"'),
    "a joint in space": (r'(?s)<joint name="A2".*?xyz="[^"]*"', None),
    "a mesh from elsewhere": (r'<box size="[^"]*"/>', '<mesh filename="/etc/passwd"/>'),
    "entities": (r"^<\?xml[^>]*>", '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;">]>'),
    "an outer entity": (
        r"^<\?xml[^>]*>",
        '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    ),
}


@pytest.mark.parametrize("name", ABSURD)
def test_a_robot_with_absurd_numbers_is_answered_with_a_line(name, tmp_path, monkeypatch):
    pattern, new = ABSURD[name]
    old = first(pattern)
    if new is None:
        new = old[: old.rindex('xyz="')] + 'xyz="1e300 0 0"'
    (tmp_path / "own.urdf").write_text(arm((old, new)))
    (tmp_path / "own.yaml").write_text(
        "robot:\n  model: own.urdf\n  acceleration: [2.5, 1.6, 3.5, 7.4, 5.6, 9.0]\n"
    )
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["cell", "check", "own.yaml"])
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("scanmotion: ") and result.stderr.count("\n") == 1, result.stderr


def test_the_same_robot_unchanged_is_taken(tmp_path, monkeypatch):
    (tmp_path / "own.urdf").write_text(arm())
    (tmp_path / "own.yaml").write_text(
        "robot:\n  model: own.urdf\n  acceleration: [2.5, 1.6, 3.5, 7.4, 5.6, 9.0]\n"
    )
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["cell", "check", "own.yaml"]).exit_code == 0
