"""Writes docs/cell.md from the settings' own fields: python docs/cell_reference.py"""

from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from scanmotion.cell.settings.cell import CellSettings, ObstacleSettings, settings_from
from scanmotion.cell.settings.scanner_presets import scanner_presets
from scanmotion.geometry.parts.make_part import models_dir

HEAD = """# The cell's YAML

This page is written by `docs/cell_reference.py` from the code that reads the file; do not edit it.

`scanmotion cell init my-cell.yaml` writes a commented file to start from.
`scanmotion cell check my-cell.yaml` names the first thing that is wrong with it: a key, a value, a robot that
touches something at rest, an obstacle in which the table would turn.
A key that is left out has its default. Every key ends in its unit. An unknown key, a key that stands twice, a
number with its unit in the text, a NaN or a value out of its range is refused with the dotted key.

A file holds only what differs from the built-in cell:

```yaml
name: workshop
turntable: {position_m: [2.0, 0.3], diameter_m: 1.2, endless: true}
obstacles:
  - {name: pillar, centre_m: [1.2, 1.4, 1.5], size_m: [0.3, 0.3, 3.0], yaw_deg: 20}
  - {name: cabinet, centre_m: [-1.5, 0.0, 1.0], size_m: [0.5, 2.0, 2.0]}
process: {clearance_m: 0.05, budget_s: 120}
```

Fixture, scanner housing and obstacles may be meshes of the cell's CAD, each with its unit:

```yaml
tool: {housing_mesh: scanner.stl, fixture_mesh: v-fixture.stl, mesh_unit: mm}
obstacles:
  - {name: cabinet, mesh: cabinet.stl, unit: mm, position_m: [-1.5, 0.0, 0.0], yaw_deg: 90}
```

Planner and Drake keep clear of convex pieces that hold each separate body of the file; the judge looks at its
triangles, which stand in the plan's folder. What is closed round a hollow in one piece, such as a fence of
one body round the cell, counts as filled: give it panel by panel, or as separate bodies.

## Choosing a scanner

The default is the paper's scanner (0.4 to 1 m). Another one is named:

```yaml
scanner: {model: photoneo-phoxi-l}
turntable: {position_m: [3.0, 0.0]}
```

| preset | range m | field deg | housing mm | for |
|---|---|---|---|---|
PRESETS

A preset gives the whole section `scanner`, the housing and its mount (`tool`), and standoff, frame rate and
dwell (`process`). What the cell states of `tool` and `process` goes first. A key of `scanner` that says
otherwise than the preset is refused. A turn sees the part from the least distance plus the part's radius: a
short range leaves more to local viewpoints, which take longer; a long one needs room, the table's axis at
least the standoff and 1.5 m from the robot. Each file in `models/scanners` says which value is from the
maker and which is not. A scanner of your own is the section `scanner` with your values, and
`tool.scanner_size_m` and `process.standoff_m` with them.
"""


def preset_rows() -> str:
    """One table row for each scanner preset."""
    rows = []
    for name in scanner_presets():
        cell = settings_from({"scanner": {"model": name}})
        near, far = cell.scanner.range_m
        field = " x ".join(f"{angle:g}" for angle in cell.scanner.field_deg)
        housing = " x ".join(f"{side * 1e3:.0f}" for side in cell.tool.scanner_size_m)
        text = (models_dir() / "scanners" / f"{name}.yaml").read_text(encoding="utf-8")
        purpose = text.splitlines()[0].split(": ", 1)[1].rstrip(".")
        rows.append(f"| `{name}` | {near:g} to {far:g} | {field} | {housing} | {purpose} |")
    return "\n".join(rows)


def bounds(field: FieldInfo) -> str:
    """The allowed range of a number, as text."""
    words = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    found = [
        f"{sign} {getattr(m, k):g}" for m in field.metadata for k, sign in words.items() if hasattr(m, k)
    ]
    return ", ".join(found)


def value_text(value: Any) -> str:
    """A default as it would stand in the file."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(value_text(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def rows_of(model: type[BaseModel]) -> list[str]:
    """One table row for each field of a section."""
    rows = []
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else f"`{value_text(field.default)}`"
        rows.append(f"| `{name}` | {default} | {bounds(field)} | {field.description or ''} |")
    return rows


def reference() -> str:
    """The whole page."""
    parts = [HEAD.replace("PRESETS", preset_rows())]
    for name, field in CellSettings.model_fields.items():
        model: Any = ObstacleSettings if name == "obstacles" else field.annotation
        if field.exclude or not (isinstance(model, type) and issubclass(model, BaseModel)):
            continue
        kind = " (a list of these)" if name == "obstacles" else ""
        parts.append(f"## {name}{kind}\n\n{' '.join((model.__doc__ or '').split())}\n")
        parts.append("| key | default | range | meaning |\n|---|---|---|---|")
        parts.append("\n".join(rows_of(model)) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    Path(__file__).with_name("cell.md").write_text(reference(), encoding="utf-8")
