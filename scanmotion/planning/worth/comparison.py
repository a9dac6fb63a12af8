"""The paper's table 3 in our cell: methods, modes and ablations on the same part with the same noise.

Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139), table 3. Both methods that the paper
compares with need the true mesh; the two-step method needs the bounding box and its own scans only.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import cast

import numpy as np

from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.planning.segment import Progress, silent

PAPER_TABLE_3 = {
    "cad-slicing": (0.8905, 1.86, 2.71, 145.0),
    "surface-partitioning": (0.9708, 0.97, 1.12, 120.0),
    "two-step": (1.0, 0.26, 0.31, 152.0),
}
"""Integrity, accuracy [mm], standard deviation [mm], time [s] as printed in the paper, on its own object."""

VARIANTS: dict[str, dict[str, str | bool]] = {
    "two-step": {},
    "as-found": {"tidy": False},
    "thorough": {"thorough": True},
    "paper-mode": {"mode": "paper"},
    "cad-slicing": {"strategy": "cad-slicing"},
    "surface-partitioning": {"strategy": "surface-partitioning"},
    "without-occlusion": {"occlusion_aware": False},
    "without-feedback": {"reach_feedback": False},
    "turntable-fallback": {"turntable": "fallback"},
}
"""What each row changes in the options, and nothing else: cell, samples and noise are the same."""

MEANINGS = {
    "two-step": "the default: four turns, local viewpoints chosen on a closed model, the dear ones left out",
    "as-found": "the default without the twin's last word: from the bounding box and its own scans alone",
    "thorough": "the default, filling the budget of seconds",
    "paper-mode": "the published formulas literally: its turns, its four cases, order by distance",
    "cad-slicing": "passes round slices of the true mesh",
    "surface-partitioning": "one view for each nearly flat patch of the true mesh",
    "without-occlusion": "local viewpoints on a grid over each hole, whatever hides it",
    "without-feedback": "local viewpoints are chosen before reach is asked for",
    "turntable-fallback": "the table turns for local viewpoints only where the arm alone cannot",
}
"""Each row in words."""

HEADER = (
    "variant", "after the global step", "integrity", "mean mm", "sd mm", "time s", "time / floor", "views",
    "left out", "paper: integrity, mm, sd mm, s",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What one plan of one variant with one seed achieves."""

    variant: str
    seed: int
    after_global: float
    """Share of what can be seen, seen by the global step; for the one-step methods by the whole."""
    integrity: float
    """Share of what can be seen, seen by the whole plan."""
    of_reach: float
    """Share of what this robot's scanner can be brought to see, seen by the whole plan."""
    mean_abs_mm: float
    sd_signed_mm: float
    time_s: float
    """Robot time."""
    global_s: float
    """Robot time until the global step is done."""
    floor_s: float
    """Lower bound on the time to visit the same viewpoints."""
    viewpoints: int
    """Served."""
    unreachable: int
    """Left out, those of the method that the cell leaves no room for included."""
    planning_s: float
    """On this machine."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One variant over all seeds: mean and half the spread (largest minus smallest) of each figure."""

    variant: str
    after_global: tuple[float, float]
    integrity: tuple[float, float]
    """Share of what can be seen."""
    of_reach: tuple[float, float]
    """Share of what this robot's scanner can be brought to see."""
    mean_abs_mm: tuple[float, float]
    sd_signed_mm: tuple[float, float]
    time_s: tuple[float, float]
    global_s: tuple[float, float]
    floor_s: tuple[float, float]
    viewpoints: tuple[float, float]
    unreachable: tuple[float, float]
    planning_s: tuple[float, float]
    seeds: tuple[int, ...]
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
    check_variants(variants)
    if not seeds:
        raise InputError("compare needs at least one seed")
    rows: list[Row] = []
    total = len(variants) * len(seeds)
    for name in variants:
        found: list[Figures] = []
        for seed in seeds:
            progress(name, (len(rows) * len(seeds) + len(found)) / total)
            found.append(figures(part, settings, name, seed=seed, options=options))
        rows.append(row_from(found))
    progress("compare", 1.0)
    return tuple(rows)


