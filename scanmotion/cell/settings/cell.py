"""The cell's YAML: strict, frozen settings whose keys carry their units."""

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, Field, ValidationError, model_validator

from scanmotion.cell.settings.errors import (
    CalibrationSettings,
    Number,
    Settings,
    TwinSettings,
    UncertaintySettings,
)
from scanmotion.cell.settings.poses import RigidPose
from scanmotion.cell.settings.programme import ProgrammeSettings
from scanmotion.cell.settings.scanner_presets import with_scanner_preset
from scanmotion.cell.settings.solids import ObstacleSettings, ToolSettings
from scanmotion.core.errors import CellError
from scanmotion.core.scanner import MATERIALS, Scanner
from scanmotion.geometry.parts.make_part import models_dir

OWN_NAMES = ("floor", "table", "table_column", "pedestal", "part", "scanner", "fixture_plate")
"""Names of solids that every cell has."""


def _length(low: float, high: float, default: float, meaning: str) -> Any:
    return Field(default=default, ge=low, le=high, description=meaning, json_schema_extra={"unit": "m"})


class RobotSettings(Settings):
    """The arm: which model, how hard it may accelerate, where it rests."""

    model: str = Field("kr240", description="built-in name, or path of a URDF beside the cell's YAML")
    joints: tuple[str, ...] = Field(
        ("A1", "A2", "A3", "A4", "A5", "A6"), description="the six joints, base to flange"
    )
    flange: str = Field("tool0", description="link whose frame is the flange (z outward)")
    flange_axis: Literal["z", "x"] | None = Field(
        None,
        description="which axis of the flange points outward; default: z, and x (REP-199) is asked about",
    )
    packages: tuple[str, ...] = Field(
        (), description="folders in which package:// of a URDF's meshes is sought"
    )
    endless_deg: Number = Field(
        360.0, gt=0.0, le=2000.0, description="bound, each way, of a joint that turns for ever (continuous)"
    )
    velocity_deg_s: tuple[Number, ...] | None = Field(
        None, description="six speeds in place of those that the URDF lacks"
    )
    acceleration: Literal["rated", "light"] | tuple[Number, ...] = Field(
        "light", description="preset, or six values in rad/s2; light is an estimate for tools up to 10 kg"
    )
    jerk_time_s: Number = Field(0.1, gt=0.0, le=5.0, description="jerk limit = acceleration / this time")
    home_deg: tuple[Number, ...] | None = Field(None, description="A1..A6 at rest; default: of the model")
    velocity_scale: Number = Field(1.0, gt=0.0, le=1.0, description="share of the rated joint speeds used")


class BaseSettings(Settings):
    """Where the robot stands."""

    position_m: tuple[Number, Number, Number] = Field((0.0, 0.0, 0.0), description="base in the world")
    yaw_deg: Number = Field(0.0, ge=-360.0, le=360.0, description="turn of the base about the vertical")
    X_WB: RigidPose = Field(
        None, description="base in the world as calibrated, in place of both: four rows, metres"
    )

    @model_validator(mode="after")
    def _one_way(self) -> "BaseSettings":
        if self.X_WB is not None and (any(self.position_m) or self.yaw_deg):
            raise ValueError("X_WB stands in place of position_m and yaw_deg; write the one or the others")
        return self


class TurntableSettings(Settings):
    """The table: seventh axis E1."""

    position_m: tuple[Number, Number] = Field((2.2, 0.0), description="axis in the world, x and y")
    height_m: Number = Field(0.70, ge=0.0, le=3.0, description="top above the floor")
    diameter_m: Number = Field(1.52, gt=0.05, le=10.0, description="of the top")
    thickness_m: Number = Field(0.06, gt=0.0, le=1.0, description="of the top")
    speed_rpm: Number = Field(10.0, gt=0.0, le=120.0, description="turns per minute")
    acceleration_rad_s2: Number = Field(0.5, gt=0.0, le=50.0, description="greatest")
    jerk_time_s: Number = Field(0.1, gt=0.0, le=5.0, description="jerk limit = acceleration / this time")
    range_deg: tuple[Number, Number] = Field((-720.0, 720.0), description="least and greatest angle")
    endless: bool = Field(False, description="the table may turn on for ever; range_deg is then not used")


class PedestalSettings(Settings):
    """A block between table and object; height 0 for none."""

    height_m: Number = Field(0.0, ge=0.0, le=2.0, description="above the table; 0 for none")
    diameter_m: Number = Field(0.3, gt=0.0, le=5.0, description="it is round")


