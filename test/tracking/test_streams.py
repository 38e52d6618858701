"""Frames as they come (late, again, many at once, with gaps), and scenes turned and named anew."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recordings import (
    START,
    STEP,
    check,
    follow,
    record,
    two_bodies,
)
from stretches import instants, one_frame

from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.marker_rows import find_rows
from kinpole_ros.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings('error')

# --- time ---------------------------------------------------------------------------------------


@pytest.mark.parametrize('jitter', [0.0, 0.4])
@pytest.mark.parametrize('lag', [0.0, 0.02, 0.1, 0.0137])
def test_every_stamp_is_answered_once_and_in_time(lag: float, jitter: float) -> None:
    seen = record('cardan', count=120)
    rng = np.random.default_rng(2)
    moved = [
        frame._replace(stamps=frame.stamps + round(jitter * STEP * rng.uniform(-1, 1)))
        for frame in seen.frames
    ]
    tracker = Tracker(settings_from({**seen.values, 'window': 0.2, 'lag': lag}))
    answered: list[int] = []
    for k, frame in enumerate(moved):
        for estimate in instants(tracker.add(frame, 1)):
            answered.append(estimate.stamp)
            late = (frame.stamps[0] - estimate.stamp) * 1e-9
            # Trails by the lag; a quarter of an interval, and what stamps jitter, either way. A
            # frame too late to be sure that none was lost waits for the next.
            waits = 1 if jitter else 0
            assert late <= lag + (0.25 + waits + 2 * jitter) * STEP * 1e-9
            assert late >= lag - (0.75 + 2 * jitter) * STEP * 1e-9 or k < 20 + lag / 0.005
    stamps = [frame.stamps[0] for frame in moved]
    first = stamps.index(answered[0])
    assert answered == stamps[first : first + len(answered)]
    assert len(stamps) - first - len(answered) <= lag / 0.005 + 1


def test_frames_at_even_times_are_answered_exactly_lag_later() -> None:
    seen = record('cardan', count=60)
    tracker = Tracker(settings_from({**seen.values, 'lag': 0.05}))
    for frame in seen.frames:
        found = instants(tracker.add(frame, 1))
        assert all(frame.stamps[0] - e.stamp == 50_000_000 for e in found)


def test_a_repeated_stamp_is_left_out() -> None:
    seen = record('cardan')
    twice = [frame for frame in seen.frames for _ in range(2)]
    for k in range(1, len(twice), 2):
        twice[k] = twice[k]._replace(points=twice[k].points + 100.0)
    tracker, found = follow(twice, seen.values, every=18)
    assert tracker.update_counts() == Counter(frames=400, repeated=200)
    _, plain = follow(seen.frames, seen.values)
    assert [e.stamp for e in found] == [e.stamp for e in plain]
    assert all(np.array_equal(a.angle, b.angle) for a, b in zip(found, plain, strict=True))


@pytest.mark.parametrize('jump', [-3 * STEP + 1, -90 * STEP, -(10**12), 501_000_000, 10**15])
def test_a_clock_that_jumps_starts_everything_anew(jump: int) -> None:
    seen = record('four_bar')
    frames = seen.frames[:100]
    # Another place, another shape: nothing of before may be left.
    other = record('four_bar', turn=0.5j, shift=3.0)
    last = frames[-1].stamps[0]
    late = [f._replace(stamps=f.stamps - START + last + jump) for f in other.frames]
    tracker, found = follow([*frames, *late], seen.values)
    assert tracker.update_counts()['resets'] == 1
    # Whether a step back lasts is seen from its second frame, beyond the window from its first.
    assert tracker.update_counts()['late'] == (-500_000_000 <= jump < 0)
    after = [estimate for estimate in found if estimate.stamp >= last + jump][-10:]
    for estimate in after:
        estimate.stamp += START - last - jump
    check(other, after)


def test_a_single_late_frame_is_left_out() -> None:
    """Overtaken by one frame, by several, again and again, told twice, and at the very end."""
    seen = record('four_bar')
    order = list(range(200))
    for frame, after in ((20, 21), (60, 99), (120, 121), (122, 123), (124, 126), (198, 199)):
        order.remove(frame)
        order.insert(order.index(after) + 1, frame)
    late = [k for place, k in enumerate(order) if any(j > k for j in order[:place])]
    assert late == [20, 60, 120, 122, 124, 198]
    order.insert(order.index(124), 124)
    values = {**seen.values, 'window': 0.25}
    tracker, found = follow([seen.frames[k] for k in order], values, every=1)
    plain, expected = follow([f for k, f in enumerate(seen.frames) if k not in late], values, 4, 1)
    # Frames that were taken away seem lost.
    counts = [Counter({**each.update_counts(), 'lost': 0}) for each in (tracker, plain)]
    assert counts[0] == counts[1] + Counter(frames=7, late=7)
    assert [e.stamp for e in found] == [e.stamp for e in expected]
    assert all(np.array_equal(a.angle, b.angle) for a, b in zip(found, expected, strict=True))


def test_a_clock_set_back_by_less_than_an_interval_goes_on() -> None:
    seen = record('cardan')
    frames = [f._replace(stamps=f.stamps - (k >= 100)) for k, f in enumerate(seen.frames)]
    frames[100].stamps[:] = frames[99].stamps - 1
    tracker, found = follow(frames, seen.values)
    assert (tracker.update_counts()['late'], tracker.update_counts()['resets']) == (1, 0)
    # A ns amid a window is much to the fourth derivative.
    check(seen, found, poles=(1e-5, 1e-5, 1e-5, 1e-3))


@pytest.mark.parametrize('count', [3, 20, 100])
def test_a_bag_that_loops_within_the_window_starts_anew_and_loses_one_frame(count: int) -> None:
    frames = record('cardan').frames[:count]
    values = {**record('cardan').values, 'window': 0.5}
    tracker, _ = follow(frames * 5, values)
    assert tracker.update_counts()['resets'] == tracker.update_counts()['late'] == 4
    assert tracker.samples == count - 1


def test_another_frame_id_starts_everything_anew() -> None:
    seen = record('four_bar')
    # Another place, another shape, as another camera sees it: nothing of before may be left.
    other = record('four_bar', turn=0.5j, shift=3.0)
    frames = [*seen.frames[:100], *(f._replace(frame_id='camera') for f in other.frames[100:])]
    tracker, found = follow(frames, seen.values, every=5)
    assert (tracker.update_counts()['frame_changes'], tracker.update_counts()['resets']) == (1, 0)
    before = [e for e in found if e.frame_id == 'world']
    after = [e for e in found if e.frame_id == 'camera']
    assert {e.stamp < frames[100].stamps[0] for e in before} == {True}
    assert {e.stamp >= frames[100].stamps[0] for e in after} == {True}
    # The first instant is at the oldest end of a window of 21 frames.
    check(seen, before, (1e-5, 1e-5, 1e-5, 2e-5))
    check(other, after[-10:])
    # From the first frame on, as if there had been none before.
    _, alone = follow(frames[100:], seen.values, every=5)
    assert [e.stamp for e in after] == [e.stamp for e in alone]
    assert all(np.array_equal(a.angle, b.angle) for a, b in zip(after, alone, strict=True))


def sifted(stamps: Sequence[int], window: int) -> tuple[list[int], Counter[str]]:
    """Which frames the window holds in the end, and what became of the others: frame by frame."""
    kept: list[int] = []
    counts: Counter[str] = Counter(frames=len(stamps))
    for k, stamp in enumerate(stamps):
        newest, before = (max(kept), stamps[k - 1]) if kept else (stamp - 1, stamp - 1)
        if abs(stamp - newest) > window or (before < newest and before < stamp <= newest):
            counts['resets'] += 1
            kept = [stamp]
        elif stamp > newest:
            kept.append(stamp)
        else:
            counts['late' if stamp < newest else 'repeated'] += 1
    return [stamp for stamp in kept if stamp >= kept[-1] - window], counts


hops = st.sampled_from((1, 1, 1, 1, 1, 1, 2, 3, 0, -1, -1, -2, -3, -7, -20, 19, 25))


@given(st.lists(hops, min_size=1, max_size=120), st.lists(st.integers(1, 119)))
def test_what_is_left_out_does_not_hang_on_how_many_frames_come_at_once(
    steps: list[int], cuts: list[int]
) -> None:
    stamps = START + STEP * np.cumsum(steps)
    points = np.random.default_rng(1).normal(size=(len(stamps), 3, 3))
    frames = MarkerFrames(stamps, 'world', ('a', 'b', 'c'), points)
    values = settings_from({'window': 0.1, 'lag': 0.02, 'stamps': 'capture'})
    kept, counts = sifted(stamps.tolist(), 100_000_000)
    found = []
    for edges in ([0], range(len(stamps)), sorted({0, *(c for c in cuts if c < len(stamps))})):
        tracker = Tracker(values)
        parts = zip(edges, [*edges[1:], len(stamps)], strict=True)
        found.append([])
        for first, end in parts:
            found[-1] += instants(tracker.add(part_of(frames, slice(first, end)), 1))
        assert tracker.samples == len(kept)
        left_out = {k: n for k, n in tracker.update_counts().items() if n and 'markers' not in k}
        left_out.pop('lost', None)
        assert left_out == counts
    for other in found[1:]:
        assert [e.stamp for e in other] == [e.stamp for e in found[0]]


def test_no_frames_change_nothing() -> None:
    seen = record('cardan', count=40)
    tracker, _ = follow(seen.frames[:-1], seen.values)
    before = dict(tracker.update_counts()), tracker.samples, tracker.identities
    none = part_of(seen.frames[-1], slice(0, 0))._replace(frame_id='nowhere', identities=())
    assert tracker.add(none, 4) == tracker.add_parts((), 4) == []
    assert (dict(tracker.update_counts()), tracker.samples, tracker.identities) == before
    assert len(instants(tracker.add(seen.frames[-1], 4))) == 1


def test_frames_in_parts_leave_the_tracker_after_each_part_as_frames_added_part_by_part() -> None:
    scene = record('four_bar', count=160, noise=1e-3)
    order = [*range(70), *range(60, 65), *range(70, 120), *range(10, 40), *range(120, 160)]
    frames = [
        scene.frames[k]._replace(frame_id='world' if n < 100 else 'other')
        for n, k in enumerate(order)
    ]
    alone, together = (Tracker(settings_from(scene.values)) for _ in range(2))

    def seen(tracker: Tracker) -> tuple[Any, ...]:
        return (
            dict(tracker.update_counts()),
            tracker.samples,
            str(tracker.interval),
            str(tracker.noise()),
        )

    expected, states = [], []
    for number, frame in enumerate(frames):
        for estimate in alone.add(frame, 2):
            expected += [(int(stamp), number) for stamp in estimate.stamp]
        states.append(seen(alone))
    after = []

    def parts() -> Iterable[MarkerFrames]:
        for frame in frames:
            yield frame
            after.append(seen(together))

    found = together.add_parts(parts(), 2)
    assert after == states
    assert (
        alone.update_counts()['resets']
        and alone.update_counts()['late']
        and alone.update_counts()['frame_changes']
    )
    due = [(int(s), int(d)) for e in found for s, d in zip(e.stamp, e.due, strict=True)]
    assert due == expected
    # At once, but where frames start anew or their times do.
    assert len(found) < 10 < len(expected)


def test_a_gap_within_the_window_resets_nothing() -> None:
    seen = record('cardan', count=300)
    frames = seen.frames[:100] + seen.frames[190:]
    tracker, found = follow(frames, seen.values)
    assert tracker.update_counts()['resets'] == 0
    check(seen, found)
    assert tracker.samples <= 101


@pytest.mark.parametrize('step', [100_000, 1_000_000_000])
def test_the_rate_of_the_frames_does_not_matter(step: int) -> None:
    """The same frames at 10 kHz and at 1 Hz: all times scale."""
    seen = record('cardan')
    factor = step / STEP
    frames = [f._replace(stamps=np.array([START + k * step])) for k, f in enumerate(seen.frames)]
    values = {**seen.values, 'window': 0.5 * factor, 'lag': 0.1 * factor}
    _, found = follow(frames, values)
    _, plain = follow(seen.frames, seen.values)
    for one, two in zip(found, plain, strict=True):
        scaled = one.angle * factor ** np.arange(5)[:, None]
        assert scaled[1] == pytest.approx(two.angle[1], rel=1e-6)
        assert one.pole(1).value == pytest.approx(two.pole(1).value, abs=1e-6)


# --- what is asked for --------------------------------------------------------------------------


def test_nothing_is_computed_when_nothing_is_asked() -> None:
    seen = record('cardan')
    tracker, found = follow(seen.frames, seen.values, order=None)
    assert found == []
    assert tracker.samples == 101
    assert tracker.interval == pytest.approx(0.005)
    # From then on only what falls due, not what was missed.
    more = record('cardan', count=201).frames[-1]
    assert len(instants(tracker.add(more, 4))) == 1


@pytest.mark.parametrize('drop', [0.3, 0.0])
def test_what_is_found_does_not_depend_on_the_order_asked_for(drop: float) -> None:
    seen = record('four_bar', count=120, noise=1e-4, drop=drop)
    _, full = follow(seen.frames, seen.values, order=4, every=4)
    for order in (1, 2, 3):
        _, part = follow(seen.frames, seen.values, order=order, every=4)
        assert [e.stamp for e in part] == [e.stamp for e in full]
        for few, all_ in zip(part, full, strict=True):
            assert few.order == order
            rows = slice(order + 1)
            for name in ('position', 'angle'):
                assert getattr(few, name) == pytest.approx(
                    getattr(all_, name)[rows], rel=1e-9, abs=1e-9, nan_ok=True
                )
            assert few.angle_covariance == pytest.approx(
                all_.angle_covariance[rows, rows], rel=1e-6, nan_ok=True
            )


@pytest.mark.parametrize(
    ('step', 'jitter'),
    [(1e9 / 240, 0.0), (STEP, 0.1), (STEP, 0.0)],
    ids=['ns', 'jitter', 'even'],
)
def test_frames_all_at_once_give_what_they_give_one_by_one(step: float, jitter: float) -> None:
    """With markers and whole bodies that drop out, one that is elsewhere for a frame, and a gap."""
    seen = record('four_bar', count=260, noise=1e-4, step=step, jitter=jitter)
    points = np.concatenate([frame.points for frame in seen.frames])
    points[120:126, :4] = np.nan
    points[140:143, 1] = np.nan
    points[200, 5] += 0.3
    keep = np.r_[0:30, 31:160, 168:260]
    stamps = np.concatenate([frame.stamps for frame in seen.frames])[keep]
    frames = MarkerFrames(stamps, 'world', seen.frames[0].identities, points[keep])
    settings = settings_from({**seen.values, 'window': 0.25})
    whole, single = Tracker(settings), Tracker(settings)
    together = whole.add(frames, 4)
    one_by_one = []
    for k in range(len(stamps)):
        one_by_one += single.add(part_of(frames, slice(k, k + 1)), 4)
    assert whole.update_counts() == single.update_counts()
    one, other = everything(together), everything(one_by_one)
    np.testing.assert_array_equal(one['stamp'], other['stamp'])
    assert len(one['stamp']) > 200
    for name in ('position', 'angle', 'position_covariance', 'angle_covariance', 'span', 'degree'):
        alike(one[name], other[name])
    for quantity in QUANTITIES:
        figures = [[quantity(e) for e in all_] for all_ in (together, one_by_one)]
        told, others = (np.concatenate([f.determined for f in each]) for each in figures)
        np.testing.assert_array_equal(told, others)
        # Not about what is next to 0 / 0.
        for part in (0, 1):
            alike(*(np.concatenate([f[part] for f in each])[told] for each in figures))


def block_and_single(frames: MarkerFrames, values: dict[str, Any]) -> tuple[list[Estimate], ...]:
    """What a tracker finds of frames all at once, and what another does of them one by one."""
    whole, single = Tracker(settings_from(values)), Tracker(settings_from(values))
    together = whole.add(frames, 3)
    one_by_one = []
    for k in range(len(frames.stamps)):
        one_by_one += single.add(part_of(frames, slice(k, k + 1)), 3)
    assert whole.update_counts() == single.update_counts()
    return instants(together), instants(one_by_one)


def turning(shape: list[complex], noise: float, count: int) -> MarkerFrames:
    """A body of that shape that turns by 3 rad/s as its middle goes round."""
    t = np.arange(count) * STEP * 1e-9
    normal = noise * np.random.default_rng(3).normal(size=(2, count, len(shape)))
    markers = 0.3 * np.exp(2j * t)[:, None] + np.exp(3j * t)[:, None] * np.array(shape)
    markers += normal[0] + 1j * normal[1]
    points = np.stack((markers.real, markers.imag, np.zeros(markers.shape)), axis=-1)
    names = tuple(map(str, range(len(shape))))
    return MarkerFrames(START + STEP * np.arange(count), 'world', names, points)


def test_a_frame_that_hardly_tells_the_angle_does_no_harm_to_the_frames_after_its_window() -> None:
    """Of three markers two are next to each other, and the third is hidden in one frame."""
    frames = turning([0.1, 0.1 + 1e-8, -0.2 + 0.05j], 1e-5, 220)
    frames.points[60, 2] = np.nan
    found = block_and_single(frames, {})
    for name in ('angle', 'position', 'angle_covariance', 'position_covariance'):
        one, other = (np.stack([getattr(e, name) for e in all_]) for all_ in found)
        alike(one, other)


@pytest.mark.parametrize('size', [1, 260])
def test_a_body_that_is_hidden_while_its_angle_passes_half_a_turn_turns_on(size: int) -> None:
    frames = turning([0.1, -0.07 + 0.02j, 0.05j], 1e-6, 260)
    half = round(np.pi / 3 / (STEP * 1e-9))
    frames.points[half - 5 : half + 5] = np.nan
    tracker = Tracker(settings_from({}))
    found = []
    for first in range(0, 260, size):
        found += instants(tracker.add(part_of(frames, slice(first, first + size)), 1))
    rates = [e.rate(1) for e in found if not e.missing[0]]
    assert len(rates) == len(found) - 10
    # A whole turn in between would be far off all noise, and the rates of its windows unsure.
    assert [rate.value[0] for rate in rates] == pytest.approx([3.0] * len(rates), abs=3e-4)
    assert max(rate.variance[0] for rate in rates[20:]) < 1e-3**2


def test_markers_that_are_exchanged_for_good_keep_their_places() -> None:
    frames = turning([0.1, -0.07 + 0.02j], 1e-4, 400)
    frames.points[200:] = frames.points[200:, ::-1]
    one, other = (np.stack([e.shape for e in all_]) for all_ in block_and_single(frames, {}))
    np.testing.assert_array_equal(one, other)
    assert (one[0] * one[-1].conj()).real.min() > 0


@pytest.mark.parametrize('size', [3, 4, 5, 6, 7])
def test_one_body_is_followed_alike_in_blocks_of_a_few_frames(size: int) -> None:
    """Instants that are differentiated together do not mix."""
    frames = two_bodies(160, 3.0, 0.0, 1e-4)
    frames = frames._replace(identities=frames.identities[:4], points=frames.points[:, :4])
    whole, parts = Tracker(settings_from({})), Tracker(settings_from({}))
    at_once = everything(whole.add(frames, 3))
    found = []
    for first in range(0, 160, size):
        found += parts.add(part_of(frames, slice(first, first + size)), 3)
    some = everything(found)
    for name in ('position', 'angle'):
        alike(at_once[name], some[name])


def test_after_each_of_several_gaps_in_one_block_nothing_is_expected() -> None:
    """Two markers that come back exchanged are as likely to have turned round meanwhile."""
    frames = turning([0.1, -0.07 + 0.02j], 1e-4, 460)
    frames.points[410:] = frames.points[410:, ::-1]
    kept = np.r_[:400, 410:415, 425:460]
    tracker = Tracker(settings_from({}))
    tracker.add(frames._replace(stamps=frames.stamps[kept], points=frames.points[kept]), None)
    assert tracker.update_counts()['resets'] == tracker.update_counts()['markers_exchanged'] == 0


def test_two_recordings_followed_in_turn_do_not_mix() -> None:
    """Of uneven stamps, and of such as take turns because they are whole ns."""
    both = [
        record('four_bar', count=150, noise=1e-4, step=step, jitter=jitter)
        for step, jitter in ((STEP, 0.1), (1e9 / 240, 0.0))
    ]
    alone = [follow(seen.frames, seen.values, every=1)[1] for seen in both]
    trackers = [Tracker(settings_from(seen.values)) for seen in both]
    in_turn: list[list[Estimate]] = [[], []]
    for frames in zip(*(seen.frames for seen in both), strict=True):
        for tracker, frame, found in zip(trackers, frames, in_turn, strict=True):
            found += instants(tracker.add(frame, 4))
    for one, other in zip(alone, in_turn, strict=True):
        for name in ('position', 'angle', 'position_covariance', 'angle_covariance'):
            expected, found = (np.stack([getattr(e, name) for e in all_]) for all_ in (one, other))
            np.testing.assert_array_equal(expected, found)


class Fault(NamedTuple):
    """What happens to a stream of frames: from the frame `first` on, `count` long, to a marker."""

    kind: str
    first: int
    count: int
    marker: int

    def spoil(self, stamps: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The stream (T,), (T, n, 3) with this fault; each four markers are a body."""
        length = len(stamps)
        first = min(self.first, length - 1)
        body = slice(self.marker // 4 * 4, self.marker // 4 * 4 + 4)
        flat = points[first : first + self.count]
        if self.kind == 'hide':
            flat[:, self.marker] = np.nan
        elif self.kind == 'hide the body':
            flat[:, body] = np.nan
        elif self.kind == 'jump':
            flat[:, self.marker, 0] += 0.05
        elif self.kind == 'swap':
            flat[:, [self.marker, 0]] = flat[:, [0, self.marker]]
        elif self.kind == 'swap for good':
            points[first:, body] = points[first:, body][:, [1, 0, 2, 3]]
        elif self.kind == 'half turn for good':
            points[first:, body] = points[first:, body][:, [2, 3, 0, 1]]
        elif self.kind == 'mirror':
            flat[:, body, 1] *= -1
        elif self.kind == 'shove':
            flat[:, body] += 0.1
        elif self.kind == 'noise':
            flat[:, body] += 2e-3 * np.random.default_rng(first).normal(size=(4, 3))
        elif self.kind == 'wild':
            flat[:, self.marker] = 1e25
        elif self.kind == 'gap':
            kept = np.r_[:first, first + self.count : length]
            return stamps[kept], points[kept]
        elif self.kind == 'late':
            stamps[first] -= STEP * self.count + 7
        elif self.kind == 'twice':
            stamps[first] = stamps[first - 1]
        elif self.kind == 'clock':
            stamps[first:] += 10**9 * (-1) ** self.count
        return stamps, points


KINDS = (
    *('hide', 'hide the body', 'jump', 'swap', 'swap for good', 'half turn for good', 'mirror'),
    *('shove', 'noise', 'wild', 'gap', 'late', 'twice', 'clock'),
)
faults = st.builds(
    Fault,
    st.sampled_from(KINDS),
    st.integers(8, 100),
    st.sampled_from((1, 1, 2, 3, 12, 60)),
    st.integers(0, 7),
)


def everything(found: list[Estimate]) -> dict[str, np.ndarray]:
    """All arrays that estimates hold, with the instants first."""
    arrays = {}
    of_instants = 'stamp', 'reason', 'size', 'height', 'span', 'degree', 'pin', 'pin_variance'
    of_orders = 'position', 'angle', 'position_covariance', 'angle_covariance'
    for name in (*of_instants, *of_orders, 'shape'):
        axis = 0 if name in ('stamp', 'shape') else -2
        array = np.concatenate([getattr(e, name) for e in found], axis=axis)
        arrays[name] = np.moveaxis(array, axis, 0)
    return arrays


@settings(max_examples=7)
@given(
    st.lists(faults, max_size=5),
    st.lists(st.sampled_from((1, 1, 2, 3, 4, 5, 7, 12, 30)), min_size=60, max_size=60),
    st.sampled_from((0.0, 3.0, -40.0)),
    st.sampled_from((0.0, 0.3)),
    st.sampled_from((1e-5, 1e-3)),
    st.sampled_from(((0.1, 0.0), (0.2, 0.1), (0.5, 0.02), (0.1, 0.099))),
    st.sampled_from((0.0, 1e-3)),
    st.integers(1, 4),
    st.booleans(),
)
@example(  # a body that begins anew amid a block, and is deformed before
    [Fault('mirror', 10, 1, 0)],
    [1] * 60,
    *(3.0, 0.0, 1e-5, (0.1, 0.0), 0.0, 4, False),
)
@example(  # a clock whose ticks are whole numbers but for rounding
    [Fault('twice', 13, 1, 0), Fault('twice', 16, 1, 0)],
    [30] * 60,
    *(-40.0, 0.0, 1e-5, (0.5, 0.02), 1e-3, 1, False),
)
def test_any_partition_of_any_stream_gives_the_same(
    spoilt: list[Fault],
    sizes: list[int],
    speed: float,
    jitter: float,
    noise: float,
    window: tuple[float, float],
    given_noise: float,
    order: int,
    alone: bool,
) -> None:
    """One by one, now and then settled, all at once, and in blocks, some of them settled."""
    frames = two_bodies(110, speed, jitter, noise)
    stamps, points = frames.stamps, frames.points
    for fault in spoilt:
        stamps, points = fault.spoil(stamps, points)
    frames = frames._replace(stamps=stamps, points=points)
    values = {
        'bodies': ['kite'] if alone else ['kite', 'rectangle'],
        'kite.markers': list('abcd'),
        **({} if alone else {'rectangle.markers': list('efgh')}),
        'window': window[0],
        'lag': window[1],
        'noise': given_noise,
    }
    count = len(stamps)
    results = []
    for edges, settled in (
        (np.arange(count + 1), 3),
        (np.array([0, count]), 0),
        (np.append(np.cumsum([0, *sizes]), count).clip(max=count), 2),
    ):
        tracker = Tracker(settings_from(values))
        found: list[Estimate] = []
        for number, (first, end) in enumerate(pairwise(edges)):
            found += tracker.add(part_of(frames, slice(first, end)), order)
            if settled and number % settled == 0:
                tracker.learn_if_due()
        results.append((tracker.update_counts(), found))
    counts, expected = results[0]
    for other_counts, other in results[1:]:
        assert other_counts == counts
        assert bool(other) == bool(expected)
        if not expected:
            continue
        one = everything(expected)
        for name, array in everything(other).items():
            if name in ('stamp', 'reason'):
                np.testing.assert_array_equal(array, one[name])
            elif name in ('angle', 'position'):
                # Of what is lost in noise rounding is no more than of that noise.
                variance = np.einsum('tkkb->tkb', one[f'{name}_covariance'])
                unit = np.sqrt(np.fmax(variance, 1.0))
                alike(one[name] / unit, array / unit)
            else:
                alike(one[name], array)


# Of many instants one may be at a threshold within rounding: these are not.
@settings(max_examples=8, derandomize=True)
@given(
    st.lists(faults, max_size=3),
    st.floats(-3, 3),
    st.complex_numbers(max_magnitude=3),
    st.sampled_from((1e-6, 1e-3, 0.7, 40.0)),
    st.sampled_from((0.2, 0.5, 1.0, 3.0, 1000.0)),
    st.booleans(),
    st.permutations(range(8)),
    st.booleans(),
)
@example(  # a curvature next to 0, whose terms cancel
    [Fault('gap', 12, 1, 0)],
    *(0.0, 0j, 1e-3, 0.2, False, list(range(8)), False),
)
@example(  # stamps of which the motion decides, with noise below a nanometer
    [Fault('twice', 14, 1, 0)],
    *(0.0, 0j, 1e-6, 0.2, False, list(range(8)), False),
)
@example(  # weights that are made orthonormal anew for the angle of a body, not for its position
    [
        Fault('noise', 75, 12, 1),
        Fault('hide the body', 24, 60, 7),
        Fault('twice', 80, 60, 5),
    ],
    *(0.0, 0j, 1.0, 1000.0, False, list(range(8)), False),
)
def test_a_scene_turned_moved_scaled_mirrored_slowed_or_renamed_gives_the_answer_so(
    spoilt: list[Fault],
    turn: float,
    shift: complex,
    scale: float,
    slower: float,
    mirrored: bool,
    order: list[int],
    reverse: bool,
) -> None:
    """With its covariances, what is determined and what is mended; noise and faults and all."""
    frames = two_bodies(160, 3.0, 0.0, 1e-4)
    stamps, points = frames.stamps, frames.points
    for fault in spoilt:
        stamps, points = fault.spoil(stamps, points)
    bodies = {'kite': 'abcd', 'rectangle': 'efgh'}
    values: dict[str, Any] = {'window': 0.2, 'lag': 0.05, 'bodies': list(bodies)}
    values |= {f'{body}.markers': list(names) for body, names in bodies.items()}
    frames = frames._replace(stamps=stamps, points=points)

    factor = scale * np.exp(1j * turn)
    flat = points[..., 0] + 1j * points[..., 1]
    there = factor * (flat.conj() if mirrored else flat) + scale * shift
    solid = np.stack((there.real, there.imag, scale * points[..., 2]), axis=-1)[:, order]
    moved = MarkerFrames(
        START + np.rint(slower * (stamps - START)).astype(np.int64),
        'world',
        tuple(np.array(frames.identities)[order]),
        solid,
    )
    others = values | {'window': 0.2 * slower, 'lag': 0.05 * slower}
    if reverse:
        others['bodies'] = list(bodies)[::-1]
    one, other = Tracker(settings_from(values)), Tracker(settings_from(others))
    expected, found = one.add(frames, 4), other.add(moved, 4)
    assert other.update_counts() == one.update_counts()
    b = slice(None, None, -1 if reverse else 1)
    hand = -1.0 if mirrored else 1.0
    rates = slower ** -np.arange(5.0)[:, None, None]

    def seen(vectors: np.ndarray) -> np.ndarray:
        return factor * (vectors.conj() if mirrored else vectors)

    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    axes = scale * axes @ np.diag([1.0, hand])
    for first, then in zip(expected, found, strict=True):
        np.testing.assert_array_equal(then.missing[:, b], first.missing)
        position = seen(first.position)
        position[0] += scale * shift
        both = rates[:, None] * rates
        for name, moved_so, unit in (
            ('angle', hand * first.angle, 1.0),
            ('position', position, scale),
        ):
            covariance = unit**2 * getattr(first, f'{name}_covariance') * both
            deviation = np.sqrt(np.einsum('kk...->k...', covariance))
            near(getattr(then, name)[..., b], moved_so * rates, deviation)
            covariances = getattr(then, f'{name}_covariance')[..., b]
            near(covariances, covariance, deviation[:, None] * deviation)
        near(then.span[:, b], slower * first.span)
        near(then.size[:, b], scale * first.size)
        for k in range(1, 5):
            pole, as_was = then.pole(k), first.pole(k)
            told = as_was.determined
            np.testing.assert_array_equal(pole.determined[:, b], told)
            near(pole.value[:, b][told], (seen(as_was.value) + scale * shift)[told])
            near(pole.covariance[:, b][told], axes @ as_was.covariance[told] @ axes.T)
        u, as_was = then.icr_velocity, first.icr_velocity
        np.testing.assert_array_equal(u.determined[:, b], as_was.determined)
        near(u.value[:, b][as_was.determined], seen(as_was.value)[as_was.determined] / slower)
        curvature, straight = then.centrode_curvature, first.centrode_curvature
        told = straight.determined
        np.testing.assert_array_equal(curvature.determined[:, b], told)
        deviation = np.sqrt(straight.variance[told]) / scale
        near(curvature.value[:, b][told], hand * straight.value[told] / scale, deviation)
        near(curvature.variance[:, b][told], straight.variance[told] / scale**2)


def near(found: np.ndarray, expected: np.ndarray, usual: np.ndarray | None = None) -> None:
    """To 1e-6 of each figure, or of what figures of its kind (..., T, B) are like."""
    if usual is None and expected.ndim > 1:
        some = np.where(np.isnan(expected).all(axis=-2, keepdims=True), 0.0, np.abs(expected))
        usual = np.nanmedian(some, axis=-2, keepdims=True)
    allowed = 1e-6 * np.maximum(np.abs(expected), 0.0 if usual is None else usual)
    assert not (np.abs(found - expected) > allowed).any()
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))


