"""The errors of scanmotion: one root, leaves that carry their evidence.

Expected outcomes (a viewpoint that cannot be reached, a plan over its budget) are data with a reason and
never exceptions. What is raised means that the input, or a promise of this package, is broken.
"""


class ScanMotionError(Exception):
    """Root of every error that scanmotion raises on purpose; its text is one clear line."""


class InputError(ScanMotionError):
    """The user's input cannot be used: a file, a number or an option."""


class PartError(InputError):
    """The part or scan cannot be used (missing, broken, empty, not finite, larger than the table).

    Attributes:
        path: what was read, or "" for a part made in memory.
    """

    def __init__(self, message: str, *, path: str = "") -> None:
        super().__init__(f"{path}: {message}" if path else message)
        self.path = path


class CellError(InputError):
    """The cell's settings or robot model cannot be used.

    Attributes:
        key: dotted key of the setting, e.g. "process.standoff_m".
    """

    def __init__(self, message: str, *, key: str = "") -> None:
        super().__init__(f"{key}: {message}" if key else message)
        self.key = key


class HoleError(InputError):
    """Holes cannot be sought in this cloud (too few points, no orientation, all in one plane)."""


class PlanFileError(InputError):
    """A plan folder cannot be read: a file is missing, of another version, or not what it says."""


class PathError(ScanMotionError):
    """No collision-free path was found between two configurations.

    Attributes:
        pair: names of the two bodies that block it.
        depth: by how much they overlap or fall short of the clearance [m].
        stop: index of the stop in the tour that cannot be reached.
    """

    def __init__(
        self, message: str, *, pair: tuple[str, str] = ("", ""), depth: float = 0.0, stop: int = 0
    ) -> None:
        super().__init__(message)
        self.stop = stop
        self.pair = pair
        self.depth = depth


class TimingError(ScanMotionError):
    """A path cannot be time-parameterised inside the limits.

    Attributes:
        joint: name of the joint or "tcp".
        value: what was reached, in the limit's unit.
        limit: what is allowed.
    """

    def __init__(self, message: str, *, joint: str = "", value: float = 0.0, limit: float = 0.0) -> None:
        super().__init__(message)
        self.joint = joint
        self.value = value
        self.limit = limit
