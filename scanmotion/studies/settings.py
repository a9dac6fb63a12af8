"""A study's YAML: what is varied. It is expanded to cases, each with an id that names all it depends on.

Guarantees: two cases with the same id have the same settings, part, method, seed, options and version, so
their results are the same; an unknown key or an impossible value is refused before anything is planned.
"""

import hashlib
import itertools
import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from scanmotion import __version__
from scanmotion.cell.settings.cell import CellSettings, load_cell, settings_from
from scanmotion.core.errors import CellError, InputError
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import box_part, carving, part_from_file
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.worth.comparison import VARIANTS

Kind = Literal["plan", "reach", "viewpoints"]
MOST_CASES = 1_000_000
"""More cases than this are a slip in a grid, not a study."""


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PartSpec(_Strict):
    """A part: a file, or a box in millimetres."""

    file: str | None = None
    box_mm: tuple[float, float, float] | None = None
    units: str = "mm"
    up: str = ""
    name: str = ""

    @model_validator(mode="before")
    @classmethod
    def _file_name(cls, value: Any) -> Any:
        return {"file": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _one(self) -> "PartSpec":
        if (self.file is None) == (self.box_mm is None):
            raise ValueError("a part is either file or box_mm")
        return self


class Layout(_Strict):
    """A named change of the cell: dotted keys of the cell's YAML and their values."""

    name: str = Field(pattern=r"^[\w .,=-]{1,80}$")
    set: dict[str, Any] = {}


class Layouts(_Strict):
    """A grid over dotted keys, or a list of named layouts, or both."""

    grid: dict[str, list[Any]] = {}
    list: tuple[Layout, ...] = ()


class StudySettings(_Strict):
    """What a study's YAML may hold."""

    kind: Kind = "plan"
    robots: tuple[str, ...] = Field(("kr240",), min_length=1)
    layouts: Layouts = Layouts()
    parts: tuple[PartSpec, ...] = Field((PartSpec(file="carving"),), min_length=1)
    methods: tuple[str, ...] = Field(("two-step",), min_length=1)
    seeds: tuple[int, ...] = Field((0,), min_length=1)
    options: dict[str, Any] = {}
    memory_gib: float = Field(2.0, gt=0.0, le=1024.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """One case of a study: all that its row depends on, but for the part's surface itself."""

    id: str
    """Hash of everything below, of the part's surface and of the version, 24 hex digits."""
    kind: Kind
    robot: str
    layout: str
    part: str
    part_hash: str
    source: Literal["mesh", "box"]
    method: str
    seed: int
    settings: dict[str, Any]
    """The whole cell, as a mapping."""
    folder: str
    """Where the cell's YAML lies; a URDF of your own is looked for there."""
    options: dict[str, Any]
    memory_gib: float
    """What the case may need; workers take no more cases than they have memory for."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Placed:
    """A cell in one layout."""

    robot: str
    layout: str
    settings: CellSettings


@dataclass(frozen=True, eq=False, kw_only=True)
class _Subject:
    """A part and how it is planned."""

    part: Part
    source: Literal["mesh", "box"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Study:
    """The cases of a study in their order, and the parts that they share, by hash."""

    cases: tuple[Case, ...]
    parts: dict[str, Part]


def study_from_yaml(path: Path) -> Study:
    """Reads and expands a study.

    Raises:
        InputError: unreadable, an unknown key, an unknown name, or a value that the cell refuses.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not readable YAML ({' '.join(str(error).split())[:160]})") from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: a mapping of settings is expected")
    return study_from(data, folder=path.resolve().parent)


def study_from(data: dict[str, Any], *, folder: Path) -> Study:
    """Expands a study from a plain mapping; relative names are looked for in `folder`.

    Raises:
        InputError: as study_from_yaml.
    """
    try:
        told = StudySettings.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(p) for p in first["loc"])
        known = f"; known: [{', '.join(StudySettings.model_fields)}]" if len(first["loc"]) == 1 else ""
        raise InputError(f"study: {key}: {first['msg']}{known}") from None
    _check(told)
    cells = [(name, _cell(name, folder)) for name in told.robots]
    layouts = _layouts(told.layouts)
    subjects = [_subject(spec, folder) for spec in told.parts]
    total = len(cells) * len(layouts) * len(subjects) * len(told.methods) * len(told.seeds)
    if total > MOST_CASES:
        raise InputError(f"study: {total} cases; at most {MOST_CASES} are taken")
    placed = [_placed(robot, base, layout) for (robot, base), layout in itertools.product(cells, layouts)]
    every = itertools.product(placed, subjects, told.methods, told.seeds)
    unique = {case.id: case for case in (_case(told, *one) for one in every)}
    return Study(cases=tuple(unique.values()), parts={hash_of(s.part): s.part for s in subjects})


