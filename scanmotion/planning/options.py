"""What a plan may be told beside the part and the cell."""

from dataclasses import dataclass, field
from typing import Literal

from scanmotion.core.errors import InputError
from scanmotion.motion.continuous.options import ContinuousOptions
from scanmotion.sensing.simulator.captures import ScanErrors

Source = Literal["mesh", "box", "scan"]
Mode = Literal["default", "paper"]
MotionKind = Literal["stops", "continuous", "auto"]
Strategy = Literal["two-step", "cad-slicing", "surface-partitioning"]


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """What a plan may be told beside the part and the cell."""

    source: Source = "mesh"
    """mesh: the twin scans the part, both steps. box: only a box is known, global step. scan: local step."""
    mode: Mode = "default"
    strategy: Strategy = "two-step"
    seed: int = 0
    rounds: int = 3
    """Most local rounds: what is still open is sought again after each."""
    samples: int = 40_000
    """Surface samples by which completeness is counted."""
    voxel: float = 0.002
    """Edge of the fused cloud's voxels [m]."""
    stride: int = 2
    """The twin casts every stride-th ray in x and y of a frame."""
    goal: float = 0.999
    """Completeness of what can be seen at which the local rounds end."""
    errors: ScanErrors | None = None
    """What the simulated scanner, arm and table get wrong; None: what the cell's section `twin` says."""
    calibrate: bool | None = None
    """Estimate the constant errors from the scans and correct them; None: where there are any."""
    surface: bool = False
    """The summary assesses the reconstructed surface too."""
    keep_scans: bool = False
    """The plan holds the twin's scans, to be saved."""
    occlusion_aware: bool = True
    """Local viewpoints are chosen on a closed model; False: the grid over each hole's box."""
    thorough: bool = False
    """Fill the budget: local viewpoints are taken down to slivers that repay a tenth of what others do."""
    tidy: bool = True
    """In the end, local viewpoints that the twin shows to be worth less than their seconds are taken out and
    the rest is ordered as one tour; False: the programme as it is found round by round."""
    reach_feedback: bool = True
    """Only what the robot reaches is chosen; False: reach is asked for afterwards."""
    turntable: Literal["axis", "fallback"] = "axis"
    """axis: the table is a seventh axis. fallback: it turns for stations only where the arm alone cannot."""
    motion: MotionKind = "stops"
    """stops: turns and stops from rest to rest. continuous: arm and table move at once, the scanner captures
    all the time; where no such motion can be driven, stops. auto: both are planned; the one that the twin
    finds to see no less in fewer seconds is kept."""
    completeness: float | None = None
    """A continuous motion sees at least this share of what can be seen, in the least seconds; None: what a
    second is worth decides."""
    fill: bool = False
    """A continuous motion uses up the budget for as much as can be seen in it."""
    search: ContinuousOptions = field(default_factory=ContinuousOptions)
    """How hard a continuous motion is sought."""
    helix: bool = False
    """Neighbouring turns of the global step may be joined, the arm moving while the table turns."""

    def __post_init__(self) -> None:
        for name, known in (
            ("turntable", ("axis", "fallback")),
            ("motion", ("stops", "continuous", "auto")),
            ("source", ("mesh", "box", "scan")),
            ("mode", ("default", "paper")),
            ("strategy", ("two-step", "cad-slicing", "surface-partitioning")),
        ):
            if getattr(self, name) not in known:
                raise InputError(f"unknown {name} {getattr(self, name)!r}; known: {', '.join(known)}")
        if self.completeness is not None and not 0.0 < self.completeness <= 1.0:
            raise InputError(f"completeness {self.completeness:g}: a share between 0 and 1 is expected")
        if self.motion != "stops":
            self._check_continuous()
        elif self.completeness is not None:
            raise InputError("a completeness is asked of a continuous motion only")
        if self.source != "mesh":
            uses = {"calibrate": "calibrate from", "surface": "make a surface of", "keep_scans": "save"}
            uses["helix"] = "compare turns by"
            asked = [use for name, use in uses.items() if getattr(self, name)]
            if asked:
                raise InputError(f"a {self.source} is not scanned by the twin: no scans to {asked[0]}")

    def _check_continuous(self) -> None:
        if self.source != "mesh":
            raise InputError(f"a continuous motion is chosen on a known surface, not on a {self.source}")
        if self.mode != "default" or self.strategy != "two-step":
            raise InputError("a continuous motion is no part of the paper's method or of those compared with")
        if self.helix:
            raise InputError("helices are a form of stops; a continuous motion has none")
