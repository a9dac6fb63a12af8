"""The table's geometry for the stages that know no cell: where it is, and where a scanner's eye can stand."""

from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.table import TableGeometry

_ABOVE_M = 0.001
"""A housing lying on its side stays this far above the table's top [m]."""
_BESIDE_M = 0.015
"""Beside the disc the eye may be this near to the level of the top: the housing is then tilted up [m]."""
_NEAR_M, _FAR_M = 0.021, 0.009
"""Room beside the housing for what a pose gives way in, for a tilted and for any housing [m]."""


def table_of(settings: CellSettings) -> TableGeometry:
    """Table, pedestal and the room that the scanner's housing needs, from the cell's settings.

    The optical centre is in the middle of the housing's front, so that half of the housing's sides, and the
    cell's clearance, keep it away from the disc.
    """
    long, short = sorted(settings.tool.scanner_size_m[:2], reverse=True)
    return TableGeometry(
        radius=settings.turntable.diameter_m / 2,
        z=-settings.pedestal.height_m,
        pedestal_radius=settings.pedestal.diameter_m / 2,
        eye_above=short / 2 + _ABOVE_M,
        eye_beside=_BESIDE_M,
        rim_near=short / 2 + _NEAR_M,
        rim_far=long / 2 + settings.process.clearance_m + _FAR_M,
    )
