import os
import socket
import time

import pytest
import serial
from slam.drivers.errors import LinkLost, PortError
from slam.drivers.ports import open_port
from slam.drivers.simulators.link import Line, MemoryLink, SimulatedTime, WireFaults
from slam.drivers.simulators.servers import PtyEndpoint, SimulatorServer, TcpEndpoint


class Ticker:
    """Sends a numbered byte every 10 ms and keeps what it is sent."""

    def __init__(self, baud=9600, size=1):
        self.baud, self.heard, self.sent, self._size = baud, b"", 0, size

        self.left = 0

    def prepare(self):
        pass

    def client_left(self):
        self.left += 1

    def receive(self, data, now_s):
        self.heard += data

    def advance(self, now_s):
        out = b""
        while (self.sent + 1) * 0.01 <= now_s:
            self.sent += 1
            out += bytes([self.sent % 256]) * self._size
        return out


def read_for(line, seconds, baud=9600):
    time_, chunks = SimulatedTime(), []
    port = MemoryLink(line, time_)("memory", baud)
    while time_.now_s < seconds:
        if data := port.read(0.01):
            chunks.append((time_.now_s, data))
    return chunks


def read_until_lost(port):
    for _ in range(3000):
        port.read(0.1)


def joined(chunks):
    return b"".join(data for _, data in chunks)


def test_a_sound_line_carries_everything_in_order():
    got = joined(read_for(Line(Ticker()), 1.0))
    assert got == bytes(range(1, len(got) + 1))
    assert len(got) in (98, 99, 100)


def test_a_baud_rate_is_a_limit():
    chunks = read_for(Line(Ticker(baud=9600, size=20)), 2.0)  # twice what 9600 baud carry
    assert len(joined(chunks)) == pytest.approx(960 * 2.0, rel=0.02)
    line = Line(Ticker(baud=9600, size=20))
    read_for(line, 5.0)
    assert line.dropped_bytes > 0
    assert len(joined(read_for(Line(Ticker(size=20), serial=False), 2.0))) > 3900


def test_at_the_wrong_speed_nothing_is_readable():
    line = Line(Ticker())
    assert joined(read_for(line, 1.0, baud=38400)) != bytes(range(1, 100))
    line.to_device(b"hello", 2.0, 19200)
    assert b"hello" not in line.device.heard


def test_packets_can_be_split_and_merged():
    split = read_for(Line(Ticker(size=8), WireFaults(split=3), serial=False), 0.5)
    assert max(len(data) for _, data in split) == 3
    merged = read_for(Line(Ticker(), WireFaults(hold_s=0.1), serial=False), 1.0)
    assert len(merged) <= 21
    assert joined(merged) == bytes(range(1, len(joined(merged)) + 1))


def test_delays_keep_the_order():
    got = joined(read_for(Line(Ticker(), WireFaults(delay_s=0.2, seed=1)), 2.0))
    assert got == bytes(range(1, len(got) + 1))


def test_flips_and_losses_are_as_frequent_as_asked_and_repeat_with_their_seed():
    def run(seed):
        line = Line(Ticker(size=50), WireFaults(flip_rate=0.02, seed=seed), serial=False)
        return joined(read_for(line, 1.0)), line.damaged_bytes

    first, damaged = run(1)
    assert damaged == pytest.approx(len(first) * 0.02, rel=0.3)
    assert (first, damaged) == run(1)
    assert first != run(2)[0]
    lost = Line(Ticker(size=50), WireFaults(loss_rate=0.1), serial=False)
    assert len(joined(read_for(lost, 1.0))) == pytest.approx(4900 * 0.9, rel=0.05)


def test_silence_loses_and_an_unplugged_port_is_gone():
    got = joined(read_for(Line(Ticker(), WireFaults(silences=((0.3, 0.6),))), 1.0))
    assert set(range(32, 59)).isdisjoint(got)
    line, now = Line(Ticker(), WireFaults(unplugged=((1.0, 2.0),))), SimulatedTime()
    link = MemoryLink(line, now)
    port = link("memory", 9600)
    with pytest.raises(LinkLost):
        read_until_lost(port)
    with pytest.raises(PortError):
        link("memory", 9600)
    now.sleep(1.0)
    again = link("other", 9600)
    with pytest.raises(LinkLost):
        port.write(b"x")  # the old handle stays dead
    assert again.read(0.1)


@pytest.mark.parametrize("wrong", [{"flip_rate": 2.0}, {"loss_rate": -1.0}, {"delay_s": -1.0}])
def test_rates_that_are_none_are_refused(wrong):
    with pytest.raises(ValueError, match=r"between|negative"):
        WireFaults(**wrong)


def test_a_pty_carries_both_directions_and_has_a_speed(tmp_path):
    device = Ticker(baud=38400)
    endpoint = PtyEndpoint(Line(device), tmp_path / "robot")
    with SimulatorServer([endpoint]):
        port = open_port(endpoint.name, 38400)
        port.write(b"hello")
        got = port.read(1.0)
        for _ in range(20):
            got += port.read(0.1)
        port.set_baud(9600)
        time.sleep(0.05)
        port.write(b"again")
        time.sleep(0.05)
        port.close()
    assert device.heard.startswith(b"hello")
    assert b"again" not in device.heard
    assert len(got) > 20
    assert got[10:15] == bytes(range(got[10], got[10] + 5))


