"""The benchmark of the live node: what is sent, and what becomes of the answers."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from bench._live import (
    CASES,
    Case,
    Live,
    Measured,
    answer_times,
    cpu_time_in,
    highest,
    live_rows,
    median_of,
    stamp_in,
    stamps_of,
    start_rows,
    summed,
)
from bench._page_limits import live_part, speed_part
from bench._rig import LAG, NODE, RELAY, Asker, Rig, wheels
from bench._rows import write_rows
from kinpole_ros.messages import MarkerReader, ns_to_stamp
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.tracker import Tracker

BEGIN = 10**12
NUMBER = 250
# Even, and in between frames for none: as the highest rate is looked for.
RATES = [Case(f'{rate:g} Hz', rate=rate) for rate in (200.0, 290.0, 1130.0)]


def test_a_run_begins_when_all_topics_are_published(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that reads its markers may not have made its publishers yet: frames went uncounted."""
    monkeypatch.setattr('bench._rig._WAIT', 0.1)
    asker = Asker()
    try:
        for publisher in asker.publishers.values():
            monkeypatch.setattr(publisher, 'get_subscription_count', lambda: 1)
        asker.until_found([f'/{NODE}/markers'])
        with pytest.raises(TimeoutError, match='a publisher of /kinpole/wheel_0/odom'):
            asker.until_found([f'/{NODE}/markers', f'/{NODE}/wheel_0/odom'])
    finally:
        asker.close()


@pytest.mark.parametrize('case', CASES, ids=lambda case: case.what)
def test_stamps_are_off_the_even_pace_by_what_is_said_and_no_more(case: Case) -> None:
    stamps = stamps_of(case, 1000, BEGIN)
    off = stamps - BEGIN - np.arange(1000) * 1e9 / case.rate
    most = max(1e9 * case.jitter, case.unit / 2)
    assert 0.6 * most < max(np.abs(off).max(), 0.5) <= most + 1
    assert not (stamps % case.unit).any()
    assert np.diff(stamps).min() > 0.4e9 / case.rate


@pytest.mark.parametrize('case', [*CASES, *RATES], ids=lambda case: case.what)
def test_an_answer_comes_with_the_frame_that_it_is_counted_for(case: Case) -> None:
    """So many frames after its own, by which latency is counted."""
    lag = LAG if case in RATES else LAG + 0.25 / case.rate
    bodies = {name: tuple(markers) for name, markers in wheels(case.bodies).items()}
    tracker = Tracker(Settings(bodies=bodies, lag=lag))
    stamps = stamps_of(case, NUMBER, BEGIN)
    rig, reader = Rig(case.bodies, case.kind), MarkerReader(case.kind)
    answers = []
    for k, stamp in enumerate(stamps.tolist()):
        (frames,) = reader.read((rig.at(stamp),))
        answers += [(int(s), k) for each in tracker.add(frames, 1) for s in each.stamp]
    # As if each frame were sent a second after that before it, and answered in 1 ms.
    sent = np.arange(NUMBER) * 10**9
    rows = np.array([(stamp, sent[k] + 10**6) for stamp, k in answers])
    behind = round(LAG * case.rate)
    times = answer_times(stamps, sent, {'body/odom': rows}, behind, ['body/odom'])
    # The first window has to fill.
    known = times[behind + 20 :]
    assert known == pytest.approx(1e-3)


def test_a_frame_is_answered_when_all_is_there_that_always_comes() -> None:
    stamps = np.array([1000, 2000, 3000, 4000])
    sent = np.array([10, 20, 30, 40]) * 10**9
    odom = np.array([(1000, 21), (2010, 32), (3000, 43)]) * (1, 10**9)
    icr = np.array([(1990, 34), (3500, 47), (4000, 99)]) * (1, 10**9)
    answers = {'odom': odom, 'icr': icr}
    # The first has none; what comes of the last frame is of one that was not sent.
    both = answer_times(stamps, sent, answers, 1, ['odom'])
    assert both.tolist() == [math.inf, 1.0, 4.0, 7.0]
    assert answer_times(stamps, sent, answers, 1, ['odom', 'icr']).tolist() == [
        math.inf,
        math.inf,
        4.0,
        7.0,
    ]
    nothing = {'odom': np.zeros((0, 2), np.int64)}
    assert answer_times(stamps, sent, nothing, 0, ['odom']).tolist() == [math.inf] * 4


