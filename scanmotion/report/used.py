"""Which libraries made a plan, and what each did in it: what is not used is not listed."""

from collections import Counter

from scanmotion.cell.ik.choice import solver_of
from scanmotion.motion.reach.find import NUMERIC, RESCUE
from scanmotion.motion.refine import REFINED
from scanmotion.planning.plan import Plan

_BY_OPW = ("OpwArm", "TurnedArm")
"""Solvers of the inverse kinematics that py-opw-kinematics serves."""


def used_packages(plan: Plan) -> list[tuple[str, str]]:
    """Names of packages, and what each did in this plan.

    Args:
        plan: made just now, or loaded; a loaded one no longer knows the ways round obstacles.
    """
    solvers = Counter(plan.solvers.values())
    drake = [
        "reads robot and cell",
        "exact collisions of arm, tool and surroundings",
        "last word on the motion",
    ]
    for solver, what in (
        (REFINED, "refined the poses of {} viewpoints"),
        (RESCUE, "found the poses of {} viewpoints in the slack"),
        (NUMERIC, "found the poses of {} viewpoints by search"),
    ):  # fmt: skip
        drake += [what.format(solvers[solver])] if solvers[solver] else []
    used = [("drake", "; ".join(drake))]
    if type(solver_of(plan.cell.robot)).__name__ in _BY_OPW:
        used.append(("py-opw-kinematics", "closed form of the arm's inverse kinematics"))
    used.append(("python-fcl", "distances to the part's triangles; collisions for the judge"))
    rays = "rays of the simulated scans; " if plan.samples is not None else ""
    used.append(("open3d", f"{rays}distances about the part"))
    planned = sum(path.method == "planned" for item in plan.segments for path in item.paths)
    if planned:
        used.append(("ompl", f"{planned} ways round obstacles"))
    kinds = Counter(o.kind for o in plan.trajectory.operations) if plan.trajectory is not None else Counter()
    if kinds["transit"]:
        used.append(("toppra", f"time profile of {kinds['transit']} transits"))
    if len(kinds):
        used.append(("ruckig", "moves from rest to rest"))
    return [*used, ("numpy", "arithmetic"), ("scipy", "transforms, hulls, trees")]
