"""What a controller's programme needs to know of the cell: numbers of frames, signals, time-outs, load."""

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator


def _number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"a finite number is expected, not {str(value)[:40]!r}")
    return float(value)


Number = Annotated[float, BeforeValidator(_number)]
Signal = Annotated[int, Field(strict=True, ge=0, le=8192)]
"""Number of a digital input or output; 0 is none."""


class ProgrammeSettings(BaseModel):
    """Exported programmes: frames by number, the load, and the signals between controller and scanner."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    tool_number: int = Field(1, ge=1, le=128, strict=True, description="TOOL_DATA, LOAD_DATA of a KUKA")
    base_number: int = Field(
        1, ge=1, le=128, strict=True, description="BASE_DATA of a KUKA: the robot's base"
    )
    centre_of_mass_m: tuple[Number, Number, Number] | None = Field(
        None, description="of fixture and scanner, on the flange; null is half-way to the scanner"
    )
    ready_in: Signal = Field(33, description="input: the scanner is ready; 0 is not waited for")
    done_in: Signal = Field(
        34, description="input: the scanner has stored what it recorded; 0 is not waited for"
    )
    fault_in: Signal = Field(35, description="input: the scanner has a fault; 0 is none")
    start_out: Signal = Field(33, description="output: record, as long as it is on; 0 is none")
    frame_out: Signal = Field(34, description="output: a pulse for each frame; 0 is none")
    frame_in: Signal = Field(0, description="input: a frame was taken; its joints are logged; 0 is none")
    step_out: Signal = Field(
        41, description="first output of the word that tells the step's number; 0 is none"
    )
    step_bits: int = Field(10, ge=1, le=16, strict=True, description="width of that word")
    table_ready_in: Signal = Field(36, description="input: a table with a programme of its own is ready")
    table_fault_in: Signal = Field(37, description="input: that drive has a fault; the arm stops")
    table_start_out: Signal = Field(35, description="output: that drive starts its next step")
    ready_timeout_s: Number = Field(10.0, gt=0.0, le=600.0, description="the scanner has to be ready within")
    done_timeout_s: Number = Field(10.0, gt=0.0, le=600.0, description="the scanner has to be done within")
    start_tolerance_deg: Number = Field(
        0.5, gt=0.0, le=5.0, description="how far a joint may be from the start when the programme begins"
    )
    kuka_speed_deg_s: tuple[Number, ...] | None = Field(
        None, description="A1..A6, E1 at 100 % by the machine data; null is the URDF's and the plan's"
    )

    @model_validator(mode="after")
    def _distinct(self) -> "ProgrammeSettings":
        word = set(range(self.step_out, self.step_out + self.step_bits)) if self.step_out else set()
        for names in (("ready_in", "done_in", "fault_in", "frame_in", "table_ready_in", "table_fault_in"),
                      ("start_out", "frame_out", "table_start_out")):  # fmt: skip
            used = [n for n in (getattr(self, name) for name in names) if n]
            if len(set(used)) < len(used):
                raise ValueError(f"{', '.join(names)}: two signals have the same number")
            if names[0] == "start_out" and word & set(used):
                raise ValueError(f"step_out: the word covers {sorted(word & set(used))}, which are used")
        if self.kuka_speed_deg_s is not None and (
            len(self.kuka_speed_deg_s) != 7 or min(self.kuka_speed_deg_s) <= 0
        ):
            raise ValueError("kuka_speed_deg_s: seven positive values are expected")
        return self
