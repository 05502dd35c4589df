"""The page of ``track setup --pick`` in a headless Chromium: real clicks and keys."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from swimid.tracking import setup as setup_format
from tests import chromium
from tests.chromium import Page
from tests.pick_page import CORNERS, NOSE, POOL, READY, TAIL, click, served

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.find() is None, reason="there is no Chromium on this machine"),
]


def test_markers_scale_and_region_are_picked_by_mouse(tmp_path: Path) -> None:
    output = tmp_path / "setup.yaml"
    with served(POOL, "--no-browser", "-o", output) as run, Page(run.address) as page:
        page.until(READY)
        click(page, 500, 300)
        page.until("!get('balloon').hidden")
        assert "stands out from its surroundings" in page.text("#balloon")
        click(page, *NOSE)  # replaces the wrong pick
        page.until("proposal.markers.length === 1 && get('balloon').hidden")
        click(page, *TAIL)
        page.until("proposal.markers.length === 2")
        page.fill("#markers > div:nth-of-type(2) .name", "rear")
        page.until("proposal.markers.some((marker) => marker.name === 'rear')")

        page.click("#next")
        page.choose("#kind", "two")
        assert "Click on the first" in page.text("#prompt")
        for corner in CORNERS[:2]:
            click(page, *corner)
        assert "Enter the distance" in page.text("#prompt")
        page.fill("#distance", "0")
        page.until("!get('error-scale').hidden")
        assert "greater than 0" in page.text("#error-scale")
        page.fill("#distance", "1.8")
        page.until("proposal.scale")
        assert page.value("proposal.scale.metres_per_pixel") == pytest.approx(1.8 / 512.1, rel=2e-3)

        page.click("details:has([data-tool=ignore]) > summary")
        page.click("[data-tool=ignore]")
        click(page, 600, 400)
        click(page, 639, 479)
        assert "ignored 1" in page.text("#boxes")
        click(page, 10, 10)
        click(page, 60, 60)
        assert "ignored 2" in page.text("#boxes")
        page.click("#undo")
        assert "ignored 2" not in page.text("#boxes")

        for label, place in (("nose", ("-0.02", "0")), ("rear", ("-0.2", "0.001"))):
            place_of = f"document.querySelector(`[aria-label='forward of {label}, m']`)"
            page.value(f"{place_of}.closest('details').open = true")
            for word, value in zip(("forward", "to port"), place, strict=True):
                page.fill(f"[aria-label='{word} of {label}, m']", value)

        page.fill("#count", "40")
        page.click("#try")
        page.until("trial")
        assert page.text("#tried").count("100.0 %") == 2
        page.until("!playing && shown === 39")

        page.click("#done")
        page.until("!get('finished').hidden")
        assert "nose: found in" in page.text("#answer")
        assert page.text("#following") == f"swimid track video {POOL} --setup {output} -o run.csv"
        assert run.end()[0] == 0
        assert not [one for one in page.problems if "422" not in one]
        loaded = page.value("performance.getEntriesByType('resource').map((entry) => entry.name)")
        assert all(one.startswith((run.address, "blob:", "data:")) for one in loaded)
    rules = setup_format.read(output)
    assert (rules.head, rules.tail) == ("nose", "rear")
    assert [marker.at_m for marker in rules.markers] == [(-0.02, 0.0), (-0.2, 0.001)]
    assert rules.scale is not None
    assert rules.scale.distance_m == 1.8
    assert len(rules.ignore_px) == 1
    assert rules.ignore_px[0] == pytest.approx((600, 400, 639, 479), abs=1)


def test_the_page_is_used_by_keyboard_on_a_small_screen(tmp_path: Path) -> None:
    output = tmp_path / "setup.yaml"
    with served(POOL, "--no-browser", "-o", output) as run, Page(run.address, 390, 844, dark=True) as page:
        page.until(READY)
        assert page.value("document.documentElement.scrollWidth") == 390
        page.value("canvas.focus()")
        page.key(".")
        page.until("shown === 1")
        page.key(",")
        page.until("shown === 0")
        # The cross begins in the middle of the picture.
        for steps, key in ((14, "ArrowLeft"), (1, "ArrowDown")):
            for _ in range(steps):
                page.key(key, shift=True)
        for steps, key in ((NOSE[1] - 250, "ArrowDown"), (1, "ArrowLeft")):
            for _ in range(steps):
                page.key(key)
        page.key("Enter")
        page.until("proposal.markers.length === 1")
        assert page.value("[choice.picks[0].x, choice.picks[0].y]") == list(NOSE)
        page.key("+")
        page.until("canvas.clientWidth > scroller.clientWidth")
        click(page, *TAIL)
        page.until("proposal.markers.length === 2")
        page.choose("#kind", "four")
        page.value("setZoom(1)")
        for corner in CORNERS:
            click(page, *corner)
        page.fill("#width", "1.8")
        page.fill("#height", "1.3")
        page.click("#fill")
        page.until("proposal.scale")
        assert page.value("document.documentElement.scrollWidth") == 390

        # A reload keeps the choice; a second window begins with an empty one.
        page.call("Page.reload")
        time.sleep(0.2)
        page.until(f"{READY} && proposal.scale")
        assert page.value("choice.picks.length") == 2
        with Page(run.address) as other:
            other.until(READY)
            assert other.value("choice.picks.length") == 0
        page.click("#done")
        page.until("!get('finished').hidden")
        assert run.end()[0] == 0
    rules = setup_format.read(output)
    assert rules.scale is not None
    assert rules.scale.points_m == ((0, 1.3), (1.8, 1.3), (1.8, 0), (0, 0))


def test_a_page_whose_command_has_ended_says_so(tmp_path: Path) -> None:
    with served(POOL, "--no-browser", "-o", tmp_path / "setup.yaml") as run, Page(run.address) as page:
        page.until(READY)
        assert run.interrupt()[0] == 130
        click(page, *NOSE)
        page.until("ended")
        assert "The command has ended" in page.text("#prompt")
    assert list(tmp_path.iterdir()) == []
