"""A plan made by hand with a straight sweep: what the exports are tried on. The judge finds nothing in it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from fake_plan import smooth, trajectory_through
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from scanmotion.cell.kinematics import scanner_in_object, scanner_poses, tcp_jacobian
from scanmotion.core.trajectory import joined
from scanmotion.core.viewpoint import Slack, Viewpoint

SPEED = 0.1
"""What the sweep reaches, less a thousandth [m/s]."""


def straight(cell, q, step):
    """Configurations that carry the scanner from q along `step` [m] in the world without turning it."""
    X = scanner_poses(cell, q[None])[0]
    found = [q]
    for share in np.linspace(0, 1, 301)[1:]:
        target, q = X[:3, 3] + smooth(share)[0] * np.asarray(step), found[-1].copy()
        for _ in range(8):
            now = scanner_poses(cell, q[None])[0]
            turn = Rotation.from_matrix(X[:3, :3] @ now[:3, :3].T).as_rotvec()
            twist = np.concatenate([turn, target - now[:3, 3]])
            q[:6] += np.linalg.solve(tcp_jacobian(cell, q[None])[0][:, :6], twist)
        found.append(q)
    return np.array(found)


def through(trajectory, index, via, *, corner):
    """The same with one transit led aside by `via`: with a rest at a corner half-way, or in one curve."""
    o, q = trajectory.operations[index], trajectory.q.copy()
    own = trajectory.operation == index
    share = np.clip((trajectory.t[own] - o.t_start) / (o.t_end - o.t_start), 0, 1)
    if corner:
        first, second = smooth(np.minimum(2 * share, 1))[0], smooth(np.maximum(2 * share - 1, 0))[0]
        middle = (o.q_start + o.q_end) / 2 + via
        q[own] = o.q_start + first[:, None] * (middle - o.q_start) + second[:, None] * (o.q_end - middle)
    else:
        s = smooth(share)[0][:, None]
        q[own] = o.q_start + s * (o.q_end - o.q_start) + 4 * s * (1 - s) * via
    qd = np.gradient(q, trajectory.t, axis=0)
    return replace(trajectory, q=q, qd=qd, qdd=np.gradient(qd, trajectory.t, axis=0))


def made_by_hand(cell):
    """Home, a revolution, a straight sweep past two stations with the table at 360 deg, a dwell."""
    a = cell.home + np.deg2rad([10, 20, -10, 5, 20, 0, 0])
    b = a + np.array([0, 0, 0, 0, 0, 0, 2 * np.pi])
    c = b + np.deg2rad([5, -10, 5, 0, 10, 0, -30])
    line = straight(cell, c, [0.0, 0.12, 0.05])
    step = np.linalg.norm([0.0, 0.12, 0.05])
    seconds = 1.875 * step / (0.999 * SPEED)
    d = line[-1] + np.deg2rad([2, -2, 1, 3, -2, 5, 10])
    before = trajectory_through(
        [cell.home, a, b, c],
        ["transit", "revolution", "transit"],
        [18.0, 14.0, 12.0],
        [("G1",), ("G1",), ("S1", "S2")],
    )
    before = through(before, 0, np.deg2rad([3, 4, -6, 20, 5, 0, 30]), corner=True)
    before = through(before, 2, np.deg2rad([4, 3, -5, 10, 0, 8, 0]), corner=False)
    sweep = trajectory_through([line[0], line[-1]], ["sweep"], [seconds], [("S1", "S2")])
    n = len(sweep.t)
    assert n > 200
    shares = np.interp(np.linspace(0, 1, n), np.linspace(0, 1, 301), np.arange(301.0))
    q = CubicSpline(np.arange(301), line)(shares)
    sweep = replace(sweep, q=q, qd=np.gradient(q, sweep.t, axis=0))
    after = trajectory_through([line[-1], d, d], ["transit", "dwell"], [3.0, 0.5], [("L1.1",), ("L1.1",)])
    trajectory = joined(joined(before, sweep), after)
    poses = scanner_in_object(cell, np.array([a, line[0], line[-1], d]))
    views = tuple(
        Viewpoint(
            id=name,
            X_OS=X,
            standoff=0.6,
            step=step,
            kind=kind,
            sweep=path,
            slack=Slack(roll=False),
            note=note,
        )
        for name, X, step, kind, path, note in zip(
            ["G1", "S1", "S2", "L1.1"],
            poses,
            ["global", "local", "local", "local"],
            ["revolution", "station", "station", "station"],
            ["", "S", "S", ""],
            ["from the side, above", "", "", 'says "no"'],
            strict=True,
        )
    )
    plan = SimpleNamespace(
        part=cell.part, cell=cell, trajectory=trajectory, viewpoints=views, cloud=None, holes=None,
        options=SimpleNamespace(seed=7, mode="default", strategy="two-step", source="mesh"),
        segments=(SimpleNamespace(unreachable=()),), samples=None, visible=None,
    )  # fmt: skip
    plan.cycle = plan.trajectory
    plan.solvers = {}
    return plan
