"""What arm, table and scanner get wrong, as settings: what the twin simulates, what calibration found."""

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def _number(value: Any) -> Any:
    """Refuses what YAML lets through as a number's stand-in: true, "0.7 m", nan."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        comma = isinstance(value, str) and value.replace(",", "", 1).lstrip("+-").isdigit()
        hint = "; write a decimal point, not a comma" if comma else ""
        raise ValueError(f"a number is expected, not {str(value)[:40]!r}{hint}")
    if not math.isfinite(value):
        raise ValueError(f"{value} is not finite")
    return float(value)


Number = Annotated[float, BeforeValidator(_number)]
Offset = Annotated[Number, Field(ge=-5.0, le=5.0)]
"""Error of a place [mm]."""
Turn = Annotated[Number, Field(ge=-2.0, le=2.0)]
"""Error of an orientation [deg]."""
Side = Annotated[Number, Field(gt=0.0, le=100.0)]
"""Side of a box [m]."""


class Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class TwinSettings(Settings):
    """What the simulated arm, table and scanner get wrong; the constant errors are zero where not stated."""

    pose_mm: Number = Field(0.02, ge=0.0, le=5.0, description="arm: position of a frame, sd per axis")
    pose_deg: Number = Field(0.003, ge=0.0, le=2.0, description="arm: orientation of a frame, sd per axis")
    range_noise: Number = Field(1.0, ge=0.0, le=100.0, description="factor on scanner.sigma_mm; 0 is none")
    frame_scale: Number = Field(1.0, ge=0.0, le=100.0, description="factor on scanner.frame_scale; 0 is none")
    hand_eye_mm: tuple[Offset, Offset, Offset] = Field(
        (0.0, 0.0, 0.0),
        description="constant: true scanner off the nominal one, along its x, y, z",
    )
    hand_eye_deg: tuple[Turn, Turn, Turn] = Field(
        (0.0, 0.0, 0.0), description="constant: rotation vector of the true scanner against the nominal one"
    )
    axis_mm: tuple[Offset, Offset] = Field(
        (0.0, 0.0), description="constant: true axis of the table off the nominal one, along x and y"
    )
    axis_deg: tuple[Turn, Turn] = Field(
        (0.0, 0.0), description="constant: tilt of the table's true axis about x and y"
    )
    backlash_deg: Number = Field(
        0.0, ge=0.0, le=2.0, description="play of the table: it lags by half of this behind its motion"
    )
    latency_ms: Number = Field(
        0.0, ge=-100.0, le=100.0, description="constant: a frame is taken so much after its pose"
    )
    jitter_ms: Number = Field(0.0, ge=0.0, le=100.0, description="standard deviation of that, frame by frame")


class UncertaintySettings(Settings):
    """What is not known when a plan is made: standard deviations, from which predictions get their
    intervals.
    """

    hand_eye_mm: Number = Field(
        0.05, ge=0.0, le=5.0, description="place of the scanner on the flange, per axis"
    )
    hand_eye_deg: Number = Field(0.005, ge=0.0, le=2.0, description="its orientation, per axis")
    axis_mm: Number = Field(0.05, ge=0.0, le=5.0, description="place of the table's axis, per axis")
    axis_deg: Number = Field(0.003, ge=0.0, le=2.0, description="its tilt, per axis")
    backlash_deg: Number = Field(0.003, ge=0.0, le=2.0, description="play of the table")
    latency_ms: Number = Field(0.5, ge=0.0, le=100.0, description="time from pose to frame")
    place_mm: Number = Field(
        1.0, ge=0.0, le=100.0, description="where the part is put on the table, per axis"
    )
    place_deg: Number = Field(0.5, ge=0.0, le=45.0, description="its turn on the table")

    def si(self) -> dict[str, float]:
        """In m, rad and s, by the names of `planning.worth.confidence.Uncertainty`."""
        units = {"mm": ("m", 1e-3), "deg": ("rad", math.pi / 180), "ms": ("s", 1e-3)}
        told = {}
        for key, value in self.model_dump().items():
            name, unit = key.rsplit("_", 1)
            told[f"{name}_{units[unit][0]}"] = value * units[unit][1]
        return told


class CalibrationSettings(Settings):
    """What calibration has found: constants that plan and measured frames are corrected by."""

    hand_eye_mm: tuple[Offset, Offset, Offset] = Field(
        (0.0, 0.0, 0.0), description="scanner off the place that `tool` gives, along its x, y, z"
    )
    hand_eye_deg: tuple[Turn, Turn, Turn] = Field(
        (0.0, 0.0, 0.0), description="rotation vector of the scanner against the one that `tool` gives"
    )
    axis_mm: tuple[Offset, Offset] = Field(
        (0.0, 0.0), description="axis of the table off the place that `turntable` gives, along x and y"
    )
    axis_deg: tuple[Turn, Turn] = Field((0.0, 0.0), description="tilt of the table's axis about x and y")
    backlash_deg: Number = Field(
        0.0, ge=-2.0, le=2.0, description="known play of the table; frames are corrected for it"
    )
    latency_ms: Number = Field(
        0.0, ge=-100.0, le=100.0, description="known time from pose to frame; frames are corrected for it"
    )
