"""The wheel and the sdist in an environment of their own, and the check of the system before a download."""

import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CHECK = ROOT / "models" / "check_system.py"


def run(*command, **more):
    return subprocess.run(command, capture_output=True, text=True, check=False, **more)


def fake_apt(folder, succeeds):
    """An apt-get that writes down what it is asked for."""
    folder.mkdir()
    path = folder / "apt-get"
    path.write_text(f'#!/bin/sh\necho "$@" >> "{folder}/asked"\nexit {0 if succeeds else 100}\n')
    path.chmod(0o755)
    return path


def check_with(missing, path, *, root):
    """check_system.py as if the library `missing` were not there, for root or not."""
    code = (
        "import ctypes, os, runpy\n"
        f"def load(name, *a, **k):\n    if name in {missing!r}:\n        raise OSError(name)\n"
        f"ctypes.CDLL = load\nos.geteuid = lambda: {0 if root else 1000}\n"
        f"runpy.run_path({str(CHECK)!r}, run_name='__main__')\n"
    )
    return run(sys.executable, "-c", code, env={**os.environ, "PATH": str(path)})


def test_nothing_is_said_where_nothing_is_missing(tmp_path):
    done = check_with((), tmp_path, root=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_exact_command_where_we_may_not_install(tmp_path):
    fake_apt(tmp_path / "bin", True)
    done = check_with(("libusb-1.0.so.0", "libGL.so.1"), tmp_path / "bin", root=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "sudo apt-get install -y libgl1 libusb-1.0-0" in done.stderr
    assert not (tmp_path / "bin" / "asked").exists()


def test_root_installs_and_a_failure_is_one_line(tmp_path):
    fake_apt(tmp_path / "bin", False)
    done = check_with(("libX11.so.6",), tmp_path / "bin", root=True)
    asked = (tmp_path / "bin" / "asked").read_text()
    assert "install -y -qq --no-install-recommends libx11-6" in asked
    assert done.returncode == 2 and "apt-get install -y libx11-6" in done.stderr


def test_without_apt_the_libraries_are_named(tmp_path):
    done = check_with(("libgomp.so.1",), tmp_path, root=True)
    assert done.returncode == 2 and "libgomp.so.1" in done.stderr and "apt-get" not in done.stderr


def test_the_system_is_looked_at_before_anything_is_downloaded(tmp_path):
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    for target, extra in (("demo", False), ("test", True)):
        done = run("make", "-n", f"PYTHON={sys.executable}", target, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        order = [i for i, line in enumerate(lines) if "check_system.py" in line or "pip install" in line]
        assert "check_system.py" in lines[order[0]] and len(order) == (3 if extra else 2)
        assert ("'.[test]'" in done.stdout) == extra


def test_the_readme_names_what_is_looked_for():
    packages = runpy.run_path(str(CHECK))["LIBRARIES"].values()
    line = next(x for x in (ROOT / "README.md").read_text().splitlines() if x.startswith("apt-get install"))
    assert line.split()[3:] == ["python3-venv", "make", *packages]


def test_libraries_that_are_really_hidden(tmp_path):
    """In a mount namespace whose libusb and libEGL are empty files, `make demo` ends before a download."""
    if os.geteuid() != 0 or run("unshare", "-m", "true").returncode != 0:
        pytest.skip("needs root and mount namespaces")
    known = run("ldconfig", "-p").stdout
    files = [x.split()[-1] for x in known.splitlines() if re.search(r"libusb-1.0.so.0|libEGL.so.1", x)]
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "models").mkdir()
    shutil.copy(CHECK, tmp_path / "models")
    fake_apt(tmp_path / "bin", False)
    hide = "".join(f"mount --bind /dev/null {Path(f).resolve()} && " for f in files)
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    command = f"{hide} make PYTHON={sys.executable} demo"
    done = run("unshare", "-m", "sh", "-c", command, cwd=tmp_path, env={**os.environ, "PATH": path})
    assert done.returncode == 2, done.stdout + done.stderr
    lines = [x for x in done.stderr.splitlines() if not x.startswith("make")]
    assert lines == [
        "system libraries are missing; install them with: apt-get install -y libusb-1.0-0 libegl1"
    ]
    assert not (tmp_path / ".venv").exists() and "pip" not in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_what_is_built_works_outside_of_the_checkout(tmp_path, kind):
    source = tmp_path / "source"
    ignore = shutil.ignore_patterns(".git", ".venv", "__pycache__", "out", "demo")
    shutil.copytree(ROOT, source, ignore=ignore, symlinks=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    if kind == "sdist":
        tools = tmp_path / "tools"
        made = run(*pip, "install", "--target", str(tools), "hatchling")
        assert made.returncode == 0, made.stderr
        code = "import hatchling.build as b; print(b.build_sdist('dist'))"
        made = run(sys.executable, "-c", code, cwd=source, env={**os.environ, "PYTHONPATH": str(tools)})
        assert made.returncode == 0, made.stderr
        [built] = (source / "dist").glob("*.tar.gz")
    else:
        made = run(*pip, "wheel", "--no-deps", "-w", str(tmp_path / "dist"), str(source))
        assert made.returncode == 0, made.stderr
        [built] = (tmp_path / "dist").glob("*.whl")
    home = tmp_path / "venv"
    venv.create(home, with_pip=True)
    python = home / "bin" / "python"
    packages = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").stdout.strip()
    # Its dependencies are those of the environment that the tests run in.
    others = (sysconfig.get_path("purelib"), sysconfig.get_path("platlib"))
    (Path(packages) / "others.pth").write_text("\n".join(dict.fromkeys(others)) + "\n")
    done = run(python, "-m", "pip", "install", "-q", "--no-deps", "--ignore-installed", str(built))
    assert done.returncode == 0, done.stderr
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    where = run(python, "-c", "import scanmotion; print(scanmotion.__file__)", cwd=tmp_path, env=env)
    assert where.stdout.startswith(str(home)), where.stdout + where.stderr
    plan = ("plan", "--box", "100", "80", "60", "--no-html", "--quiet", "--out", "out")
    done = run(home / "bin" / "scanmotion", *plan, cwd=tmp_path, env=env)
    assert done.returncode in (0, 1), done.stderr
    assert (tmp_path / "out" / "plan.json").is_file()
