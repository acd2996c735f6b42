"""`slam online` on simulated devices behind pseudo-terminals, in real time."""

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
from gtsam import Pose2
from slam.drivers.simulators.hokuyo_device import HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line, WireFaults
from slam.drivers.simulators.motion import scenario_motion
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.servers import PtyEndpoint, SimulatorServer
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import open_log
from slam.logs.messages import DeviceHealth, LaserScan, LogLine, RawBytes, WheelOdometry

from slam.online.robot_config import (
    LaserPort,
    MountConfig,
    RecordingConfig,
    RobotConfig,
    RobotPort,
)
from slam.online.run_online import run_online
from slam.runs.config_file import load_config
from slam.runs.errors import RunError
from slam.runs.kernel_warmup.warmup import warm_up
from slam.runs.replay import replay

SAME = ("graph.g2o", "graph.times.csv", "trajectory.tum", "keyframes.tum", "odometry.tum",
        "map.pgm")  # fmt: skip


class Robot:
    """Simulated devices, and what has to be written into robot.toml for them."""

    def __init__(self, base, laser, folder):
        self.base, self.laser = base, laser
        self.config = RobotConfig(
            robot=RobotPort(port=str(folder / "p3dx")),
            laser=LaserPort(port=str(folder / "laser"), from_deg=-90, to_deg=90, cluster=4),
            mount=MountConfig(x=0.16),
            recording=RecordingConfig(reserve_mib=0),
        )


@pytest.fixture
def simulated(tmp_path):
    @contextmanager
    def run(robot=None, laser=None, starts_s=2.0):
        bed = scenario("testbed-180cm")
        motion = scenario_motion(bed, starts_s=starts_s)
        bed.world.cast(Pose2(), np.zeros(1), 30.0)  # compiles it
        base = PioneerDevice(motion, world=bed.world)
        head = HokuyoDevice(Sweeper(MODELS["utm-30lx"], bed.world, motion))
        ports = [
            PtyEndpoint(Line(base, robot), tmp_path / "p3dx"),
            PtyEndpoint(Line(head, laser, serial=False), tmp_path / "laser"),
        ]
        with SimulatorServer(ports):
            yield Robot(base, head, tmp_path)

    return run


def after(seconds):
    """A `stop` that says so after a while."""
    end = []

    def stop():
        end.append(time.monotonic())
        return end[-1] - end[0] >= seconds

    return stop


@pytest.fixture(scope="module", autouse=True)
def compiled():
    warm_up(load_config(None))


