"""Settings of the cell's solids: fixture and scanner on the flange, and what stands around."""

from typing import Literal

from pydantic import Field, model_validator

from scanmotion.cell.settings.errors import Number, Settings, Side
from scanmotion.cell.settings.poses import RigidPose, differs


class ToolSettings(Settings):
    """V-fixture and scanner on the flange."""

    arm_m: Number = Field(0.25, ge=0.0, le=2.0, description="flange to scanner along the flange axis")
    offset_m: Number = Field(0.0, ge=-1.0, le=1.0, description="scanner off the flange axis, along flange x")
    tilt_deg: Number = Field(
        45.0, ge=-180.0, le=180.0, description="optical axis against the flange axis, about flange y"
    )
    roll_deg: Number = Field(0.0, ge=-180.0, le=180.0, description="scanner turned about its optical axis")
    mass_kg: Number = Field(5.0, gt=0.0, le=1000.0, description="fixture and scanner together")
    X_FS: RigidPose = Field(
        None,
        description="scanner in the flange (z outward) as calibrated, in place of the four: rows, metres",
    )
    plate_m: Number = Field(0.16, gt=0.0, le=1.0, description="diameter of the fixture's plate on the flange")
    scanner_size_m: tuple[Number, Number, Number] = Field(
        (0.262, 0.158, 0.063), description="housing along x, y, z of the scanner"
    )

    housing_mesh: str | None = Field(
        None,
        description="the scanner's own housing, a mesh beside the YAML in the scanner's frame (z along its "
        "axis, origin in the optical centre), in place of the box",
    )
    fixture_mesh: str | None = Field(
        None, description="the own fixture, a mesh in the flange's frame (z outward), in place of ours"
    )
    mesh_unit: Literal["m", "mm"] | None = Field(None, description="unit of both meshes; has to be said")

    @model_validator(mode="after")
    def _unit(self) -> "ToolSettings":
        if self.mesh_unit is None and (self.housing_mesh or self.fixture_mesh):
            raise ValueError("a mesh has no unit: write mesh_unit: mm, or m")
        return self

    @model_validator(mode="after")
    def _one_way(self) -> "ToolSettings":
        if self.X_FS is not None and differs(self, "arm_m", "offset_m", "tilt_deg", "roll_deg"):
            raise ValueError(
                "X_FS stands in place of arm_m, offset_m, tilt_deg and roll_deg; write the one or the others"
            )
        return self


class ObstacleSettings(Settings):
    """A box that stands in the cell, or a mesh of the cell's CAD."""

    name: str = Field(pattern=r"^[\w .-]{1,60}$", description="what findings and causes call it")
    centre_m: tuple[Number, Number, Number] | None = Field(None, description="of the box, in the world")
    size_m: tuple[Side, Side, Side] | None = Field(None, description="along its own x, y and z")
    mesh: str | None = Field(
        None, description="STL, OBJ, PLY or DAE beside the YAML, in place of the box; its bodies one by one"
    )
    unit: Literal["m", "mm"] | None = Field(None, description="of the mesh; has to be said")
    position_m: tuple[Number, Number, Number] | None = Field(
        None, description="of the mesh's origin, in the world; default: the world's origin"
    )
    X_WM: RigidPose = Field(None, description="pose of the mesh, in place of position_m and yaw_deg")
    yaw_deg: Number = Field(0.0, description="turn about the vertical")

    @model_validator(mode="after")
    def _box_or_mesh(self) -> "ObstacleSettings":
        if self.mesh is None:
            if self.centre_m is None or self.size_m is None:
                raise ValueError("a box needs centre_m and size_m, a mesh mesh and unit")
            if self.unit is not None or self.position_m is not None or self.X_WM is not None:
                raise ValueError("unit, position_m and X_WM are a mesh's; a box has centre_m and size_m")
            return self
        if self.centre_m is not None or self.size_m is not None:
            raise ValueError("centre_m and size_m are a box's; a mesh has position_m and unit")
        if self.unit is None:
            raise ValueError("a mesh has no unit: write unit: mm, or m")
        if self.X_WM is not None and (self.position_m is not None or self.yaw_deg):
            raise ValueError("X_WM stands in place of position_m and yaw_deg; write the one or the others")
        return self
