"""What viewpoints cost in seconds, before a motion is planned."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class ViewCosts:
    """For weighing viewpoints against each other; `view_costs` of the cell makes one."""

    station_s: float
    """A station, beside the way there [s]."""
    revolution_s: float
    """A whole turn of the table, beside the way there [s]."""
    seconds_per_metre: float
    """The scanner's way between viewpoints, with its ramps [s/m]."""
    first_way: float = 0.3
    """Way to a viewpoint that is chosen first, and the most that is counted for a later one [m]."""
    usual_way: float = 0.1
    """Way that is counted for a viewpoint in a finished choice [m]."""

    def own_seconds(self, turns: np.ndarray) -> np.ndarray:
        """Time at viewpoints that are whole turns or not, shape (n,) [s]."""
        return np.where(turns, self.revolution_s, self.station_s)
