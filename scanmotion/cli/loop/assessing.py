"""`scanmotion assess`: a measured cloud or mesh held against its reference."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import OK, Progress, print_table, progress_bar, say_json
from scanmotion.cli.inputs import OUT, Json, Quiet, Units, check_file, check_known
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from scanmotion.core.part import Part
    from scanmotion.report.assessment import Assessment
    from scanmotion.sensing.metrology.artefacts import Ball
    from scanmotion.sensing.metrology.deviations import DeviationLimits

LIMITS = "What counts"


def assess(
    measured: Annotated[Path, typer.Argument(help="Measured cloud or mesh (PLY, PCD, XYZ, STL, OBJ).")],
    reference: Annotated[
        Path, typer.Option("--reference", help="CAD mesh, or probed points with normals (PLY, XYZ).")
    ],
    units: Units = "mm",
    reference_units: Annotated[
        str, typer.Option("--reference-units", help="Unit of the reference file.")
    ] = "mm",
    align: Annotated[
        str,
        typer.Option(
            "--align",
            help="auto: fit, and look for a start where that fails; fine: fit from where it is; "
            "global: look for a start; none: both are in one frame.",
        ),
    ] = "auto",
    distance: Annotated[
        float,
        typer.Option("--distance", help="Covered: a measured point this near, mm.", rich_help_panel=LIMITS),
    ] = 3.0,
    angle: Annotated[
        float,
        typer.Option("--angle", help="... whose normal is off by at most this, deg.", rich_help_panel=LIMITS),
    ] = 60.0,
    cut: Annotated[
        float | None,
        typer.Option("--cut", help="Points farther off than this do not count, mm.", rich_help_panel=LIMITS),
    ] = None,
    regions: Annotated[
        Path | None,
        typer.Option(
            "--regions",
            help='JSON: {"head": [[x, y, z], [x, y, z]]}, corners in mm in the reference\'s frame.',
        ),
    ] = None,
    artefact: Annotated[
        str | None,
        typer.Option("--artefact", help="The object is a sphere, a ball-bar or a plane: figures on it too."),
    ] = None,
    limit: Annotated[float, typer.Option("--limit", help="Distance of the full colour, mm.")] = 0.5,
    out: Annotated[
        Path,
        typer.Option("--out", help="Folder: assess.json, assess.html, deviation.ply.", rich_help_panel=OUT),
    ] = Path("assessment"),
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Hold a measured cloud against its reference: completeness, accuracy, map, histogram, sections."""
    check_file("MEASURED", measured)
    check_file("--reference", reference)
    for option, value in (
        ("--distance", distance),
        ("--limit", limit),
        ("--cut", 1.0 if cut is None else cut),
    ):
        if not 0 < value < 1e4:
            raise InputError(f"{option} {value:g}: a positive length in mm is expected")
    if not 0 < angle <= 180:
        raise InputError(f"--angle {angle:g}: between 0 and 180 deg is expected")
    if artefact is not None:
        check_known("--artefact", artefact, ("sphere", "ball-bar", "plane"))
    check_assessment_folder(out)
    from scanmotion.sensing.metrology.deviations import DeviationLimits

    limits = DeviationLimits(
        cover_distance=distance * 1e-3, cover_angle=angle / 57.29577951308232,
        cut=float("inf") if cut is None else cut * 1e-3,
    )  # fmt: skip
    boxes = None if regions is None else read_regions(regions)
    with progress_bar(quiet=quiet or json) as progress:
        made = _assessed(
            (measured, units),
            (reference, reference_units),
            align,
            limits,
            boxes,
            artefact,
            limit * 1e-3,
            progress,
        )
        from scanmotion.report.assessment import assessment_html, assessment_record, figure_rows

        progress("write", 0.8)
        write_assessment(out, made, assessment_html(made))
    if json:
        say_json(assessment_record(made))
    elif not quiet:
        rows = figure_rows(made) + [(k, str(v)) for k, v in (made.artefact or {}).items()]
        print_table("The assessment", (), [*rows, ("page", str(out / "assess.html"))])
    return OK


