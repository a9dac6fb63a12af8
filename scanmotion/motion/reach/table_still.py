"""Stations that the arm reaches while the table stays where it is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scanmotion.cell.arm.robot import clean_angle
from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.motion.reach.find import Reach, ReachOptions
from scanmotion.motion.reach.ik_candidates import ik_candidates


def with_table_still(cell: Cell, clearance: Clearance, reaches: Sequence[Reach], angle: float) -> list[Reach]:
    """Stations with the configurations that leave the table at an angle, where there are any.

    Args:
        cell: the cell.
        clearance: its collision checker.
        reaches: what the cell can do with the table turning; what is no station stays as it is.
        angle: of the table [rad].
    """
    stations = [n for n, r in enumerate(reaches) if r.viewpoint.kind == "station" and len(r.q)]
    views = [reaches[n].viewpoint for n in stations]
    options = ReachOptions()
    at = np.array([clean_angle(np.array(angle))])
    found = ik_candidates(cell, views, [at] * len(views), options.rolls, hopeless=clearance.tool_blocked)
    free = clearance.first_free(found.q, found.starts, found.geometry, options.most)
    still = list(reaches)
    for i, n in enumerate(stations):
        rows = np.arange(len(found.q))[found.of(i)]
        rows = rows[free[rows]][: options.most]
        if len(rows):
            q = found.q[rows]
            still[n] = replace(
                still[n], q=q, clearance=np.maximum(clearance.margins(q), 0.0),
                manipulability=found.sigma[rows], X_OS=scanner_in_object(cell, q),
            )  # fmt: skip
    return still
