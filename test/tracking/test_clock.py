"""The even clock behind the stamps of frames: found, counted by, and used where motion says so."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kinpole_ros.mechanism import marker_positions
from kinpole_ros.mechanism._motions import ORDERS, BodyMotion
from kinpole_ros.messages import DiagnosticsMaker
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.clock import MAX_PENDING, Clock, estimate_clock
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.frame_counter import FrameCounter, motion_costs
from kinpole_ros.tracking.timeline import Timeline
from kinpole_ros.tracking.tracker import Tracker

START = 10**18
NAMES = ('a', 'b', 'c', 'd')
KITE = np.array([(0.09, 0.02), (-0.03, 0.1), (-0.08, -0.05), (0.05, -0.06)])


def record(times, rest=0.0, seed=0, noise=2e-4):
    """Points (T, 4, 3) of a body that swings and moves on, after a `rest`; its rates (T,)."""
    a, b = 5.0, 9.0
    since = np.maximum(times - rest, 0.0)
    angle = np.zeros((ORDERS, len(times)))
    angle[0] = 1 - np.cos(a * since)
    angle[1] = a * np.sin(a * since)
    position = np.zeros((ORDERS, len(times)), complex)
    position[0] = 0.1 * (1 - np.cos(b * since)) + 0.08j * np.sin(a * since) ** 2
    points = np.zeros((len(times), 4, 3))
    points[..., :2] = marker_positions(BodyMotion(position, angle), KITE)
    return points + noise * np.random.default_rng(seed).normal(size=points.shape), angle[1]


def late(times, kind, seed=1, drift=1e-4):
    rng = np.random.default_rng(seed)
    times = times * (1 + drift)
    if kind == 'uniform':
        times = times + rng.uniform(0.2e-3, 3e-3, len(times))
    elif kind == 'rounded':
        times = np.round(times, 3)
    elif kind != 'none':
        times = times + rng.exponential(float(kind), len(times))
    return START + np.rint(times * 1e9).astype(np.int64)


def track(stamps, points, mode='auto', block=None, order=1):
    given = {'window': 0.3, 'lag': 0.1, 'stamps': mode, 'body.markers': list(NAMES)}
    tracker = Tracker(settings_from(given))
    found = []
    for k in range(0, len(stamps), block or len(stamps)):
        part = slice(k, k + (block or len(stamps)))
        found += tracker.add(MarkerFrames(stamps[part], 'world', NAMES, points[part]), order)
        # As the node does while it waits.
        tracker.learn_if_due()
    stamp = np.concatenate([e.stamp for e in found])
    rate = np.concatenate([e.rate(1)[0][:, 0] for e in found])
    return tracker, stamp, rate


def errors(stamps, points, rates, skip=1.5, **how):
    tracker, stamp, rate = track(stamps, points, **how)
    place = {s: k for k, s in enumerate(stamps.tolist())}
    off = rate - rates[[place[s] for s in stamp.tolist()]]
    # The results of two frames with one stamp are not told apart by it.
    off[np.isin(stamp, stamps[1:][np.diff(stamps) == 0])] = np.nan
    off = off[(stamp - START > skip * 1e9) & np.isfinite(off)]
    return tracker, float(np.sqrt((off**2).mean()))


def frames_kept(count, share=0.02, seed=2):
    kept = np.random.default_rng(seed).random(count) >= share
    kept[:3] = True
    return kept.nonzero()[0]


@pytest.mark.parametrize('kind', ['uniform', '0.0005', '0.001', '0.003'])
@pytest.mark.parametrize('rate', [100, 200])
def test_interval_and_frames_lost_are_found(kind, rate):
    numbers = frames_kept(6 * rate)
    stamps = late(numbers / rate, kind)
    clock, counts = estimate_clock(stamps, None)
    assert clock.interval == pytest.approx(1e9 / rate * (1 + 1e-4), rel=2e-5)
    right = np.diff(counts) == np.diff(numbers[: len(counts)])
    # Whether a frame was late before another was lost, or came after it, nobody knows.
    assert right[:-8].mean() > (0.97 if kind == '0.003' else 0.999)
    assert counts[-9] - counts[0] == numbers[len(counts) - 9] - numbers[0]


def counted(late_by, share=0.02, seed=2, block=1):
    """Counts of frames less their numbers, and how many waited; markers move by 1 mm a frame."""
    numbers = frames_kept(1200, share, seed)
    stamps = np.maximum.accumulate(late(numbers / 200, late_by))
    stamps += np.arange(len(stamps))
    points, _ = record(numbers / 200)
    clock, counts = estimate_clock(stamps[:400], None)
    counter = FrameCounter(clock, int(counts[391]))
    counter.noise = 2e-4
    sure, waited, first = [], [], 392
    while first < len(stamps):
        part = slice(first, first + block)
        sure.extend(counter.count_frames(stamps[part], points[part])[0].tolist())
        first = min(first + block, len(stamps))
        waited.append(first - 392 - len(sure))
    return np.array(sure) - numbers[392 : 392 + len(sure)], max(waited)


@pytest.mark.parametrize(('late_by', 'most'), [('0.0005', 1), ('0.001', 8), ('0.003', MAX_PENDING)])
def test_counts_as_frames_come(late_by, most):
    off, waited = counted(late_by)
    assert (off == off[0]).mean() > 0.98
    assert waited <= most


@pytest.mark.parametrize('late_by', ['0.0005', '0.004'])
def test_counts_of_many_frames_are_those_of_one_after_the_other(late_by):
    for seed in range(5):
        off, _ = counted(late_by, 0.1, seed)
        for block in (3, 50, 1000):
            np.testing.assert_array_equal(counted(late_by, 0.1, seed, block)[0], off)


def test_frames_to_come_are_not_before_their_ticks():
    early = 0
    for seed in range(100):
        numbers = frames_kept(500, seed=seed)
        stamps = late(numbers / 200, '0.003', seed)
        known = int((numbers < 400).sum())
        clock = estimate_clock(stamps[:known], None)[0]
        # The ticks themselves are the stamps of frames that are not late.
        ticks = clock.ticks(late(numbers / 200, 'none'))
        first = round(float(np.median(ticks[:known] - numbers[:known])))
        early += ticks[-1] < numbers[-1] + first
    assert early <= 5


def test_a_motion_too_fast_for_a_cubic_does_not_say_that_a_frame_was_late():
    """Twelve and a half frames a turn, one of them lost."""
    number = np.delete(np.arange(9), 7)
    noise, wrong = 1e-4, 0
    for seed in range(40):
        turned = 2 * np.pi * 8 / 100 * number + seed
        place = 0.1 * np.exp(1j * turned) + 0.1 * np.exp(-0.35j * np.sin(turned))
        values = np.stack((place.real, place.imag), axis=1)
        values += noise * np.random.default_rng(seed).normal(size=values.shape)
        costs = motion_costs(np.stack((number, np.append(number[:-1], 7))), values / noise)
        wrong += costs[0] > costs[1] + 4.6
    assert wrong == 0


@pytest.mark.parametrize('kind', ['uniform', '0.001', '0.003', 'rounded'])
def test_figures_are_as_with_even_stamps(kind):
    kept = frames_kept(1000)
    times = kept / 240
    points, rates = record(times)
    even = START + np.rint(times * 1e9).astype(np.int64)
    _, ideal = errors(even, points, rates)
    stamps = late(times, kind)
    tracker, found = errors(stamps, points, rates / (1 + 1e-4))
    assert found < 1.1 * ideal
    state = tracker.stamp_state()
    assert state.regularized and not state.costs
    assert state.interval == pytest.approx((1 + 1e-4) / 240, rel=1e-4)
    assert tracker.update_counts()['lost'] == pytest.approx(1000 - len(kept), abs=2)
    _, raw = errors(stamps, points, rates / (1 + 1e-4), mode='capture')
    assert raw > 1.3 * ideal


def test_frames_that_are_late_by_several_ticks_are_counted_by_the_motion():
    kept = frames_kept(1000)
    times = kept / 240
    points, rates = record(times)
    even = START + np.rint(times * 1e9).astype(np.int64)
    _, ideal = errors(even, points, rates)
    stamps = np.maximum.accumulate(late(times, '0.005')) + np.arange(len(times))
    _, found = errors(stamps, points, rates / (1 + 1e-4))
    assert found < 1.5 * ideal


def test_frames_that_are_uneven_are_taken_by_their_stamps():
    rng = np.random.default_rng(0)
    times = np.arange(800) / 200 + rng.uniform(-0.3, 0.3, 800) / 200
    points, _ = record(times - times[0])
    stamps = START + np.rint(times * 1e9).astype(np.int64)
    auto, *found = track(stamps, points)
    _, *capture = track(stamps, points, mode='capture')
    for one, other in zip(found, capture, strict=True):
        np.testing.assert_array_equal(one, other)
    assert auto.stamp_state().nats < -6 and not auto.stamp_state().costs


def test_a_change_of_the_rate_is_noticed():
    times = np.concatenate((np.arange(600) / 200, 3 + np.arange(600) / 150))
    points, rates = record(times)
    for kind in 'none', '0.001':
        tracker, found = errors(late(times, kind, drift=0), points, rates, 4.5, mode='arrival')
        assert tracker.stamp_state().interval == pytest.approx(1 / 150, rel=1e-3)
        assert found < 0.1


@pytest.mark.parametrize(('before', 'after'), [(25, 50), (100, 200), (200, 500), (250, 100)])
def test_even_stamps_of_another_rate_were_not_rounded(before, after):
    steps = np.repeat((1 / before, 1 / after), (101, after))
    points, rates = turned(np.cumsum(steps), 1)
    stamps = START + np.rint(np.cumsum(steps) * 1e9).astype(np.int64)
    tracker, rms = errors(stamps, points, rates, skip=0.4)
    assert not tracker.stamp_state().regularized
    assert rms < 0.02


@pytest.mark.parametrize(('before', 'after'), [(30, 50), (60, 25), (60, 200), (120, 100)])
def test_rounded_stamps_of_another_rate_soon_have_its_clock(before, after):
    steps = np.repeat((1 / before, 1 / after), (8 * before, 3 * after))
    times = np.cumsum(steps)[frames_kept(len(steps))]
    points, rates = turned(times, 1)
    tracker, rms = errors(late(times, 'rounded', drift=0), points, rates, skip=8.3)
    assert tracker.state.timeline.clock.interval == pytest.approx(1e9 / after, rel=1e-2)
    assert rms < 0.1


@pytest.mark.parametrize(('before', 'after'), [(30, 50), (30, 100), (60, 200)])
@pytest.mark.parametrize('block', [1, None])
def test_frames_before_the_ticks_of_their_rounding_wait_for_another_rate(before, after, block):
    times = np.cumsum(np.repeat((1 / before, 1 / after), (8 * before, 3 * after)))
    points, rates = turned(times, 1)
    _, stamp, rate = track(late(times, 'rounded', drift=0), points, block=block)
    assert np.abs(rate - rates[0])[stamp > START + 2 * 10**9].max() < 0.5


def test_frames_that_waited_while_the_machine_stalled_are_of_no_faster_camera():
    rng = np.random.default_rng(0)
    times = np.arange(2400) / 200
    arrived = times.copy()
    for first, length in zip(rng.uniform(1, 11, 6), rng.uniform(0.05, 0.25, 6), strict=True):
        waits = (arrived > first) & (arrived < first + length)
        arrived[waits] = first + length + 2e-4 * np.arange(np.count_nonzero(waits))
    points, rates = turned(times, 1)
    tracker, rms = errors(late(arrived, 'rounded', drift=0), points, rates)
    assert tracker.state.timeline.clock.interval == pytest.approx(5e6, rel=1e-3)
    assert rms < 0.05


@pytest.mark.parametrize('block', [1, 7, None])
@pytest.mark.parametrize('even', [5, 7, 12, 18, 30])
def test_a_shift_by_half_a_period_updates_the_clock_once(monkeypatch, even, block):
    """As where a publisher begins anew. The clock was updated without end for the first frame."""
    updates = []
    update = Timeline.update_clock

    def counted(self, *given):
        updates.append(given)
        assert len(updates) < 100
        return update(self, *given)

    monkeypatch.setattr(Timeline, 'update_clock', counted)
    times = 0.01 * np.concatenate((np.arange(even), np.arange(even, even + 60) + 0.5))
    points, rates = record(times, noise=1e-4)
    _, stamp, rate = track(START + np.rint(times * 1e9).astype(np.int64), points, block=block)
    assert len(stamp) > 30
    assert np.abs(rate - np.interp((stamp - START) * 1e-9, times, rates)).max() < 0.5


@pytest.mark.parametrize('seed', [1, 3])
def test_frames_that_wait_when_the_rate_changes_are_counted_too(seed):
    times = np.concatenate((np.arange(600) / 200, 3 + np.arange(1000) / 300))
    points, _ = record(times)
    stamps = late(times, '0.003', seed, drift=0)
    # Once frames come in time, none waits any more.
    stamps[-100:] = START + np.rint(times[-100:] * 1e9).astype(np.int64) + 3_000_000
    _, stamp, _ = track(stamps, points, mode='arrival', block=1)
    assert stamp[-1] >= stamps[-1] - 105_000_000


def stamps_of_any_kind(seed, count=250):
    """Stamps (T,), ns, of rates, units, jitters and jumps that change again and again."""
    rng = np.random.default_rng(seed)
    stamps = [START]
    while len(stamps) < count:
        unit = rng.choice([1, 1_000, 100_000, 1_000_000, 5_000_000])
        step = 1e6 * rng.choice([1, 2, 3, 5, 8, 8.333, 10, 16.667, 20])
        jump = step * rng.choice([1, 1, 1, 0.5, 1.5, 2, 0, -1, 10, 40, 0.1])
        jitter = rng.choice([0, 0, 0, 1e3, 1e5, 2e6])
        ticks = np.arange(rng.choice([1, 2, 3, 7, 15, 25, 60]))
        since = jump + step * ticks + jitter * rng.random(len(ticks))
        stamps += [stamps[-1] + int(round(one / unit) * unit) for one in since.tolist()]
    return np.array(stamps)


# These gave times that step back, and warnings, where frames waited at a change of the rate.
@pytest.mark.filterwarnings('error')
@settings(max_examples=1)
@given(st.integers(0, 10_000), st.sampled_from(('auto', 'arrival')), st.sampled_from((1, 5, 300)))
@example(95, 'arrival', 1)
@example(110, 'arrival', 1)
@example(134, 'arrival', 300)
def test_times_increase_and_work_is_bounded_with_stamps_of_any_kind(seed, mode, block):
    stamps = stamps_of_any_kind(seed)
    points, _ = record((stamps - START) * 1e-9)
    updates = []
    update = Timeline.update_clock

    def counted(self, *given):
        updates.append(given)
        assert len(updates) <= len(stamps)
        return update(self, *given)

    given = {'window': 0.3, 'lag': 0.1, 'stamps': mode, 'body.markers': list(NAMES)}
    tracker = Tracker(settings_from(given))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Timeline, 'update_clock', counted)
        for k in range(0, len(stamps), block):
            part = slice(k, k + block)
            tracker.add(MarkerFrames(stamps[part], 'world', NAMES, points[part]), 1)
            assert (np.diff(tracker.state.history['time']) > 0).all()


def test_rounding_lapses_when_stamps_become_true():
    rng = np.random.default_rng(0)
    times = np.arange(1200) / 240
    points, _ = record(times, rest=10.0)
    stamps = late(times, 'rounded')
    uneven = times[600:] + rng.uniform(-0.3, 0.3, 600) / 240
    stamps[600:] = START + np.rint(uneven * 1e9).astype(np.int64)
    assert track(stamps[:600], points[:600])[0].stamp_state().regularized
    assert not track(stamps, points)[0].stamp_state().regularized


def test_decided_soon_after_a_body_at_rest_moves():
    times = np.arange(800) / 200
    points, _ = record(times, rest=2.0)
    stamps = late(times, 'uniform')
    tracker, *_ = track(stamps[:380], points[:380])
    assert not tracker.stamp_state().regularized
    tracker, *_ = track(stamps[:500], points[:500])
    assert tracker.stamp_state().regularized


@settings(max_examples=1, deadline=None)
@given(st.sampled_from(['uniform', '0.001', '0.003']), st.integers(1, 40), st.integers(0, 99))
# A frame later than all before it; frames in doubt; a body that was found to have jumped.
@example('uniform', 5, 2)
@example('uniform', 5, 3)
@example('0.003', 7, 1)
# Frames in bunches, whose noise is learned as the clock is looked at.
@example('0.03', 1, 0)
@example('0.03', 1, 1)
def test_blocks_do_not_matter(kind, block, seed):
    times = frames_kept(200, seed=seed) / 200
    points, _ = record(times)
    stamps = late(times, kind, seed)
    for mode in ('auto', 'arrival'):
        _, stamp, rate = track(stamps, points, mode)
        _, again, other = track(stamps, points, mode, block)
        np.testing.assert_array_equal(again, stamp)
        np.testing.assert_allclose(other, rate, rtol=1e-9, atol=1e-9)


def test_arrival_takes_stamps_that_step_back_and_leaves_out_frames_sent_twice():
    times = np.arange(400) / 200
    points, _ = record(times)
    stamps = late(times, '0.003')
    assert (np.diff(stamps) < 0).any()
    twice = np.sort(np.concatenate((np.arange(400), [150, 250])))
    tracker, stamp, _ = track(stamps[twice], points[twice], mode='arrival')
    assert tracker.update_counts()['repeated'] == 2
    assert not tracker.update_counts()['resets'] and not tracker.update_counts()['late']
    assert len(np.unique(stamp)) == len(stamp) > 350


def test_diagnostics_name_the_jitter_and_the_fix():
    times = np.arange(600) / 200
    points, _ = record(times)
    stamps = late(times, 'uniform')
    for mode, warns in (('capture', True), ('auto', False)):
        tracker, *_ = track(stamps, points, mode)
        array = DiagnosticsMaker('kinpole').make(int(stamps[-1]), tracker, None, 3.0, {})
        status = array.status[0]
        assert ('stamps: arrival' in status.message) == warns
        values = {pair.key: pair.value for pair in status.values}
        assert float(values['jitter of the stamps, rms (s)']) == pytest.approx(0.8e-3, rel=0.1)


def test_frames_later_than_the_next_are_named() -> None:
    """Which frames were lost is then a guess, of the stamps: no deviation includes a wrong one."""
    times = frames_kept(700) / 200
    points, _ = record(times)
    for mean, warns in (('0.003', False), ('0.02', True)):
        stamps = late(times, mean)
        tracker, *_ = track(stamps, points)
        array = DiagnosticsMaker('kinpole').make(int(stamps[-1]), tracker, None, 3.0, {})
        assert ('which frames were lost' in array.status[0].message) == warns


@pytest.mark.parametrize('mode', ['auto', 'arrival'])
def test_frames_later_than_any_clock_could_tell_do_no_harm(mode: str) -> None:
    """Most stamps run backward then: no frames are counted that nobody sent."""
    times = np.arange(300) / 200
    points, _ = record(times)
    tracker, *_ = track(late(times, '0.04', 5), points, mode)
    assert tracker.update_counts()['frames'] == 300
    assert tracker.update_counts()['lost'] < 300


def test_bunches_are_spread_over_the_clock_and_named_where_they_are_not():
    """Frames that are stamped on arrival, ten at a time, as by a network that holds them back."""
    times = np.arange(600) / 200
    points, rates = record(times)
    number = np.arange(600)
    stamps = START + number // 10 * 50_000_000 + number % 10 * 100_000
    found = {}
    for mode in ('auto', 'capture'):
        tracker = Tracker(settings_from({'bodies': ['body'], 'stamps': mode}))
        estimates = tracker.add(MarkerFrames(stamps, 'lab', NAMES, points), 1)
        seen = [e.stamp for e in estimates]
        value = np.concatenate([e.rate(1).value[:, 0] for e in estimates])
        off = value - rates[np.searchsorted(stamps, np.concatenate(seen))]
        status = DiagnosticsMaker('kinpole').make(START, tracker, None, 3.0, {}, stamps.tolist())
        late = off[np.concatenate(seen) > START + 2 * 10**9]
        found[mode] = np.sqrt((late**2).mean()), status.status[0].message
    # By the stamps there are ten frames a window for each that there are places for: no figures.
    assert found['auto'][0] < 0.05
    assert not found['capture'][0] < 0.05
    assert 'bunches' not in found['auto'][1]
    assert 'the stamps come in bunches' in found['capture'][1]


def test_a_clock_far_finer_than_its_lateness_counts_in_bounded_work(monkeypatch) -> None:
    clock = Clock(0, 0.0, 5.0, 1e7, 1e7, 1e8, 0.0, 1.0)
    stamps = 10**9 + 5_000_000 * np.arange(60)
    counter, most = FrameCounter(clock, 0), []
    costs = FrameCounter._motion_costs
    monkeypatch.setattr(
        FrameCounter, '_motion_costs', lambda self: most.append(len(self._losses)) or costs(self)
    )
    counts, sure_with = counter.count_frames(stamps, np.zeros((60, 4, 3)))
    assert max(most) < 10_000
    assert len(counts) >= 60 - MAX_PENDING
    assert (np.diff(counts) > 0).all()
    assert (np.diff(sure_with) >= 0).all()


GRIDS = [(60, 1 / 64, 0.0), (50, 1 / 64, 0.0), (85, 0.01, 0.0), (240, 0.004, 0.0)]


@pytest.mark.parametrize(
    ('rate', 'step', 'mean', 'share'),
    [
        *((*grid, share) for grid in GRIDS for share in (0.0, 0.02)),
        # Late before their stamps are rounded, and often lost.
        (60, 1 / 64, 0.002, 0.0),
        (50, 1 / 64, 0.002, 0.02),
        (85, 0.01, 0.002, 0.1),
        (240, 0.004, 0.0005, 0.02),
    ],
)
def test_frames_on_the_grid_of_a_timer_are_at_the_ticks_of_their_camera(rate, step, mean, share):
    """A grid that is hardly finer than the frames: regular empty steps are no losses."""
    kept = frames_kept(20 * rate, share)
    times = kept / rate + 0.4 / rate
    points, rates = record(times)
    arrived = times + mean * np.random.default_rng(3).exponential(size=len(times))
    rounded = np.maximum.accumulate(np.floor(arrived / step) * step)
    tracker, rms = errors(START + np.rint(rounded * 1e9).astype(np.int64), points, rates, skip=2.5)
    _, even = errors(START + np.rint(times * 1e9).astype(np.int64), points, rates, skip=2.5)
    assert tracker.state.timeline.clock.interval == pytest.approx(1e9 / rate, rel=1e-3)
    assert rms < 1.1 * even
    lost = kept[-1] + 1 - len(kept)
    assert lost - 3 <= tracker.update_counts()['lost'] <= lost + (mean > 0)


def test_losses_after_the_last_update_and_before_the_decision_for_ticks_count() -> None:
    rest = 2.0
    for count in (450, 590):
        kept = frames_kept(count, 0.05)
        # The stamps of a body at rest leave open which frames were late and which lost.
        points, _ = record(kept / 100, rest=rest)
        tracker, _, _ = track(late(kept / 100, '0.002'), points, block=50)
        assert abs(tracker.update_counts()['lost'] - (kept[-1] + 1 - len(kept))) <= 1
        # They are counted once, however often somebody asks.
        assert tracker.update_counts()['lost'] == tracker.update_counts()['lost']


@pytest.mark.parametrize('share', [0.01, 0.05])
def test_losses_of_exactly_even_stamps_are_not_taken_for_the_grid_of_a_timer(share):
    for seed in range(5):
        kept = frames_kept(1500, share, seed)
        points, _ = record(kept / 100)
        tracker, _, _ = track(START + kept * 10_000_000, points, block=50)
        assert tracker.state.timeline.clock.interval == 1e7
        lost = kept[-1] + 1 - len(kept)
        assert lost - 1 <= tracker.update_counts()['lost'] <= lost


def turned(numbers, rate, seed=0):
    """A body that turns once a second about a point beside it: points, and its rate (T,)."""
    turn = np.exp(2j * np.pi * numbers / rate)
    markers = (0.12 + KITE @ [1, 1j]) * turn[:, None]
    points = np.stack((markers.real, markers.imag, np.zeros(markers.shape)), axis=-1)
    points += 2e-4 * np.random.default_rng(seed).normal(size=points.shape)
    return points, np.full(len(numbers), 2 * np.pi)


@pytest.mark.parametrize('mode', ['auto', 'capture', 'arrival'])
@pytest.mark.parametrize(('rate', 'every'), [(25, 20), (50, 49)])
def test_frames_that_are_lost_regularly_make_no_slower_clock(rate, every, mode):
    """A link that is hidden once a turn: the stamps alone are those of a slower camera."""
    numbers = np.arange(4 * rate)
    numbers = numbers[numbers % every != every // 2]
    points, rates = turned(numbers, rate)
    stamps = START + numbers * (10**9 // rate)
    tracker, rms = errors(stamps, points, rates, skip=0.0, mode=mode)
    state = tracker.stamp_state()
    assert (state.interval, state.jitter) == (1 / rate, 0.0)
    assert not state.costs
    # At the ticks are the stamps.
    assert tracker.update_counts()['lost'] == pytest.approx(4 * rate - len(numbers), abs=1)
    _, ideal = errors(*(part[:60] for part in (stamps, points, rates)), skip=0.0, mode='capture')
    assert rms < 1.5 * ideal


def test_a_stamp_is_not_later_than_by_its_rounding():
    """Nor is that of a frame after a loss, in which a body turned too far for a polynomial."""
    numbers = np.arange(112)
    numbers = numbers[(numbers - 16) % 33 >= 3]
    times = numbers / 24
    places = 24 * (2 * times + 0.08 * np.sin(2 * np.pi * 0.7 * times))
    points, _ = turned(places, 24)
    tracker, *_ = track(START + np.rint(times * 1e3).astype(np.int64) * 1_000_000, points)
    assert tracker.stamp_state().interval == pytest.approx(1 / 24, rel=1e-3)
    assert tracker.update_counts()['lost'] == 9


@pytest.mark.parametrize('kind', ['uniform', '0.001', 'rounded'])
def test_late_stamps_of_a_slow_camera_are_recognized(kind):
    """In a window of 0.3 s are fewer frames than the motion needs to decide."""
    times = np.arange(150) / 25
    points, rates = record(times)
    tracker, found = errors(late(times, kind), points, rates / (1 + 1e-4), skip=2.0)
    _, ideal = errors(START + np.rint(times * 1e9).astype(np.int64), points, rates, skip=2.0)
    assert tracker.stamp_state().regularized
    assert found < 1.1 * ideal
