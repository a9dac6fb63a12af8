"""`scanmotion plan --explain`: which stage lost what."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from scanmotion.cli.app import print_table

if TYPE_CHECKING:
    from scanmotion.planning.plan import Plan


def explanation(made: "Plan") -> list[dict[str, Any]]:
    """The stages of a plan as JSON has them."""
    from scanmotion.planning.explain import explained

    return [asdict(stage) for stage in explained(made)]


def say_explained(made: "Plan") -> None:
    """Prints a line a stage, and one a cause."""
    from scanmotion.planning.explain import explained

    rows = []
    for stage in explained(made):
        rows.append((stage.name, str(stage.given), str(stage.lost) if stage.lost else "-", stage.note))
        for cause, count, example in stage.causes:
            rows.append(("", "", str(count), example or cause))
    print_table("What each stage lost", ("stage", "viewpoints in", "lost", "why"), rows)
