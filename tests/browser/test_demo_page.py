"""The demonstration as an operator sees it: simulated devices, `slam online`, a browser."""

import re
import subprocess
import sys
import time

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.slow


def test_the_map_grows_during_the_demo(visit, tmp_path):
    log = tmp_path / "stderr"
    with log.open("w") as stderr:
        demo = subprocess.Popen(
            [sys.executable, "-m", "slam", "demo", "--out", str(tmp_path / "demo")],
            stdout=subprocess.DEVNULL, stderr=stderr,
        )  # fmt: skip
    try:
        with visit(allowed=("ERR_CONNECTION_REFUSED", "WebSocket connection to")) as page:
            page.goto(address(log, demo))
            seen = set()
            end = time.monotonic() + 200.0
            while "finished" not in page.locator("#link").inner_text():
                assert time.monotonic() < end
                assert demo.poll() is None
                seen.add(page.locator("#keyframes").inner_text())
                page.wait_for_timeout(100)
            assert len(seen) >= 4, seen
            expect(page.locator("#devices")).to_contain_text("p3dx")
            page.screenshot(path=tmp_path / "demo.png")
        assert demo.wait(200) == 0, log.read_text()
    finally:
        demo.kill()
        demo.wait()


def address(log, demo) -> str:
    """Where the online command of the demo says that the page is."""
    end = time.monotonic() + 200.0
    while not (found := re.search(r"live view: (http://127\.0\.0\.1:\d+/)", log.read_text())):
        assert demo.poll() is None, log.read_text()
        assert time.monotonic() < end
        time.sleep(0.2)
    return found.group(1)
