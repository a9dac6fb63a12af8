"""What viewpoints cost in this cell: from its table, its dwell and its transit speed."""

import math

from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.view_costs import ViewCosts
from scanmotion.geometry.rest_to_rest import jerk_limited_seconds

_AZIMUTH_RAD = math.radians(15.0)
"""What the table turns to a station beyond the arm's own way there, as plans of sculptures have it [rad]."""
_ARRIVE_S = 1.0
"""A turn begins and ends with the arm at rest: its last ramp down and its first ramp up [s]."""
_RAMPS = 1.2
"""Ways are short, so that their ramps make them a fifth longer than at full speed."""


def view_costs(settings: CellSettings) -> ViewCosts:
    """Seconds of stations, whole turns and ways, from the cell's speeds.

    They are estimates that weigh candidates; the tour's seconds are planned later and are not made of these.
    """
    table = settings.turntable
    v, a = table.speed_rpm * 2 * math.pi / 60, table.acceleration_rad_s2
    j = a / table.jerk_time_s
    return ViewCosts(
        station_s=settings.process.dwell_s + float(jerk_limited_seconds(_AZIMUTH_RAD, v, a, j)),
        revolution_s=_ARRIVE_S + float(jerk_limited_seconds(2 * math.pi, v, a, j)),
        seconds_per_metre=_RAMPS / settings.process.transit_speed_m_s,
    )