def test_a_pole_does_not_depend_on_what_else_is_asked_for() -> None:
    seen = record('four_bar', count=200, noise=1e-4)
    points = np.concatenate([frame.points for frame in seen.frames])
    stamps = START + STEP * np.arange(len(points))
    frames = MarkerFrames(stamps, 'world', seen.frames[0].identities, points)
    always, changing = Tracker(settings_from(seen.values)), Tracker(settings_from(seen.values))
    for first, order in ((0, 1), (80, 4), (120, 2), (140, 3)):
        part = part_of(frames, slice(first, first + 40 if first else 80))
        full, some = (instants(t.add(part, o)) for t, o in ((always, 4), (changing, order)))
        for one, other in zip(full, some, strict=True):
            alike(one.pole(1).value, other.pole(1).value)
            alike(one.pole(1).covariance, other.pole(1).covariance)


QUANTITIES: tuple[Callable[[Estimate], Any], ...] = (
    *(lambda estimate, k=k: estimate.pole(k) for k in range(1, 5)),
    lambda estimate: estimate.icr_velocity,
    lambda estimate: estimate.centrode_curvature,
    lambda estimate: estimate.relative_icr,
)


def alike(one: np.ndarray, other: np.ndarray) -> None:
    """To 1e-9 of what each figure (T, ...) is like over time."""
    scale = np.nanmedian(np.where(np.isnan(one).all(axis=0), 0.0, np.abs(one)), axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    one, other = one / scale, other / scale
    assert one.shape == other.shape
    same = (one == other) | (np.isnan(one) & np.isnan(other))
    # In one go: one by one, as approx does it, numbers by the million take longer than trackers.
    with np.errstate(invalid='ignore'):
        close = np.abs(one - other) <= 1e-9 * np.maximum(1.0, np.abs(other))
    assert (same | (close & np.isfinite(other))).all()


def test_a_name_stands_for_identity_then_namespace_then_id() -> None:
    identities = ('tip/3', 'tip/4', 'base/1', 'left/2', 'right/2', '7', 'plain')
    places = {
        'tip/3': 0,
        'tip/4': 1,
        '3': 0,
        '4': 1,
        'base': 2,
        '1': 2,
        'left': 3,
        'right': 4,
        '7': 5,
        'plain': 6,
    }
    for marker, place in places.items():
        assert find_rows(identities, [marker]) == [place]
    # Two of that namespace, two of that id, none at all, none in an empty message.
    for marker in ('tip', '2', 'nobody', 'base/2', '', '/'):
        assert find_rows(identities, [marker]) == [len(identities)]
    assert find_rows((), ['tip']) == [0]
    # The full identity goes before the namespace, and that before the id.
    assert find_rows(('3/9', '1/3', '3'), ['3']) == [2]
    assert find_rows(('1/3', '3/9'), ['3']) == [1]
    assert find_rows(('a/b/1',), ['a/b']) == [0]


def test_comparisons_of_names_grow_with_the_number_of_markers() -> None:
    """Each marker was held against all names of the message."""
    compared = 0

    class Name(str):
        def __eq__(self, other: object) -> bool:
            nonlocal compared
            compared += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    found = {}
    for count in (100, 200):
        names = [f'm{k}' for k in range(count)]
        values = {'bodies': ['body'], 'body.markers': names, 'plane': 'xy'}
        frame = one_frame(START, 'world', tuple(map(Name, names)), np.zeros((count, 3)))
        compared = 0
        Tracker(settings_from(values)).add(frame, None)
        found[count] = compared
    assert found[200] <= 2 * found[100]


def test_markers_of_no_body_are_counted() -> None:
    seen = record('four_bar', count=20)
    values = {'bodies': ['crank'], 'crank.markers': seen.values['crank.markers']}
    tracker, _ = follow(seen.frames, values)
    assert tracker.update_counts()['markers_unknown'] == 7
    assert tracker.update_counts()['markers_not_seen'] == 0
