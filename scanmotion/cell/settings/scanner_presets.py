"""Scanners by name: what models/scanners/NAME.yaml says of their optics, housing, standoff and frame rate."""

import functools
from collections.abc import Mapping
from typing import Any

import yaml

from scanmotion.core.errors import CellError
from scanmotion.geometry.parts.make_part import models_dir

FIXED = ("scanner",)
"""Sections of which a cell that names a preset may state nothing else."""


def scanner_presets() -> tuple[str, ...]:
    """Names of the scanners that come with the package."""
    return tuple(sorted(p.stem for p in (models_dir() / "scanners").glob("*.yaml")))


@functools.cache
def _preset(name: str) -> dict[str, dict[str, Any]]:
    return yaml.safe_load((models_dir() / "scanners" / f"{name}.yaml").read_text(encoding="utf-8"))


def with_scanner_preset(data: Mapping[str, Any]) -> dict[str, Any]:
    """A cell's mapping with the values of the preset that its `scanner.model` names; without one, as it is.

    What the cell states of tool and process goes before the preset.

    Raises:
        CellError: an unknown preset, or a key of the section `scanner` that says otherwise than the preset.
    """
    scanner = data.get("scanner")
    name = scanner.get("model") if isinstance(scanner, Mapping) else None
    if name is None:
        return dict(data)
    if name not in scanner_presets():
        known = ", ".join(scanner_presets())
        raise CellError(f"unknown scanner {str(name)[:40]!r}; known: {known}", key="scanner.model")
    out = dict(data)
    for section, preset in _preset(name).items():
        stated = data.get(section) or {}
        if not isinstance(stated, Mapping):
            continue
        if section in FIXED:
            for key, value in preset.items():
                if key in stated and _plain(stated[key]) != _plain(value):
                    raise CellError(
                        f"scanner.model {name} has {value}; leave out this key, or scanner.model",
                        key=f"{section}.{key}",
                    )
        out[section] = {**preset, **stated}
    return out


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, list | tuple) else value
