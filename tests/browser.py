"""A headless Chromium that takes pictures of local pages and tells what they tried to load."""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
    "--hide-scrollbars", "--force-device-scale-factor=1", "--host-resolver-rules=MAP * ~NOTFOUND",
)  # fmt: skip


def chromium() -> str:
    for name in ("chromium", "chromium-browser", "google-chrome"):
        path = shutil.which(name)
        if path:
            return path
    pytest.skip("needs Chromium (Debian: apt-get install chromium)")


def screenshot(page: Path, *, fragment="", size=(1000, 700), wait_ms=6000):
    """Picture of a page as an array (rows, columns, 3), and the addresses off the page that it asked for."""
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        shot, log = Path(folder, "shot.png"), Path(folder, "net.json")
        address = page.resolve().as_uri() + fragment
        command = [
            chromium(), *FLAGS, f"--user-data-dir={folder}/profile", f"--window-size={size[0]},{size[1]}",
            f"--virtual-time-budget={wait_ms}", f"--screenshot={shot}", f"--log-net-log={log}", address,
        ]  # fmt: skip
        subprocess.run(command, capture_output=True, timeout=180, check=True)
        image = np.asarray(Image.open(shot).convert("RGB"))
        return image, requested(log)


def requested(log: Path) -> set[str]:
    """Addresses in a net log that lead off the page, the browser's own services apart."""
    text = log.read_text()
    try:
        events = json.loads(text)["events"]
    except json.JSONDecodeError:
        # The browser ended before it closed the list.
        events = json.loads(text.rstrip().rstrip(",") + "]}")["events"]
    urls = {e.get("params", {}).get("url", "") for e in events}
    own = ("file:", "data:", "blob:", "chrome", "devtools:", "about:")
    services = ("googleapis.com", "google.com", "gvt1.com", "gstatic.com")
    return {u for u in urls if u and not u.startswith(own) and not any(s in u for s in services)}
