"""Plan: all that planning found, in one value; it is the same whether it was made or loaded."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.last_word import LastWord
from scanmotion.core.finding import Finding
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.summary import NOT_WORTH, Summary
from scanmotion.core.trajectory import Trajectory, joined
from scanmotion.core.viewpoint import Viewpoints
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.segment import Segment
from scanmotion.planning.steps.helices import Joining
from scanmotion.planning.worth.confidence import Confidence
from scanmotion.sensing.assess import Accuracy, accuracy
from scanmotion.sensing.corrections.corrected_scan import Corrections
from scanmotion.sensing.fusion.fuse import Cloud
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
    planning_s: dict[str, float] = field(default_factory=dict[str, float])
    scans: tuple[Scan, ...] = ()
    """What the twin measured, as it was fused; only where PlanOptions.keep_scans asks for it."""
    corrections: Corrections | None = None
    """Calibration and registration, where there were any."""
    joining: Joining | None = None
    """What came of joining turns, where that was allowed."""
    way_home: Trajectory | None = None
    """From the end of the scan back to its start; None where it ends there, or `no_way_home` says why."""
    no_way_home: str = ""
    motion: Mapping[str, JsonValue] | None = None
    """The continuous motion, as the summary tells it; None for stops."""
    last_word: LastWord | None = None
    """What Drake says of the whole motion; None where nothing moves."""
    meta: Mapping[str, str] = field(default_factory=dict[str, str])
    """What the user notes, as object number, operator, date; it stands in the summary and report."""
    summary: Summary | None = None
    """What the plan achieves and what the judge found; None until it is saved."""

    def _told(self) -> list[tuple[str, str]]:
        """What a short form says: name and value."""
        seconds, done = self.time_s()["total"], self.completeness()["final"]
        served = len({v.id for item in self.segments for v in item.served})
        told = [("part", self.part.name), ("viewpoints served", str(served)), ("time", f"{seconds:.1f} s")]
        told += [] if done is None else [("scanned, of what can be seen", f"{done:.2%}")]
        told += [("unreachable", str(len(self.unreachable)))] if self.unreachable else []
        told += [("not worth their seconds", str(len(self.not_worth)))] if self.not_worth else []
        checks = "not judged yet" if self.summary is None else f"{len(self.summary.findings)} findings"
        return [*told, ("checks", checks)]

    def __repr__(self) -> str:
        return "Plan(" + "; ".join(f"{name}: {value}" for name, value in self._told()) + ")"

    def _repr_html_(self) -> str:
        """The short form as a table, for notebooks."""
        rows = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in self._told())
        return f"<table>{rows}</table>"

    @property
    def viewpoints(self) -> Viewpoints:
        """Every viewpoint that was asked for, served or not, in order."""
        return Viewpoints(r.viewpoint for item in self.segments for r in item.reaches)

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """(id, reason) of viewpoints that no operation serves."""
        return self.dropped + tuple(pair for item in self.segments for pair in item.unreachable)

    @property
    def unreachable(self) -> tuple[tuple[str, str], ...]:
        """(id, reason) of those that the robot cannot serve."""
        return tuple(pair for pair in self.left_out if not pair[1].startswith(NOT_WORTH))

    @property
    def not_worth(self) -> tuple[tuple[str, str], ...]:
        """(id, reason) of those that it could serve and that add less than their seconds are worth."""
        return tuple(pair for pair in self.left_out if pair[1].startswith(NOT_WORTH))

    @property
    def seen(self) -> np.ndarray | None:
        """Which samples the whole plan sees, shape (n,)."""
        return self.segments[-1].seen if self.samples is not None and self.segments else None

    @property
    def solvers(self) -> dict[str, str]:
        """Which solver found the pose of each viewpoint that is served, by id; "" where it was given."""
        return {v: solver for item in self.segments for v, solver in item.solvers.items()}

    @property
    def seen_globally(self) -> np.ndarray:
        """Which samples the global step sees, shape (n,)."""
        nothing = np.zeros(0 if self.samples is None else len(self.samples.points), bool)
        return next((item.seen for item in reversed(self.segments) if item.step == "global"), nothing)

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
        return {
            "after_global": float(self.seen_globally.sum()) / can,
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

    def save(
        self,
        folder: str | Path,
        *,
        extras: Mapping[str, bytes | str] | None = None,
        pages: "Callable[[Plan], Mapping[str, str]] | None" = None,
    ) -> list[Finding]:
        """Writes the plan folder as a whole or not at all, and has it judged.

        A convenience over `scanmotion.plan_io.save`, with the judge of this package.

        Args:
            folder: replaced if it exists.
            extras: further files by name.
            pages: makes further files of the judged plan, as scene.html and report.html.

        Returns:
            what the judge found; it stands in summary.json too.

        Raises:
            PlanFileError: the folder cannot be written.
            InputError: there is no trajectory to write.
        """
        from scanmotion.judge import margins_of, verify
        from scanmotion.plan_io.save import save

        return list(save(self, folder, judge=verify, measure=margins_of, pages=pages, extras=extras).findings)
