"""The report in a real browser, cut off from every network."""

import json
import re

import numpy as np
import pytest
from slam.drivers.simulators.drive import paper_drive
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import KeyframeDecision, LaserExtrinsics, LaserScan, LoopResult
from slam.logs.trajectory import NS, Trajectory, write_tum

from slam.evaluation.report.write import write_report
from slam.runs.config_file import load_config
from slam.runs.replay import replay

HOSTILE = "<img src=x onerror=alert(1)>"


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


@pytest.fixture(scope="module")
def long_report(tmp_path_factory):
    """As many poses as mit-killian has, under hostile names, with three closures."""
    folder = tmp_path_factory.mktemp("long") / HOSTILE.replace("/", "")
    folder.mkdir()
    n = 17_480
    t = np.linspace(0.0, 60.0, n)
    poses = np.column_stack([40 * np.cos(t), 25 * np.sin(0.9 * t), t])
    path = Trajectory(NS * 1000 + np.arange(n) * (NS // 10), poses)
    keyframes = path.select(np.arange(0, n, 40))
    write_tum(folder / "trajectory.tum", path)
    write_tum(folder / "odometry.tum", Trajectory(path.stamps_ns, poses * 1.05))
    write_tum(folder / "keyframes.tum", keyframes)
    stamps = keyframes.stamps_ns.tolist()
    with LogWriter(folder / "run.mcap") as log:
        log.write(LaserExtrinsics(stamps[0], 0.0, 0.0, 0.0))
        for k in (10, 11, 200, 201):  # the third pair has left no scans
            log.write(KeyframeDecision(stamps[k], k, 40 * k, "turn", "", 1, 0, 1, 2, (), ()))
            log.write(LaserScan(stamps[k], -1.5, 0.1, np.full(31, 5.0, np.float32), 0.0, 20.0))
        for k, accepted in enumerate((True, False, True)):
            reason = "accepted" if accepted else HOSTILE
            log.write(
                LoopResult(stamps[200 + k], 10 + k, 200 + k, accepted, reason, 0.75, 0.5, 2.5)
            )
    write_report([folder], None, folder.parent / "report.html")
    return folder.parent / "report.html"


def ready(page, report):
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached")


def test_it_opens_without_a_network_and_shows_its_plots(report, visit):
    with visit(offline=True) as page:
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        ready(page, report)
        assert [url for url in asked if not url.startswith("data:")] == [report.as_uri()]
        assert page.locator(".map canvas").count() == 3
        scroll_through(page)
        for title in (
            "Final pose error", "x over time", "Heading over time", "Position error over time",
            "Position error over distance", "NEES with chi-square band",
            "Keyframe interval along the path", "T_PE along the path",
            "Why keyframes were taken, and the deciding axis",
            "Position error of all runs over time",
        ):  # fmt: skip
            card = page.locator(".card", has=page.get_by_role("heading", name=title, exact=True))
            assert card.count() >= 1
            box = card.first.locator("canvas, .length").first.bounding_box()
            assert box["width"] > 200
            assert box["height"] > 10
        assert no_sideways_scroll(page), "the page must not scroll sideways"


def scroll_through(page):
    """Bring every chart into sight once: they are drawn when one gets near."""
    page.evaluate(
        """async () => {
            for (const host of document.querySelectorAll(".chart")) {
                host.scrollIntoView();
                while (!host.querySelector("canvas")) await new Promise(requestAnimationFrame);
            }
        }"""
    )


def no_sideways_scroll(page):
    return page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def ink(page, locator):
    """Share of a canvas' pixels that are not clear."""
    return locator.evaluate(
        """canvas => {
            const {width, height} = canvas;
            const data = canvas.getContext("2d").getImageData(0, 0, width, height).data;
            let drawn = 0;
            for (let k = 3; k < data.length; k += 4) drawn += data[k] > 0;
            return drawn / (width * height);
        }"""
    )


def test_every_chart_and_map_has_something_drawn(report, visit):
    with visit(offline=True) as page:
        ready(page, report)
        scroll_through(page)
        canvases = page.locator(".chart canvas, .map canvas")
        assert canvases.count() > 20
        for k in range(canvases.count()):
            assert ink(page, canvases.nth(k)) > 0.001


def facts(page, place):
    """What is said beside a drawing, by name."""
    names = page.locator(f"{place} dt").all_inner_texts()
    return dict(zip(names, page.locator(f"{place} dd").all_inner_texts(), strict=True))


def point_at(page, container, k):
    """Move the mouse onto the kth pose of the container's path."""
    slider = page.locator(f"{container} input[type=range]")
    slider.evaluate("(e, k) => { e.value = k; e.dispatchEvent(new Event('input')); }", k)
    shown = facts(page, f"{container} .readout")
    slider.evaluate("e => { e.value = 0; e.dispatchEvent(new Event('input')); }")
    return move_to(page, container, number(shown["x"]), number(shown["y"]))


def move_to(page, container, x, y):
    """Move the mouse to a place on the container's map, given in m; returns it in px."""
    place = page.locator(f"{container} .map")
    place.scroll_into_view_if_needed()
    at = place.evaluate(
        "(e, [x, y]) => { const p = e.leaflet.latLngToContainerPoint([y, x]); return [p.x, p.y]; }",
        [x, y],
    )
    box = place.bounding_box()
    page.mouse.move(box["x"] + at[0] + 1, box["y"] + at[1])
    page.mouse.move(box["x"] + at[0], box["y"] + at[1])
    return [box["x"] + at[0], box["y"] + at[1]]


def test_pointing_at_the_path_gives_the_figures_of_report_json(report, visit):
    figures = json.loads(report.with_suffix(".json").read_text())["runs"]
    with visit(offline=True) as page:
        ready(page, report)
        last = int(page.locator("#run-0-map input[type=range]").get_attribute("max"))
        point_at(page, "#run-0-map", last)
        shown = facts(page, "#run-0-map .readout")
        assert shown["time"] == f"{figures[0]['duration_s']:.3f} s"
        assert shown["keyframe"].startswith(str(figures[0]["keyframes"] - 1))
        assert {"x", "y", "heading", "error", "sigma", "speed", "T_PE"} <= set(shown)
        page.locator("#run-0-map select").select_option("error")
        most = page.locator("#run-0-map .ramp").inner_text()
        assert f"{figures[0]['ate_max_m']:.3f} m" in most
        slider = page.locator("#run-0-map input[type=range]")
        errors = slider.evaluate(
            """e => Array.from({length: Number(e.max) + 1}, (_, k) => {
                e.value = k; e.dispatchEvent(new Event("input"));
                const names = [...document.querySelectorAll("#run-0-map .readout dt")];
                const error = names.find(name => name.textContent === "error");
                return parseFloat(error.nextSibling.textContent);
            })"""
        )
        assert max(errors) == pytest.approx(figures[0]["ate_max_m"], abs=1e-4)
        rmse = float(np.sqrt(np.mean(np.square(errors))))
        assert rmse == pytest.approx(figures[0]["ate_rmse_m"], abs=1e-4)


def test_a_chart_and_the_map_show_the_same_pose(report, visit):
    with visit(offline=True) as page:
        ready(page, report)
        chart = page.locator("[data-run='0'][data-chart='0'] .u-over")
        page.locator("[data-run='0'][data-chart='0']").scroll_into_view_if_needed()
        chart.wait_for()
        box = chart.bounding_box()
        page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 50)
        said = page.locator("[data-run='0'][data-chart='0'] .u-value").all_inner_texts()
        shown = facts(page, "#run-0-map .readout")
        assert number(said[0]) == pytest.approx(number(shown["time"]), abs=0.01)
        assert number(said[1]) == pytest.approx(number(shown["x"]), abs=0.01)
        move_to(page, ".map-card:has([data-map=all])", number(shown["x"]), number(shown["y"]))
        all_runs = facts(page, ".map-card:has([data-map=all]) .readout")
        assert all_runs["run"] in ("longest-0.3", "longest-0.9")
        assert number(all_runs["x"]) == pytest.approx(number(shown["x"]), abs=0.2)


def number(text):
    """What a text with a unit says."""
    return float(re.sub(r"[^-0-9.]", "", text.replace("\u2212", "-")))


def picture(page):
    page.wait_for_timeout(50)  # it is drawn with the next frame
    return page.locator("#run-0-map .map canvas").evaluate("canvas => canvas.toDataURL()")


def test_the_path_takes_the_colour_that_is_chosen(report, visit):
    with visit(offline=True) as page:
        ready(page, report)
        seen = {picture(page)}
        for colouring in ("error", "sigma", "t", "speed"):
            page.locator("#run-0-map select").select_option(colouring)
            assert page.locator("#run-0-map .ramp").is_visible()
            seen.add(picture(page))
        assert len(seen) == 5


def test_a_closure_in_the_table_shows_its_pair(long_report, visit):
    with visit(offline=True) as page:
        ready(page, long_report)
        row = page.locator("table.closures tr[data-closure]").nth(1)
        cells = [text.strip() for text in row.locator("td").all_inner_texts()]
        before = picture(page)
        row.get_by_role("button", name="show").click()
        panel = page.locator("#run-0-map .closure")
        assert "Closure 2 of 3: rejected" in panel.inner_text()
        for cell in cells[1:3]:
            assert f"scan of keyframe {cell} " in panel.inner_text()
        shown = facts(page, "#run-0-map .closure")
        assert shown["result"] == cells[3] == HOSTILE, "as text"
        assert (shown["score"], shown["second best"], shown["chi²"]) == tuple(cells[4:])
        assert "the scans lie where the finished graph has them" in panel.inner_text()
        with_scans = picture(page)
        assert with_scans != before
        panel.get_by_role("button", name="next").click()
        assert "the run does not hold them" in panel.inner_text()
        assert picture(page) != with_scans
        panel.get_by_role("button", name="close").click()
        assert panel.is_hidden()
        assert page.locator("img[src=x]").count() == 0


def test_a_click_on_the_map_opens_the_closure_there(long_report, visit):
    with visit(offline=True) as page:
        ready(page, long_report)
        place = page.locator("#run-0-map .map")
        place.scroll_into_view_if_needed()
        at = place.evaluate(
            """e => {
                const [p, q] = [12, 202].map(k => 40 * k * 60 / 17479).map(t =>
                    e.leaflet.latLngToContainerPoint([25 * Math.sin(0.9 * t), 40 * Math.cos(t)]));
                return [(2 * p.x + q.x) / 3, (2 * p.y + q.y) / 3];
            }"""
        )
        box = place.bounding_box()
        page.mouse.click(box["x"] + at[0], box["y"] + at[1])
        panel = page.locator("#run-0-map .closure")
        panel.wait_for()
        assert "Closure 3 of 3: accepted" in panel.inner_text()
        assert "scan of keyframe 12 at 48.0 s" in panel.inner_text()


@pytest.mark.parametrize("poses", [1, 2, 200])
def test_a_run_of_which_little_is_left_is_shown(tmp_path, visit, poses):
    t = np.linspace(0.0, 6.0, poses)
    path = Trajectory(NS + np.arange(poses) * NS, np.column_stack([t, 0 * t, 0 * t]))
    (tmp_path / "run").mkdir()
    write_tum(tmp_path / "run" / "trajectory.tum", path)
    write_report([tmp_path / "run"], None, tmp_path / "report.html")
    with visit(offline=True) as page:
        ready(page, tmp_path / "report.html")
        if poses == 1:
            page.locator(".map").click()
        else:
            page.locator("input[type=range]").press("End")
        assert facts(page, ".readout")["time"] == f"{poses - 1}.000 s"
        scroll_through(page)
        assert page.locator(".chart canvas").count() == 3


def test_panning_a_long_path_is_smooth(long_report, visit):
    with visit(offline=True) as page:
        ready(page, long_report)
        place = page.locator("#run-0-map .map")
        page.locator("#run-0-map select").select_option("t")
        place.scroll_into_view_if_needed()
        box = place.bounding_box()
        x, y = box["x"] + 500, box["y"] + 250
        page.mouse.move(x, y)
        page.mouse.down()
        page.evaluate(
            """() => {
                window.times = [];
                const tick = t => { times.push(t); requestAnimationFrame(tick); };
                requestAnimationFrame(tick);
            }"""
        )
        for k in range(80):
            page.mouse.move(x - 2 * k, y + k)
        steps = page.evaluate("times.slice(1).map((t, k) => t - times[k])")
        page.mouse.up()
        assert len(steps) > 20
        assert np.median(steps) < 25.0, "ms from frame to frame; a screen of 60 Hz takes 16.7"


def test_it_is_good_on_a_phone(report, chromium):
    context = chromium.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, offline=True
    )
    try:
        page = context.new_page()
        ready(page, report)
        scroll_through(page)
        assert no_sideways_scroll(page)
        place = page.locator("#run-0-map .map")
        point = point_at(page, "#run-0-map", 30)
        page.touchscreen.tap(*point)
        assert facts(page, "#run-0-map .readout")["time"]
        widths = page.locator(".chart .uplot").evaluate_all("all => all.map(e => e.offsetWidth)")
        assert max(widths) <= 390
        assert place.bounding_box()["height"] < 600, "room is left to scroll past it"
    finally:
        context.close()


def test_tables_are_sorted_by_a_click_and_by_the_keyboard(report, visit):
    def column(page):
        cells = page.locator("table.sortable").first.locator("td:nth-child(3)")
        return [float(text.replace("\u202f", "")) for text in cells.all_inner_texts()]

    with visit(offline=True) as page:
        ready(page, report)
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
        ready(page, report)
        light = page.screenshot()
        ground = "getComputedStyle(document.body).backgroundColor"
        bright = page.evaluate(ground)
        page.emulate_media(color_scheme="dark")
        assert page.evaluate(ground) != bright
        assert page.screenshot() != light
        page.emulate_media(media="print")
        assert page.evaluate(ground) == "rgb(255, 255, 255)"
        widths = page.locator(".chart, .map").evaluate_all(
            "all => all.map(e => e.getBoundingClientRect().width)"
        )
        assert max(widths) <= 1200
        assert page.locator(".chart canvas").count() == page.locator(".chart").count()
        paper = page.locator(".chart .uplot").evaluate_all(
            "all => all.map(e => e.getBoundingClientRect().width)"
        )
        assert max(paper) <= 700, "charts fit on A4"
        assert len(page.pdf()) > 10_000
        page.emulate_media(media="screen")
        assert page.locator("html.paper").count() == 0