def check_assessment_folder(out: Path) -> None:
    """Refuses a folder that holds something else.

    Raises:
        InputError: a file of that name, or a folder without assess.json that is not empty.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out}: is not a folder")
    if out.is_dir() and any(out.iterdir()) and not (out / "assess.json").is_file():
        raise InputError(f"--out {out}: holds something that is not an assessment; name another folder")


def read_regions(path: Path) -> "dict[str, np.ndarray]":
    """Boxes by name, (2, 3) each in m.

    Raises:
        InputError: no such file, or not boxes by name.
    """
    import json

    import numpy as np

    check_file("--regions", path)
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        boxes = {str(n): np.array(b, dtype=float).reshape(2, 3) * 1e-3 for n, b in told.items()}
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: is not a mapping of names to two corners ({str(error)[:80]})") from None
    for name, box in boxes.items():
        if not (np.isfinite(box).all() and (box[0] < box[1]).all()):
            raise InputError(f"{path}: {name}: the first corner must lie below the second in x, y and z")
    return boxes


def _assessed(
    measured: tuple[Path, str], reference: tuple[Path, str], how: str, limits: "DeviationLimits",
    boxes: "dict[str, np.ndarray] | None", artefact: str | None, limit: float, progress: Progress,
) -> "Assessment":  # fmt: skip
    """Reads both, fits and compares."""
    from scanmotion.report.assessment import Assessment
    from scanmotion.sensing.metrology.alignment import aligned
    from scanmotion.sensing.metrology.deviations import deviations, deviations_at_points
    from scanmotion.sensing.metrology.measured import measured_cloud, reference_part

    progress("read", 0.0)
    part = reference_part(*reference)
    points, normals = measured_cloud(*measured)
    progress("align", 0.2)
    if not part.is_mesh:
        if how != "none":
            raise InputError(
                "--reference is a cloud of probed points: both must be in one frame; say --align none"
            )
        return Assessment(
            measured=measured[0].name, reference=part, alignment=None, limit=limit,
            found=deviations_at_points(points, part),
        )  # fmt: skip
    found = aligned(points, part, how=how)
    moved = points @ found.X[:3, :3].T + found.X[:3, 3]
    progress("compare", 0.4)
    compared = deviations(moved, normals @ found.X[:3, :3].T, part, limits=limits, boxes=boxes)
    return Assessment(
        measured=measured[0].name, reference=part, alignment=found, found=compared, limit=limit,
        artefact=None if artefact is None else artefact_figures(artefact, compared.points, part),
    )  # fmt: skip


def artefact_figures(kind: str, points: "np.ndarray", part: "Part") -> dict[str, float]:
    """Figures on the measured points of an artefact, in mm; the reference mesh has the nominal values."""
    from scanmotion.sensing.metrology.artefacts import ball_bar_from, ball_from, plane_from

    if kind == "plane":
        flat = plane_from(points)
        return {
            "flatness F (VDI/VDE 2634)": _mm(flat.flatness),
            "D_Form.Pla.D95% (ISO 10360-13)": _mm(flat.form_95),
        }
    if kind == "sphere":
        return _ball_figures(ball_from(points, nominal=ball_from(part.vertices).diameter))
    true = ball_bar_from(part.vertices)
    bar = ball_bar_from(points, diameter=true.balls[0].diameter, spacing=true.spacing)
    figures = {
        f"sphere {i + 1}: {k}": v for i, b in enumerate(bar.balls) for k, v in _ball_figures(b).items()
    }
    return {**figures, "sphere spacing": _mm(bar.spacing), "spacing error SD, D_CC": _mm(bar.spacing_error)}


def _ball_figures(ball: "Ball") -> dict[str, float]:
    return {
        "probing form PF (VDI/VDE 2634)": _mm(ball.form_all),
        "P_Form.Sph.D95% (ISO 10360-13)": _mm(ball.form_95),
        "diameter": _mm(ball.diameter), "probing size PS": _mm(ball.size_error),
    }  # fmt: skip


def _mm(metres: float | None) -> float:
    assert metres is not None
    return round(float(metres) * 1e3, 5)


def write_assessment(out: Path, made: "Assessment", html: str) -> None:
    """The folder, whole or not at all."""
    import json

    import numpy as np

    from scanmotion.plan_io.files import atomic_folder
    from scanmotion.report.assessment import assessment_record
    from scanmotion.sensing.fusion.surface import deviation_mesh

    files: dict[str, bytes | str] = {
        "assess.json": json.dumps(assessment_record(made), indent=1, allow_nan=False) + "\n",
        "assess.html": html,
    }
    if made.reference.is_mesh:
        none = np.zeros((0, 3), np.int64)
        files["deviation.ply"] = deviation_mesh(
            made.found.points, none, made.reference, limit=made.limit
        ).data()
    atomic_folder(out, files, mark="assess.json")
