"""Events: instants at which the velocity, acceleration or jerk of a body steps."""

import csv

import numpy as np
import pytest

from bench._events import event_motions, smooth_motions
from bench._motions import motions
from bench._rigs import record as record_rig
from bench._spoil import combined, exponential, hidden, misplaced, soft
from kinpole_ros import track
from kinpole_ros.derivatives import Samples, find_events
from kinpole_ros.planar import to_complex, to_plane
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.parameters import settings_from
from kinpole_ros.tracking.tracker import Tracker

RATE, WINDOW = 200, 0.3
SHARE = WINDOW / 8
MARKERS = np.array([(0.09, 0.02), (-0.03, 0.1), (-0.08, -0.05), (0.05, -0.06)])
SIZE = 0.2  # m


def events_of(values, sigma, seen=None, batch=64):
    """Events of samples (N, 3) at even times, their noise (3,), and the samples that are seen."""
    time = np.arange(len(values)) / RATE
    variance = np.tile(np.square(sigma)[:2], (len(values), 1))
    if seen is not None:
        variance[~seen] = np.inf
    asked = []
    for begin in np.arange(2.2 * WINDOW, time[-1] - WINDOW - SHARE, SHARE):
        rows = slice(*np.searchsorted(time, (begin - 2 * WINDOW, begin + WINDOW + SHARE)))
        asked.append(Samples(time[rows], values[rows], variance[rows], begin, begin + SHARE))
    found = [
        event
        for first in range(0, len(asked), batch)
        for event in find_events(asked[first : first + batch], WINDOW)
    ]
    return [event for event in found if event is not None]
