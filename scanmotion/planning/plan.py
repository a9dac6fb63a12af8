"""Plan: all that planning found, its summary, and its folder on disk."""

import functools
import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion import __version__
from scanmotion.cell.build import Cell
from scanmotion.cell.collision.last_word import LastWord
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.trajectory import Trajectory, joined
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.judge import Finding, verify
from scanmotion.plan_io.frames import frame_files
from scanmotion.plan_io.measured import (
    calibration_record,
    millimetres,
    registration_records,
    scan_files,
    surface_record,
)
from scanmotion.plan_io.schema import PlanRecord, atomic_folder, csv_text, json_text, trajectory_json
from scanmotion.planning.budget import budget_record, coverage_of
from scanmotion.planning.confidence import Confidence
from scanmotion.planning.helices import MOST_LOST, Joining
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.plan_arrays import arrays_data, hole_records
from scanmotion.planning.segment import Segment
from scanmotion.sensing.assess import Accuracy, accuracy
from scanmotion.sensing.corrections import Corrections
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.fusion.surface import surface
from scanmotion.sensing.holes.find import HoleReport
from scanmotion.sensing.simulator.simulate import Scan
from scanmotion.views.unscanned import Patch

_WORK = {"revolution": "table", "helix": "table", "path": "table", "sweep": "sweep", "dwell": "dwell"}
"""What each kind of scanning operation counts as in `time_s`."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """A planned scan: viewpoints, motion, and what the twin expects of it."""

    part: Part
    cell: Cell
    options: PlanOptions
    segments: tuple[Segment, ...]
    trajectory: Trajectory | None
    """Of the scan; None where nothing could be planned."""
    cloud: Cloud | None
    """The fused scan: simulated, or the measured one."""
    holes: HoleReport | None
    """Holes after the global step."""
    samples: SurfaceSamples | None
    visible: np.ndarray | None
    """Which samples any allowed scanner pose can see, shape (n,)."""
    confidence: Confidence | None = None
    """Intervals of predicted coverage and accuracy; None where the simulator knows no truth."""
    searched: tuple[Segment, ...] = ()
    """The segments as they were found, where pruning has made others of them since."""
    out_of_reach: np.ndarray | None = None
    """Which of those stay unscanned because no pose that sees them was found that the robot reaches, (n,)."""
    dropped: tuple[tuple[str, str], ...] = ()
    """Viewpoints of the method that were not planned: (id, reason)."""
    unscanned: tuple[Patch, ...] = ()
    """Patches of surface that stay unscanned, each with its reason."""
    planning_s: dict[str, float] = field(default_factory=dict)
    scans: tuple[Scan, ...] = ()
    """What the twin measured, as it was fused; only where PlanOptions.keep_scans asks for it."""
    corrections: Corrections | None = None
    """Calibration and registration, where there were any."""
    joining: Joining | None = None
    """What came of joining turns, where that was allowed."""
    way_home: Trajectory | None = None
    """From the end of the scan back to its start; None where it ends there, or `no_way_home` says why."""
    no_way_home: str = ""
    motion: Mapping[str, Any] | None = None
    """The continuous motion, as the summary tells it; None for stops."""
    last_word: LastWord | None = None
    """What Drake says of the whole motion; None where nothing moves."""

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """Every viewpoint that was asked for, served or not, in order."""
        return tuple(r.viewpoint for item in self.segments for r in item.reaches)

    @property
    def unreachable(self) -> tuple[tuple[str, str], ...]:
        """(id, reason) of viewpoints that no operation serves."""
        return self.dropped + tuple(pair for item in self.segments for pair in item.unreachable)

    @property
    def seen(self) -> np.ndarray | None:
        """Which samples the whole plan sees, shape (n,)."""
        return self.segments[-1].seen if self.samples is not None and self.segments else None

    @property
    def cycle(self) -> Trajectory | None:
        """The scan and the way home: what is written, judged, exported and driven."""
        scan, home = self.trajectory, self.way_home
        return scan if scan is None or home is None else joined(scan, home)

    def completeness(self) -> dict[str, float | None]:
        """Shares after the global step and at the end, of what can be seen; and of the whole surface."""
        if self.visible is None or self.seen is None:
            return {"after_global": None, "final": None, "final_of_whole": None}
        can = max(int(self.visible.sum()), 1)
        first = next((r.seen for r in reversed(self.segments) if r.step == "global"), np.zeros(1, bool))
        return {
            "after_global": float(first.sum()) / can,
            "final": float(self.seen.sum()) / can,
            "final_of_whole": float(self.seen.mean()),
        }

    def within_reach(self) -> dict[str, float | None]:
        """Of what can be seen, the share that this robot's scanner can be brought to see; of that, the share
        that the plan scans.
        """
        if self.visible is None or self.seen is None or self.out_of_reach is None:
            return {"share": None, "scanned": None}
        can, reached = int(self.visible.sum()), int((self.visible & ~self.out_of_reach).sum())
        return {"share": reached / max(can, 1), "scanned": float(self.seen.sum()) / max(reached, 1)}

    def accuracy(self) -> Accuracy | None:
        """Distance of the fused cloud from the true surface; None where no truth is known."""
        if self.samples is None or self.cloud is None:
            return None
        return accuracy(self.cloud.points, self.part)

    @functools.cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """The surface reconstructed from the fused cloud: vertices (v, 3) [m] and triangles (t, 3).

        Raises:
            InputError: nothing was scanned, or too little.
        """
        if self.cloud is None:
            raise InputError("nothing was scanned: there is no surface")
        return surface(self.cloud)

    def accuracies(self) -> dict[str, Any]:
        """`accuracy` of the summary: of the fused cloud, and of the surface where the options ask for it."""
        found: dict[str, Any] = millimetres(self.accuracy())
        if self.options.surface and self.samples is not None and self.seen is not None:
            seen = self.samples.points[self.seen]
            found["surface"] = surface_record(self.surface, self.part, seen)
        return found

    def time_s(self) -> dict[str, float]:
        """Seconds of the scan in total and by kind of work, its floor, and of the cycle with the way home."""
        split = {"arm": 0.0, "table": 0.0, "sweep": 0.0, "dwell": 0.0}
        for o in self.trajectory.operations if self.trajectory is not None else ():
            arm_moves = np.abs(o.q_end[:6] - o.q_start[:6]).max() > 1e-9
            key = _WORK.get(o.kind)
            split[key or ("arm" if arm_moves else "table")] += o.t_end - o.t_start
        total = self.trajectory.duration if self.trajectory is not None else 0.0
        floor = sum(r.tour.floor for r in self.segments)
        found = {"total": total, **split, "floor": floor, "cycle": self.cycle.duration if self.cycle else 0.0}
        return {k: float(v) for k, v in found.items()}

    def budget(self) -> dict[str, Any]:
        """The budget, what uses it up, and what a shorter programme would see."""
        stops = [stop for item in self.segments for stop in item.tour.stops]
        whole, coverage = self.completeness()["final"], None
        if self.trajectory is not None and self.samples is not None and whole is not None:
            assert self.seen is not None
            coverage = coverage_of(
                self.part, self.cell, self.trajectory, self.samples, self.seen, whole
            )  # fmt: skip
        floor = self.time_s()["floor"]
        return budget_record(self.cell, self.trajectory, stops, floor, coverage)

    @functools.cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What Drake finds in the motion, and the judge in the files, which are written for him elsewhere."""
        told = self.last_word.findings if self.last_word is not None else ()
        with tempfile.TemporaryDirectory() as work:
            return (*told, *verify(atomic_folder(Path(work) / "plan", plan_files(self))))

    @functools.cached_property
    def summary(self) -> dict[str, Any]:
        """summary.json: what the plan achieves; docs/results.md says what each figure means."""
        time_s = self.time_s()
        served = [v for item in self.segments for v in item.served]
        told = {
            "viewpoints": {
                "global": sum(v.step == "global" for v in served),
                "local": sum(v.step == "local" for v in served),
                "unreachable": [{"id": name, "reason": reason} for name, reason in self.unreachable],
            },
            "completeness": _rounded(self.completeness()),
            "within_reach": _rounded(self.within_reach()),
            "rounds": [self._told(item) for item in self.segments],
            "searched": [self._told(item) for item in self.searched],
            "unscanned": [
                {
                    "center_mm": [round(float(x) * 1e3, 1) for x in p.center],
                    "area_mm2": round(p.area * 1e6, 1),
                    "reason": p.reason,
                }
                for p in self.unscanned
            ],
            **({} if self.confidence is None else {"confidence": self.confidence.record()}),
            "accuracy": self.accuracies(),
            "calibration": calibration_record(self.corrections),
            "registration": registration_records(self.corrections),
            "time_s": {k: round(v, 3) for k, v in time_s.items()},
            "budget": self.budget(),
            **({} if self.joining is None else {"helix": joining_record(self.joining)}),
            **({"no_way_home": self.no_way_home} if self.no_way_home else {}),
            **({} if self.motion is None else {"motion": dict(self.motion)}),
            "findings": [str(f) for f in self.findings],
            **({} if self.last_word is None else {"drake": drake_record(self.last_word)}),
            "planning_s": {k: round(v, 2) for k, v in self.planning_s.items()},
            **({} if self.part.report is None else {"read": self.part.report.record()}),
        }
        # What is told in memory is what stands on disk: plain numbers, no numpy scalars.
        return json.loads(json_text(told))

    def _told(self, item: Segment) -> dict[str, Any]:
        return {
            "step": item.step,
            "viewpoints": len(item.served),
            "completeness": self._share(item.seen),
        }

    def _share(self, seen: np.ndarray) -> float | None:
        if self.visible is None or len(seen) != len(self.visible):
            return None
        return round(float(seen.sum()) / max(int(self.visible.sum()), 1), 6)

    def record(self) -> PlanRecord:
        """plan.json."""
        return plan_record(self)

    def save(self, folder: str | Path, *, extras: Mapping[str, bytes | str] | None = None) -> list[Finding]:
        """Writes the plan folder as a whole or not at all, and has it judged.

        Args:
            folder: replaced if it exists.
            extras: further files by name, as scene.html and report.html.

        Returns:
            what the judge found; it stands in summary.json too.

        Raises:
            PlanFileError: the folder cannot be written.
            InputError: there is no trajectory to write.
        """
        files = plan_files(self) | {"summary.json": json_text(self.summary)}
        if self.scans and self.cloud is not None:
            files |= scan_files(self.cloud, self.surface, self.part, self.scans)
        atomic_folder(folder, {**files, **(extras or {})})
        return list(self.findings)


