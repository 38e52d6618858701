"""
The live node for a long time: does it grow, does it slow down?

A publisher sends what a rig sends on a bad day: markers hidden, markers that jump, frames that
never come, and now and then a clock that jumps.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, Vector3Stamped
from rclpy.serialization import deserialize_message

from bench._rig import LAG, NODE, Asker, Rig, processes, wheels
from kinpole_ros.messages import stamp_to_ns

_RATE = 500.0
# Shares of markers hidden, of markers 0.1 m off, of frames that never come; s between clock jumps.
_HIDDEN, _OFF, _LOST = 0.05, 0.002, 0.01
_JUMP_EVERY = 20.0
_PERIOD = 60.0
_RESULTS = {
    'angular_velocity': Vector3Stamped,
    'icr': PointStamped,
    'centrode_curvature': Vector3Stamped,
}


class Minute(NamedTuple):
    """One minute: resident memory (MB), latency (s) by percentile, and what was counted in it."""

    memory: float
    p50: float
    p99: float
    worst: float
    sent: int
    answered: int
    counts: dict[str, int]


def soak(
    minutes: float, progress: Callable[[float], None] | None = None, rate: float = _RATE
) -> list[Minute]:
    """
    Run node and publisher at `rate` (Hz) for that many minutes; figures of each.

    Latency is from sending a frame to the arrival of its angular velocity. Raises OSError if the
    node ends, or does not answer.
    """
    with processes() as running:
        asker = Asker()
        try:
            asker.until(asker.publishers[NODE].get_subscription_count, 'the node at its markers')
            (wheel,) = wheels(1)
            topics = {
                topic: asker.hear(f'/{NODE}/{wheel}/{topic}', kind)
                for topic, kind in _RESULTS.items()
            }
            told = asker.hear('/diagnostics', DiagnosticArray)
            run = _Run(asker, rate)
            found: list[Minute] = []
            counts: dict[str, int] = {}
            for minute in range(max(1, round(minutes * 60 / _PERIOD))):
                run.sent.clear()
                answers: dict[int, int] = {}
                start = time.monotonic()
                while time.monotonic() < start + _PERIOD:
                    run.step()
                    for data, received in topics['angular_velocity']:
                        stamp = stamp_to_ns(deserialize_message(data, Vector3Stamped).header.stamp)
                        answers[stamp + round(LAG * 1e9)] = received
                    for heard in topics.values():
                        heard.clear()
                    if progress is not None:
                        done = (time.monotonic() - start) / _PERIOD
                        progress(min(1.0, (minute + done) * _PERIOD / 60 / minutes))
                if running[NODE].poll() is not None:
                    raise ChildProcessError('soak: the node ended; see what it printed')
                before, counts = counts, _counts(told)
                told.clear()
                times = [answers[s] - sent for s, sent in run.sent.items() if s in answers]
                p50, p99, worst = np.percentile(np.array(times) * 1e-9, (50, 99, 100)).tolist()
                since = {key: value - before.get(key, 0) for key, value in counts.items()}
                memory = _resident(running[NODE].pid)
                found.append(Minute(memory, p50, p99, worst, len(run.sent), len(times), since))
            return found
        finally:
            asker.close()


class _Run:
    """The publisher: each step one frame, at its time."""

    def __init__(self, asker: Asker, rate: float) -> None:
        self.sent: dict[int, int] = {}
        self._asker = asker
        self._rig = Rig()
        self._generator = np.random.default_rng(4)
        self._step = round(1e9 / rate)
        self._stamp = 10**12
        self._since_jump = 0
        self._due = time.monotonic()

    def step(self) -> None:
        self._stamp += self._step
        self._since_jump += self._step
        if self._since_jump > _JUMP_EVERY * 1e9:
            self._stamp += self._generator.integers(-(10**11), 10**11)
            self._since_jump = 0
        lots = self._generator.random(3)
        data = self._rig.at(self._stamp, hidden=lots[0] < 4 * _HIDDEN, off=lots[1] < 4 * _OFF)
        self._due = max(self._due + self._step * 1e-9, time.monotonic() - 0.05)
        while (left := self._due - time.monotonic()) > 0:
            self._asker.executor.spin_once(timeout_sec=left)
        self._asker.executor.spin_once(timeout_sec=0)
        if lots[2] > _LOST:
            self.sent[self._stamp] = time.time_ns()
            self._asker.publishers[NODE].publish(data)


def _counts(told: list[tuple[Any, int]]) -> dict[str, int]:
    if not told:
        return {}
    status = deserialize_message(told[-1][0], DiagnosticArray).status[0]
    return {v.key: int(v.value) for v in status.values if v.value.isdigit()}


def _resident(pid: int) -> float:
    """Resident memory of a process, MB; NaN where there is no /proc."""
    try:
        for line in Path(f'/proc/{pid}/status').read_text().splitlines():
            if line.startswith('VmRSS:'):
                return int(line.split()[1]) / 1024
    except OSError:
        pass
    return float('nan')


def soak_rows(found: list[Minute]) -> list[dict[str, float]]:
    """A row by minute: figures as of Minute, latencies in ms, counts under their words."""
    return [
        {
            'minute': float(number),
            'memory': one.memory,
            'p50': 1e3 * one.p50,
            'p99': 1e3 * one.p99,
            'worst': 1e3 * one.worst,
            'sent': float(one.sent),
            'answered': float(one.answered),
        }
        | {word: float(count) for word, count in one.counts.items()}
        for number, one in enumerate(found, 1)
    ]
