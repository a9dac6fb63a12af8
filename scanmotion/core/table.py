"""The turntable as the geometry sees it, in the object frame O."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TableGeometry:
    """Where the table's top is, and where a scanner of this cell can stand about it; `table_of` makes one."""

    radius: float
    """Of the table's disc [m]."""
    z: float = 0.0
    """Height of its top in O, below zero where a pedestal lifts the part [m]."""
    pedestal_radius: float = 0.0
    """Of the pedestal between table and part [m]; 0 for none."""
    eye_above: float = 0.08
    """Least height of the optical centre over the table's top, above the disc [m]."""
    eye_beside: float = 0.015
    """The same beside the disc, where the housing may reach below the top [m]."""
    rim_near: float = 0.1
    """Beside means at least so far outside the rim [m]."""
    rim_far: float = 0.17
    """So far outside the rim the housing clears the disc whichever way it is turned [m]."""