def test_a_frame_without_an_answer_is_late_and_none_is_left_out() -> None:
    times = np.full(200, 0.002)
    times[:3] = 0.011, 0.009, math.inf
    sent = np.arange(200) * 8_000_000
    found = summed(times, sent, 200.0, 0.3)
    assert found == Measured(0.002, 0.009, 0.99, 0.3, 125.0)
    times[3] = math.inf
    assert summed(times, sent, 200.0, 0.3).p99 == 0.011
    times[4] = math.inf
    assert summed(times, sent, 200.0, 0.3).p99 == math.inf


def test_the_median_is_that_of_each_figure() -> None:
    rows = (1, 9, 0.5, 0.1, 200), (2, 7, 0.7, 0.3, 190), (3, 8, 0.6, 0.2, 199)
    assert median_of([Measured(*row) for row in rows]) == Measured(2, 8, 0.6, 0.2, 199)


@pytest.mark.parametrize('limit', [150.0, 200.0, 333.0, 800.0, 1234.0, 5000.0, 1e5])
def test_the_highest_rate_is_found_to_within_a_step(limit: float) -> None:
    tried: list[float] = []

    def held(rate: float) -> bool:
        tried.append(rate)
        return rate <= limit

    found = highest(held, 200.0, 8000.0, 1.1)
    assert len(tried) <= 12
    assert not any(rate % 10 for rate in tried)
    if limit < 200:
        assert (found, tried) == (0, [200])
    elif limit > 8000:
        assert found == 6400
    else:
        assert found <= limit < 1.1 * found


def test_cpu_time_is_read_past_any_name() -> None:
    ticks = os.sysconf('SC_CLK_TCK')
    name = '(a) 1 2 (b'
    fields = ' '.join(['S', *'0' * 10, str(3 * ticks), str(2 * ticks), '77', '88'])
    assert cpu_time_in(f'12 ({name}) {fields}') == 5.0
    own = Path('/proc/self/stat')
    if own.exists():
        spent = sum(os.times()[:2])
        assert cpu_time_in(own.read_text()) == pytest.approx(spent, abs=0.1)


def test_the_stamp_of_a_message_is_read_from_its_bytes() -> None:
    stamp = 1_700_000_000_987_654_321
    header = Header(stamp=ns_to_stamp(stamp), frame_id='world')
    assert stamp_in(serialize_message(Vector3Stamped(header=header))) == stamp


def test_the_page_has_a_line_for_each_case_and_marks_what_is_above_its_bar(tmp_path: Path) -> None:
    ours = Measured(0.0012, 0.0021, 0.99, 0.4, 200.0)
    slow = Measured(0.0016, math.inf, 0.5, 0.9, 200.0)
    other = Measured(0.001, 0.001, 1.0, 0.1, 200.0)
    cases = {case.what: {NODE: ours, RELAY: other} for case in CASES}
    cases[CASES[-1].what] = {NODE: slow, RELAY: other}
    live = Live(cases, {NODE: 500.0, RELAY: 2000.0}, 0.8, 0.1)
    rows = live_rows(live)
    assert (rows[0]['p50'], rows[0]['p99_relay'], rows[0]['core']) == (1.2, 1.0, 0.4)
    write_rows(tmp_path / 'live.csv', rows)
    lines = [line for line in live_part(rows).splitlines() if line.startswith('| ')][2:]
    assert len(lines) == len(CASES)
    assert lines[0].startswith('| one body at 200 Hz | 1.20 (1.20) | **2.10** (2.10) | 40% | 10% ')
    assert '**1.60** (1.60) | **–** (–) | 90% | 10% | 50.0% | 100.0% |' in lines[-1]
    assert '| 500 Hz | 2,000 Hz | **0.25** | at least 0.5 |' in speed_part([], start_rows(live))
