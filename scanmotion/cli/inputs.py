"""Options that several commands share, and the doors through which their values come in."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.core.errors import InputError
from scanmotion.core.support.threads import allow_threads
from scanmotion.core.support.whole_file import write_whole

if TYPE_CHECKING:
    from scanmotion.cell.settings.cell import CellSettings
    from scanmotion.core.part import Part

PART, CELL, OUT = "What is scanned", "The cell", "Output"


def _threads(count: int | None) -> int | None:
    """Sets the number before any library that reads it is loaded."""
    if count is not None:
        allow_threads(count)
    return count


PartFile = Annotated[
    Path | None,
    typer.Option("--part", help="Mesh of the part (PLY, STL, OBJ, OFF, GLB, 3MF).", rich_help_panel=PART),
]
Box = Annotated[
    tuple[float, float, float] | None,
    typer.Option(
        "--box", metavar="L W H", help="Only the bounding box is known, in mm: global step alone.",
        rich_help_panel=PART,
    ),
]  # fmt: skip
ScanFile = Annotated[
    Path | None,
    typer.Option(
        "--scan", help="A measured global scan (cloud or mesh): local step alone.", rich_help_panel=PART
    ),
]
Units = Annotated[
    str,
    typer.Option(
        "--units",
        help="Unit of the file: mm, cm, m, in, ft or um. By default what the file states, else mm.",
        rich_help_panel=PART,
        show_default=False,
    ),
]
Up = Annotated[
    str,
    typer.Option(
        "--up",
        help="Axis of the file that points up, e.g. +z or -y. By default +z, and +y in glTF by its standard.",
        rich_help_panel=PART,
        show_default=False,
    ),
]
Place = Annotated[
    str,
    typer.Option(
        "--place",
        help="centre: on the table's centre; keep: the file is in the table's frame. "
        "By default centre, and keep for --scan.",
        rich_help_panel=PART,
        show_default=False,
    ),
]
Robot = Annotated[
    str | None,
    typer.Option("--robot", help="Built-in cell, see `scanmotion robots`.", rich_help_panel=CELL),
]
CellFile = Annotated[
    Path | None,
    typer.Option("--cell", help="Your own cell, see `scanmotion cell init`.", rich_help_panel=CELL),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Errors only.", rich_help_panel=OUT)]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.", rich_help_panel=OUT)]
Threads = Annotated[
    int | None,
    typer.Option(
        "--threads",
        callback=_threads,
        expose_value=True,
        is_eager=True,
        help="Threads at most; by default OMP_NUM_THREADS, or all cores. The result does not depend on it.",
        rich_help_panel=OUT,
    ),
]
Mode = Annotated[str, typer.Option("--mode", help="default, or paper: the published formulas literally.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same plan.")]


def only_one(**given: object) -> str | None:
    """Name of the one option that was given, None for none.

    Raises:
        InputError: more than one was given.
    """
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise InputError(f"give only one of {', '.join('--' + n for n in names)}")
    return names[0] if names else None


def cell_from(robot: str | None, cell: Path | None) -> "CellSettings":
    """The settings that --robot or --cell name; the KR 240 where neither is given."""
    from scanmotion.cell.settings.cell import load_cell

    only_one(robot=robot, cell=cell)
    if cell is not None:
        if not cell.is_file():
            raise InputError(f"{cell}: no such file; `scanmotion cell init {cell}` writes one to start from")
        return load_cell(cell)
    return load_cell(robot or "kr240")


def box_from(box: tuple[float, float, float]) -> "Part":
    """A box part from sides in mm.

    Raises:
        InputError: a side is not a number between 1 mm and 100 m.
    """
    from scanmotion.geometry.parts.make_part import box_part

    if not all(1.0 <= side <= 1e5 for side in box):
        sides = " x ".join(f"{side:g}" for side in box)
        raise InputError(f"--box: {sides} mm; sides between 1 mm and 100 m are expected")
    return box_part(*(side * 1e-3 for side in box))


def part_and_source(
    part: Path | None,
    box: tuple[float, float, float] | None,
    scan: Path | None,
    *,
    units: str = "",
    up: str = "",
    place: str = "",
) -> tuple["Part", str]:
    """The part and where it comes from: "mesh", "box" or "scan"; the built-in carving where none is given."""
    from scanmotion.geometry.parts.make_part import carving, part_from_file

    given = only_one(part=part, box=box, scan=scan)
    strange = {"units": bool(units), "up": bool(up), "place": bool(place)}
    if part is None and scan is None and any(strange.values()):
        name = next(name for name, set_ in strange.items() if set_)
        what = "--box is in mm, z up" if box is not None else "it is about a file"
        raise InputError(f"--{name}: only together with --part or --scan; {what}")
    if box is not None:
        return box_from(box), "box"
    if scan is not None:
        return part_from_file(scan, units=units or None, up=up, place=place or "keep"), "scan"
    if part is not None:
        return part_from_file(part, units=units or None, up=up, place=place or "centre"), "mesh"
    assert given is None
    return carving(), "mesh"


def say_read(part: "Part", *, quiet: bool = False) -> None:
    """One line on stderr of what was read, where the part came from a file."""
    if part.report is not None and not quiet:
        typer.echo(f"{part.report.file}: {part.report.line}", err=True)


def _replaceable(out: Path) -> bool:
    """Whether a plan, or several placements, stand in a folder."""
    return any((out / mark).is_file() for mark in ("plan.json", "placements.json"))


def check_out_folder(out: Path) -> None:
    """Refuses, before any work is done, a folder that a plan must not replace.

    Raises:
        InputError: a file of that name, a folder that holds something else, or no way to write there.
    """
    import os

    from scanmotion.cli.plans.complete import holds_answer

    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise InputError(f"--out {out}: is not a folder")
    if out.is_dir() and any(out.iterdir()) and not (_replaceable(out) or holds_answer(out)):
        raise InputError(f"--out {out}: holds something that is not a plan; name another folder")
    parent = out.resolve().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError(f"--out {out}: cannot write in {parent}")


def check_file(option: str, path: Path) -> None:
    """Refuses what is no plain file: reading a pipe or a device might never end.

    Raises:
        InputError: missing, or not a file.
    """
    if not path.is_file():
        raise InputError(f"{option} {path}: {'is not a file' if path.exists() else 'no such file'}")


def meta_from(words: Sequence[str]) -> dict[str, str]:
    """What --meta notes on a plan, by key.

    Raises:
        InputError: a word is not key=value, a key is there twice, or one is too long for a sheet.
    """
    noted: dict[str, str] = {}
    for word in words:
        key, sign, value = word.partition("=")
        key, value = key.strip(), value.strip()
        if not sign or not key or not value:
            raise InputError(f"--meta {word!r}: key=value is expected, as operator=Meier")
        if key in noted:
            raise InputError(f"--meta {key}: is there twice")
        if len(key) > 40 or len(value) > 2000:
            raise InputError(f"--meta {key[:40]}: at most 40 letters for the key, 2000 for the value")
        noted[key] = value
    return noted


def check_known(option: str, value: str, known: tuple[str, ...]) -> None:
    """Refuses a value that is not one of the known ones.

    Raises:
        InputError: with the known ones.
    """
    if value not in known:
        raise InputError(f"{option} {value}: unknown; known: {', '.join(known)}")


def check_mode(mode: str) -> None:
    """Refuses an unknown mode.

    Raises:
        InputError: with the known ones.
    """
    check_known("--mode", mode, ("default", "paper"))


def write_text(path: Path, text: str) -> None:
    """Writes the whole file or none of it."""
    write_whole(path, text)


def check_suffix(option: str, path: Path | None, *known: str) -> None:
    """Refuses a file name that does not end as it should, or a folder that is not there.

    Raises:
        InputError: with the endings that are known.
    """
    if path is None:
        return
    if path.suffix not in known:
        raise InputError(f"{option} {path}: must end in {' or '.join(known)}")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{option} {path}: the folder {path.parent} does not exist")
