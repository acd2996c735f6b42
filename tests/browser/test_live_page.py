"""The live page in a real browser."""

import itertools
import re

import pytest
from playwright.sync_api import expect
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.worlds import scenario

from slam.mapping.slam import Slam
from slam.mapping.stage_timer import NullTimer
from slam.runs.config_file import load_config
from slam.runs.offline import feed, finish
from slam.runs.status import Status
from slam.viewer.server import LiveServer
from slam.viewer.viewers import Viewers

TOKEN = "a-token-of-the-operator"
ALONE = ("ERR_CONNECTION_REFUSED", "WebSocket connection to")  # while the server is away


class LiveDrive:
    """The start of a drive along a corridor, as far as it is wanted, shown on a server."""

    def __init__(self, port: int = 0, token: str = "") -> None:
        self.viewers = Viewers()
        self.server = LiveServer("127.0.0.1", port, token)
        self.server.start()
        self.viewers.servers.append(self.server)
        self.slam = Slam(load_config(None, ["keyframes.method=sdp-pe"]))
        world = scenario("corridor", 0)
        drive = simulate(world, LASERS["hokuyo-181"], ODOMETRY_NOISE["typical"], 0)
        self._all = list(itertools.islice(drive, 1200))  # 40 s, some 20 m
        self._messages = iter(self._all)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.port}/"

    def go(self, messages: int) -> None:
        for message in itertools.islice(self._messages, messages):
            feed(self.slam, message)
            self.viewers._due = 0.0  # every step counts here, however fast it was
            self.viewers.show(self.slam, message)

    def end(self) -> None:
        self.slam.finish_input()
        result = finish(self.slam, lambda: self._all, [], NullTimer(), lambda stage, done: None)
        self.viewers.finish(result)


@pytest.fixture
def live():
    drive = LiveDrive()
    yield drive
    drive.server.close()


def colours(page) -> set[str]:
    """Which of the page's colours are on the canvas, on more than a handful of pixels."""
    return set(
        page.evaluate(
            """() => {
              const canvas = document.getElementById("map");
              const style = getComputedStyle(document.documentElement);
              const copy = new OffscreenCanvas(canvas.width, canvas.height);
              const context = copy.getContext("2d", { willReadFrequently: true });
              context.drawImage(canvas, 0, 0);
              const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
              const counts = new Map();
              for (let k = 0; k < data.length; k += 4) {
                const colour = (data[k] << 16) | (data[k + 1] << 8) | data[k + 2];
                counts.set(colour, (counts.get(colour) ?? 0) + 1);
              }
              const code = name => {
                const text = style.getPropertyValue("--" + name).trim().slice(1);
                return parseInt(text.length === 3 ? [...text].map(c => c + c).join("") : text, 16);
              };
              return ["unknown", "free", "wall", "scan", "path", "robot"].filter(
                name => counts.get(code(name)) > 20);
            }"""
        )
    )


def figure(page, name: str) -> float:
    """The first number of a field; 0 while there is none."""
    found = re.search(r"-?[\d.]+", page.locator(f"#{name}").inner_text())
    return float(found.group()) if found else 0.0


def wait_for_scans(page, live) -> None:
    expect(page.locator("#scans")).to_have_text(str(len(live.slam.scans)))
    page.wait_for_timeout(200)  # a picture or two


def test_the_map_grows_while_the_robot_drives(live, visit):
    with visit() as page:
        page.goto(live.address)
        expect(page.locator("#stage")).to_have_text("starting")
        assert not colours(page) & {"free", "scan", "robot"}
        live.go(200)
        expect(page.locator("#link")).to_have_text("live")
        wait_for_scans(page, live)
        before = {name: figure(page, name) for name in ("keyframes", "travelled", "extent")}
        assert before["keyframes"] == len(live.slam.keyframes) > 1
        live.go(600)
        wait_for_scans(page, live)
        assert {"unknown", "free", "wall", "scan", "robot"} <= colours(page)
        assert figure(page, "keyframes") == len(live.slam.keyframes) > before["keyframes"]
        assert figure(page, "travelled") > before["travelled"] + 3.0
        assert figure(page, "extent") > before["extent"]
        assert figure(page, "t_pe") > 0.0
        assert figure(page, "interval") > 0.0
        assert "mm" in page.locator("#sigmas").inner_text()
        assert page.locator("#history .interval").get_attribute("d").startswith("M")
        live.end()
        expect(page.locator("#link")).to_have_text("finished")


def test_light_and_dark_are_two_pictures_and_the_hands_work(live, visit):
    live.go(500)
    with visit("dark") as page:
        page.goto(live.address)
        wait_for_scans(page, live)
        dark = page.screenshot()
        assert {"free", "wall"} <= colours(page)
        page.emulate_media(color_scheme="light")
        page.wait_for_timeout(200)
        assert {"free", "wall"} <= colours(page)
        assert page.screenshot() != dark
        page.get_by_role("button", name="follow robot").click()
        expect(page.locator("#follow")).to_have_attribute("aria-pressed", "true")
        page.mouse.move(300, 300)
        page.mouse.wheel(0, -300)
        page.mouse.down()
        page.mouse.move(340, 340, steps=3)
        page.mouse.up()
        expect(page.locator("#follow")).to_have_attribute("aria-pressed", "false")


