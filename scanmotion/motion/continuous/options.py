"""How hard a continuous motion is sought, and what a second is worth."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ContinuousOptions:
    """How hard to search; every number counts work, none counts seconds of the planner."""

    price: float = 25_000.0
    """Seconds that the whole surface is worth: a second is spent for 0.004 % of it."""
    twice: float = 0.3
    """Share of a place's worth that is paid only where two frames from different sides see it."""
    places: int = 40_000
    """Places drawn on the surface."""
    hard: int = 4_500
    """Of these, the ones that are looked at in the search: those that fewest poses see."""
    easy: int = 1_500
    """And so many of the rest, each for several."""
    evaluations: int = 20_000
    """Motions that are looked at."""
    again: int = 3_000
    """Motions that are looked at again, each time the realisation shows other times or blocked ways."""
    rounds: int = 6
    """Most realisations."""
    azimuths_deg: tuple[float, ...] = (0.0, -25.0, 25.0, -50.0, 50.0)
    """Azimuths about the robot's side of the table at which nodes are sought [deg]."""
