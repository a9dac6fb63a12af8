"""Motion planning for robot arms that scan objects on a turntable."""

__version__ = "0.1.0"