def drake_record(word: LastWord) -> dict[str, Any]:
    """`drake` of summary.json: how much of the motion was checked, and how."""
    return {
        "checked": word.checked,
        "way_m": round(word.way_m, 3),
        "by_triangles": word.by_triangles,
        "findings": len(word.findings),
    }


def joining_record(joining: Joining) -> dict[str, Any]:
    """`helix` of summary.json."""
    return {
        "taken": joining.taken, "still_seconds": joining.still_seconds, "most_lost": MOST_LOST,
        "tried": [asdict(form) for form in joining.tried], "note": joining.note,
    }  # fmt: skip


def _rounded(shares: dict[str, float | None]) -> dict[str, float | None]:
    return {k: None if v is None else round(v, 6) for k, v in shares.items()}


def plan_files(plan: Plan) -> dict[str, bytes | str]:
    """The files of a plan folder but summary.json and the pages."""
    if plan.trajectory is None:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in plan.unreachable[:3])
        raise InputError(f"nothing could be planned: {reasons}")
    solid, cycle = plan.cell.part, plan.cycle
    assert solid is not None and cycle is not None
    return {
        "plan.json": json_text(plan.record()),
        "trajectory.csv": csv_text(cycle),
        "trajectory.json": trajectory_json(cycle, plan.cell.joint_names),
        "robot.urdf": plan.cell.robot.record,
        **plan.cell.robot.meshes,
        "part.ply": ply_bytes(solid.vertices, solid.triangles),
        "cell.json": plan.cell.settings.model_dump_json(indent=1) + "\n",
        "holes.json": json_text({"units": "m", "holes": hole_records(plan.holes)}),
        "scan.npz": arrays_data(plan.cloud, plan.samples, plan.visible, plan.segments),
        **frame_files(plan.trajectory, plan.viewpoints, plan.cell),
    }