def test_what_nobody_has_read_is_not_kept_for_the_next_client(tmp_path):
    device = Ticker(size=50)
    endpoint = PtyEndpoint(Line(device, serial=False), tmp_path / "laser")
    with SimulatorServer([endpoint]) as server:
        for _ in range(2):  # before the first client, and between two
            before = device.sent
            end = server.now_s + 0.6
            while server.now_s < end:
                time.sleep(0.02)
            assert device.sent > before + 30  # time passes for it all the same
            port = open_port(endpoint.name, 9600)
            first = port.read(1.0)
            assert (device.sent - first[0]) % 256 < 25
            time.sleep(0.2)  # leave some unread
            port.close()


def test_a_device_on_the_network_learns_that_its_client_has_left(tmp_path):
    device = Ticker()
    endpoint = TcpEndpoint(Line(device, serial=False))
    with SimulatorServer([endpoint]):
        port = open_port(endpoint.name)
        assert port.read(2.0)
        assert device.left == 0
        port.close()
        end = time.monotonic() + 10.0
        while not device.left and time.monotonic() < end:
            time.sleep(0.01)
    assert device.left == 1


def test_a_simulator_removes_its_own_names_alone(tmp_path):
    first = PtyEndpoint(Line(Ticker()), tmp_path / "laser")
    second = PtyEndpoint(Line(Ticker()), tmp_path / "laser")
    first.close()
    assert os.readlink(tmp_path / "laser") == second.device
    second.close()
    assert not (tmp_path / "laser").is_symlink()


def test_a_replugged_pty_is_found_by_its_alias(tmp_path):
    line = Line(Ticker(), WireFaults(unplugged=((0.3, 0.6),)))
    endpoint = PtyEndpoint(line, tmp_path / "laser")
    with SimulatorServer([endpoint]) as server:
        port = open_port(endpoint.name)
        with pytest.raises(LinkLost):
            read_until_lost(port)
        port.close()
        with pytest.raises(PortError, match="does not exist"):
            open_port(endpoint.name)
        while server.now_s < 0.7:
            time.sleep(0.02)
        assert os.readlink(endpoint.name) == endpoint.device
        port = open_port(endpoint.name)
        assert port.read(1.0)
        port.close()


def test_a_pty_in_use_is_told_as_such():
    endpoint = PtyEndpoint(Line(Ticker()))
    with SimulatorServer([endpoint]):
        port = open_port(endpoint.name)
        with pytest.raises(PortError, match="in use by another program"):
            open_port(endpoint.name)
        port.close()


def test_tcp_carries_both_directions_to_one_client():
    device = Ticker()
    endpoint = TcpEndpoint(Line(device, serial=False))
    with SimulatorServer([endpoint]):
        port = open_port(endpoint.name)
        port.write(b"hello")
        assert port.read(1.0)
        second = open_port(endpoint.name.replace("tcp", "socket"))
        with pytest.raises(LinkLost, match="closed"):
            read_until_lost(second)
        assert port.read(1.0)
        second.close()
        port.close()
        time.sleep(0.05)
        third = open_port(endpoint.name)
        assert third.read(1.0)
        third.close()
    assert device.heard == b"hello"


def test_an_address_where_nobody_listens_is_told_as_such():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        number = listener.getsockname()[1]
    with pytest.raises(PortError, match="one client at a time"):
        open_port(f"tcp://127.0.0.1:{number}")


@pytest.mark.parametrize("name", ["tcp://", "tcp://host", "tcp://host:x", "tcp://:5"])
def test_addresses_that_are_none_are_told_as_such(name):
    with pytest.raises(PortError):
        open_port(name)


def test_a_missing_port_names_those_there_are():
    with pytest.raises(PortError, match=r"does not exist.*Ports on this machine"):
        open_port("/dev/does-not-exist")


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (serial.SerialException(13, "Permission denied"), "usermod -a -G dialout"),
        (serial.SerialException(16, "Device or resource busy"), "in use by another"),
        (serial.SerialException(5, "Input/output error"), "cannot be opened"),
        (ValueError("invalid URL"), "cannot be opened"),
    ],
)
def test_each_refusal_of_a_port_has_its_advice(monkeypatch, error, advice):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(PortError, match=advice):
        open_port("/dev/ttyUSB0")


@pytest.mark.parametrize(
    ("error", "advice"),
    [(TimeoutError("timed out"), "netmask"), (OSError(113, "No route to host"), "netmask")],
)
def test_each_refusal_of_an_address_has_its_advice(monkeypatch, error, advice):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(socket, "create_connection", refuse)
    with pytest.raises(PortError, match=advice):
        open_port("tcp://192.168.0.10:10940")
