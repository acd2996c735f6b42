"""Two devices, one log, one pipeline: the part of an online run that lasts as long as the drive."""

from __future__ import annotations

import time
from array import array
from collections import deque
from collections.abc import Callable

from slam.drivers.connection import Clock, Received
from slam.drivers.hokuyo import Hokuyo
from slam.drivers.pioneer import Pioneer
from slam.drivers.ports import Port, open_port
from slam.drivers.reader import DeviceReader
from slam.logs.messages import LaserScan
from slam.logs.recorder import Recorder
from slam.mapping.slam import Slam
from slam.online.device_notes import RobotWatch, clock_model, health, identity, line_of
from slam.online.robot_config import RobotConfig
from slam.online.sequencer import MessageSequencer, Taken
from slam.runs.errors import RunError
from slam.runs.observer import NullObserver, Observer
from slam.runs.offline import feed
from slam.runs.replay import TimedStep
from slam.runs.status import GOOD_LINKS, STALE_S, Status, device_losses

_POLL_S = 0.1  # how soon a request to stop is noticed
_DISK_S = 0.5  # s between two looks at whether recording has ended
_NOBODY = "answers on"  # in what a driver says of a port that opens, but stays silent
_SWAPPED = (
    "both ports open and neither device answers: are robot.port and laser.port swapped? "
    "`slam drivers probe PORT` says which device is where"
)
_DIAGNOSTICS_S = 5.0  # between two notes of losses and devices in the log


