"""A small plan that keeps every promise, made by hand: no planner is asked, so the judge can be tried alone.

One operation of each kind: two transits, a revolution, a sweep past three viewpoints, a dwell. The
viewpoints are where the cell's own kinematics (not the judge's) put the scanner.
"""

import itertools
import json
from types import SimpleNamespace
from typing import Any

import numpy as np
from fake_plan import trajectory_through
from scipy.interpolate import CubicSpline

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.viewpoint import Slack, Viewpoint
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.plan_io.write import plan_files

STANDOFF = 0.6
KINDS = ["transit", "revolution", "transit", "sweep", "transit", "dwell"]
SERVES = [("G1",), ("G1",), ("S1", "S2", "S3"), ("S1", "S2", "S3"), ("L1",), ("L1",)]


def poses_in_object(cell, q):
    """X_OS of configurations (n, 7), shape (n, 4, 4)."""
    c, s = np.cos(q[:, 6]), np.sin(q[:, 6])
    turn = np.tile(np.eye(4), (len(q), 1, 1))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
    X_WO = np.asarray(cell.X_WT) @ turn @ np.asarray(cell.X_TO)
    return np.linalg.inv(X_WO) @ np.asarray(scanner_poses(cell, q))


def seconds_for(cell, a, b, speed):
    """Long enough for a quintic from a to b to keep to `speed` [m/s] and to the table's pace."""
    q = a + np.linspace(0, 1, 60)[:, None] * (b - a)
    X = np.asarray(scanner_poses(cell, q))
    fastest = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1).max() * 59 * 1.875
    return np.ceil(max(1.0, 1.05 * fastest / speed, 2.0 * abs(b[6] - a[6])) * 10) / 10


def station(name, X, *, kind: Any = "station", **more):
    return Viewpoint(
        id=name, X_OS=X, standoff=STANDOFF, step="local", kind=kind,
        slack=more.pop("slack", Slack(roll=False)), **more,
    )  # fmt: skip


def hand_made_plan():
    """What plan.plan_files needs of a Plan."""
    part = box_part(0.2, 0.15, 0.4)
    cell = build_cell(load_cell("kr240"), part)
    a = cell.home + np.deg2rad([10, 20, -10, 5, 20, 0, 0])
    b = a + np.array([0, 0, 0, 0, 0, 0, 2 * np.pi])
    c = b + np.deg2rad([5, -10, 5, 0, 10, 0, 0])
    d = c + np.deg2rad([4, 0, 0, 0, 0, 0, 0])
    e = d + np.deg2rad([-12, 5, 0, 0, -5, 20, -30])
    stops = [np.asarray(cell.home), a, b, c, d, e, e]
    seconds = [seconds_for(cell, p, q, 0.1) for p, q in itertools.pairwise(stops)]
    seconds[-1] = 0.3
    trajectory = trajectory_through(stops, KINDS, seconds, SERVES)
    X = poses_in_object(cell, np.array([a, c, (c + d) / 2, d, e]))
    views = (
        station("G1", X[0], kind="revolution"),
        *(station(f"S{n}", X[n], sweep="S") for n in (1, 2, 3)),
        station("L1", X[4]),
    )
    segment = SimpleNamespace(step="local", seen=np.zeros(0, bool), unreachable=(), served=views)
    plan: Any = SimpleNamespace(
        part=part, cell=cell,
        options=SimpleNamespace(seed=7, mode="default", strategy="two-step", source="mesh"),
        segments=(segment,), trajectory=trajectory,
        cloud=None, holes=None, samples=None, visible=None, seen=None, viewpoints=views, unreachable=(),
        dropped=(), unscanned=(),
    )  # fmt: skip
    plan.cycle = plan.trajectory
    plan.solvers = {}
    return plan


def hand_made_files():
    """The files of its folder, by name."""
    return plan_files(hand_made_plan())


class Written:
    """The files of a plan, open to be spoiled before they are written."""

    def __init__(self, files):
        self.files = dict(files)
        self.plan = json.loads(self.files["plan.json"])
        lines = self.files["trajectory.csv"].splitlines()
        self.header, rows = lines[0], [line.split(",") for line in lines[1:]]
        self.table = np.array([[float(x) for x in row[:8]] for row in rows])
        self.operation = np.array([int(row[8]) for row in rows])

    @property
    def t(self):
        return self.table[:, 0]

    @property
    def deg(self):
        """The joints' columns [deg]; writing into it changes the table."""
        return self.table[:, 1:]

    def rows_of(self, operation):
        return np.flatnonzero(self.operation == operation)

    def rows_with_start(self, operation):
        """The rows of an operation and the instant that it shares with the one before."""
        own = self.rows_of(operation)
        return own if own[0] == 0 else np.concatenate([[own[0] - 1], own])

    def retimed(self, operation, seconds):
        """One operation in another time, sampled every 10 ms along the same way; all later ones shift."""
        own = self.rows_with_start(operation)
        old = self.table[own]
        share = (old[:, 0] - old[0, 0]) / (old[-1, 0] - old[0, 0])
        at = np.linspace(0, 1, round(seconds / 0.01) + 1)[1:]
        fresh = np.column_stack([old[0, 0] + at * seconds, CubicSpline(share, old[:, 1:])(at)])
        shift = seconds - (old[-1, 0] - old[0, 0])
        after = self.table[own[-1] + 1 :] + [shift, *[0] * 7]
        self.operation = np.concatenate(
            [self.operation[: own[1]], np.full(len(at), operation), self.operation[own[-1] + 1 :]]
        )
        self.table = np.concatenate([self.table[: own[1]], fresh, after])
        self.agree()

    def agree(self):
        """plan.json takes its times and ends from the table."""
        for o in self.plan["operations"]:
            rows = self.rows_of(o["index"])
            first = max(rows[0] - 1, 0)
            o["t_start"], o["t_end"] = self.t[first], self.t[rows[-1]]
            o["q_start"] = np.deg2rad(self.deg[first]).tolist()
            o["q_end"] = np.deg2rad(self.deg[rows[-1]]).tolist()
        # What is written beside the table tells of the old one.
        for name in ("trajectory.json", "frames.csv", "frames.json"):
            self.files.pop(name, None)

    def drop(self, rows):
        self.table, self.operation = np.delete(self.table, rows, axis=0), np.delete(self.operation, rows)

    def text(self):
        kinds = [o["kind"] for o in self.plan["operations"]]
        lines = (
            f"{row[0]:.4f}," + ",".join(f"{v:.8f}" for v in row[1:]) + f",{o},{kinds[o]}"
            for row, o in zip(self.table, self.operation, strict=True)
        )
        return "\n".join([self.header, *lines]) + "\n"

    def write(self, folder):
        content = {**self.files, "trajectory.csv": self.text(), "plan.json": json.dumps(self.plan)}
        folder.mkdir(exist_ok=True)
        for name, data in content.items():
            (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
        return folder
