"""The files that a frame visits, from the bytes of its message to those of all topics."""

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from rig_streams import PARAMETERS, markers

import kinpole_ros
from kinpole_ros.messages import (
    MarkerReader,
    joint_build,
    live_outputs,
    message_class,
    serialize_message,
)
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.tracker import Tracker

PACKAGE = str(Path(kinpole_ros.__file__).parent)
# As docs/architecture.md describes the walk.
USUAL = {
    *('messages/_reader.py', 'tracking/tracker.py', 'tracking/timeline.py', 'tracking/placing.py'),
    *('tracking/step.py', 'tracking/estimate.py', 'tracking/quantities.py'),
    *('messages/_results.py', 'messages/_rows.py', 'messages/_drawing.py'),
}
# A frame that C does not take alone; events are searched once in a share of a window.
CORRECTED = {
    *('tracking/correction.py', 'tracking/names.py', 'tracking/identity.py'),
    *('tracking/candidates.py', 'tracking/statistics.py', 'planar/_procrustes.py'),
}
NOW_AND_THEN = {'tracking/events.py', 'tracking/history.py', 'derivatives/_event_search.py'}


def cloud(points: np.ndarray, k: int) -> bytes:
    """A PointCloud2 of the markers (n,) of frame `k`."""
    names = ('sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/PointField', 'std_msgs/msg/Header')
    cloud_of, field, header = map(message_class, names)
    time = message_class('builtin_interfaces/msg/Time')
    xyz = np.stack((points.real, points.imag, 0 * points.real), axis=1).astype('<f4')
    # Not even to the nanosecond, as those of a camera.
    stamp = 1_000_000_000 + k * 10_000_000 + 997 * (k % 7)
    return serialize_message(
        cloud_of(
            header=header(stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id='map'),
            height=1,
            width=len(points),
            fields=[field(name=n, offset=4 * i, datatype=7, count=1) for i, n in enumerate('xyz')],
            is_bigendian=False,
            point_step=12,
            row_step=12 * len(points),
            data=np.frombuffer(xyz.tobytes(), np.uint8),
            is_dense=True,
        )
    )


@pytest.fixture(scope='module')
def walks() -> dict[str, list[str]]:
    """The files of the package that a frame visits, in order, of a usual and of a bad frame."""
    settings = settings_from(PARAMETERS)
    reader, tracker = MarkerReader('point_cloud2'), Tracker(settings)
    outputs = [output for output in live_outputs(settings, None) if not output.interval]
    build, order = joint_build(outputs), max(output.order for output in outputs)
    points, visited, walks = markers(0), list[str](), dict[str, list[str]]()

    def note(frame: FrameType, event: str, _: Any) -> None:
        name = frame.f_code.co_filename
        if event == 'call' and name.startswith(PACKAGE):
            file = Path(name).relative_to(PACKAGE).as_posix()
            if not visited or visited[-1] != file:
                visited.append(file)

    points[405, 1] += 0.05
    for k, of_frame in enumerate(points[:460]):
        message = cloud(of_frame, k)
        visited.clear()
        sys.setprofile(note if k in (405, 451) else None)
        for frames in reader.read([message]):
            for estimate in tracker.add(frames, order, True):
                list(build(estimate))
        sys.setprofile(None)
        tracker.learn_if_due()
        if k in (405, 451):
            walks['bad marker' if k == 405 else 'usual'] = visited.copy()
    assert tracker.update_counts()['markers_left_out'] == 1
    return walks


def test_a_usual_frame_visits_the_files_that_the_docs_name(walks: dict[str, list[str]]) -> None:
    walk = walks['usual']
    print('\n'.join(walk))
    assert set(walk) == USUAL
    assert len(walk) - len(set(walk)) <= 12


def test_a_bad_marker_adds_the_files_of_its_correction(walks: dict[str, list[str]]) -> None:
    walk = walks['bad marker']
    print('\n'.join(walk))
    assert set(walk) - NOW_AND_THEN == USUAL | CORRECTED
    assert len(walk) - len(set(walk)) <= 56
