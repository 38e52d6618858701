"""
Samples of poses to derivatives with covariances, by Gaussian processes and their evidence.

A pose is an angle and a point of the plane; markers, rigid bodies and ROS are unknown here. At each
instant, the poses of a body in a window around it become one result, which depends on nothing else
but the spectrum of the body, if that is known from many windows:

1. Samples. Poses at stamps become even samples of three signals, in units of their noise. Samples
   may be missing, have a low weight, or be off the even grid.
2. Models. A signal is a line, a Gaussian process, and white noise. Some 130 processes differ in
   spectrum, length and amplitude, and the window alone determines their modes.
3. Evidence. Each model gives the probability of the samples under it, and derivatives at the
   instant, as sums over its modes. Missing samples are low-rank corrections.
4. Steps. Steps of position, velocity or acceleration are searched, as at an impact. The best are
   columns of a regression, with which models are evaluated.
5. Averaging. The derivatives are the mean of all models by probability. The covariance is the mean
   of theirs, by the root of the evidence, plus the variance between models and event places.
6. Segments. Free flight between impacts, or turning between stops, is a low polynomial between
   events. Such segments are mixed into the result by their evidence.
7. Spectrum. If the window has no event, the spectrum of the body is one more process.
8. Hub. If some point of the body has a polynomial as path, with more evidence than all of these,
   the position is that of this point.

==================== =============================================================================
_spectra.py          `find_spectrum`: the lines of a body's motion, from many windows
_models.py           2: processes, spectra, modes, and their derivatives, as tables for the library
window               1: the usual interval, the cell of each frame, the size of the window, blocks
samples              1: first guesses of even samples
models               tables as the library sees them; columns of samples of low weight and of steps
evidence             3: corrections for columns, evidence and probabilities; the formulas
screens, events      4: the search of steps
mean                 5: derivatives and covariances; uneven samples move along the estimated motion
polynomials          orthonormal polynomials of samples, and their derivatives
segments             6: polynomials between events
hub                  8: the point of a body whose path is a polynomial
derive               the order of these for one signal
_pose_derivatives.py `derive_poses`: arrays to the library and back; keeps the tables
_cached_tables.py    the same tables, in files
_event_search.py     `find_event`: reports events some time after them
change_points        the search of these, by polynomials with steps
==================== =============================================================================

Names without an ending are files of core/src. To understand the estimator, read _models.py,
evidence.h and events.h, in this order. A slower version with numpy is in
test/derivatives_reference.
"""

from kinpole_ros.derivatives._event_search import Event, Samples, find_event
from kinpole_ros.derivatives._models import FEWEST_SAMPLES
from kinpole_ros.derivatives._pose_derivatives import (
    Call,
    Derivatives,
    Poses,
    Windows,
    derive_poses,
    finish_call,
    new_call,
    set_spectra,
)
from kinpole_ros.derivatives._spectra import (
    SPECTRUM_WINDOWS,
    Spectrum,
    find_spectrum,
    spectrum_numbers,
)

__all__ = [
    'FEWEST_SAMPLES',
    'SPECTRUM_WINDOWS',
    'Call',
    'Derivatives',
    'Event',
    'Poses',
    'Samples',
    'Spectrum',
    'Windows',
    'derive_poses',
    'find_event',
    'find_spectrum',
    'finish_call',
    'new_call',
    'set_spectra',
    'spectrum_numbers',
]
