"""Finding: one broken promise of a plan."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is wrong, where, by how much."""

    code: str
    """One of limits, position, velocity, acceleration, jerk, tcp_speed, rest, order, viewpoint, collision,
    clearance, budget, sampling, summary, frames; of a programme also path, time.
    """
    message: str
    where: str = ""
    """Joint, pair of bodies, operation or viewpoint."""
    value: float = 0.0
    limit: float = 0.0
    t: float | None = None
    """When [s]."""

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"