class ScannerSettings(Settings):
    """Table 1 of the paper, and the noise of the scan twin."""

    model: str | None = Field(
        None,
        description="preset that gives the keys below, and housing, standoff and frame rate; null for none",
    )
    field_deg: tuple[Number, Number] = Field((30.0, 21.0), description="field of view, long and short side")
    range_m: tuple[Number, Number] = Field((0.4, 1.0), description="least and greatest working distance")
    max_incidence_deg: Number = Field(
        70.0, gt=0.0, lt=90.0, description="greatest angle between a ray and the surface's normal"
    )
    baseline_m: Number = Field(0.150, ge=0.0, le=2.0, description="camera to projector, along scanner x")
    rays: tuple[int, int] = Field((424, 296), description="measured pixels of a frame")
    sigma_mm: Number = Field(0.05, ge=0.0, le=10.0, description="noise along the ray at least distance")
    frame_scale: Number = Field(1.5e-4, ge=0.0, le=0.1, description="scale error of a frame, m per m")
    material: Literal["matt", "glossy", "dark"] = Field("matt", description="of the part's surface, a model")
    exposure_ms: Number = Field(0.0, ge=0.0, le=100.0, description="a frame's exposure: motion blurs it")
    rolling_ms: Number = Field(
        0.0, ge=-1000.0, le=1000.0, description="the last pixel row is measured so much after the first"
    )


class ProcessSettings(Settings):
    """Table 2 of the paper, and what the plan has to keep."""

    standoff_m: Number = _length(0.1, 5.0, 0.7, "nominal distance of the scanner to the surface")
    scan_speed_m_s: Number = Field(0.1, gt=0.0, le=2.0, description="scanner relative to the part")
    transit_speed_m_s: Number = Field(0.1, gt=0.0, le=5.0, description="scanner in the world, between views")
    fps: Number = Field(10.0, gt=0.0, le=1000.0, description="frames captured per second")
    dwell_s: Number = Field(0.3, ge=0.0, le=60.0, description="how long the scanner stands at a viewpoint")
    clearance_m: Number = _length(0.0, 0.5, 0.03, "arm and scanner to part, table and surroundings")
    self_clearance_m: Number = _length(0.0, 0.2, 0.005, "links and scanner to one another")
    budget_s: Number = Field(152.0, gt=0.0, le=1e6, description="time allowed for the whole scan")
    max_height_m: Number = _length(0.05, 5.0, 1.2, "of a part that the cell takes")


