"""Frames one by one, as live, give what blocks of them give, as in replay, however spoiled."""

from collections.abc import Callable

import numpy as np
import pytest
from rig_streams import STREAMS, Stream

from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.tracker import Tracker

COLUMNS = (
    *('stamp', 'angle', 'position', 'reference', 'angle_covariance', 'position_covariance'),
    *('size', 'height', 'span', 'degree', 'reason', 'pin', 'pin_variance'),
)
INSTANT_AXIS = {'angle': 1, 'position': 1, 'angle_covariance': 2, 'position_covariance': 2}


def tracked(stream: Stream, size: int) -> tuple[Tracker, list[Estimate]]:
    tracker, estimates = Tracker(settings_from(stream.parameters)), []
    for block in stream.blocks(size):
        estimates += tracker.add(block, 2, events=True)
        tracker.learn_if_due()
    return tracker, estimates


def column(estimates: list[Estimate], name: str) -> np.ndarray:
    return np.concatenate([getattr(e, name) for e in estimates], INSTANT_AXIS.get(name, 0))


def events(estimates: list[Estimate]) -> list[tuple[int, int, int]]:
    return [(e.body, e.stamp, e.order) for estimate in estimates for e in estimate.events]


@pytest.mark.parametrize('make', STREAMS, ids=lambda make: make.__name__)
def test_frames_one_by_one_give_the_results_of_blocks(make: Callable[[], Stream]) -> None:
    stream = make()
    live, one_by_one = tracked(stream, 1)
    replay, in_blocks = tracked(stream, 97)
    assert sum(map(len, one_by_one)) > 50
    for name in COLUMNS:
        expected, found = column(one_by_one, name), column(in_blocks, name)
        if expected.dtype.kind in 'OUi':
            np.testing.assert_array_equal(found, expected, err_msg=name)
        else:
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=name)
    assert replay.update_counts() == live.update_counts()
    assert replay.outages() == live.outages()
    assert replay.wrong().tolist() == live.wrong().tolist()
    assert replay.matcher.notes == live.matcher.notes
    assert replay.matcher.regrouped == live.matcher.regrouped
    assert events(in_blocks) == events(one_by_one)