def ply_bytes(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    """Binary little-endian PLY in double precision."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty double x\n"
        f"property double y\nproperty double z\nelement face {len(triangles)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, triangles
    return header.encode("ascii") + vertices.astype("<f8").tobytes() + faces.tobytes()


def plan_record(plan: Plan) -> PlanRecord:
    """The plan in the schema of plan.json."""
    cell, process = plan.cell, plan.cell.settings.process
    frames, cycle = {7: "flange", 8: "table", 9: "world"}, plan.cycle
    assert cycle is not None

    def finite(values: np.ndarray) -> list[float | None]:
        return [float(v) if np.isfinite(v) else None for v in values]

    return PlanRecord.model_validate(
        {
            "software": f"scanmotion {__version__}",
            "robot": cell.settings.robot.model,
            "part": plan.part.name,
            "source": plan.options.source, "mode": plan.options.mode, "strategy": plan.options.strategy,
            "seed": plan.options.seed,
            "joint_names": cell.joint_names, "robot_joints": cell.settings.robot.joints,
            "flange_link": cell.settings.robot.flange,
            "limits": {
                "position_min_rad": finite(cell.q_min), "position_max_rad": finite(cell.q_max),
                "velocity_rad_s": cell.v_max.tolist(), "acceleration_rad_s2": cell.a_max.tolist(),
                "jerk_rad_s3": cell.j_max.tolist(),
            },
            "X_WB": cell.X_WB.tolist(), "X_FS": cell.X_FS.tolist(), "X_WT": cell.X_WT.tolist(),
            "X_TO": cell.X_TO.tolist(), "home": cell.home.tolist(),
            "process": {
                k: getattr(process, k)
                for k in ("scan_speed_m_s", "transit_speed_m_s", "fps", "dwell_s", "clearance_m", "budget_s")
            },
            "bodies": [
                {
                    "name": b.name, "frame": frames[b.link], "shape": b.shape, "size_m": b.size,
                    "X": b.X_LG.tolist(),
                }
                for b in cell.bodies if b.link in frames
            ],
            "urdf_file": "robot.urdf", "part_file": "part.ply", "cell_file": "cell.json",
            "viewpoints": [_view_record(v) for v in plan.viewpoints],
            "unreachable": [pair for item in plan.segments for pair in item.unreachable],
            "operations": [
                {
                    "index": o.index, "kind": o.kind, "viewpoints": o.viewpoints,
                    "t_start": round(o.t_start, 6), "t_end": round(o.t_end, 6),
                    "q_start": o.q_start.tolist(), "q_end": o.q_end.tolist(),
                }
                for o in cycle.operations
            ],
        }
    )  # fmt: skip


def _view_record(v: Viewpoint) -> dict[str, Any]:
    return {
        "id": v.id, "X_OS": v.X_OS.tolist(), "standoff_m": v.standoff, "step": v.step, "kind": v.kind,
        "sweep": v.sweep, "slack_standoff_m": v.slack.standoff, "slack_tilt_rad": v.slack.tilt,
        "slack_roll": v.slack.roll, "note": v.note,
    }  # fmt: skip