def test_devices_losses_and_news_are_shown(live, visit):
    live.go(200)
    with visit() as page:
        page.goto(live.address)
        for seconds, kind in ((1.0, "connected"), (2.0, "lost")):
            live.viewers.tell(
                Status(
                    seconds, {"p3dx": "connected", "laser": kind}, 39.9, 0.012, 0, 3, 2.5, (),
                    {"laser: outages": 1}, (f"laser {kind}: <b>for a test</b>",),
                )
            )  # fmt: skip
            expect(page.locator("#devices dd").nth(1)).to_have_text(kind)
        expect(page.locator("#losses")).to_contain_text("laser: outages")
        expect(page.locator("#news li")).to_have_text(
            ["laser connected: <b>for a test</b>", "laser lost: <b>for a test</b>"]
        )


def test_the_headline_says_why_nothing_is_live(live, visit):
    live.go(200)
    links = {"p3dx": "connected", "laser": "connected"}
    robot = {"battery": "12.8 V", "motors": "off", "STOP button": "pressed"}
    with visit() as page:
        page.goto(live.address)
        live.viewers.tell(Status(1.0, links, 40.0, 0.02, 0, 3, 2.5, (), {}, robot=robot))
        expect(page.locator("#link")).to_have_text("live")
        expect(page.locator("#devices dd")).to_contain_text(["connected", "12.8 V", "off"])
        live.viewers.tell(
            Status(
                2.0, links | {"laser": "failed"}, 0.0, 6.2, 0, 3, 2.5, (), {},
                reasons={"laser": "no <i>Hokuyo</i> answers; trying again, 3 times so far"},
                robot=robot, warnings=("the STOP button is pressed",),
            )
        )  # fmt: skip
        expect(page.locator("#link")).to_have_text(
            "not live: laser failed: no <i>Hokuyo</i> answers; trying again, 3 times so far"
        )
        expect(page.locator("#link")).to_have_attribute("data-state", "lost")
        expect(page.locator("#devices")).to_contain_text("6.2 s")
        expect(page.locator("#reasons li").last).to_have_text("the STOP button is pressed")
        live.viewers.tell(Status(3.0, links, 40.0, 0.02, 0, 3, 2.5, (), {}, robot=robot))
        expect(page.locator("#link")).to_have_text("live")


def test_a_page_comes_back_after_the_server_was_away(visit):
    first = LiveDrive()
    first.go(400)
    with visit(allowed=ALONE) as page:
        page.goto(first.address)
        wait_for_scans(page, first)
        first.server.close()
        expect(page.locator("#link")).to_contain_text("no connection")
        second = LiveDrive(first.server.port)
        try:
            second.go(150)
            wait_for_scans(page, second)
            expect(page.locator("#link")).to_have_text("live")
            assert figure(page, "keyframes") == len(second.slam.keyframes)
            second.go(100)
            wait_for_scans(page, second)
        finally:
            second.server.close()


def test_another_site_sees_nothing(live, visit):
    foreign = LiveDrive()  # any other origin will do: here a second server
    try:
        with visit(allowed=("Content Security Policy", "WebSocket")) as page:
            page.goto(f"http://localhost:{foreign.server.port}/")
            code = page.evaluate(OPEN_FEED, f"ws://127.0.0.1:{live.server.port}/feed")
            assert code == "refused"
            page.goto("about:blank")  # a page without a policy of its own
            code = page.evaluate(OPEN_FEED, f"ws://127.0.0.1:{live.server.port}/feed")
            assert code == "refused"
        with visit() as page:
            page.goto(live.address)
            code = page.evaluate(OPEN_FEED, f"ws://127.0.0.1:{live.server.port}/feed")
            assert code == "open"
    finally:
        foreign.server.close()


OPEN_FEED = """address => new Promise(resolve => {
  const socket = new WebSocket(address);
  socket.onopen = () => { socket.close(); resolve("open"); };
  socket.onerror = () => resolve("refused");
})"""


def test_without_the_token_there_is_only_a_line_of_text(visit):
    live = LiveDrive(token=TOKEN)
    live.go(200)
    try:
        with visit(allowed=("403", "Content Security Policy")) as page:
            assert page.goto(live.address).status == 403
            assert "token is missing" in page.inner_text("body")
            assert (
                page.evaluate(OPEN_FEED, f"{live.address}feed".replace("http", "ws")) == "refused"
            )
        with visit() as page:
            page.goto(f"{live.address}?token={TOKEN}")
            wait_for_scans(page, live)
    finally:
        live.server.close()
