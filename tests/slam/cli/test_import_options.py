"""`slam import`, `info` and `reoptimise` over foreign files: exit codes, and what is said."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from slam.logs.mcap_log import open_log
from slam.logs.messages import LaserExtrinsics

from slam.cli.app import app
from tests.logs import bags
from tests.logs.bags import drive


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    error = result.exception
    known = error is not None and getattr(error, "explains_itself", False)
    return (1, str(error)) if known else (result.exit_code, result.output)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out.mcap"


def test_an_import_says_what_it_chose(tmp_path, out):
    robot = drive(
        scan="/robot1/scan", odom="/robot1/odom", tf="/tf_static", laser="robot1/laser",
        child="robot1/base_link", frame="robot1/odom", mount=(0.2, 0.1, 1.0),
    )  # fmt: skip
    bag = bags.write_bag2(tmp_path / "bag", robot)
    code, said = run("import", bag, "--out", out)
    assert code == 0
    assert (
        "scans from /robot1/scan, odometry from /robot1/odom, laser at (0.20, 0.10, 57.3 deg)"
        in said
    )
    code, said = run("info", bag)
    assert code == 0
    for part in ("/robot1/scan", "10.00 Hz", "sensor_msgs/msg/LaserScan, robot1/laser", "57.3 deg"):
        assert part in said
    with open_log(out) as log:
        assert log.metadata()["import"]["chosen 1"] == "scans from /robot1/scan"


def test_a_guess_ends_with_3_and_an_answer_with_0(tmp_path, out):
    bag = bags.write_bag2(tmp_path / "bag", drive(mount=None))
    code, said = run("import", bag, "--out", out)
    assert code == 3
    assert "warning: no transform from base_link to laser" in said
    assert run("import", bag, "--out", out, "--mount", "0.16,0,180deg")[0] == 0
    with open_log(out) as log:
        (mount,) = log.messages(("/tf",))
    assert isinstance(mount, LaserExtrinsics)
    assert (mount.x, mount.theta) == pytest.approx((0.16, 3.14159265))
    code, said = run("import", bag, "--out", out, "--mount", "0.16,0,180")
    assert code == 2
    code, said = run("import", bag, "--out", out, "--scan", "/other")
    assert code == 1
    assert "--scan (there are: /scan)" in said
    code, said = run("import", bag, "--out", out, "--odom", "none", "--from", 0.5, "--to", 1)
    assert code == 0
    assert "6 scans, 7 messages" in said


def test_drives_and_clocks_have_options(tmp_path, out):
    items = drive(20)
    again = [(t, k, r + 5 * 10**9, m) for t, k, r, m in drive(20) if t != "/tf_static"]
    bag = bags.write_bag2(tmp_path / "bag", items + again)
    code, said = run("import", bag, "--out", out)
    assert (code, "--drive N" in said, "--use-receipt-time" in said) == (1, True, True)
    assert run("import", bag, "--out", out, "--drive", 2)[0] == 0
    assert run("import", bag, "--out", out, "--use-receipt-time")[0] == 0


def test_reoptimise_tells_what_it_left_out(tmp_path):
    lines = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1.1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    (tmp_path / "a.g2o").write_text(lines)
    assert run("reoptimise", tmp_path / "a.g2o", "--out", tmp_path / "sound")[0] == 0
    (tmp_path / "b.g2o").write_text(lines + "EDGE_PRIOR_SE2 0 0 0 0 1 0 0 1 0 1\n")
    code, said = run("reoptimise", tmp_path / "b.g2o", "--out", tmp_path / "some")
    assert code == 3
    assert "left out: 1 EDGE_PRIOR_SE2 lines" in said
