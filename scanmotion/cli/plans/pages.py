"""The HTML files that go with a plan."""

from typing import TYPE_CHECKING

from scanmotion.cli.app import Progress

if TYPE_CHECKING:
    from scanmotion.planning.plan import Plan


def pages(made: "Plan", progress: Progress | None = None) -> dict[str, str]:
    """The two HTML files that go with a plan."""
    tell = progress or (lambda stage, share: None)
    from scanmotion.report.page import report_html
    from scanmotion.report.scene import scene_html

    tell("scene", 0.0)
    scene = scene_html(made)
    tell("report", 0.5)
    return {"scene.html": scene, "report.html": report_html(made)}
