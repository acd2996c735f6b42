"""The report in a real browser, cut off from every network."""

import pytest
from slam.drivers.simulators.drive import paper_drive
from slam.logs.mcap_log import LogWriter

from slam.evaluation.report.write import write_report
from slam.runs.config_file import load_config
from slam.runs.replay import replay


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Two runs of the test bed, with truth, on one page."""
    folder = tmp_path_factory.mktemp("report")
    with LogWriter(folder / "testbed.mcap") as log:
        for message in paper_drive("878cm"):
            log.write(message)
    runs = []
    for interval in ("0.3", "0.9"):
        settings = ["localise.every_scan=false", f"keyframes.max_interval={interval}"]
        runs.append(folder / f"longest-{interval}")
        replay(folder / "testbed.mcap", runs[-1], load_config(None, settings))
    write_report(runs, None, folder / "report.html")
    return folder / "report.html"


def test_it_opens_without_a_network_and_shows_its_plots(report, visit):
    with visit(offline=True) as page:
        page.goto(report.as_uri())
        requests = page.evaluate("performance.getEntriesByType('resource').map(e => e.name)")
        assert [r for r in requests if not r.startswith("data:")] == []
        assert page.locator("svg.map").count() == 2
        for title in (
            "Final pose error", "Position error over time", "Position error over distance",
            "NEES with chi-square band", "Keyframe interval along the path", "T_PE along the path",
            "Why keyframes were taken, and the deciding axis",
        ):  # fmt: skip
            card = page.locator(".card", has=page.get_by_role("heading", name=title, exact=True))
            assert card.count() >= 1
            box = card.first.locator("svg").bounding_box()
            assert box["width"] > 200
            assert box["height"] > 40
        wide = page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert wide, "the page must not scroll sideways"


def test_tables_are_sorted_by_a_click_and_by_the_keyboard(report, visit):
    def column(page):
        cells = page.locator("table.sortable").first.locator("td:nth-child(3)")
        return [float(text.replace("\u202f", "")) for text in cells.all_inner_texts()]

    with visit(offline=True) as page:
        page.goto(report.as_uri())
        head = page.locator("table.sortable").first.get_by_role("button", name="keyframes")
        head.click()
        up = column(page)
        assert up == sorted(up)
        assert up[0] != up[-1]
        head.press("Enter")
        assert column(page) == sorted(up, reverse=True)
        assert page.locator("th[aria-sort=descending]").count() == 1


def test_light_dark_and_print_differ(report, visit):
    with visit("light", offline=True) as page:
        page.goto(report.as_uri())
        light = page.screenshot()
        ground = "getComputedStyle(document.body).backgroundColor"
        bright = page.evaluate(ground)
        page.emulate_media(color_scheme="dark")
        assert page.evaluate(ground) != bright
        assert page.screenshot() != light
        page.emulate_media(media="print")
        assert page.evaluate(ground) == "rgb(255, 255, 255)"
        assert len(page.pdf()) > 10_000
