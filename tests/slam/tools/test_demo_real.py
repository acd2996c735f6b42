"""`slam demo --real` on a small graph with scans in place of the one that rtb-data ships."""

import math
import sys
import zipfile

import pytest

from slam.runs.errors import RunError
from slam.tools.demo.real import run_real_demo, shipped_graph


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """A package `rtbdata` with no data yet; returns its data folder."""
    folder = tmp_path / "site" / "rtbdata"
    (folder / "data").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(folder.parent)
    yield folder / "data"
    sys.modules.pop("rtbdata", None)


def graph_text(steps=12):
    """A room 8 m long and 6 m wide, seen every 0.3 m by a laser of 181 beams."""
    lines = []
    for k in range(steps):
        ranges = " ".join(f"{_range(0.3 * k - 2.0, i - 90):.3f}" for i in range(181))
        lines += [
            f"VERTEX_SE2 {k} {0.3 * k} 0 0",
            f"ROBOTLASER1 0 -1.5707963 3.1415927 0.0174533 30 0.1 0 181 {ranges} 0 "
            f"{0.3 * k} 0 0 {0.3 * k} 0 0 0 0 0 0 0 {k + 1}.0 host {k + 1}.0",
        ]
    lines += [f"EDGE_SE2 {k} {k + 1} 0.31 0 0 100 0 0 100 0 400" for k in range(steps - 1)]
    return "\n".join(lines) + "\n"


def _range(x, bearing_deg):
    c, s = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
    ahead = (4.0 - x) / c if c > 1e-9 else math.inf
    aside = 3.0 / abs(s) if abs(s) > 1e-9 else math.inf
    return min(ahead, aside)


def test_the_graph_becomes_a_run_and_a_report(shipped, tmp_path, capsys):
    with zipfile.ZipFile(shipped / "killian.g2o.zip", "w") as archive:
        archive.writestr("killian.g2o", graph_text())
    out = tmp_path / "demo"
    run_real_demo(out, lambda text: None)
    assert (out / "report.html").is_file()
    assert (out / "killian" / "map.png").is_file()
    said = capsys.readouterr().out
    assert "0 loops, 3 m in" in said
    assert "m rmse from the solution" in said


def test_data_without_the_graph_is_named(shipped):
    with pytest.raises(RunError, match="has no such file"):
        shipped_graph()


def test_a_missing_package_is_named_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "rtbdata", None)
    with pytest.raises(RunError, match="sdp-slam"):
        shipped_graph()
