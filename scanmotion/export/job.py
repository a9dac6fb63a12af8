"""What a writer of robot programmes is given: the plan, the cell's settings, and how it is to be run."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scanmotion.cell.settings.cell import CellSettings, settings_from
from scanmotion.cell.settings.programme import ProgrammeSettings
from scanmotion.core.errors import InputError, PlanFileError
from scanmotion.export.pose import Arm, arm_for_poses
from scanmotion.export.source import Source, Stretch
from scanmotion.plan_io.read import read_json, read_text

DRY_PERCENT = 10
"""Speed of a dry run."""

Files = dict[str, bytes | str]


@dataclass(frozen=True, eq=False, kw_only=True)
class ExportJob:
    """A plan that is to become a programme."""

    source: Source
    name: str
    signals: ProgrammeSettings
    mass: float
    """Of fixture and scanner [kg]."""
    dry_run: bool = False
    """Scanner off, reduced speed, a halt at each view."""

    @cached_property
    def arm(self) -> Arm:
        """The chain of the plan's URDF."""
        record = self.source.record
        text = read_text(self.source.folder, record.urdf_file, limit=8 << 20)
        return arm_for_poses(text, record.robot_joints, record.flange_link)

    @cached_property
    def X_FS(self) -> np.ndarray:
        """The scanner on the flange, shape (4, 4) [m]."""
        return np.array(self.source.record.X_FS)

    @cached_property
    def fastest(self) -> np.ndarray:
        """Speeds that 100 percent mean, shape (7,) [rad/s].

        Raises:
            InputError: they are not positive numbers.
        """
        own = self.signals.kuka_speed_deg_s
        if own is not None:
            return np.deg2rad(own)
        found = np.append(self.arm.velocity, self.source.record.limits.velocity_rad_s[6])
        if not (np.isfinite(found) & (found > 0)).all():
            raise InputError("the robot's greatest speeds are not positive numbers")
        return found

    @cached_property
    def centre_of_mass(self) -> np.ndarray:
        """Of fixture and scanner on the flange, shape (3,) [m]."""
        given = self.signals.centre_of_mass_m
        return np.array(given) if given is not None else self.X_FS[:3, 3] / 2

    @cached_property
    def inertia(self) -> np.ndarray:
        """About the centre of mass, shape (3,) [kg m2]: half of the mass at each end of the fixture."""
        half = self.X_FS[:3, 3] / 2
        return self.mass * np.maximum(np.sum(half**2) - half**2, 0.02**2)

    @cached_property
    def stretches(self) -> list[Stretch]:
        """The operations in order; their numbers in the programme count from 1."""
        return self.source.stretches()


Writer = Callable[[ExportJob], Files]
"""Every writer of a format has this signature: files by name, nothing written yet."""


def job_from(source: Source, name: str, *, signal: int | None = None, dry_run: bool = False) -> ExportJob:
    """A job with the settings of the plan's own cell.

    Args:
        source: the plan.
        name: of the programme and of its files.
        signal: number of the output that is on while the scanner scans, instead of the cell's.
        dry_run: scanner off, reduced speed, a halt at each view.

    Raises:
        PlanFileError: the cell's settings cannot be read.
    """
    data = read_json(source.folder, source.record.cell_file)
    if not isinstance(data, dict):
        raise PlanFileError(f"{source.record.cell_file}: a cell's settings are expected")
    settings: CellSettings = settings_from(data, folder=str(source.folder))
    signals = settings.programme
    if signal is not None:
        try:
            changed = signals.model_dump() | {"start_out": signal}
            signals = ProgrammeSettings.model_validate(changed)
        except ValueError:
            raise InputError(
                f"--signal {signal}: is no number of an output, or one that the cell uses for another signal"
            ) from None
        if signal < 1:
            raise InputError(f"--signal {signal}: a digital output has a number from 1 to 8192")
    return ExportJob(source=source, name=name, signals=signals, mass=settings.tool.mass_kg, dry_run=dry_run)