def check_variants(variants: Sequence[str]) -> None:
    """Refuses rows that the table does not have, or none at all.

    Raises:
        InputError: with the known ones.
    """
    unknown = [name for name in variants if name not in VARIANTS]
    if unknown:
        raise InputError(f"unknown variant {unknown[0]!r}; known: {', '.join(VARIANTS)}")
    if not variants:
        raise InputError(f"compare needs at least one variant; known: {', '.join(VARIANTS)}")


def figures(
    part: Part, settings: CellSettings, variant: str, *, seed: int, options: PlanOptions | None = None
) -> Figures:
    """Plans and simulates one variant with one seed; arguments as for `compare`."""
    told = replace(options or PlanOptions(), seed=seed, **VARIANTS[variant])
    result = plan(part, settings, options=told)
    accuracy, share, time_s = result.accuracy(), result.completeness(), result.time_s()
    parts = [item.trajectory for item in result.segments if item.step == "global"]
    first, final, reach = share["after_global"], share["final"], result.within_reach()
    return Figures(
        variant=variant, seed=seed,
        after_global=np.nan if first is None else float(first),
        integrity=np.nan if final is None else float(final),
        of_reach=np.nan if reach["scanned"] is None else float(reach["scanned"]),
        mean_abs_mm=accuracy.mean_abs * 1e3 if accuracy else np.nan,
        sd_signed_mm=accuracy.sd_signed * 1e3 if accuracy else np.nan,
        time_s=float(time_s["total"]),
        global_s=float(sum(t.duration for t in parts if t is not None)),
        floor_s=float(time_s["floor"]),
        viewpoints=sum(len(item.served) for item in result.segments),
        unreachable=len(result.unreachable),
        planning_s=float(result.planning_s["total"]),
    )  # fmt: skip


def row_from(found: Sequence[Figures]) -> Row:
    """The row of one variant: mean and half spread over its seeds.

    Raises:
        InputError: nothing to average, or figures of several variants.
    """
    names = {f.variant for f in found}
    if len(names) != 1:
        raise InputError(f"a row is of one variant, got {len(names)}")
    name = names.pop()
    pairs: dict[str, tuple[float, float]] = {}
    for field in fields(Figures):
        if field.name not in ("variant", "seed"):
            values = np.array([getattr(f, field.name) for f in found], float)
            pairs[field.name] = (float(values.mean()), float(np.ptp(values)) / 2)
    method = str(VARIANTS[name].get("strategy", "two-step"))
    theirs = PAPER_TABLE_3[method] if name in PAPER_TABLE_3 or name == "paper-mode" else None
    return Row(variant=name, seeds=tuple(f.seed for f in found), paper=theirs, **pairs)


def cells(row: Row) -> tuple[str, ...]:
    """A row as text, in the order of HEADER: mean and half spread; beside it what the paper printed."""

    def pair(value: tuple[float, float], form: str) -> str:
        mean, spread = value
        if not np.isfinite(mean):
            return "not known"
        return f"{mean:{form}}" + (f" +- {spread:{form}}" if spread > 0 else "")

    paper = "" if row.paper is None else "{:.2%}, {:.2f}, {:.2f}, {:.0f}".format(*row.paper)
    ratio = f"{row.time_s[0] / row.floor_s[0]:.2f}" if row.floor_s[0] > 0 else "not known"
    return (
        row.variant, pair(row.after_global, ".2%"), pair(row.integrity, ".2%"), pair(row.mean_abs_mm, ".3f"),
        pair(row.sd_signed_mm, ".3f"), pair(row.time_s, ".1f"), ratio, pair(row.viewpoints, ".0f"),
        pair(row.unreachable, ".0f"), paper,
    )  # fmt: skip


def markdown(rows: Sequence[Row]) -> str:
    """The table in Markdown."""
    lines = [HEADER, ("---",) * len(HEADER), *(cells(row) for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def document(part: str, rows: Sequence[Row]) -> dict[str, object]:
    """The table for machines; a figure that is not known is null."""

    def known(value: object) -> object:
        if isinstance(value, tuple):
            return [known(v) for v in cast(tuple[object, ...], value)]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {
        "part": part,
        "rows": [{k: known(v) for k, v in asdict(row).items()} for row in rows],
    }
