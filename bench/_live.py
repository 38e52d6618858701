"""
What the live node costs, against a relay: the least that any ROS 2 node in Python can do.

The relay reads the same message the ordinary way and publishes one Vector3Stamped. Both run at the
same time, each in its own process, and get each frame in turn, at the pace of its stamps. Whoever
sends sleeps between frames, as a processor does between those of a tracker.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import QoSProfile
from visualization_msgs.msg import MarkerArray

from bench._rig import LAG, NODE, RELAY, Asker, Rig, node_words, processes, started, wheels
from bench._speed import compared
from kinpole_ros.messages import STATE, TF, installed_class, result_outputs, type_name
from kinpole_ros.ros.private import take

_FEW = ('angular_velocity', 'icr', 'centrode_curvature')
_POLES = ('odom', 'icr', 'iap', 'ijp', 'isp')
# What is published of every frame. Of others, some frames may leave them undetermined.
_ALWAYS = ('odom', 'angular_velocity')
# What is read after a run only, must be kept until then. Of paths and drawings one is kept.
_KEPT = 20_000
_HEAVY = (PathMessage, MarkerArray)
# ns.
_START = 10**12
# A frame counts as answered within so many periods; a rate is held with such a share of them.
_PERIODS, _SHARE = 2.0, 0.99
# s, in which the window fills and the node finds who listens: it does not count.
_WARM_UP = 1.0
# Hz. Whatever else runs on the machine may take a core for a moment, so a rate has more than
# one try.
_TRIES = 2
# Of a rate, what must be reached in sending.
_REACHED = 0.95
_LOWEST, _HIGHEST = 200.0, 8000.0


class Case(NamedTuple):
    """
    What is sent, and which results of each body are subscribed to; None for all topics.

    `rate` in Hz. Stamps are off the even pace by up to `jitter` s, and whole multiples of `unit`
    ns. `kind` is one of MARKER_TYPES.
    """

    what: str
    topics: Collection[str] | None = _FEW
    bodies: int = 1
    rate: float = 200.0
    jitter: float = 0.0
    unit: int = 1
    kind: str = 'point_cloud2'


_THREE = Case('', bodies=3, jitter=5e-5, kind='marker_array')
CASES = (
    Case('one body at 200 Hz'),
    Case('one body, stamps off by up to 50 µs', jitter=5e-5),
    Case('one body, stamps off by up to 1 ms', jitter=1e-3),
    Case('one body at 120 Hz, stamps in whole µs', rate=120.0, unit=1000),
    _THREE._replace(what='3 bodies in a MarkerArray, stamps off by up to 50 µs'),
    _THREE._replace(what='the same, all topics', topics=None),
    _THREE._replace(what='the same, ~/state alone', topics=(STATE,)),
    Case('4 bodies at 200 Hz', bodies=4),
    Case('16 bodies at 100 Hz, poles and odometry', topics=_POLES, bodies=16, rate=100.0),
)


class Measured(NamedTuple):
    """
    Time from sending a frame to its last result (s), by percentile, and what it takes.

    `answered` is the share of the frames answered within two periods, `core` that of a core, and
    `rate` (Hz) what was reached in sending.
    """

    p50: float
    p99: float
    answered: float
    core: float
    rate: float


class Live(NamedTuple):
    """Cases and highest rate (Hz) of node and relay; start and help in s."""

    cases: dict[str, dict[str, Measured]]
    rate: dict[str, float]
    first_answer: float
    help: float


def measure_live(
    seconds: float = 4.0,
    runs: int = 3,
    step_up: float = 1.2,
    progress: Callable[[float], None] | None = None,
) -> Live:
    """
    Measure all of it.

    Each case takes `seconds` a run and gives the median of some `runs`. The highest rate is found
    to within a factor of `step_up`, and each try takes half as long. `progress` is called with the
    share done, by time.
    """
    tell = progress or (lambda share: None)
    found: dict[str, list[dict[str, Measured]]] = {case.what: [] for case in CASES}
    for number, case in enumerate(CASES * runs):
        tell(0.75 * number / len(CASES) / runs)
        with _asked(case, LAG + 0.25 / case.rate) as ask:
            found[case.what].append(ask(case, (NODE, RELAY), seconds))
    cases = {
        what: {name: median_of([each[name] for each in listed]) for name in (NODE, RELAY)}
        for what, listed in found.items()
    }
    tell(0.75)
    best = {}
    with _asked(CASES[0], LAG) as ask:
        for name in (NODE, RELAY):

            def held(rate: float, name: str = name) -> bool:
                case = CASES[0]._replace(rate=rate)
                tries = (ask(case, (name,), seconds / 2)[name] for _ in range(_TRIES))
                return any(
                    each.answered >= _SHARE and each.rate >= _REACHED * rate for each in tries
                )

            best[name] = highest(held, _LOWEST, _HIGHEST, step_up)
    tell(0.95)
    starts = [_first_answer() for _ in range(3)]
    helps = [_help() for _ in range(5)]
    return Live(cases, best, float(np.median(starts)), float(np.median(helps)))


@contextmanager
def _asked(
    case: Case, lag: float
) -> Iterator[Callable[[Case, Sequence[str], float], dict[str, Measured]]]:
    """
    Node and relay for the bodies and topics of a case, with what sends them frames.

    That takes a case, which may differ in rate and stamps, who is sent its frames and for how long
    (s), and returns the figures of each.
    """
    subscriptions: dict[str, dict[str, Any]] = {NODE: {}, RELAY: {}}
    with processes(case.bodies, case.kind, lag) as running:
        asker = Asker(case.kind)
        try:
            topics = [(RELAY, 'answer', Vector3Stamped)]
            for topic, kind, *_ in result_outputs(list(wheels(case.bodies)), 'xy'):
                # Frames are published if it is asked for.
                if topic == TF:
                    continue
                own = topic if topic == STATE else topic.partition('/')[2]
                if case.topics is None or own in case.topics:
                    topics.append((NODE, topic, installed_class(type_name(kind))))
            for name, topic, kind in topics:
                qos = QoSProfile(depth=1 if kind in _HEAVY else _KEPT)
                subscriptions[name][topic] = asker.node.create_subscription(
                    kind, f'/{name}/{topic}', lambda _: None, qos, raw=True
                )
            asker.until_found(f'/{name}/{topic}' for name, topic, _ in topics)
            begun = time.monotonic_ns()

            def ask(case: Case, names: Sequence[str], seconds: float) -> dict[str, Measured]:
                pids = {name: running[name].pid for name in names}
                # Later than all before by more than a window.
                begin = _START + time.monotonic_ns() - begun
                stamps = stamps_of(case, round((_WARM_UP + seconds) * case.rate), begin)
                first = round(_WARM_UP * case.rate)
                sent, cores = _send(asker, case, stamps, first, pids)
                time.sleep(0.5)
                found = {}
                for name in names:
                    answers = {
                        topic: _arrivals(one)
                        for topic, one in subscriptions[name].items()
                        if one.msg_type not in _HEAVY
                    }
                    always = answers if name == RELAY else _always(case)
                    behind = 0 if name == RELAY else round(LAG * case.rate)
                    times = answer_times(stamps, sent[name], answers, behind, always)
                    found[name] = summed(times[first:], sent[name][first:], case.rate, cores[name])
                return found

            yield ask
        finally:
            asker.close()


def _always(case: Case) -> list[str]:
    """Topics of a case with a message for every frame."""
    if case.topics == (STATE,):
        return [STATE]
    chosen = _ALWAYS if case.topics is None else [one for one in _ALWAYS if one in case.topics]
    return [f'{body}/{topic}' for body in wheels(case.bodies) for topic in chosen]


def _send(
    asker: Asker, case: Case, stamps: np.ndarray, first: int, pids: Mapping[str, int]
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """
    Send frames of these stamps (N,), ns, to these processes, each in turn, at the stamps' pace.

    Returns when each was sent them (N,), ns, and the share of a core it takes from the frame
    `first` on.
    """
    rig = Rig(case.bodies, case.kind)
    # Made before: the sender must not be what limits.
    frames = [rig.at(stamp) for stamp in stamps.tolist()]
    due = (stamps - stamps[0]) * 1e-9
    sent = {name: np.zeros(len(stamps), np.int64) for name in pids}
    before: dict[str, float] = {}
    start = begun = time.monotonic()
    for k, frame in enumerate(frames):
        if k == first:
            before, begun = {name: _cpu_time(pid) for name, pid in pids.items()}, time.monotonic()
        for place, name in enumerate(pids):
            left = start + due[k] + place / len(pids) / case.rate - time.monotonic()
            if left > 0:
                time.sleep(left)
            sent[name][k] = time.time_ns()
            asker.publishers[name].publish(frame)
    wall = time.monotonic() - begun
    cores = {name: (_cpu_time(pid) - before[name]) / wall for name, pid in pids.items()}
    return sent, cores


def stamps_of(case: Case, count: int, begin: int) -> np.ndarray:
    """Stamps (count,) of a case from `begin` on, ns."""
    off = np.random.default_rng(2).uniform(-1e9 * case.jitter, 1e9 * case.jitter, count)
    times = begin + np.arange(count) * 1e9 / case.rate + off
    return np.round(times / case.unit).astype(np.int64) * case.unit


def _arrivals(subscription: Any) -> np.ndarray:
    """Stamps and times of arrival (M, 2) of the messages that wait, ns."""
    rows = [
        (stamp_in(data), info['received_timestamp']) for data, info in take(subscription, _KEPT)
    ]
    return np.array(rows, np.int64).reshape(-1, 2)


def stamp_in(data: bytes) -> int:
    """The stamp of a serialized message that begins with its header, ns."""
    order = '<u4' if data[1] else '>u4'
    seconds, nanoseconds = np.frombuffer(data, order, 2, offset=4).tolist()
    return int(seconds * 10**9 + nanoseconds)


def answer_times(
    stamps: np.ndarray,
    sent: np.ndarray,
    answers: Mapping[str, np.ndarray],
    behind: int,
    always: Collection[str],
) -> np.ndarray:
    """
    Time (N,) from sending each frame to its last answer, s; inf where one of `always` is missing.

    Frames have `stamps` and were sent at `sent` (N,), ns. `answers` are stamps and times of arrival
    (M, 2), ns, by topic. An answer has the stamp of one frame, or nearly, and came with the one
    `behind` frames later.
    """
    count = len(stamps)
    last = np.zeros(count, np.int64)
    answered = np.ones(count, bool)
    between = (stamps[1:] + stamps[:-1]) / 2
    for topic, rows in answers.items():
        frame = np.searchsorted(between, rows[:, 0]) + behind
        rows, frame = rows[frame < count], frame[frame < count]
        np.maximum.at(last, frame, rows[:, 1])
        if topic in always:
            answered &= np.bincount(frame, minlength=count) > 0
    return np.where(answered, (last - sent) * 1e-9, np.inf)


def summed(times: np.ndarray, sent: np.ndarray, rate: float, core: float) -> Measured:
    """
    Figures of frames (N,) that were to be sent at `rate` Hz.

    They were sent at `sent`, ns, and answered in `times`, s, inf for never.
    """
    p50, p99 = np.percentile(times, (50, 99), method='inverted_cdf').tolist()
    answered = float(np.mean(times <= _PERIODS / rate))
    return Measured(p50, p99, answered, core, 1e9 / float(np.diff(sent).mean()))


def median_of(runs: Sequence[Measured]) -> Measured:
    """The median of each figure."""
    return Measured(*np.median(runs, axis=0).tolist())


def highest(held: Callable[[float], bool], lowest: float, most: float, step_up: float) -> float:
    """
    The highest rate that is held, a multiple of 10 Hz, to within a factor of `step_up`; 0 for none.

    From the lowest on it doubles until one is not held or `most` is reached, and halves the rest.
    """
    good, bad = 0.0, lowest
    while bad <= most and held(bad):
        good, bad = bad, 2 * bad
    while 0 < good < bad <= most and bad > step_up * good:
        middle = 10.0 * round((good * bad) ** 0.5 / 10)
        if middle in (good, bad):
            break
        if held(middle):
            good = middle
        else:
            bad = middle
    return good


def _cpu_time(pid: int) -> float:
    """CPU time of a process so far, s; NaN where there is no /proc."""
    try:
        return cpu_time_in(Path(f'/proc/{pid}/stat').read_text())
    except OSError:
        return float('nan')


def cpu_time_in(stat: str) -> float:
    """CPU time (s), user and system, in the text of /proc/PID/stat."""
    # The name of the command, in brackets, may hold anything.
    fields = stat.rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _first_answer() -> float:
    """From the start of the process to the first result, s, with markers there already."""
    asker = Asker()
    heard = asker.hear(f'/{NODE}/{next(iter(wheels(1)))}/angular_velocity', Vector3Stamped)
    rig = Rig()
    begun = time.monotonic_ns()

    def send_and_look() -> bool:
        asker.publishers[NODE].publish(rig.at(_START + time.monotonic_ns() - begun))
        # About 200 Hz.
        until = time.monotonic() + 0.005
        while (left := until - time.monotonic()) > 0:
            asker.executor.spin_once(timeout_sec=left)
        return bool(heard)

    with tempfile.TemporaryDirectory() as folder:
        words = node_words(Path(folder))
        start = time.time_ns()
        with started(words):
            asker.until(send_and_look, 'the first answer')
    asker.close()
    return (heard[0][1] - start) * 1e-9


def _help() -> float:
    start = time.monotonic()
    subprocess.run(
        [sys.executable, '-m', 'kinpole_ros.tools.cli', '--help'],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.monotonic() - start


def live_rows(live: Live) -> list[dict[str, Any]]:
    """One row by case: figures of node and relay, latencies in ms."""
    return [
        {'what': what}
        | {
            f'{field}{suffix}': value * (1e3 if field in ('p50', 'p99') else 1)
            for name, suffix in ((NODE, ''), (RELAY, '_relay'))
            for field, value in both[name]._asdict().items()
        }
        for what, both in live.cases.items()
    ]


def start_rows(live: Live) -> list[dict[str, Any]]:
    """Rate, start and help as rows of `_speed.speed_rows`; a time alone is compared with 1 s."""
    what = 'rate at which 99% of the frames are answered within two periods, against the relay'
    # A relay that held none would be 0 Hz.
    rates = live.rate[NODE], max(live.rate[RELAY], 1.0)
    return [
        compared(what, *rates, 'Hz', 0.5) | {'least': True},
        compared('node from start to first answer', live.first_answer, 1.0, 's', 2.0),
        compared('kinpole --help', live.help, 1.0, 's', 0.3),
    ]
