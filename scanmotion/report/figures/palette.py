"""One meaning, one colour, in pictures, charts and the scene; colour-blind readers can tell them apart."""

SEEN_GLOBAL, SEEN_LOCAL, MISSED, HIDDEN = range(4)
"""What became of a piece of surface."""

STATUS_NAMES = ("seen in the global step", "seen in a local round", "can be seen, was not", "cannot be seen")
NOT_YET = "#d9d9d6"
STATUS_COLOURS = ("#4c8bc4", "#f2a33a", "#c8102e", "#8a8a8a")

OPERATION_COLOURS = {
    "transit": "#8a8a8a", "revolution": "#4c8bc4", "sweep": "#f2a33a", "dwell": "#2e9e6b", "helix": "#7b3fa0",
    "path": "#b5446e",
}  # fmt: skip
TIME_COLOURS = {"arm": "#8a8a8a", "table": "#4c8bc4", "sweep": "#f2a33a", "dwell": "#2e9e6b"}
HOLE_COLOURS = {"common": "#c8102e", "interstitial": "#7b3fa0", "edge": "#e07b00", "island": "#00857c"}
CAUSE_COLOURS = {
    "served": "#2e9e6b",
    "out_of_reach": "#c8102e",
    "joint_limit": "#e07b00",
    "collision": "#7b3fa0",
    "singular": "#0b5fa5",
    "other": "#444444",
}
JOINT_COLOURS = ("#1b6ca8", "#d1495b", "#edae49", "#66a182", "#7b3fa0", "#2e4057", "#8a8a8a")


def rgb(colour: str) -> tuple[float, float, float]:
    """#rrggbb as three shares of 1."""
    return (int(colour[1:3], 16) / 255, int(colour[3:5], 16) / 255, int(colour[5:7], 16) / 255)
