"""Slack: other poses that a viewpoint allows where the exact one is not served, and a search among them."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.ik.slack_plant import AskedPose, SlackPlant
from scanmotion.core.viewpoint import Slack, Viewpoint

TRIES = 4
"""Seeds of the search; each is tried with two distances and, for a part with hollows, with and without it."""
_ROOM_M = (0.02, 0.002)
"""How much more than the clearance the search asks for: first enough to drive away from there."""
_SHARE = 0.999
"""Share of the tilt that is used, so that rounding does not leave it."""


def has_slack(viewpoint: Viewpoint) -> bool:
    """Whether there are other poses than those at the exact distance and direction."""
    slack = viewpoint.slack
    return viewpoint.kind == "station" and (slack.tilt > 0 or slack.standoff[1] > slack.standoff[0])


def distances(cell: Cell, viewpoint: Viewpoint) -> tuple[float, float, float]:
    """Distance to the aimed point, and the least and greatest allowed, inside the scanner's range [m]."""
    d, (low, high) = viewpoint.standoff, viewpoint.slack.standoff
    nearest, farthest = cell.settings.scanner.range_m
    return d, max(d + low, min(d, nearest)), min(d + high, max(d, farthest))


def asked_pose(cell: Cell, viewpoint: Viewpoint) -> AskedPose:
    """What a viewpoint asks of the constrained search; a hair's breadth of its slack is kept for rounding."""
    d, near, far = distances(cell, viewpoint)
    slack = viewpoint.slack
    return AskedPose(
        X_OS=viewpoint.X_OS, standoff=d, near=near, far=far, tilt=_SHARE * slack.tilt, roll=slack.roll
    )


def variants(cell: Cell, viewpoint: Viewpoint) -> list[Viewpoint]:
    """Poses within the slack, those that differ least first: three distances, tilts to four sides.

    They have no slack of their own but the roll's.
    """
    d, near, far = distances(cell, viewpoint)
    exact = replace(viewpoint, slack=Slack(roll=viewpoint.slack.roll))
    tilt = _SHARE * viewpoint.slack.tilt
    moves = [(0.0, 0.0, along) for along in dict.fromkeys((d, near, far))]
    if tilt > 0:
        for share in (0.5, 1.0):
            turns = share * tilt * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
            moves += [(x, y, along) for x, y in turns for along in dict.fromkeys((d, near, far))]
    aim = np.eye(4)
    aim[:3, 3] = [0, 0, d]
    out = []
    for x, y, along in moves[1:]:
        turn, back = np.eye(4), np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec([x, y, 0.0]).as_matrix()
        back[2, 3] = -along
        out.append(exact.moved(viewpoint.X_OS @ aim @ turn @ back))
    return out


class SlackSearch:
    """Drake's InverseKinematics with a minimum distance, over arm and table, inside the slack.

    The plants are made when first asked for; one instance belongs to one thread.

    Args:
        cell: the cell.
        clearance: its checker, which has the last word.
    """

    def __init__(self, cell: Cell, clearance: Clearance) -> None:
        self._cell, self._clearance = cell, clearance

    @cached_property
    def _with_hull(self) -> SlackPlant:
        return SlackPlant(self._cell, part="hull")

    @cached_property
    def _without_part(self) -> SlackPlant:
        return SlackPlant(self._cell, part="none")

    def solve(self, viewpoint: Viewpoint, seeds: np.ndarray) -> np.ndarray | None:
        """The first configuration found that the exact tier calls free, shape (7,), or None.

        Args:
            viewpoint: with slack.
            seeds: configurations at or near its poses, in or out of collision, shape (k, 7) [rad].
        """
        asked = asked_pose(self._cell, viewpoint)
        for room in _ROOM_M:
            least = max(self._clearance.clearance, self._clearance.self_clearance) + room
            for seed in seeds[:TRIES]:
                for plant in self.plants():
                    q = plant.solve(asked, seed, least)
                    if q is None:
                        continue
                    q = np.clip(q, self._cell.q_min, self._cell.q_max)
                    if self._clearance.free(q[None])[0]:
                        return q
        return None

    def plants(self) -> tuple[SlackPlant, ...]:
        """With the part's hull; and without the part, which then is only checked, where it has hollows."""
        if self._cell.part is None or not self._cell.part.is_mesh:
            return (self._without_part,)
        return (self._with_hull,) if self._convex else (self._with_hull, self._without_part)

    @cached_property
    def _convex(self) -> bool:
        """Whether the part fills its hull."""
        from scipy.spatial import ConvexHull

        part = self._cell.part
        assert part is not None
        a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
        volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
        return part.closed and volume > 0.999 * ConvexHull(part.vertices).volume


def seeds_from(q: np.ndarray, blocked: np.ndarray, most: int = TRIES) -> np.ndarray:
    """Rows that are not blocked beyond doubt first, and of those, others of the table's angle, shape (k, 7).

    Args:
        q: candidates, best first, shape (n, 7) [rad].
        blocked: which ones are blocked beyond doubt, shape (n,).
        most: greatest number of seeds.
    """
    q = q[np.argsort(blocked, kind="stable")]
    _, first = np.unique(np.round(q[:, 6], 3), return_index=True)
    again = np.ones(len(q), bool)
    again[first] = False
    return q[np.lexsort((np.arange(len(q)), again))][:most]