class CellSettings(Settings):
    """All that describes a cell; `load_cell` reads it from YAML."""

    name: str = "cell"
    robot: RobotSettings = RobotSettings.model_validate({})
    base: BaseSettings = BaseSettings.model_validate({})
    tool: ToolSettings = ToolSettings.model_validate({})
    turntable: TurntableSettings = TurntableSettings.model_validate({})
    pedestal: PedestalSettings = PedestalSettings.model_validate({})
    obstacles: tuple[ObstacleSettings, ...] = Field((), max_length=200)
    scanner: ScannerSettings = ScannerSettings.model_validate({})
    process: ProcessSettings = ProcessSettings.model_validate({})
    twin: TwinSettings = TwinSettings.model_validate({})
    calibration: CalibrationSettings = CalibrationSettings.model_validate({})
    uncertainty: UncertaintySettings = UncertaintySettings.model_validate({})
    programme: ProgrammeSettings = ProgrammeSettings.model_validate({})

    folder: str = Field("", exclude=True, description="where the YAML lies; model paths are relative to it")

    @model_validator(mode="after")
    def _consistent(self) -> "CellSettings":
        low, high = self.scanner.range_m
        if not 0 < low < high:
            raise ValueError(f"scanner.range_m: {low:g} .. {high:g} is not an increasing range above zero")
        if not low <= self.process.standoff_m <= high:
            raise ValueError(
                f"process.standoff_m: {self.process.standoff_m:g} is outside scanner.range_m"
                f" {low:g} .. {high:g}"
            )
        if self.turntable.range_deg[1] - self.turntable.range_deg[0] < 360 and not self.turntable.endless:
            raise ValueError("turntable.range_deg: less than one turn; a revolution needs 360 deg")
        if not (0 < self.scanner.field_deg[1] <= 120 and 0 < self.scanner.field_deg[0] <= 120):
            raise ValueError("scanner.field_deg: angles between 0 and 120 deg are expected")
        if min(self.scanner.rays) < 8 or max(self.scanner.rays) > 8192:
            raise ValueError("scanner.rays: between 8 and 8192 pixels are expected")
        names = [obstacle.name for obstacle in self.obstacles]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"obstacles: the name {name!r} is there twice")
            if name in OWN_NAMES:
                raise ValueError(f"obstacles: {name!r} is a name of the cell's own: {', '.join(OWN_NAMES)}")
        for key in ("home_deg", "acceleration", "velocity_deg_s"):
            value = getattr(self.robot, key)
            if isinstance(value, tuple) and len(value) != 6:
                raise ValueError(f"robot.{key}: 6 values are expected, not {len(value)}")
        if self.robot.velocity_deg_s is not None and min(self.robot.velocity_deg_s) <= 0:
            raise ValueError("robot.velocity_deg_s: positive values are expected")
        if len(self.robot.joints) != 6:
            joints = self.robot.joints
            more = (
                "; a rail or a positioner is not planned: make it fixed in the URDF"
                if len(joints) > 6
                else ""
            )
            raise ValueError(f"robot.joints: six turning joints are expected, not {len(joints)}{more}")
        if isinstance(self.robot.acceleration, tuple) and min(self.robot.acceleration) <= 0:
            raise ValueError("robot.acceleration: positive values are expected")
        return self

    def scanner_model(self) -> Scanner:
        """The scanner in SI units."""
        s = self.scanner
        plain = Scanner(
            fov=(math.radians(s.field_deg[0]), math.radians(s.field_deg[1])), range=s.range_m,
            max_incidence=math.radians(s.max_incidence_deg), baseline=s.baseline_m, rays=s.rays,
            sigma_at_near=s.sigma_mm * 1e-3, frame_scale=s.frame_scale,
            exposure=s.exposure_ms * 1e-3, rolling=s.rolling_ms * 1e-3,
        )  # fmt: skip
        return plain if s.material == "matt" else plain.before(MATERIALS[s.material])

    def twin_errors(self) -> dict[str, Any]:
        """The twin's errors in SI units, by the names of `scan.captures.ScanErrors`."""
        t = self.twin
        return {
            "range_noise": t.range_noise, "frame_scale": t.frame_scale,
            "pose_m": _metres(t.pose_mm), "pose_rad": math.radians(t.pose_deg),
            "hand_eye_m": tuple(map(_metres, t.hand_eye_mm)),
            "hand_eye_rad": tuple(map(math.radians, t.hand_eye_deg)),
            "axis_m": tuple(map(_metres, t.axis_mm)), "axis_rad": tuple(map(math.radians, t.axis_deg)),
            "backlash_rad": math.radians(t.backlash_deg),
            "latency_s": t.latency_ms / 1000, "jitter_s": t.jitter_ms / 1000,
        }  # fmt: skip


def _metres(millimetres: float) -> float:
    return millimetres / 1000


