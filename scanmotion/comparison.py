"""The paper's table 3 in our cell: methods, modes and ablations on the same part with the same noise.

Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139), table 3. Both methods that the paper compares
with need the true mesh; the two-step method needs the bounding box and its own scans only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.config import CellSettings
from scanmotion.errors import InputError
from scanmotion.legs import Progress, silent
from scanmotion.part import Part
from scanmotion.pipeline import PlanOptions, plan

PAPER_TABLE_3 = {
    "cad-slicing": (0.8905, 1.86, 2.71, 145.0),
    "surface-partitioning": (0.9708, 0.97, 1.12, 120.0),
    "two-step": (1.0, 0.26, 0.31, 152.0),
}
"""Integrity, accuracy [mm], standard deviation [mm], time [s] as printed in the paper, on its own object."""

VARIANTS: dict[str, dict] = {
    "two-step": {},
    "two-step, paper mode": {"mode": "paper"},
    "cad-slicing": {"strategy": "cad-slicing"},
    "surface-partitioning": {"strategy": "surface-partitioning"},
    "without occlusion": {"occlusion_aware": False},
    "without feedback from reach": {"reach_feedback": False},
    "turntable as fallback": {"turntable": "fallback"},
}
"""What each row changes in the options."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One variant over all seeds: mean and half the spread (largest minus smallest) of each figure."""

    variant: str
    integrity: tuple[float, float]
    """Share of what can be seen."""
    mean_abs_mm: tuple[float, float]
    sd_signed_mm: tuple[float, float]
    time_s: tuple[float, float]
    viewpoints: tuple[float, float]
    unreachable: tuple[float, float]
    paper: tuple[float, float, float, float] | None
    """The paper's own figures for this method, on its own object."""


def compare(
    part: Part,
    settings: CellSettings,
    *,
    variants: Sequence[str] = tuple(VARIANTS),
    seeds: Sequence[int] = (0, 1, 2),
    options: PlanOptions | None = None,
    progress: Progress = silent,
) -> tuple[Row, ...]:
    """Plans and simulates every variant with every seed.

    Args:
        part: a mesh.
        settings: the cell.
        variants: names from VARIANTS.
        seeds: each seeds the search, the surface samples and the scanner's noise.
        options: what all variants share.
        progress: told the variant and the share of all plans done.

    Raises:
        InputError: an unknown variant, or no seed.
    """
    unknown = [name for name in variants if name not in VARIANTS]
    if unknown:
        raise InputError(f"unknown variant {unknown[0]!r}; known: {', '.join(VARIANTS)}")
    if not seeds:
        raise InputError("compare needs at least one seed")
    base, rows, total = options or PlanOptions(), [], len(variants) * len(seeds)
    for name in variants:
        figures = []
        for seed in seeds:
            progress(name, (len(rows) * len(seeds) + len(figures)) / total)
            figures.append(_figures(part, settings, replace(base, seed=seed, **VARIANTS[name])))
        rows.append(_row(name, np.array(figures)))
    progress("compare", 1.0)
    return tuple(rows)


def _figures(part: Part, settings: CellSettings, options: PlanOptions) -> tuple[float, ...]:
    result = plan(part, settings, options=options)
    accuracy = result.accuracy()
    final = result.completeness()["final"]
    served = sum(len(item.leg.served) for item in result.rounds)
    return (
        final if final is not None else np.nan,
        accuracy.mean_abs * 1e3 if accuracy else np.nan,
        accuracy.sd_signed * 1e3 if accuracy else np.nan,
        result.time_s()["total"],
        served,
        len(result.unreachable),
    )


def _row(name: str, figures: np.ndarray) -> Row:
    spread = (figures.max(axis=0) - figures.min(axis=0)) / 2
    pairs = [(float(m), float(s)) for m, s in zip(figures.mean(axis=0), spread, strict=True)]
    method = VARIANTS[name].get("strategy", "two-step")
    return Row(
        variant=name, integrity=pairs[0], mean_abs_mm=pairs[1], sd_signed_mm=pairs[2],
        time_s=pairs[3], viewpoints=pairs[4], unreachable=pairs[5],
        paper=PAPER_TABLE_3[method] if name in PAPER_TABLE_3 or name.endswith("paper mode") else None,
    )  # fmt: skip
