"""
The point that a body turns about: a pin, fixed to the ground, or a hub, on a simple path.

Let c be that point in the frame of the body, and p its position in the plane. The origin of the
body is at z = p - c exp(i angle). Where p is a polynomial of time, regression of z on exp(i angle)
gives c. A pin has degree 0 over all poses, a hub a low degree over each window. The path of a hub
is smoother than that of a point on the rim, so the hub represents the position of the body.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import chi_square, medians, student
from kinpole_ros.tracking.thresholds import CONFIRMING_FRAMES, MEMORY_FRAMES, MIN_SAMPLES, N_SIGMA

# Poses kept per body, and the angle between them, rad: 4 rad of turning in one direction.
_MAX_POSES = 64
_MIN_STEP = 4 / _MAX_POSES
# A pin is taken below this ratio of its mean square residual to that of the rigid fit, and dropped
# above it.
_MAX_MISFIT_RATIO = 2.0
# Correlation of residuals beyond this many standard deviations adds to the variance of a pin.
_CORRELATION_SIGMAS = 2.0
# The center of an arc whose residuals are correlated is off by this many times their square over
# the spread of the angles (a centrode of constant speed over a small arc).
_ARC_BIAS = 15.0
# An ICR that moves by this many body sizes per rad would be seen.
_MIN_ICR_SPEED = 0.05
# A body has to be visible in this share of the frames of a window.
_MIN_VISIBLE = 0.5
# Degrees of the polynomials of a hub. The first two decide whether there is a hub; of all, the one
# with the smallest variance locates it. The hub of a wheel moves on a line, and higher degrees
# would take part of its motion away.
_DEGREES = np.arange(1, 6)[:, None]
_DECIDING_DEGREE = 1
# A hub is taken if turning about it explains this share of the motion, and far more than noise
# would; and if the angle changes by as many times its noise.
_MIN_EXPLAINED, _MIN_SIGNAL = 0.9, N_SIGMA**2
# Number of windows with equal turning that must agree on a hub.
_MIN_WINDOWS = 2.9
# Frames of late whose windows show a hub: a body may turn about another point from now on.
_HUB_FRAMES = 1024
# Windows whose residuals exceed those of the others by this factor are down-weighted.
_MAX_RESIDUAL_RATIO = 100.0


class PinSearch(NamedTuple):
    """
    Poses kept for the pins of B bodies, by the angle turned, so that a body at rest keeps its pin.

    `markers` (64, B, n), complex, m, are those of the poses, NaN for none. `count` (B,) is the
    number of poses so far, `required` (B,) that of a new pin, and `last_angle` (B,), rad, is that
    of the last pose.
    """

    markers: Complex
    count: np.ndarray
    required: np.ndarray
    last_angle: Real

    def widen(self, width: int) -> 'PinSearch':
        """Make room for up to `width` markers per body."""
        added = (0, 0), (0, 0), (0, width - self.markers.shape[2])
        return self._replace(markers=np.pad(self.markers, added, constant_values=np.nan))

    def forget(self, which: np.ndarray) -> 'PinSearch':
        """Forget the poses of some bodies (B,)."""
        return self._replace(count=np.where(which, 0, self.count))


def new_pin_search(bodies: int, width: int) -> PinSearch:
    """Return the search for pins without poses."""
    return PinSearch(
        markers=np.full((_MAX_POSES, bodies, width), complex(np.nan, np.nan)),
        count=np.zeros(bodies, int),
        required=np.full(bodies, _MAX_POSES // 2),
        last_angle=np.full(bodies, np.nan),
    )


def update_pins(
    bodies: Bodies, search: PinSearch, history: History, new: int
) -> tuple[Bodies, PinSearch]:
    """Take the `new` newest frames, and fit pins to the poses kept so far."""
    rows = slice(len(history) - new, None)
    angle, position = history['angle'][rows], history['position'][rows]
    information = history['information'][rows] * bodies.fitting.information_factor
    has_pose = (information > 0).all(axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        variance = bodies.marker_variance / information
    off = has_pose & _off_pins(bodies, position, angle, variance)
    bodies, search = _drop(bodies, search, _any_run(off, CONFIRMING_FRAMES))
    usable = has_pose & ~off
    with np.errstate(invalid='ignore'):
        far = np.abs((angle - search.last_angle + np.pi) % (2 * np.pi) - np.pi) > _MIN_STEP
    fresh = usable & (far | (search.count == 0))
    since = bodies.pin_since.copy()
    search = search._replace(
        markers=search.markers.copy(),
        count=search.count.copy(),
        last_angle=search.last_angle.copy(),
    )
    for b in np.flatnonzero(fresh.any(axis=0)).tolist():
        at = np.flatnonzero(usable[:, b] & (np.arange(new) >= fresh[:, b].argmax()))
        at = at[_spaced(angle[at, b].tolist())]
        if not search.count[b]:
            since[b] = history['time'][rows][at[0]]
        slots = (search.count[b] + np.arange(len(at))) % _MAX_POSES
        used = history['used'][rows][at, b]
        search.markers[slots, b] = np.where(used, history['markers'][rows][at, b], np.nan)
        search.last_angle[b] = angle[at[-1], b]
        search.count[b] += len(at)
    # Poses are weighed by their noise, which is 0 until it is known.
    which = np.flatnonzero((search.count >= MIN_SAMPLES) & (bodies.marker_variance > 0))
    bodies = bodies.change(pin_since=since)
    return _fit_pins(bodies, search, which) if len(which) else (bodies, search)


def _off_pins(bodies: Bodies, position: Complex, angle: Real, variance: Real) -> np.ndarray:
    """Return where (N, B) bodies are off their pins; `variance` (N, 2, B) is of the poses."""
    with np.errstate(invalid='ignore'):
        off = np.abs(position + np.exp(1j * angle) * bodies.pin_arm - bodies.pin) ** 2
        spread = variance[:, 1] + np.abs(bodies.pin_arm) ** 2 * variance[:, 0]
        return np.asarray(off > N_SIGMA**2 * spread)


def _fit_pins(bodies: Bodies, search: PinSearch, which: np.ndarray) -> tuple[Bodies, PinSearch]:
    """Fit pins to the poses kept of some bodies (b,)."""
    count = np.minimum(search.count, _MAX_POSES)
    is_pose = np.arange(_MAX_POSES)[:, None] < count
    fit = bodies.fit(np.where(is_pose[..., None], search.markers, np.nan))
    is_pose = (is_pose & np.isfinite(fit.angle))[:, which]
    z = np.where(is_pose, fit.position[:, which], 0)
    e = np.where(is_pose, np.exp(1j * fit.angle[:, which]), 0)
    misfit, factor = bodies.marker_variance[which], bodies.fitting.information_factor[:, which]
    information = fit.weight[:, which] * factor[1], fit.spread[:, which] * factor[0]
    with np.errstate(divide='ignore', invalid='ignore'):
        even, of_angle = (np.where(is_pose, misfit / part, 0.0) for part in information)
        scale = np.sqrt(misfit[:, None] * bodies.relative[which])
        marker_residual = fit.residual[:, which] / scale
    usable = is_pose[..., None] & ~np.isnan(marker_residual)
    marker_residual = np.where(usable, marker_residual, 0)
    pin = _fit_centers(z, e, is_pose, (even, of_angle), marker_residual)
    contradicted = pin.square > _MAX_MISFIT_RATIO
    size = bodies.fitting.size[which]
    is_seen = np.sqrt(pin.noise) < _MIN_ICR_SPEED * 0.45 * size * pin.spread
    is_seen &= pin.variance < (_MIN_ICR_SPEED * size) ** 2
    is_pinned = (search.count[which] >= search.required[which]) & is_seen
    is_pinned |= np.isfinite(bodies.pin[which])
    is_pinned &= ~contradicted
    pinned, changes = which[is_pinned], {}
    for name, values in (
        ('pin', pin.center),
        ('pin_arm', pin.arm),
        ('pin_variance', pin.variance),
    ):
        changes[name] = getattr(bodies, name).copy()
        changes[name][pinned] = values[is_pinned]
    dropped = np.zeros(bodies.count, bool)
    dropped[which[contradicted]] = True
    return _drop(bodies.change(**changes), search, dropped)


def _drop(bodies: Bodies, search: PinSearch, which: np.ndarray) -> tuple[Bodies, PinSearch]:
    """Drop the pins of some bodies (B,), which need eight times as many poses for another."""
    if not which.any():
        return bodies, search
    more = np.minimum(8 * search.required, MEMORY_FRAMES)
    required = np.where(which & np.isfinite(bodies.pin), more, search.required)
    bodies = bodies.change(
        pin=np.where(which, complex(np.nan, np.nan), bodies.pin),
        pin_variance=np.where(which, np.nan, bodies.pin_variance),
    )
    return bodies, search._replace(required=required).forget(which)


def _correlated_part(residual: Complex, count: np.ndarray) -> Real:
    """Mean product (b,) of neighboring residuals (T, b), beyond that of white noise."""
    products = (residual * np.roll(residual, 1, axis=0).conj()).real.sum(axis=0)
    total = (np.abs(residual) ** 2).sum(axis=0)
    return np.asarray(np.maximum(products - _CORRELATION_SIGMAS * total / np.sqrt(count), 0) / 2)


def _any_run(values: np.ndarray, length: int) -> np.ndarray:
    """Where (B,) values (N, B) are true this many times in a row."""
    if len(values) < length:
        return np.zeros(values.shape[1], bool)
    runs = np.lib.stride_tricks.sliding_window_view(values, length, axis=0)
    return np.asarray(runs.all(axis=-1).any(axis=0))


def find_hubs(bodies: Bodies, history: History, window: int, before: Complex) -> Complex:
    """
    Find the hubs of bodies.

    Parameters
    ----------
    bodies, history : Bodies, History
        What is known of the bodies, and their poses.
    window : int
        Length of the windows of the derivatives, ns.
    before : (B,) complex
        The hubs found before.

    Returns
    -------
    (B,) complex
        The hubs in the frames of the bodies, m, 0 for a body that has none.

    """
    time = history['time']
    oldest = max(len(time) - _HUB_FRAMES, 0)
    ends = [len(time)]
    while ends[-1] > oldest and time[ends[-1] - 1] - time[oldest] >= window:
        ends.append(int(time.searchsorted(time[ends[-1] - 1] - window)))
    if len(ends) == 1:
        return np.zeros(bodies.count, complex)
    first, end = np.array(ends[1:]), np.array(ends[:-1])
    # Rows (W, N) of W windows, as many as the largest has.
    rows = end[:, None] - np.arange((end - first).max(), 0, -1)
    is_inside = rows >= first[:, None]
    rows = np.maximum(rows, 0)
    information = history['information'][rows] * bodies.fitting.information_factor
    visible = (information > 0).all(axis=2) & is_inside[..., None]
    count = visible.sum(axis=1)
    usable = count > np.maximum(_DEGREES[-1] + 1, _MIN_VISIBLE * (end - first)[:, None])
    if not usable.any():
        return np.zeros(bodies.count, complex)
    visible &= usable[:, None]
    position = history['position'][rows]
    start = np.take_along_axis(position, visible.argmax(axis=1)[:, None], axis=1)
    values = np.where(visible, (position - start, np.exp(1j * history['angle'][rows])), 0.0)
    times = (time[rows] - time[first][:, None]) / window
    sums = np.where(usable, _residual_sums(times, values, visible), 0.0)  # (3, D, W, B)
    with np.errstate(divide='ignore', invalid='ignore'):
        variance = np.where(visible[:, :, None], bodies.marker_variance / information, 0.0)
    variance = variance.sum(axis=1) / np.maximum(count, 1)[:, None]
    freedom = np.where(usable, count - 1 - _DEGREES[..., None], 0)
    return _hubs_of_sums(sums, variance, freedom, before)


def _hubs_of_sums(sums: Complex, variance: Real, freedom: Real, before: Complex) -> Complex:
    """
    Hubs (B,) from the sums of `_residual_sums` over windows, 0 for none.

    `variance` (W, 2, B) is that of angle and position in each window, `freedom` (D, W, B) the
    degrees of freedom of each polynomial.
    """
    path, turning, product = sums[0].real, sums[1].real, sums[2]
    path_noise, turning_noise = 2 * freedom * variance[:, 1], freedom * variance[:, 0]
    deciding = _DECIDING_DEGREE
    # The former hub is wrong if it explains the newest window worse than no hub.
    is_wrong = np.abs(product + before * turning) ** 2 > np.abs(product) ** 2
    is_wrong = (is_wrong & (turning > _MIN_SIGNAL * turning_noise))[deciding, 0] & (before != 0)
    # Down-weight a window that no hub explains, such as one with a jump.
    own_hub = np.abs(product[deciding]) ** 2
    own_hub /= np.where(turning[deciding] > 0, turning[deciding], 1.0)
    residual = (path[deciding] - own_hub) / np.maximum(freedom[deciding], 1)
    usable = freedom[deciding] > 0
    typical = medians(np.where(usable, residual, np.nan).T)
    typical = np.maximum(typical, np.finfo(float).tiny)
    weights = 1 / np.maximum(residual / (_MAX_RESIDUAL_RATIO * typical), 1.0)
    squares = ((weights * turning[deciding]) ** 2).sum(axis=0)
    path, turning, product, path_noise, turning_noise, freedom = (
        (weights * part).sum(axis=1)
        for part in (path, turning, product, path_noise, turning_noise, freedom)
    )
    freedom = np.maximum(freedom, 1.0)
    turns = turning > _MIN_SIGNAL * turning_noise
    turning = np.where(turns, turning - turning_noise, 1.0)
    hub = np.where(turns, -product / turning, 0.0)
    explained = np.abs(product * hub)
    unexplained = np.maximum(path - explained, 0.0) / freedom
    required = np.maximum(_MIN_EXPLAINED * (path - path_noise), _MIN_SIGNAL * path_noise / freedom)
    is_hub = (explained > required) & (turning**2 > _MIN_WINDOWS * squares)
    best = np.where(turns, unexplained / turning, np.inf).argmin(axis=0), np.arange(hub.shape[1])
    return np.where(turns[best] & is_hub[deciding] & ~is_wrong, hub[best], 0.0)


class _PinFit(NamedTuple):
    """
    Pins fitted to poses of b bodies.

    `center`, `arm` and `variance` are `pin`, `pin_arm` and `pin_variance` of `Bodies`. `square` is
    the mean square residual over that of the noise, `noise` the variance of a position, m^2, and
    `spread` that of the turns.
    """

    center: Complex
    arm: Complex
    variance: Real
    square: Real
    noise: Real
    spread: Real


def _fit_centers(
    z: Complex, e: Complex, is_pose: np.ndarray, noise: tuple[Real, Real], marker_residual: Complex
) -> _PinFit:
    """
    Fit pins to poses (T, b) of bodies at `z`, turned by `e`, where there `is_pose`.

    `noise` are the variances (T, b) of a position, m^2, and of an angle, rad^2; the residuals of
    the markers (T, b, n) are in standard deviations.
    """
    even, of_angle = noise
    count = np.maximum(is_pose.sum(axis=0), 3)
    # Weight by the variance at the pin, which depends on the arm.
    arm = _fit_arm(z, e, is_pose / count)[0]
    across = even + np.abs(arm) ** 2 * of_angle
    weights = 1 / np.where(is_pose, across, 1)
    weights = np.where(is_pose, weights, 0.0)
    weights /= weights.sum(axis=0)
    arm, z_mean, e_mean, spread = _fit_arm(z, e, weights)
    across = even + np.abs(arm) ** 2 * of_angle
    around = np.where(is_pose, e - e_mean, 0)
    # Residuals in the frame of the body, along and across the arm.
    residual = (np.where(is_pose, z - z_mean, 0) + arm * around) * e.conj()
    direction = np.where(arm == 0, 1, arm / np.maximum(np.abs(arm), np.finfo(float).tiny))
    residual = residual * direction.conj()
    squares = residual.real**2 / np.where(is_pose, even, 1)
    squares += residual.imag**2 / np.where(is_pose, across, 1)
    square = squares.sum(axis=0) / np.maximum(2 * count - 4, 1)
    # The center is linear in the poses, with these coefficients.
    shares = weights * (1 - e_mean * around.conj() / spread)
    white = np.maximum(square, 1) * np.where(is_pose, even + across, 0) / 2
    variance = (np.abs(shares) ** 2 * white).sum(axis=0)
    variance += _ARC_BIAS * _correlated_part(residual * np.sqrt(weights), count) / spread
    # Errors of the shape move the center with the angle, and are seen in the markers.
    slow = np.einsum('kb,kbn->bn', shares * e * np.sqrt((even + across) / 2), marker_residual)
    freedom = np.maximum(2 * marker_residual.any(axis=0).sum(axis=-1) - 3, 1)
    slow = (np.abs(slow) ** 2).sum(axis=-1) / freedom
    is_slow = slow > chi_square(freedom, _CORRELATION_SIGMAS) * variance
    variance = np.where(is_slow, slow * student(freedom), variance)
    mean_noise = (weights * even).sum(axis=0)
    return _PinFit(z_mean + arm * e_mean, arm, variance, square, mean_noise, spread)


def _fit_arm(z: Complex, e: Complex, weights: Real) -> tuple[Complex, Complex, Complex, Real]:
    """
    Fit the arms (b,) to the pins of bodies at `z`, turned by `e` (T, b).

    Also returns the means of both, and the spread of the turns. The weights (T, b) add up to 1.
    """
    z_mean, e_mean = (weights * z).sum(axis=0), (weights * e).sum(axis=0)
    around = e - e_mean
    spread = (weights * np.abs(around) ** 2).sum(axis=0)
    return -(weights * (z - z_mean) * around.conj()).sum(axis=0) / spread, z_mean, e_mean, spread


def _spaced(angles: list[float]) -> list[int]:
    """Indices of the first angle, and of each that is a step from the one before."""
    spaced, last = [0], angles[0]
    for k, angle in enumerate(angles):
        if abs((angle - last + np.pi) % (2 * np.pi) - np.pi) > _MIN_STEP:
            spaced.append(k)
            last = angle
    return spaced


def _residual_sums(times: Real, values: Complex, visible: np.ndarray) -> Complex:
    """
    Sums (3, D, W, B) over the residuals of polynomials of each degree, fitted to each window.

    The sums are of |path|^2, |turn|^2 and conj(turn) path. `values` (2, W, N, B) are paths and
    turns at `times` (W, N), 0 where a body is not `visible` (W, N, B).
    """
    powers = (times - 0.5)[..., None] ** np.arange(int(_DEGREES[-1, 0]) + 1)
    if (visible == visible[..., :1]).all():
        visible = visible[..., :1]
    powers = powers[:, None] * visible.swapaxes(1, 2)[..., None]
    basis, _ = np.linalg.qr(powers)  # (W, 1 or B, N, P)
    columns = values.swapaxes(2, 3)[..., None]
    coefficients = basis.swapaxes(2, 3) @ columns
    residual = (columns - basis @ coefficients)[..., 0]
    coefficients = np.moveaxis(coefficients[..., 0], -1, 1)  # (2, P, W, B)
    # The residual of the highest degree, plus the coefficients that each lower degree lacks.
    sums = []
    for first, second in ((0, 0), (1, 1), (1, 0)):
        product = coefficients[first].conj() * coefficients[second]
        lacking = np.cumsum(product[:1:-1], axis=0)[::-1]
        lacking = np.concatenate((lacking, np.zeros_like(lacking[:1])))
        sums.append(lacking + (residual[first].conj() * residual[second]).sum(axis=-1))
    return np.array(sums)
