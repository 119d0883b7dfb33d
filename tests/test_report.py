# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The report: right numbers, no network, no code from a recording."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest
import shapely
from helpers import empty_map, office_map, upright_rectangle
from plotly.offline import get_plotlyjs

from rgslam.report import render_report
from rgslam.report.map_figure import map_figure
from rgslam.report.run_traces import PATH_TOLERANCE, ellipse_factor
from rgslam.report.sigma_figure import sigma_figure
from rgslam.rg_map import RGMap
from rgslam.types import Cuboid

NASTY = '<script>alert(1)</script> & "quotes" </SCRIPT><!-- {{7*7}}.log'


@pytest.fixture(scope="module")
def rg_map() -> RGMap:
    return office_map()


@pytest.fixture(scope="module")
def page(rg_map: RGMap) -> str:
    return render_report(rg_map)


def without_plotly(page: str) -> str:
    assert page.count(get_plotlyjs()) == 1
    return page.replace(get_plotlyjs(), "")


def traces(rg_map: RGMap, name: str) -> list[dict]:
    return [trace for trace in map_figure(rg_map)["data"] if trace["name"].startswith(name)]


def text_of(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", without_plotly(page)))


# --- Offline and safe -----------------------------------------------------------------------------


def test_the_page_loads_nothing(page: str) -> None:
    own = without_plotly(page)
    assert not re.search(r"https?:|//[a-z]+\.[a-z]", own)
    assert not re.search(r"<(link|iframe|object|embed|img|base)\b|\bsrc=|@import|url\(", own)
    assert "default-src 'none'" in own
    # Plotly's own default would offer to send the plot to a server.
    assert own.count('"showSendToCloud":false') == own.count("Plotly.newPlot(") == 2


def test_text_of_a_recording_stays_text() -> None:
    rg_map = office_map(1, 40, 4, recording=NASTY)
    loops = [{"i": 0, "j": 1, "accepted": False, "reason": NASTY}]
    run = dataclasses.replace(
        rg_map.run,
        warnings=(NASTY,),
        counts={NASTY: 1},
        seconds={NASTY: 1.0},
        version=NASTY,
        details={"loops": loops},
    )
    page = render_report(dataclasses.replace(rg_map, run=run))
    own = without_plotly(page)
    assert "<script>alert" not in own
    assert own.lower().count("<script>") == own.lower().count("</script>") == 2
    assert own.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 6
    assert "<!--" not in own


def test_the_same_map_gives_the_same_page(page: str) -> None:
    assert render_report(office_map()) == page


def test_a_large_map_stays_below_eight_megabytes() -> None:
    page = render_report(office_map(39, 13_631, 2_000, 5_000))
    assert len(page.encode()) < 8e6


def test_an_empty_map_has_a_report() -> None:
    text = text_of(render_report(empty_map()))
    assert "0 regions" in text and "No warnings." in text


# --- Numbers --------------------------------------------------------------------------------------


def test_the_summary_has_what_the_run_cost(page: str) -> None:
    text = text_of(page)
    assert "RG map of office.log" in text
    assert "scan matching 12.35 412" in text
    assert "all 17.60 503" in text
    assert "scan 17: 3 NaN ranges" in text
    assert "240 scans" in text and "81 m² mapped" in text


def test_tables_have_a_line_per_gateway_and_region(page: str) -> None:
    text = text_of(page)
    assert "G2 narrow passage R1 – R3 90.0 ± 2.8 2" in text  # sqrt(4 + 4) cm
    assert "R1 hallway 24.0 1.2 96 4 0 G1, G2, G3" in text
    assert "R4 room 19.0 1.2 96 4 1 G3" in text


def test_rectangles_are_listed_largest_first_with_their_sigmas(rg_map: RGMap) -> None:
    door = upright_rectangle(4, "door", (1.01, 2.1), (0.003, 0.012))
    poster = upright_rectangle(0, NASTY, (0.6, 0.84), (0.001, 0.002))
    box = Cuboid(2, "cabinet", np.eye(4), np.array([0.8, 0.4, 1.2]),
                 np.diag([1.0] * 6 + [1e-4, 4e-4, 9e-4]), (4, 0))  # fmt: skip
    full = dataclasses.replace(rg_map, rectangles=(poster, door), cuboids=(box,))
    text = text_of(render_report(full))
    assert text.index("4 door 101.0 ± 0.3 210.0 ± 1.2 5") < text.index("60.0 ± 0.1 84.0 ± 0.2 5")
    assert "2 cabinet 80.0 ± 1.0 40.0 ± 2.0 120.0 ± 3.0 4, 0" in text
    (drawn,) = traces(full, "rectangles")
    assert len(drawn["x"]) == len(drawn["text"]) == 2 * 6 - 1
    assert "101.0 ± 0.3 × 210.0 ± 1.2 cm" in drawn["text"][-1]
    assert "<script>" not in "".join(drawn["text"])


def test_a_map_without_stereo_tells_nothing_of_rectangles(rg_map: RGMap, page: str) -> None:
    assert "ectangles" not in re.sub(r"a rectangle or", "", text_of(page))
    assert traces(rg_map, "rectangles") == []


def test_loops_are_counted_by_verdict_and_reason(page: str, rg_map: RGMap) -> None:
    text = text_of(page)
    assert "7 accepted, 1 rejected." in text
    assert "rejected two peaks 1" in text
    for odd in ({}, {"loops": 5}, {"loops": [3, {"i": None}]}):
        run = dataclasses.replace(rg_map.run, details=odd)
        text = text_of(render_report(dataclasses.replace(rg_map, run=run)))
        expected = "0 accepted, 1 rejected" if "loops" in odd and odd["loops"] != 5 else "kept no"
        assert expected in text


# --- Plots ----------------------------------------------------------------------------------------


def test_the_map_shows_regions_and_gateways_with_their_facts(rg_map: RGMap) -> None:
    regions = traces(rg_map, "regions")
    assert len(regions) == 4
    assert regions[0]["text"] == "<b>R1 hallway</b><br>area 24.0 m²<br>accuracy 1.2 cm" + (
        "<br>completeness 96 %"
    )
    assert [trace["showlegend"] for trace in regions] == [True, False, False, False]
    np.testing.assert_allclose(regions[0]["x"], [0, 12, 12, 0, 0])
    (gateways,) = traces(rg_map, "narrow passage")
    assert len(gateways["x"]) == len(gateways["text"]) == 3 * 4 - 1
    assert "width 90.0 ± 2.8 cm" in gateways["text"][1]


def test_the_drawn_path_keeps_to_the_trajectory(rg_map: RGMap) -> None:
    line, dots = traces(rg_map, "trajectory")
    drawn = shapely.LineString(np.column_stack([line["x"], line["y"]]))
    assert len(line["x"]) < len(rg_map.trajectory.stamps)
    away = shapely.distance(drawn, shapely.points(rg_map.trajectory.wTb[:, :2]))
    assert away.max() <= PATH_TOLERANCE + 1e-3  # the plot's rounding
    assert dots["marker"]["color"][0] == 0.0
    assert len(dots["x"]) == len(dots["marker"]["color"])


def test_ellipses_hold_95_percent_and_say_their_exaggeration(rg_map: RGMap) -> None:
    keyframes = rg_map.keyframes
    sigma = np.diag([0.04, 0.02, 0.01]) ** 2
    round_keyframes = dataclasses.replace(
        keyframes,
        wTb=keyframes.wTb * [1.0, 1.0, 0.0],
        covariances=np.broadcast_to(sigma, keyframes.covariances.shape),
    )
    changed = dataclasses.replace(rg_map, keyframes=round_keyframes)
    factor = ellipse_factor(changed)
    (trace,) = traces(changed, "95 % ellipses")
    assert f"× {factor}," in trace["name"] and trace["visible"] == "legendonly"
    x = np.array(trace["x"][:25], float) - round_keyframes.wTb[0, 0]
    y = np.array(trace["y"][:25], float) - round_keyframes.wTb[0, 1]
    # In two dimensions 95 % lie within 2.4477 sigma.
    assert x.max() == pytest.approx(2.4477 * factor * 0.04, abs=2e-3)
    assert y.max() == pytest.approx(2.4477 * factor * 0.02, abs=2e-3)


def test_sigma_over_time_is_in_centimetres_and_degrees(rg_map: RGMap) -> None:
    position, heading = sigma_figure(rg_map)["data"]
    assert heading["y"][-1] == pytest.approx(np.rad2deg(0.003), rel=1e-3)
    # The larger axis of [[4, .6], [.6, 1]] cm^2.
    assert position["y"][-1] == pytest.approx(np.sqrt(2.5 + np.hypot(1.5, 0.6)), rel=1e-3)
    stamps = rg_map.keyframes.stamps
    assert position["x"][-1] == pytest.approx(stamps[-1] - stamps[0], abs=0.01)


def test_figures_hold_nothing_that_json_lacks(rg_map: RGMap) -> None:
    for shown in (rg_map, empty_map()):
        json.dumps([map_figure(shown), sigma_figure(shown)], allow_nan=False)