def online_equals_replay(out, tmp_path):
    replay(out / "run.mcap", tmp_path / "again", load_config(out / "slam.toml"))
    for name in SAME:
        assert (out / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


FAULTS = [
    (None, None),
    (WireFaults(flip_rate=5e-5, delay_s=0.03, seed=1), WireFaults(flip_rate=1e-5, seed=2)),
    (WireFaults(silences=((3.0, 4.3),)), WireFaults(unplugged=((4.0, 4.6),), loss_rate=1e-5)),
]


@pytest.mark.parametrize("faults", FAULTS, ids=["none", "damage", "outages"])
def test_the_graph_is_that_of_the_replay(simulated, tmp_path, faults):
    told = []
    with simulated(*faults) as robot:
        out = tmp_path / "run"
        summary = run_online(
            robot.config, out, stop=after(8.0), on_status=told.append, period_s=0.5
        )
    online_equals_replay(out, tmp_path)
    assert summary == json.loads((out / "summary.json").read_text())
    assert summary["keyframes"] >= 3
    assert summary["recording"]["stopped"] == ""
    assert not robot.base.sending
    assert robot.laser.state == "idle"
    assert {c.id for c in robot.base.commands}.isdisjoint({4, 11, 21, 32})  # nothing that moves it
    assert told[-1].keyframes > 0
    assert "keyframes" in told[-1].line()
    outages = sum(device["outages"] for device in summary["devices"].values())
    assert outages == (2 if faults is FAULTS[2] else 0)
    with open_log(out / "run.mcap") as log:
        counts = log.counts()
        noted = log.metadata()
        said = list(log.messages(["/log", "/diagnostics"]))
    events = " ".join(f"{m.name} {m.text}" for m in said if isinstance(m, LogLine))
    last = {m.device: m for m in said if isinstance(m, DeviceHealth)}
    assert counts["/scan"] == summary["devices"]["laser"]["scans"]
    assert min(counts[f"/raw/{d}/{way}"] for d in ("p3dx", "laser") for way in ("rx", "tx")) > 0
    for name, figures in summary["devices"].items():
        assert last[name].link == "closed"
        shown = dict(zip(last[name].names, last[name].values, strict=True))
        assert {k: int(shown[k]) for k in figures if k in shown}.items() <= figures.items()
    assert noted["laser"]["SERI"] == "H0000001"
    assert noted["laser"]["steps_per_turn"] == "1440"
    assert abs(float(noted["laser"]["clock_offset_s"]) - time.time()) < 3600
    assert noted["p3dx"]["subclass"] == "p3dx-sh"
    assert noted["p3dx"]["metres"] == "0.001"
    assert "laser connected" in events
    assert "p3dx closed" in events
    assert ("p3dx lost" in events) == (faults is FAULTS[2])


def test_a_rotated_recording_stays_in_parts_and_gives_the_same_run(simulated, tmp_path):
    out = tmp_path / "run"
    with simulated() as robot:
        rotation = {"recording": RecordingConfig(reserve_mib=0, rotate_minutes=2 / 60)}
        summary = run_online(robot.config.model_copy(update=rotation), out, stop=after(6.0))
    assert summary["log"] == "recording_000.mcap"
    assert len(list(out.glob("recording_*.mcap"))) >= 3
    for again, from_raw in (("decoded", False), ("raw", True)):
        settings = load_config(out / "slam.toml")
        replay(out / summary["log"], tmp_path / again, settings, from_raw=from_raw)
        for name in SAME:
            assert (out / name).read_bytes() == (tmp_path / again / name).read_bytes(), name


def random_wire(rng):
    """Two kinds of fault on one wire; its windows begin while the robot drives."""
    at = rng.uniform(3.0, 5.5)
    window = ((at, at + rng.uniform(0.1, 1.2)),)
    kinds = {
        "flip_rate": 10.0 ** rng.uniform(-6, -4), "loss_rate": 10.0 ** rng.uniform(-6, -4),
        "split": int(rng.integers(20, 400)), "hold_s": rng.uniform(0.02, 0.1),
        "delay_s": rng.uniform(0.01, 0.05), "silences": window, "unplugged": window,
    }  # fmt: skip
    chosen = rng.choice(list(kinds), size=2, replace=False)
    return WireFaults(**{k: kinds[k] for k in chosen}, seed=int(rng.integers(1000)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_twenty_live_runs_with_random_faults_are_their_replays(simulated, tmp_path, seed):
    rng = np.random.default_rng(seed)
    with simulated(random_wire(rng), random_wire(rng)) as robot:
        run_online(robot.config, tmp_path / "run", stop=after(9.0))
    online_equals_replay(tmp_path / "run", tmp_path)


def test_messages_are_recorded_before_they_are_used_and_behind_their_bytes(simulated, tmp_path):
    with simulated() as robot:
        run_online(robot.config, tmp_path / "run", stop=after(3.0), record_only=True)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    with open_log(tmp_path / "run" / "run.mcap") as log:
        received = list(log.receipts())
    raw = {(t, m.device) for t, m in received if isinstance(m, RawBytes)}
    scans = [(t, m) for t, m in received if isinstance(m, LaserScan)]
    wheels = [(t, m) for t, m in received if isinstance(m, WheelOdometry)]
    assert len(scans) == summary["scans"] > 40
    assert all((t, "laser") in raw for t, _ in scans)
    assert all((t, "p3dx") in raw for t, _ in wheels)
    # Of two reports received at once, the second is stamped a nanosecond behind the first.
    assert all(m.stamp_ns <= t for t, m in scans)
    assert all(m.stamp_ns <= t + 10 for t, m in wheels)
    assert "keyframes" not in summary


def test_a_laser_carried_by_hand_needs_no_robot(simulated, tmp_path):
    with simulated() as robot:
        alone = RobotConfig(laser=robot.config.laser, recording=robot.config.recording)
        summary = run_online(alone, tmp_path / "run", stop=after(2.5))
    assert summary["laser_only"]
    assert summary["lost"] == {}
    assert list(summary["devices"]) == ["laser"]


def test_without_a_robot_the_map_is_made_by_the_laser_alone(simulated, tmp_path):
    with simulated() as robot:
        port = robot.config.robot.model_copy(update={"port": str(tmp_path / "nothing")})
        config = robot.config.model_copy(update={"robot": port})
        told = []
        summary = run_online(
            config, tmp_path / "run", stop=after(2.5), on_status=told.append, period_s=0.3
        )
    assert summary["laser_only"]
    assert summary["lost"]["p3dx: never connected"] == 1
    # On a busy machine one more comes when the devices have been closed.
    last = [status for status in told if "closed" not in status.links.values()][-1]
    assert last.links == {"p3dx": "failed", "laser": "connected"}
    assert "p3dx failed" in last.line()
    assert any("does not exist" in text for status in told for text in status.news)
    with open_log(tmp_path / "run" / "run.mcap") as log:
        assert log.counts()["/scan"] > 40
        assert "/odom" not in log.counts()


def fall_silent(*devices):
    """Whatever they hear, they say nothing any more."""
    for device in devices:
        device.receive = lambda data, now_s: None
        device.advance = lambda now_s: b""


def test_devices_that_fall_silent_are_told_as_such_everywhere(simulated, tmp_path):
    told, both = [], {"p3dx": "connected", "laser": "connected"}
    with simulated() as robot:
        give_up = after(60.0)

        def stopping():
            live = [status for status in told if status.links == both]
            robot.base.stop_pressed = len(live) > 1
            if any(status.warnings for status in live):
                fall_silent(robot.base, robot.laser)
            gone = told and not {"connected", "waiting"} & set(told[-1].links.values())
            return give_up() or bool(gone and told[-1].age_s > 2.0)

        run_online(robot.config, tmp_path / "run", stop=stopping, record_only=True,
                   on_status=told.append, period_s=0.3)  # fmt: skip
    live = [status for status in told if status.links == both]
    last = [status for status in told if "closed" not in status.links.values()][-1]
    assert min(status.age_s for status in live) < 0.5
    assert last.age_s > 2.0
    assert f"age {last.age_s:.1f} s" in last.line()
    assert "laser failed: no Hokuyo answers" in last.alarm or "laser lost: no scan" in last.alarm
    assert "trying again" in last.alarm
    pressed = next(s for s in told if s.warnings)
    assert "STOP button is pressed" in pressed.line()
    assert pressed.robot["STOP button"] == "pressed"
    with open_log(tmp_path / "run" / "run.mcap") as log:
        said = list(log.messages(["/log", "/diagnostics"]))
    lines = [f"{m.level} {m.name} {m.text}" for m in said if isinstance(m, LogLine)]
    assert any(text.startswith("warning p3dx the STOP button is pressed") for text in lines)
    assert any(text.startswith("error laser lost: no scan from the laser") for text in lines)
    health = [dict(zip(m.names, m.values, strict=True)) | {"link": m.link}
              for m in said if isinstance(m, DeviceHealth) and m.device == "p3dx"]  # fmt: skip
    assert health[-1]["stop_button"] == "pressed"
    assert health[-1]["motors"] == "on"
    assert health[-1]["battery_v"] == "12.8"


def test_a_disk_that_runs_full_ends_the_run_with_what_there_is(simulated, tmp_path, monkeypatch):
    with simulated() as robot:
        end = time.monotonic() + 4.0

        def disk_usage(folder):
            return SimpleNamespace(free=2**40 if time.monotonic() < end else 0)

        monkeypatch.setattr("slam.logs.recorder.shutil.disk_usage", disk_usage)
        config = robot.config.model_copy(update={"recording": RecordingConfig(reserve_mib=1)})
        with pytest.raises(RunError, match="kept in reserve"):
            run_online(config, tmp_path / "run", stop=after(20.0), record_only=True)
    with open_log(tmp_path / "run" / "run.mcap") as log:
        assert log.counts()


def test_the_map_goes_on_when_the_disk_has_no_room_left_for_the_log(
    simulated, tmp_path, monkeypatch
):
    end, told = time.monotonic() + 8.0, []

    def disk_usage(folder):
        return SimpleNamespace(free=2**40 if time.monotonic() < end else 0)

    monkeypatch.setattr("slam.logs.recorder.shutil.disk_usage", disk_usage)
    with simulated() as robot:
        config = robot.config.model_copy(update={"recording": RecordingConfig(reserve_mib=1)})
        out = tmp_path / "run"
        end = time.monotonic() + 4.0
        summary = run_online(config, out, stop=after(8.0), on_status=told.append, period_s=0.5)
    assert "the map goes on without a log" in " ".join(" ".join(status.news) for status in told)
    assert summary["recording"]["stopped"].endswith("free some space")
    assert summary["lost"]["not recorded: /scan"] > 40
    with open_log(out / "run.mcap") as log:
        recorded = log.counts()
        assert not log.skipped
    assert recorded["/scan"] < summary["scans"] - 40
    assert recorded["/pose"] == summary["scans"]
    assert (out / "map.pgm").exists()


def test_an_unfinished_recording_is_never_overwritten(tmp_path):
    left = tmp_path / "run.recording"
    left.mkdir()
    (left / "recording.mcap.partial").write_bytes(b"precious")
    config = RobotConfig(
        robot=RobotPort(port="a"), laser=LaserPort(port="b"), mount=MountConfig(x=0)
    )
    with pytest.raises(RunError, match="slam recover"):
        run_online(config, tmp_path / "run", stop=lambda: True)
    assert (left / "recording.mcap.partial").read_bytes() == b"precious"
    (tmp_path / "there").mkdir()
    with pytest.raises(RunError, match="exists already"):
        run_online(config, tmp_path / "there", stop=lambda: True)


def command(*words, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "slam", *map(str, words)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def as_from_a_terminal():
    """The tests themselves may have been started so that a closed terminal is ignored."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def finished(process):
    out, talk = process.communicate(timeout=60)
    assert "Traceback" not in talk
    return process.returncode, out, talk


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_leaves_a_complete_run(simulated, tmp_path, number, code):
    with simulated() as robot:
        (tmp_path / "robot.toml").write_text(
            tomli_w.dumps(robot.config.model_dump(exclude_none=True))
        )
        process = command(
            "online", "--config", tmp_path / "robot.toml", "--out", tmp_path / "run",
            "--set", "loops.enabled=false", preexec_fn=as_from_a_terminal,
        )  # fmt: skip
        wait_for(lambda: robot.laser.state == "stream" and robot.base.sending)
        time.sleep(2.0)
        process.send_signal(number)
        assert finished(process)[0] == code
        assert robot.laser.state == "idle"
        assert not robot.base.connected
    assert {p.name for p in (tmp_path / "run").iterdir()} >= {*SAME, "run.mcap", "summary.json"}
    assert not (tmp_path / "run.recording").exists()
    online_equals_replay(tmp_path / "run", tmp_path)


def test_under_nohup_a_closed_terminal_is_no_reason_to_stop(simulated, tmp_path):
    with simulated() as robot:
        (tmp_path / "robot.toml").write_text(
            tomli_w.dumps(robot.config.model_dump(exclude_none=True))
        )
        before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # which a child inherits
        try:
            process = command("online", "--config", tmp_path / "robot.toml", "--record-only",
                              "--out", tmp_path / "run")  # fmt: skip
        finally:
            signal.signal(signal.SIGHUP, before)
        wait_for(lambda: robot.laser.state == "stream" and robot.base.sending)
        process.send_signal(signal.SIGHUP)
        time.sleep(1.0)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert finished(process)[0] == 143


def wait_for(condition, seconds=40.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_killed_run_leaves_a_recording_to_recover(simulated, tmp_path):
    with simulated() as robot:
        (tmp_path / "robot.toml").write_text(
            tomli_w.dumps(robot.config.model_dump(exclude_none=True))
        )
        process = command("online", "--config", tmp_path / "robot.toml", "--out", tmp_path / "run",
                          "--record-only")  # fmt: skip
        wait_for(lambda: robot.laser.state == "stream" and robot.base.sending)
        time.sleep(2.0)
        process.kill()
        process.communicate()
    saved = tmp_path / "saved.mcap"
    left = tmp_path / "run.recording" / "recording.mcap.partial"
    recovering = command("recover", left, "--out", saved)
    assert finished(recovering)[0] in (0, 3)
    with open_log(saved) as log:
        assert log.counts()["/scan"] > 20


def test_the_command_says_what_is_wrong_in_one_line(tmp_path):
    (tmp_path / "robot.toml").write_text("[robot]\nport='a'\nbuad=9600\n")
    process = command("online", "--config", tmp_path / "robot.toml", "--out", tmp_path / "run")
    code, _, talk = finished(process)
    assert code == 1
    assert "robot.baud" in talk.splitlines()[-1]
    assert not (tmp_path / "run").exists()


def test_probe_names_both_devices_and_a_missing_one(simulated, tmp_path):
    with simulated() as robot:
        ports = [robot.config.robot.port, robot.config.laser.port, tmp_path / "none"]
        code, out, _ = finished(command("drivers", "probe", "--seconds", 0.5, *ports))
    assert code == 1
    assert "p3dx-sh" in out
    assert "UTM-30LX" in out
    assert "clock offset" in out
    assert "does not exist" in out


def test_devices_that_are_simulated_for_others_can_be_probed(tmp_path):
    simulator = command("drivers", "simulate", "--world", "testbed", "--folder", tmp_path)
    try:
        wait_for(lambda: (tmp_path / "laser").exists())
        asked = command("drivers", "probe", "--seconds", 0.5, tmp_path / "p3dx", tmp_path / "laser")
        code, out, talk = finished(asked)
        assert code == 0, out + talk
        assert "UTM-30LX" in out
    finally:
        simulator.send_signal(signal.SIGINT)
        code, out, _ = finished(simulator)
    assert code == 0
    assert str(tmp_path / "p3dx") in out


def test_what_cannot_be_simulated_is_refused(tmp_path):
    for option, value, words in (
        ("--world", "ofice", "unknown scenario"),
        ("--laser", "utm-30", "did you mean utm-30lx"),
        ("--robot", "b21", "no such robot"),
    ):
        code, _, talk = finished(command("drivers", "simulate", option, value))
        assert code == 1
        assert words in talk
