"""The report and the figures in it: what they show is what the plan holds."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from browser import screenshot
from fake_plan import fake_hole, fake_plan

import scanmotion.report.page as mut
import scanmotion.report.surface as surface_page
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.summary import Summary
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.report.figures import palette
from scanmotion.report.figures.charts import tcp_speed
from scanmotion.report.figures.maps import causes_of
from scanmotion.report.figures.surface import (
    in_sight,
    nearest_status,
    picture_of,
    shaded,
    status_image,
    status_of_samples,
    view_of,
)
from scanmotion.report.page import report_html
from scanmotion.views.unscanned import Patch


@pytest.fixture(scope="module")
def plan(kr240_cell):
    return fake_plan(kr240_cell)


@pytest.fixture(scope="module")
def page(plan):
    return report_html(plan)


@pytest.fixture
def text_of(monkeypatch):
    """Reads the report of a plan, whose pictures need not be drawn for that."""
    of_surface = ("coverage", "hole", "reach")
    for module, names in ((mut, ("cell", "joint", "tcp", "time", "curve")), (surface_page, of_surface)):
        monkeypatch.setattr(module, "image", lambda figure, what: f'<img alt="{what}" src="data:,">')
        for name in names:
            monkeypatch.setattr(module, f"{name}_figure", lambda *a, **k: None)
    return lambda plan: " ".join(Reader(report_html(plan)).texts)


class Reader(HTMLParser):
    """Text, attributes and unclosed elements of a page."""

    def __init__(self, page):
        super().__init__()
        self.texts, self.links, self.tags, self.open = [], [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href", "action", "data")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def test_report_is_whole_and_loads_nothing(page):
    read = Reader(page)
    assert read.open == []
    assert "script" not in read.tags
    assert len(read.links) >= 7
    assert all(link.startswith("data:image/png;base64,") for link in read.links)
    assert "default-src 'none'" in page
    assert not re.search(r"url\(|@import|https?://", page)


def test_report_says_what_the_plan_holds(page, plan):
    text = " ".join(Reader(page).texts)
    for word in (
        "100.00%",
        "0.080 mm",
        "13.5 s",
        "inside the budget of 152.0 s",
        "Seed 7",
        "passes its checks",
        "H1",
    ):
        assert word in text, word
    for view in plan.viewpoints:
        assert view.id in text
    assert "out of reach: 3.1 m <b>" in text  # escaped in the page, whole for the reader
    assert "standoff_m" in text and "scanmotion" in text


def test_report_warns_of_findings_and_lateness(plan, text_of):
    text = text_of(with_summary(plan, budget={"limit_s": 10.0, "ok": False}, findings=["A3 <too> fast"]))
    assert "Do not run" in text and "over its budget" in text and "A3 <too> fast" in text


def test_report_tells_each_round_and_what_stays_unscanned(plan):
    rounds = [
        {"step": "global", "viewpoints": 4, "completeness": 0.88},
        {"step": "local", "viewpoints": 7, "completeness": 0.9125},
    ]
    patches = (
        Patch(center=np.array([0.01, -0.02, 0.03]), area=2e-6, reason="cannot be seen"),
        Patch(center=np.array([0.1, 0.2, 0.3]), area=5e-6, reason="not worth its seconds"),
        Patch(center=np.array([0.0, 0.0, 0.0]), area=4e-6, reason="cannot be seen"),
    )
    page = report_html(replace(with_summary(plan, rounds=rounds), unscanned=patches))
    rows = [re.findall(r"<td[^>]*>([^<]*)", row) for row in re.findall(r"<tr>(.*?)</tr>", page)]
    assert ["1", "global", "4", "88.00%", ""] in rows
    assert ["2", "local", "7", "91.25%", "+3.25%"] in rows
    assert ["cannot be seen", "2", "6"] in rows
    assert ["1", "100  200  300", "5", "not worth its seconds"] in rows
    assert ["3", "10  -20  30", "2", "cannot be seen"] in rows


def test_a_plan_that_was_not_judged_has_no_report(plan):
    with pytest.raises(InputError, match="not been judged"):
        report_html(replace(plan, summary=None))


def with_summary(plan, **told):
    return replace(plan, summary=Summary.model_validate(plan.summary.document() | told))


def test_report_is_deterministic(plan, page):
    assert report_html(plan) == page


def test_report_without_motion_or_truth(plan, text_of):
    text = text_of(replace(plan, trajectory=None, samples=None, visible=None, holes=None))
    assert "No viewpoint could be served" in text and "nothing can be predicted" in text


def test_status_of_samples(plan):
    status = status_of_samples(plan)
    normals = plan.samples.normals
    assert (status[np.abs(normals[:, 2]) < 0.5] == palette.SEEN_GLOBAL).all()
    assert (status[normals[:, 2] > 0.5] == palette.SEEN_LOCAL).all()
    assert (status[normals[:, 2] < -0.5] == palette.HIDDEN).all()
    before = status_of_samples(plan, after="global")
    assert (before[normals[:, 2] > 0.5] == palette.MISSED).all()


@pytest.mark.parametrize("azimuth, side", [(0, (0.3, 0.5)), (90, (0.2, 0.5)), (180, (0.3, 0.5))])
def test_a_box_seen_square_on_fills_its_rectangle(azimuth, side):
    part = box_part(0.2, 0.3, 0.5)
    view = view_of(part, azimuth=azimuth, elevation=0.0, pixels=400)
    picture = picture_of(part, view)
    seen = picture.hit.sum() * view.scale**2
    assert seen == pytest.approx(side[0] * side[1], rel=0.02)
    toward = np.array([np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth)), 0])
    np.testing.assert_allclose(picture.normals, np.tile(toward, (picture.hit.sum(), 1)), atol=1e-5)


def test_pixels_of_hit_points_are_their_own():
    part = box_part(0.2, 0.3, 0.5)
    picture = picture_of(part, view_of(part, azimuth=33.0, elevation=21.0))
    column, row, height = picture.view.pixels(picture.points)
    rows, cols = np.nonzero(picture.hit)
    np.testing.assert_allclose(column, cols + 0.5, atol=1e-3)
    np.testing.assert_allclose(row, rows + 0.5, atol=1e-3)
    np.testing.assert_allclose(height, picture.height[picture.hit], atol=1e-5)
    assert in_sight(picture, picture.points).all()
    assert not in_sight(picture, picture.points - 0.02 * picture.view.toward).any()


def test_a_cloud_is_drawn_like_its_mesh(rng):
    part = box_part(0.2, 0.3, 0.5)
    samples = surface_samples(part, 60_000, rng=rng)
    cloud = Part(name="cloud", vertices=samples.points, triangles=np.zeros((0, 3), int))
    view = view_of(part, azimuth=30.0, elevation=20.0, pixels=150)
    mesh, points = picture_of(part, view), picture_of(cloud, view)
    assert (mesh.hit & points.hit).sum() > 0.98 * mesh.hit.sum()
    both = mesh.hit & points.hit
    assert np.median(np.abs(mesh.height[both] - points.height[both])) < 2 * view.scale
    assert shaded(points, np.ones((points.hit.sum(), 3))).shape == (*view.shape, 4)


def test_status_does_not_bleed_over_an_edge(rng):
    part = box_part(0.4, 0.4, 0.4)
    samples = surface_samples(part, 3000, rng=rng)
    status = np.where(samples.normals[:, 2] > 0.5, palette.SEEN_LOCAL, palette.SEEN_GLOBAL)
    points = np.array([[0.2, 0.0, 0.3999], [0.1999, 0.0, 0.4]])
    normals = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    assert nearest_status(points, normals, samples, status).tolist() == [
        palette.SEEN_GLOBAL,
        palette.SEEN_LOCAL,
    ]


def test_status_image_shows_the_colours(plan):
    view = view_of(plan.part, azimuth=0.0, elevation=89.9)
    image = status_image(plan.part, view, plan.samples, status_of_samples(plan))
    middle = image[image.shape[0] // 2, image.shape[1] // 2, :3]
    expected = np.array(palette.rgb(palette.STATUS_COLOURS[palette.SEEN_LOCAL]))
    np.testing.assert_allclose(middle / middle.max(), expected / expected.max(), atol=0.02)


def test_causes(plan):
    assert causes_of(plan) == {"G1": "served", "L1.1": "served", "L2.1": "out_of_reach"}


def test_tcp_speed_of_a_circle():
    t = np.linspace(0, 5, 2001)
    p = 0.4 * np.column_stack([np.cos(0.5 * t), np.sin(0.5 * t), 0 * t])
    np.testing.assert_allclose(tcp_speed(t, p)[1:-1], 0.2, rtol=1e-5)


def test_hole_kinds_have_colours_of_their_own():
    assert len(set(palette.HOLE_COLOURS.values())) == len(palette.HOLE_COLOURS) == 4
    assert fake_hole().kind in palette.HOLE_COLOURS


def test_report_in_a_browser(page, tmp_path):
    file = tmp_path / "report.html"
    file.write_text(page, encoding="utf-8")
    image, asked = screenshot(file, size=(1200, 3600), wait_ms=2000)
    assert asked == set()
    pixels = image.reshape(-1, 3).astype(int)
    assert len(np.unique(pixels // 16, axis=0)) > 100, "the page is blank"
    blue = (pixels[:, 2] > pixels[:, 0] + 40) & (pixels[:, 2] > pixels[:, 1] + 15)
    assert blue.sum() > 2000, "no surface that was seen"