def _check(told: StudySettings) -> None:
    known = {f.name for f in fields(PlanOptions)} - {"seed", "source", "errors", "keep_scans"}
    for name in told.options:
        if name not in known:
            raise InputError(f"study: options.{name}: unknown; known: [{', '.join(sorted(known))}]")
    for name in told.methods:
        if name not in VARIANTS:
            raise InputError(f"study: method {name!r}: unknown; known: {', '.join(VARIANTS)}")
    if min(told.seeds) < 0:
        raise InputError(f"study: seeds: {min(told.seeds)} is below zero")


def _cell(name: str, folder: Path) -> CellSettings:
    """A built-in cell, or one from a YAML beside the study."""
    path = folder / name
    return load_cell(path) if path.suffix in (".yaml", ".yml") else load_cell(name)


def _layouts(told: Layouts) -> list[Layout]:
    """The list, and every combination of the grid; the cell as it is where neither is given."""
    made = list(told.list)
    if told.grid:
        for values in itertools.product(*told.grid.values()):
            chosen = dict(zip(told.grid, values, strict=True))
            made.append(Layout(name=_grid_name(chosen), set=chosen))
    names = [layout.name for layout in made]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"study: the layout {name!r} is there twice")
    return made or [Layout(name="as it is")]


def _grid_name(chosen: dict[str, Any]) -> str:
    """For instance "height_m=0.6, position_m=2.2 0"."""

    def text(value: Any) -> str:
        return " ".join(f"{v:g}" for v in value) if isinstance(value, list | tuple) else str(value)

    return ", ".join(f"{key.rsplit('.', 1)[-1]}={text(value)}" for key, value in chosen.items())[:80]


def _placed(robot: str, base: CellSettings, layout: Layout) -> _Placed:
    """The cell with the layout's keys set, checked as a cell's YAML is.

    Raises:
        InputError: with the layout's name and the cell's own words.
    """
    data = base.model_dump(mode="json")
    for key, value in layout.set.items():
        *path, last = key.split(".")
        at: Any = data
        for part in path:
            at = at.get(part) if isinstance(at, dict) else None
        if not isinstance(at, dict) or last not in at:
            raise InputError(f"study: layout {layout.name!r}: the cell has no key {key!r}")
        at[last] = value
    try:
        settings = settings_from(data, folder=base.folder)
    except CellError as error:
        raise InputError(f"study: layout {layout.name!r}: {error}") from None
    return _Placed(robot=robot, layout=layout.name, settings=settings)


def _subject(spec: PartSpec, folder: Path) -> _Subject:
    """The part and how it is planned; the file "carving" is the built-in one."""
    if spec.file == "carving":
        return _Subject(part=carving(), source="mesh")
    if spec.box_mm is not None:
        part = box_part(*(side * 1e-3 for side in spec.box_mm))
        name = spec.name or "box {:g} {:g} {:g}".format(*spec.box_mm)
        return _Subject(part=replace(part, name=name), source="box")
    part = part_from_file(folder / str(spec.file), units=spec.units, up=spec.up)
    if not part.is_mesh:
        raise InputError(
            f"study: {spec.file}: a cloud is not a part that can be planned many times; give a mesh"
        )
    return _Subject(part=replace(part, name=spec.name or part.name), source="mesh")


def hash_of(part: Part) -> str:
    """Hash of a part's name and surface, 24 hex digits."""
    digest = hashlib.sha256(part.name.encode())
    for array in (part.vertices, part.triangles):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:24]


def _case(told: StudySettings, at: _Placed, subject: _Subject, method: str, seed: int) -> Case:
    body: dict[str, Any] = {
        "kind": told.kind,
        "robot": at.robot,
        "layout": at.layout,
        "part": subject.part.name,
        "part_hash": hash_of(subject.part),
        "source": subject.source,
        "method": method,
        "seed": seed,
        "settings": at.settings.model_dump(mode="json"),
        "options": told.options,
    }
    text = json.dumps({**body, "version": __version__}, sort_keys=True)
    id_ = hashlib.sha256(text.encode()).hexdigest()[:24]
    return Case(id=id_, folder=at.settings.folder, memory_gib=told.memory_gib, **body)
