"""Makes the README's pictures by scanmotion's own commands and a headless Chromium.

    python docs/make_images.py

`scanmotion plan` writes the scene, which Chromium photographs at 43 s, and the plan, whose coverage the
report's own figure shows.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
MOST_BYTES = 400_000


def scene_picture(page: Path, to: Path) -> None:
    """The scene at 43 s."""
    sys.path.insert(0, str(ROOT / "tests"))
    from browser import screenshot

    pixels, _ = screenshot(page, fragment="#t=43", size=(1280, 720))
    Image.fromarray(pixels).save(to, optimize=True)


def coverage_picture(folder: Path, to: Path) -> None:
    """The part after the global step and at the end."""
    from scanmotion.plan_io.load import load_plan
    from scanmotion.report.figures.maps import coverage_figure

    coverage_figure(load_plan(folder)).savefig(to, metadata={"Software": None})


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work) / "out"
        subprocess.run(
            ["scanmotion", "plan", "--robot", "kr240", "--out", str(folder), "--quiet"], check=True
        )
        scene_picture(folder / "scene.html", IMAGES / "scene.png")
        coverage_picture(folder, IMAGES / "coverage.png")
    for path in IMAGES.glob("*.png"):
        if path.stat().st_size > MOST_BYTES:
            raise SystemExit(f"{path.name} is larger than {MOST_BYTES} bytes")


if __name__ == "__main__":
    main()