class LiveRun:
    """Threads read and record; the pipeline runs in the thread that calls `run`.

    A pipeline that falls behind makes its inbox longer and delays nothing else.  `slam` is
    None where only a recording is wanted.
    """

    def __init__(
        self,
        config: RobotConfig,
        recorder: Recorder,
        clock: Clock,
        slam: Slam | None,
        opener: Callable[[str, int], Port] = open_port,
        observer: Observer | None = None,
    ) -> None:
        self.slam = slam
        self.sequencer = MessageSequencer(recorder, hand_on=slam is not None)
        robot = config.robot
        self.robot: Pioneer | None = None
        if robot is not None:
            self.robot = Pioneer(robot.driver(), self.sequencer, clock, opener)
        self.laser = Hokuyo(config.laser.driver(), self.sequencer, clock, opener)
        self.sessions = [one for one in (self.robot, self.laser) if one is not None]
        self.readers = [
            DeviceReader(session, self.sequencer, clock=clock) for session in self.sessions
        ]
        self.timed = TimedStep()
        self.latencies_ms = array("d")  # from a scan's last byte until `step` is done with it
        self.searching_ms = array("d")  # likewise, of scans that came while a loop search ran
        self.delays_ms = array("d")  # likewise, until it is used: it waits for odometry after it
        self.cpu_share = 0.0  # of one core, while the devices were read
        self.ended_by = ""  # why the run ended by itself
        self._recorder, self._clock, self._extrinsics = recorder, clock, config.mount
        self._observer = observer or NullObserver()
        self._links: dict[str, str] = {session.device: "waiting" for session in self.sessions}
        self._last_texts: dict[str, str] = {}
        self._notices: list[str] = []
        self._unused: deque[int] = deque()  # receipts of scans that wait for odometry
        self._newest_ns = 0  # receipt of the newest scan that has been used
        self._robot_watch = RobotWatch()
        self._closing = False  # whether the devices are not read any more
        self._hinted = False  # that the ports may be swapped
        self._reasons: dict[str, str] = {}  # of links that are not good, and what devices say
        self._metadata: dict[str, dict[str, str]] = {}  # metadata by its name
        self._diagnosed_ns = self._status_ns = self._began_ns = self._disk_checked_ns = 0
        self._status_scans = 0

    def run(
        self, stop: Callable[[], bool], on_status: Callable[[Status], None], period_s: float = 1.0
    ) -> None:
        """Work until `stop` says so or recording has ended; then use what still waits.

        Raises:
            RunError: a device's thread has died.
        """
        now = self._began_ns = self._status_ns = self._clock()
        cpu_s = time.process_time()
        self.sequencer(Received(now, self._extrinsics.message(now)))
        for reader in self.readers:
            reader.start()
        try:
            while not (stop() or self._ended()):
                self._use(self.sequencer.get(_POLL_S))
                self._status_if_due(on_status, period_s)
        finally:
            for reader in self.readers:
                reader.stop()
            self._closing = True
        self.cpu_share = (time.process_time() - cpu_s) / ((self._clock() - now) * 1e-9)
        while (received := self.sequencer.get(0.0)) is not None:
            self._use(received)
            self._status_if_due(on_status, period_s)
        if self.slam is not None:
            self.slam.finish_input()
        self._device_events()
        self._write_diagnostics(self._clock())

    def _use(self, received: Taken | None) -> None:
        if received is None or self.slam is None:
            return
        message = received.message
        if isinstance(message, LaserScan):
            self._unused.append(received.receipt_ns)
        searching = self.slam.loops.searching
        feed(self.slam, message, self.timed)
        searching = searching or self.slam.loops.searching
        self._observer.show(self.slam, message)
        now = self._clock()
        if isinstance(message, LaserScan):
            self._newest_ns = received.receipt_ns
            self.latencies_ms.append((now - received.receipt_ns) * 1e-6)
            if searching:
                self.searching_ms.append(self.latencies_ms[-1])
        while len(self._unused) > self.slam.waiting_scans:
            self.delays_ms.append((now - self._unused.popleft()) * 1e-6)

    def _ended(self) -> bool:
        dead = [reader for reader in self.readers if not reader.running]
        if dead:
            raise RunError("the thread of a device has died; this is a defect of ours, see above")
        now = self._clock()
        if now - self._disk_checked_ns >= _DISK_S * 1e9:
            self._disk_checked_ns = now
            self._check_recording()
        return bool(self.ended_by)

    def _check_recording(self) -> None:
        """Where the disk has no room left, the map goes on without a log."""
        status = self._recorder.status()
        if not status.stopped or self.sequencer.unlogged:
            return
        if self.slam is not None and status.files:
            self.sequencer.unlogged = True
            self._notices.append(f"{status.stopped}; the map goes on without a log")
        else:
            self.ended_by = status.stopped

    def _status_if_due(self, on_status: Callable[[Status], None], period_s: float) -> None:
        now = self._clock()
        if now - self._status_ns < period_s * 1e9:
            return
        status = self._status(now)
        on_status(status)
        self._observer.tell(status)
        self._status_ns, self._status_scans = now, self.sequencer.scans
        if now - self._diagnosed_ns >= _DIAGNOSTICS_S * 1e9:
            self._write_diagnostics(now)

    def _status(self, now: int) -> Status:
        news = self._device_events()
        slam = self.slam
        age_s = (now - (self._newest_scan_ns() or self._began_ns)) * 1e-9
        stale = age_s > STALE_S
        decision = slam.records.decisions[-1] if slam and slam.records.decisions else None
        return Status(
            seconds=(now - self._began_ns) * 1e-9,
            links=dict(self._links),
            scan_hz=(self.sequencer.scans - self._status_scans) / ((now - self._status_ns) * 1e-9),
            age_s=age_s,
            waiting=self.sequencer.waiting,
            keyframes=len(slam.keyframes) if slam else 0,
            t_pe=decision.t_pe if decision else float("nan"),
            sigmas=decision.achieved_sigmas if decision else (),
            lost=self.losses(),
            news=news,
            reasons={
                device: reason
                for device, reason in self._explained().items()
                if stale or self._links[device] not in GOOD_LINKS
            },
            robot={c.name: c.value for c in self._robot_watch.conditions},
            warnings=self._robot_watch.warnings,
        )

    def _newest_scan_ns(self) -> int:
        """When the newest scan came in that is used, or with no map to make, recorded."""
        return self.sequencer.last_scan_ns if self.slam is None else self._newest_ns

    def _explained(self) -> dict[str, str]:
        """Why a device is not there, and what is being done about it."""
        tries: dict[str, int] = {reader.device: reader.failures for reader in self.readers}
        found = {}
        for device, reason in self._reasons.items():
            trying = f"; trying again, {tries[device]} times so far" if tries[device] else ""
            again = trying if self._links[device] in ("lost", "failed") else ""
            found[device] = f"{reason.rstrip('. ')}{again}"
        return found

    def _device_events(self) -> tuple[str, ...]:
        """What has happened to the devices, without repeating that one is still not there."""
        news, self._notices = self._notices, []
        for event in self.sequencer.events():
            detail = event.detail.removeprefix(f"{event.kind}: ")
            if event.kind != "notice":
                self._links[event.device] = event.kind
            if event.kind in GOOD_LINKS:
                self._reasons.pop(event.device, None)
            elif event.kind != "closed":
                self._reasons[event.device] = detail
            self._observer.note(line_of(event))
            text = f"{event.device} {event.kind}: {detail}"
            if text != self._last_texts.get(event.device):
                self._last_texts[event.device] = text
                news.append(text)
        return (*news, *self._robot_events(), *self._swap_hint())

    def _swap_hint(self) -> list[str]:
        """A hint where both ports are there and neither answers as what it should be."""
        silent = all(_NOBODY in self._reasons.get(device, "") for device in self._links)
        if not silent or self._hinted:
            return []
        self._hinted = True
        return [_SWAPPED]

    @property
    def never_connected(self) -> dict[str, str]:
        """Devices that have not been there at all, and why."""
        explained = self._explained()
        return {
            reader.device: explained.get(reader.device, "there was no time for it")
            for reader in self.readers if not reader.connections
        }  # fmt: skip

    def _robot_events(self) -> list[str]:
        """What has changed about the robot itself; it goes into the log as well."""
        if self.robot is None or self._links["p3dx"] not in GOOD_LINKS:
            self._robot_watch.forget()
            return []
        lines = self._robot_watch.look(self.robot.decoder, self._clock())
        for line in lines:
            self._recorder.put(line)
            self._observer.note(line)
        return [f"p3dx: {line.text}" for line in lines]

    def losses(self) -> dict[str, int]:
        """What was lost so far, by cause; an outage counts as one."""
        status = self._recorder.status()
        found: dict[str, int] = {}
        for session in self.sessions:
            found |= device_losses(session.device, session.decoder.counters())
        for reader in self.readers:
            if reader.outages:
                found[f"{reader.device}: outages"] = reader.outages
        for topic, count in sorted((status.dropped | status.refused).items()):
            found[f"not recorded: {topic}"] = count
        if self._closing:
            found |= {f"{device}: never connected": 1 for device in self.never_connected}
        if self.slam is not None:
            found |= dict(self.slam.lost)
        return found

    def devices(self) -> dict[str, dict[str, int]]:
        """All counters of the devices, for the summary."""
        counters = [session.decoder.counters() for session in self.sessions]
        return {
            reader.device: {"connections": reader.connections, "outages": reader.outages, **counted}
            for reader, counted in zip(self.readers, counters, strict=True)
        }

    def _write_diagnostics(self, now: int) -> None:
        """Write into the log itself who the devices are, how they stand, and what was lost."""
        self._diagnosed_ns = now
        notes = {"lost": {cause: str(n) for cause, n in self.losses().items()}}
        for session in self.sessions:
            device, decoder = session.device, session.decoder
            reason = self._explained().get(device, "")
            state = health(now, device, self._links[device], decoder, reason)
            self._recorder.put(state)
            self._observer.note(state)
            notes[device] = identity(decoder) | clock_model(decoder)
        for name, values in notes.items():
            if values != self._metadata.get(name, {}):
                self._metadata[name] = values
                self._recorder.add_metadata(name, values)
