"""Viewpoint: where the scanner should stand, in the object frame, and what it may give way in."""

from dataclasses import dataclass, field, replace
from html import escape
from typing import Any, Literal

import numpy as np

from scanmotion.core.support.dataframe import dataframe

Step = Literal["global", "local"]
Kind = Literal["revolution", "station"]


@dataclass(frozen=True, kw_only=True)
class Slack:
    """How far a viewpoint may be moved without losing its purpose; zero everywhere means exact."""

    standoff: tuple[float, float] = (0.0, 0.0)
    """Change of the distance along the optical axis, least and greatest [m]."""
    tilt: float = 0.0
    """Greatest angle of the optical axis about the aimed surface point [rad]."""
    roll: bool = True
    """Whether the scanner may turn freely about its optical axis."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Viewpoint:
    """One pose of the scanner relative to the object.

    For a revolution the table makes one full turn while the arm stands still: X_OS is then the pose at table
    angle zero and only its height, radius and inclination matter, its azimuth about z is free.
    Stations that share a `sweep` are passed in the order of their ids, or in the reverse order, in one
    straight line of the scanner relative to the part.
    """

    id: str
    """"G0", "G1".. for the global step, "L1.1", "L1.2".. for the local one; unique in a plan."""
    X_OS: np.ndarray
    """Pose of S in O, shape (4, 4)."""
    standoff: float
    """Distance along +z of S to the aimed surface, as far as that is known when the viewpoint is chosen; of a
    turn the median over those of its angles at which it is inside the scanner's range [m]."""
    step: Step
    kind: Kind
    sweep: str = ""
    """Name of the sweep, shared by its viewpoints; "" for none."""
    slack: Slack = field(default_factory=Slack)
    note: str = ""
    """What it is for, in words."""

    def __post_init__(self) -> None:
        X = np.array(self.X_OS, dtype=float)
        if X.shape != (4, 4) or not np.isfinite(X).all():
            raise ValueError(f"viewpoint {self.id}: X_OS must be a finite (4, 4) matrix")
        X.setflags(write=False)
        object.__setattr__(self, "X_OS", X)

    def __repr__(self) -> str:
        x, y, z = (f"{v * 1e3:.0f}" for v in self.p_OS)
        return f"Viewpoint({self.id!r}, {self.kind}, at ({x}, {y}, {z}) mm, {self.standoff * 1e3:.0f} mm off)"

    @property
    def p_OS(self) -> np.ndarray:
        """Position of the optical centre in O, shape (3,) [m]."""
        return self.X_OS[:3, 3]

    @property
    def direction(self) -> np.ndarray:
        """Viewing direction (+z of S) in O, shape (3,)."""
        return self.X_OS[:3, 2]

    def moved(self, X_OS: np.ndarray) -> "Viewpoint":
        """The same viewpoint at another pose.

        Args:
            X_OS: of the scanner in the object, shape (4, 4) [m].
        """
        return replace(self, X_OS=X_OS)


class Viewpoints(tuple[Viewpoint, ...]):
    """Viewpoints in an order: a tuple with arrays and a table of all of them."""

    __slots__ = ()

    @property
    def X_OS(self) -> np.ndarray:
        """Poses of S in O, shape (n, 4, 4)."""
        return np.array([v.X_OS for v in self]).reshape(-1, 4, 4)

    def columns(self) -> dict[str, list[str] | np.ndarray]:
        """What a table of them holds, by column: positions and standoff [m], direction as a unit vector."""
        X = self.X_OS
        text = {
            name: [str(getattr(v, name)) for v in self] for name in ("id", "step", "kind", "sweep", "note")
        }
        where = dict(zip(("x_m", "y_m", "z_m"), X[:, :3, 3].T, strict=True))
        aims = dict(zip(("dx", "dy", "dz"), X[:, :3, 2].T, strict=True))
        note = text.pop("note")
        return {**text, **where, **aims, "standoff_m": np.array([v.standoff for v in self]), "note": note}

    def to_dataframe(self) -> Any:
        """The same as a pandas DataFrame, a row a viewpoint.

        Raises:
            InputError: pandas is not installed.
        """
        return dataframe(self.columns())

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        rows = "".join(
            f"<tr><td>{escape(v.id)}</td><td>{v.step}</td><td>{v.kind}</td>"
            f"<td>{', '.join(f'{1e3 * x:.0f}' for x in v.p_OS)}</td><td>{1e3 * v.standoff:.0f}</td></tr>"
            for v in self
        )
        head = "".join(f"<th>{h}</th>" for h in ("viewpoint", "step", "kind", "at [mm]", "standoff [mm]"))
        return f"<table><tr>{head}</tr>{rows}</table>"


def look_at(p_OS: np.ndarray, direction: np.ndarray, *, roll: float = 0.0) -> np.ndarray:
    """Pose X_OS at `p_OS` that looks along `direction`; at roll 0, +x of S (the long side) is horizontal.

    Args:
        p_OS: position, shape (3,) [m].
        direction: viewing direction in O, shape (3,) [-], of any positive length.
        roll: turn about the optical axis [rad].
    """
    z = np.asarray(direction, dtype=float)
    z = z / np.linalg.norm(z)
    x = np.cross(z, (0.0, 0.0, 1.0))
    if np.linalg.norm(x) < 1e-9:
        x = np.array([0.0, 1.0, 0.0])
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    X_OS = np.eye(4)
    X_OS[:3, :3] = np.column_stack([c * x + s * y, -s * x + c * y, z])
    X_OS[:3, 3] = p_OS
    return X_OS
