"""
What reading, replaying and estimating cost, beside what the libraries below them take.

Everything is measured as a ratio within one run: the times of a machine drift, their ratios hold.
CPU times of this process, the best of several.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from rclpy.serialization import deserialize_message

from bench._motions import motions
from bench._record import RATE, START, STEP, frames_of, observe, stamps_of
from kinpole_ros.bags import BagWriter, read_messages, replay
from kinpole_ros.messages import (
    ROS_TYPE_NAMES,
    MarkerReader,
    installed_class,
    serialize_message,
    to_message,
)
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.frame import part_of
from kinpole_ros.tracking.tracker import Tracker

Rows = list[dict[str, Any]]
_MARKERS = 8
_NOISE = 1e-3
# What the project promises of each.
_READING = {'marker_array': 30.0, 'pose_array': 8.0, 'marker': 4.0, 'point_cloud2': 1.5}
_MOST_BODIES, _LONGEST_WINDOW = 100, 1000


def speed_rows(quick: bool = False, progress: Callable[[float], None] | None = None) -> Rows:
    """
    One row by comparison: `what`, `ours` and `other` with their `unit`, `ratio`, and `bar`.

    The ratio is ours over the other where `bar` is the most it may be; where it is the `least`
    that it must be, the other over ours. `progress` is called with the share done, by time.
    """
    tell = progress or (lambda share: None)
    with tempfile.TemporaryDirectory() as folder:
        tell(0.0)
        bag = Path(folder) / 'markers.mcap'
        _write_markers(bag, 2_000 if quick else 100_000)
        rows = _reading()
        tell(0.06)
        rows += _replaying(bag, Path(folder))
        tell(0.68)
        rows += _estimating(100 if quick else 400)
        tell(0.73)
        rows += _memory(Path(folder), 1_000 if quick else 3_000, lambda: tell(0.8))
    return rows


def compared(
    what: str, ours: float, other: float, unit: str, bar: float, least: bool = False
) -> dict[str, Any]:
    """A row of `speed_rows`."""
    ratio = other / ours if least else ours / other
    return {
        'what': what,
        'ours': ours,
        'other': other,
        'unit': unit,
        'ratio': ratio,
        'bar': bar,
        'least': least,
    }


def _best(repeats: int, *works: Callable[[], object]) -> list[float]:
    """Least CPU time of some calls of each, s: in turns, since a machine is not always as fast."""
    times = []
    for _ in range(repeats):
        for work in works:
            begun = time.process_time()
            work()
            times.append(time.process_time() - begun)
    return [min(times[k :: len(works)]) for k in range(len(works))]


def _reading(markers: int = 100, number: int = 50) -> Rows:
    points = np.random.default_rng(0).normal(size=(number, markers, 3))
    names = [f'm{k}' for k in range(markers)]
    rows = []
    for kind, bar in _READING.items():
        data = [
            serialize_message(to_message(kind, START + k, 'lab', names, seen))
            for k, seen in enumerate(points)
        ]
        reader = MarkerReader(kind)
        reader.read(data[:1])

        def singly(data: list[bytes] = data, reader: MarkerReader = reader) -> None:
            for one in data:
                reader.read((one,))

        cls = installed_class(ROS_TYPE_NAMES[kind])

        def ordinary(data: list[bytes] = data, cls: type = cls) -> None:
            for one in data:
                deserialize_message(one, cls)

        what = f'reading {markers} markers of a {kind}, against rclpy making the message'
        ours, other = (1e6 * best / number for best in _best(7, singly, ordinary))
        rows.append(compared(what, ours, other, 'µs', bar, least=True))
    return rows


def _write_markers(bag: Path, count: int) -> None:
    """A bag of one body of 8 markers, from a motion that comes back after each second."""
    motion = motions()['four-bar coupler']
    rng = np.random.default_rng(3)
    _, exact = observe(motion, np.arange(RATE) / RATE)
    arms = exact.mean(axis=1, keepdims=True) - exact
    both = np.concatenate((exact, exact.mean(axis=1, keepdims=True) + 0.7j * arms), axis=1)
    names = [f'm{k}' for k in range(_MARKERS)]
    solid = np.zeros((RATE, _MARKERS, 3))
    solid[..., 0], solid[..., 1] = both.real, both.imag
    with BagWriter(bag) as writer:
        for k in range(count):
            seen = solid[k % RATE].copy()
            seen[:, :2] += _NOISE * motion.size * rng.normal(size=(_MARKERS, 2))
            stamp = START + STEP * k
            writer.write('/markers', to_message('point_cloud2', stamp, 'lab', names, seen), stamp)


def _replaying(bag: Path, folder: Path) -> Rows:
    settings = Settings()
    count = 0

    def iterate() -> None:
        nonlocal count
        with bag.open('rb') as file:
            count = sum(1 for _ in make_reader(file).iter_messages())

    ours, other = _best(3, lambda: replay(bag, settings), iterate)
    per = 1e6 / count
    what = f'replay of {count:,} frames of {_MARKERS} markers without output, against mcap reading'
    rows = [compared(what, per * ours, per * other, 'µs a frame', 3.0)]

    results, copy = folder / 'results.mcap', folder / 'copy.mcap'
    replay(bag, settings, results)
    ready = [(m.topic, m.type_name, m.data, m.log_time) for m in read_messages(results)]

    def write() -> None:
        with copy.open('wb') as file:
            writer = Writer(file)
            writer.start()
            channels: dict[str, int] = {}
            for topic, name, data, log_time in ready:
                if topic not in channels:
                    schema = writer.register_schema(name, 'ros2msg', b'')
                    channels[topic] = writer.register_channel(topic, 'cdr', schema)
                writer.add_message(channels[topic], log_time, data, log_time)
            writer.finish()

    ours, other = _best(2, lambda: replay(bag, settings, results), write)
    what = (
        f'the same with all {len({m[0] for m in ready})} topics written, against mcap writing them'
    )
    return [*rows, compared(what, per * ours, per * other, 'µs a frame', 2.0)]


def _estimating(count: int) -> Rows:
    """Time per frame, one by one, all figures to the jerk."""

    def cost(bodies: int, samples: int) -> float:
        motion = motions()['four-bar coupler']
        rng = np.random.default_rng(4)
        total = 2 * samples + count
        _, exact = observe(motion, np.arange(total) / RATE)
        seen = np.repeat(exact[:, None], bodies, axis=1)
        seen = seen + _NOISE * motion.size * (rng.normal(size=(*seen.shape, 2)) @ (1, 1j))
        frames, settings = frames_of(seen, stamps_of(total))
        window = (samples - 1) / RATE
        tracker = Tracker(Settings(**{**vars(settings), 'window': window, 'lag': window / 3}))
        tracker.add(part_of(frames, slice(2 * samples)), 3)
        times = []
        for k in range(2 * samples, total):
            frame = part_of(frames, slice(k, k + 1))
            begun = time.process_time()
            for estimate in tracker.add(frame, 3):
                [estimate.pole(order) for order in (1, 2, 3)]
                estimate.centrode_curvature  # noqa: B018 - computed when asked for
            times.append(time.process_time() - begun)
        return 1e6 * float(np.median(times))

    # In turns, as above.
    costs = [
        [cost(1, 61), cost(_MOST_BODIES, 61), cost(1, 30), cost(1, _LONGEST_WINDOW)]
        for _ in range(5)
    ]
    one, many, short, long = map(min, zip(*costs, strict=True))
    return [
        compared(f'estimates of {_MOST_BODIES} bodies, against one', many, one, 'µs a frame', 5.0),
        compared(
            f'estimates from windows of {_LONGEST_WINDOW:,} samples, against 30',
            long,
            short,
            'µs a frame',
            3.0,
        ),
    ]


def _memory(folder: Path, few: int, written: Callable[[], None]) -> Rows:
    """Peak memory of a replay of a hundred times as many frames."""
    words = 'from bench._speed import peak; import sys; print(peak(sys.argv[1]))'
    peaks = []
    for count in (few, 100 * few):
        bag = folder / f'{count}.mcap'
        _write_markers(bag, count)
        if count > few:
            written()
        done = subprocess.run(
            [sys.executable, '-c', words, str(bag)], check=True, capture_output=True, text=True
        )
        peaks.append(float(done.stdout))
        bag.unlink()
    what = f'peak memory of a replay of {100 * few:,} frames, against {few:,}'
    return [compared(what, peaks[1], peaks[0], 'MB', 1.2)]


def peak(bag: str) -> float:
    """Peak memory of this process, MB, once it has replayed a bag."""
    replay(bag, Settings())
    # What getrusage says is no less than what the process had that started this one.
    status = Path('/proc/self/status')
    if status.exists():
        found = [line for line in status.read_text().splitlines() if line.startswith('VmHWM:')]
        return int(found[0].split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
