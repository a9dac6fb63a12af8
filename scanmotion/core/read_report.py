"""What was read from a file: it travels with every part and cloud that came from one."""

from dataclasses import asdict, dataclass
from typing import Any


def counted(n: int, word: str) -> str:
    """A number with its word: "1 speck", "3 specks"."""
    return f"{n} {word}" if n == 1 else f"{n} {word}s"


@dataclass(frozen=True, kw_only=True)
class ReadReport:
    """What a file held, what was taken for what, and what was changed before use."""

    file: str
    """Its name, without its folder."""
    format: str
    """Kind of file in words, e.g. "PLY, ASCII"."""
    points: int
    """Vertices or points that are used."""
    triangles: int
    """Triangles that are used; 0 for a cloud."""
    size_mm: tuple[float, float, float]
    """Sides of its box along x, y, z of the object frame [mm]."""
    units: str
    """Unit that its coordinates were taken to be in."""
    units_from: str
    """How that is known: "given", "stated by ..", "assumed", "guessed from its size"."""
    columns: tuple[str, ...] = ()
    """What was taken for what, one phrase each."""
    bodies: int = 1
    """Separate surfaces that are used."""
    specks: int = 0
    """Small pieces far off that were left out."""
    closed: bool = False
    """Whether the mesh is watertight."""
    welded: int = 0
    """Vertices merged into another."""
    turned: int = 0
    """Triangles or normals turned round."""
    dropped: int = 0
    """Triangles and points left out."""
    split: int = 0
    """Vertices doubled where surfaces met in an edge or a corner."""
    changes: tuple[str, ...] = ()
    """All that was changed or left out, one sentence each."""
    warnings: tuple[str, ...] = ()
    """What may be wrong with it still, one sentence each."""

    @property
    def line(self) -> str:
        """One line of what matters: what it is, its size, its unit, and what was done to it."""
        size = " x ".join(f"{side:.4g}" for side in self.size_mm)
        what = f"{self.triangles} triangles" if self.triangles else f"{self.points} points"
        parts = [f"{self.format}: {what}, {size} mm, unit {self.units} ({self.units_from})"]
        if self.bodies > 1:
            parts.append(f"{self.bodies} bodies")
        return "; ".join(
            [*parts, *(c for c in self.columns if "by the header" not in c), *self.changes, *self.warnings]
        )

    def record(self) -> dict[str, Any]:
        """As a document for JSON."""
        told: dict[str, Any] = asdict(self)
        lists = ("size_mm", "columns", "changes", "warnings")
        return {k: list(v) if k in lists else v for k, v in told.items()}