class _StrictLoader(yaml.SafeLoader):
    """YAML without code, in which no key may stand twice: the last one would silently win."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [k.value for k, _ in node.value if isinstance(k, yaml.ScalarNode)]
        for key in keys:
            if keys.count(key) > 1:
                line = node.start_mark.line + 1
                raise yaml.YAMLError(f"the key {key!r} is there twice in the mapping from line {line} on")
        return super().construct_mapping(node, deep=deep)


def builtin_cells() -> tuple[str, ...]:
    """Names of the cells that come with the package."""
    return tuple(sorted(p.stem for p in (models_dir() / "cells").glob("*.yaml")))


def load_cell(name_or_path: str | Path) -> CellSettings:
    """A built-in cell by name, or a YAML file.

    Raises:
        CellError: unknown name, unreadable file, unknown key, wrong type or unit, with the dotted key.
    """
    text = str(name_or_path)
    if text in builtin_cells():
        path = models_dir() / "cells" / f"{text}.yaml"
    else:
        path = Path(name_or_path)
        if path.suffix not in (".yaml", ".yml"):
            raise CellError(f"unknown robot {text!r}; known: {', '.join(builtin_cells())}, or a YAML file")
        if not path.is_file():
            raise CellError(f"{text}: no such file")
    try:
        if path.stat().st_size > 1 << 20:
            raise CellError(f"{text}: more than 1 MiB is not a cell")
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=_StrictLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        line = " ".join(str(error).split())[:160]
        raise CellError(f"{text}: is not readable YAML ({line})") from None
    if not isinstance(data, dict):
        raise CellError(f"{text}: a mapping of settings is expected")
    return settings_from(data, folder=str(path.resolve().parent))


def settings_from(data: dict[str, Any], *, folder: str = "") -> CellSettings:
    """Settings from a plain mapping, as YAML gives it.

    Raises:
        CellError: as load_cell.
    """
    try:
        return CellSettings.model_validate({**with_scanner_preset(data), "folder": folder})
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"] if not str(part).startswith(("tuple", "literal")))
        raise CellError(_message(first, key, data), key=key) from None


def cell_settings_from(source: Any) -> CellSettings:
    """Settings of a cell, whatever names it: settings, a built-in name, a YAML file, or a mapping as in one.

    Raises:
        CellError: not one of these, or as load_cell.
    """
    if isinstance(source, CellSettings):
        return source
    if isinstance(source, str | Path):
        return load_cell(source)
    if isinstance(source, dict):
        return settings_from(source)
    raise CellError(f"a {type(source).__name__} is no cell; known: settings, a name, a YAML file, a mapping")


def _message(first: Any, key: str, data: dict) -> str:
    kind, context = first["type"], first.get("ctx") or {}
    if kind == "extra_forbidden":
        model: Any = CellSettings
        for part in first["loc"][:-1]:
            field = model.model_fields.get(str(part)) if hasattr(model, "model_fields") else None
            model = field.annotation if field is not None else ObstacleSettings
        known = sorted(set(getattr(model, "model_fields", {})) - {"folder"})
        return f"unknown; known: [{', '.join(known)}]"
    value = first.get("input")
    if kind in ("greater_than_equal", "less_than_equal", "greater_than", "less_than"):
        bound = next(iter(context.values()))
        if value == bound:
            return f"{value!r} itself is not allowed"
        side = "below" if kind.startswith("greater") else "above"
        suffix = key.rstrip(".0123456789").rsplit("_", 1)[-1]
        unit = {"m": "metres", "mm": "millimetres", "deg": "degrees"}.get(suffix)
        hint = f"; is it in {unit}?" if unit else ""
        return f"{value!r} is {side} the {'least' if side == 'below' else 'greatest'} {bound:g} allowed{hint}"
    if kind in ("too_long", "too_short"):
        asked = context.get("max_length" if kind == "too_long" else "min_length")
        hint = "; a decimal comma makes two numbers of one" if kind == "too_long" else ""
        return f"{asked} values are expected, not {context.get('actual_length')}{hint}"
    if kind == "invalid_key":
        return "a key is a word; a decimal comma ends a value: write a point"
    if kind == "string_pattern_mismatch":
        return f"{str(value)[:40]!r}: letters, digits, spaces, '.', '_' and '-' are expected"
    text = first["msg"].removeprefix("Value error, ")
    return " ".join(text.split())


_OBSTACLE = """# Boxes that stand in the cell, and meshes from its CAD (STL, OBJ, PLY, DAE), for instance
# obstacles:
#   - {name: pillar, centre_m: [1.2, 1.4, 1.5], size_m: [0.3, 0.3, 3.0], yaw_deg: 20}
#   - {name: cabinet, mesh: cabinet.stl, unit: mm, position_m: [-1.5, 0.0, 0.0], yaw_deg: 90}"""


def cell_template(name: str = "kr240") -> str:
    """A commented YAML of the built-in cell `name`, every key with its meaning and value."""
    settings = load_cell(name)
    lines = [
        "# A cell of scanmotion. Lengths in metres (_m), angles in degrees (_deg), times in seconds (_s).",
        "",
    ]
    for key in CellSettings.model_fields:
        value = getattr(settings, key)
        if key == "folder":
            continue
        if not isinstance(value, BaseModel):
            plain = [v.model_dump() for v in value] if isinstance(value, tuple) else value
            lines += [_OBSTACLE] if key == "obstacles" else []
            lines += [f"{key}: {_yaml(plain)}", ""]
            continue
        lines += [f"# {' '.join((type(value).__doc__ or '').split())}", f"{key}:"]
        for inner, field in type(value).model_fields.items():
            note = f"  # {field.description}" if field.description else ""
            lines.append(f"  {inner}: {_yaml(getattr(value, inner))}{note}")
        lines.append("")
    return "\n".join(lines)


def _yaml(value: Any) -> str:
    text = yaml.safe_dump(list(value) if isinstance(value, tuple) else value, default_flow_style=True)
    return text.replace("\n...", "").strip()


def pose(xyz: Any, yaw: float = 0.0) -> np.ndarray:
    """A (4, 4) pose at `xyz` [m], turned by `yaw` about z [rad]."""
    X = np.eye(4)
    X[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    X[:3, 3] = xyz
    return X
