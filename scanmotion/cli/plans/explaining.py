"""`scanmotion plan --explain`: which stage lost what."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from scanmotion.cli.app import print_table, say_json
from scanmotion.cli.plans.complete import is_complete

if TYPE_CHECKING:
    from scanmotion.planning.plan import Plan


def say_explained(made: "Plan", *, json: bool) -> dict[str, Any]:
    """Says which stage lost what, before anything is written: an empty plan ends there.

    Args:
        made: the plan.
        json: whether the record of a plan follows, which then holds what is returned.

    Returns:
        what the record holds of it.
    """
    from scanmotion.planning.explain import explained

    stages = explained(made)
    told = {"explain": [asdict(stage) for stage in stages]}
    if json:
        if made.trajectory is None and not is_complete(made):
            say_json(told)
        return told
    rows: list[tuple[str, ...]] = []
    for stage in stages:
        rows.append((stage.name, str(stage.given), str(stage.lost) if stage.lost else "-", stage.note))
        for cause, count, example in stage.causes:
            rows.append(("", "", str(count), example or cause))
    print_table("What each stage lost", ("stage", "viewpoints in", "lost", "why"), rows)
    return told
