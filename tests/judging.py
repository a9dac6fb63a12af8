"""A plan judged in memory, as `save` judges it in its folder."""

from scanmotion.judge import verify
from scanmotion.plan_io.save import judged


def findings_of(plan):
    """What the judge finds in the plan's files."""
    return list(judged(plan, judge=verify).findings)


def summarised(plan):
    """The plan with its summary."""
    return judged(plan, judge=verify).plan
