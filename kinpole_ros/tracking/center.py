"""
The point that a body turns about: a pin, fixed to the ground, or a hub, on a simple path.

With the arm c in the axes of the body, its origin is at z = p - c exp(i angle) for its point p.
Regressing z on exp(i angle) gives c where the path of p is a polynomial of time: of degree 0 over
all poses for a pin, of a low degree over each window for a hub. A hub is followed by longer windows
than a point on the rim, so it stands for the position of the body.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.fit import fit_markers
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import chi_square, medians, student
from kinpole_ros.tracking.thresholds import CONFIRMING_FRAMES, MEMORY_FRAMES, MIN_SAMPLES, N_SIGMA

# Poses kept per body, and the angle between them, rad: 4 rad of one-way turning.
_KEPT = 64
_STEP = 4 / _KEPT
# Mean square misfit, over what the rigid fit lets expect, below which a pin is taken and above
# which it is dropped.
_MISFIT = 2.0
# What is not noise makes a pin less sure from so many deviations on: the sum of residuals, or
# products of neighbors, where the misfit is similar from pose to pose.
_DOUBTED = 2.0
# An arc bent by such a misfit has its center off by this many times its square over the spread of
# the angles (a centrode of constant speed, seen over a small arc).
_BEND = 15.0
# An ICR that wandered by this much, body sizes per rad, would have been seen.
_WANDER = 0.05
# A window is looked at in which the body is seen in this share of the frames.
_PRESENT = 0.5
# Of polynomials whose rests are looked at: one says whether, the one that tells best where. That
# may be a line, as the hub of a wheel goes, of which a parabola takes half away.
_DEGREES = np.arange(1, 6)[:, None]
_WHETHER = 1
# A point is taken when turning about it explains this share of what moves, and far more than the
# noise would have it explain; the angle must turn by as many times its noise.
_SHARE, _CLEAR = 0.9, N_SIGMA**2
# Number of windows that must agree on a hub, reckoned as many in which the body turns alike.
_WINDOWS = 2.9
# A window that leaves more than the others by this factor counts for less, in proportion.
_UNEXPLAINED = 100.0
# The newest frames may turn out to have been at other times, where stamps are late.
UNSETTLED = 20


class Pins:
    """
    Pins of B bodies: `center` (B,), complex, m, NaN for none, its `arm` in the axes of the body,
    the `variance` of a coordinate, m^2, and `since` when the body was seen to turn about it, ns.

    Poses are kept by the angle turned, not by time: a body at rest stays what it was.
    """

    def __init__(self, bodies: Bodies) -> None:
        count = bodies.count
        self.center = np.full(count, complex(np.nan, np.nan))
        self.arm = np.zeros(count, complex)
        self.variance = np.full(count, np.nan)
        self.since = np.zeros(count, np.int64)
        self._markers = np.full((_KEPT, count, bodies.width), complex(np.nan, np.nan))
        self._number = np.zeros(count, int)
        self._wanted = np.full(count, _KEPT // 2)
        self._last = np.full(count, np.nan)

    def widen(self, width: int) -> None:
        """Make room for up to `width` markers per body."""
        more = (0, 0), (0, 0), (0, width - self._markers.shape[2])
        self._markers = np.pad(self._markers, more, constant_values=np.nan)

    def forget(self, which: np.ndarray) -> None:
        """Forget the poses and pins of the bodies `which` (B,)."""
        self.center[which] = complex(np.nan, np.nan)
        self.variance[which] = np.nan
        self._number[which] = 0

    def off(self, position: Complex, angle: Real, variance: Real) -> np.ndarray:
        """Where (N, B) a body is off its pin; `variance` (N, 2, B) is of angle and position."""
        with np.errstate(invalid='ignore'):
            off = np.abs(position + np.exp(1j * angle) * self.arm - self.center) ** 2
            spread = variance[:, 1] + np.abs(self.arm) ** 2 * variance[:, 0]
            return np.asarray(off > N_SIGMA**2 * spread)

    def update(self, bodies: Bodies, history: History, new: int, posed: bool = False) -> None:
        """Take the `new` newest frames, and fit pins to the poses that are kept."""
        rows = slice(len(history) - new, None)
        angle, position = history['angle'][rows], history['position'][rows]
        information = history['information'][rows] * bodies.scale
        known = (information > 0).all(axis=1)
        with np.errstate(divide='ignore', invalid='ignore'):
            variance = bodies.error / information
        off = known & self.off(position, angle, variance)
        self._leave(_any_run(off, CONFIRMING_FRAMES))
        usable = known & ~off
        with np.errstate(invalid='ignore'):
            far = np.abs((angle - self._last + np.pi) % (2 * np.pi) - np.pi) > _STEP
        fresh = usable & (far | (self._number == 0))
        for b in np.flatnonzero(fresh.any(axis=0)).tolist():
            at = np.flatnonzero(usable[:, b] & (np.arange(new) >= fresh[:, b].argmax()))
            at = at[_spaced(angle[at, b].tolist())]
            if not self._number[b]:
                self.since[b] = history['time'][rows][at[0]]
            place = (self._number[b] + np.arange(len(at))) % _KEPT
            used = history['used'][rows][at, b]
            self._markers[place, b] = np.where(used, history['markers'][rows][at, b], np.nan)
            self._last[b] = angle[at[-1], b]
            self._number[b] += len(at)
        self._fit(bodies, self._number >= MIN_SAMPLES, posed)

    def _fit(self, bodies: Bodies, which: np.ndarray, posed: bool) -> None:
        """Fit pins to the poses kept of the bodies `which` (B,)."""
        if not which.any():
            return
        which = np.flatnonzero(which)
        count = np.minimum(self._number, _KEPT)
        held = np.arange(_KEPT)[:, None] < count
        fit = fit_markers(bodies, np.where(held[..., None], self._markers, np.nan))
        held = (held & np.isfinite(fit.angle))[:, which]
        count = np.maximum(held.sum(axis=0), 3)
        z = np.where(held, fit.position[:, which], 0)
        e = np.where(held, np.exp(1j * fit.angle[:, which]), 0)
        misfit = bodies.error[which]
        information = fit.weight[:, which], fit.spread[:, which]
        if posed:
            information = bodies.scale[1, which], bodies.scale[0, which]
        with np.errstate(divide='ignore', invalid='ignore'):
            even, of_angle = (np.where(held, misfit / part, 0.0) for part in information)
            scale = np.sqrt(misfit[:, None] * bodies.relative[which])
            left = fit.residual[:, which] / scale
        left = np.where(held[..., None] & ~np.isnan(left), left, 0)
        arm = _arm(z, e, held / count)[0]
        weights = np.where(held, 1 / np.where(held, even + np.abs(arm) ** 2 * of_angle, 1), 0)
        weights /= weights.sum(axis=0)
        arm, z_mean, e_mean, spread = _arm(z, e, weights)
        around = np.where(held, e - e_mean, 0)
        off = (np.where(held, z - z_mean, 0) + arm * around) * e.conj()
        along = np.where(arm == 0, 1, arm / np.maximum(np.abs(arm), np.finfo(float).tiny))
        off = off * along.conj()
        across = even + np.abs(arm) ** 2 * of_angle
        squares = off.real**2 / np.where(held, even, 1) + off.imag**2 / np.where(held, across, 1)
        square = squares.sum(axis=0) / np.maximum(2 * count - 4, 1)
        shares = weights * (1 - e_mean * around.conj() / spread)
        each = np.maximum(square, 1) * np.where(held, even + across, 0) / 2
        off *= np.sqrt(weights)
        similar = (off * np.roll(off, 1, axis=0).conj()).real.sum(axis=0)
        total = (np.abs(off) ** 2).sum(axis=0)
        bent = np.maximum(similar - _DOUBTED * total / np.sqrt(count), 0) / 2
        found = (np.abs(shares) ** 2 * each).sum(axis=0) + _BEND * bent / spread
        slow = np.einsum('kb,kbn->bn', shares * e * np.sqrt((even + across) / 2), left)
        freedom = np.maximum(2 * left.any(axis=0).sum(axis=-1) - 3, 1)
        slow = (np.abs(slow) ** 2).sum(axis=-1) / freedom
        surely = slow > chi_square(freedom, _DOUBTED) * found
        found = np.where(surely, slow * student(freedom), found)
        contradicted = square > _MISFIT
        noise = (weights * even).sum(axis=0)
        size = bodies.size[which]
        seen = np.sqrt(noise) < _WANDER * 0.45 * size * spread
        seen &= found < (_WANDER * size) ** 2
        taken = (self._number[which] >= self._wanted[which]) & seen
        taken |= np.isfinite(self.center[which])
        taken &= ~contradicted
        pinned = which[taken]
        self.center[pinned] = (z_mean + arm * e_mean)[taken]
        self.arm[pinned] = arm[taken]
        self.variance[pinned] = found[taken]
        gone = np.zeros(bodies.count, bool)
        gone[which[contradicted]] = True
        self._leave(gone)

    def _leave(self, which: np.ndarray) -> None:
        """Take the bodies `which` (B,) off their pins; next time eight times as much is wanted."""
        left = which & np.isfinite(self.center)
        self._wanted[left] = np.minimum(8 * self._wanted[left], MEMORY_FRAMES)
        self.forget(which)


def _any_run(values: np.ndarray, length: int) -> np.ndarray:
    """Where (B,) so many values (N, B) in a row are true."""
    if len(values) < length:
        return np.zeros(values.shape[1], bool)
    runs = np.lib.stride_tricks.sliding_window_view(values, length, axis=0)
    return np.asarray(runs.all(axis=-1).any(axis=0))


def find_hubs(bodies: Bodies, history: History, window: int, before: Complex) -> Complex:
    """
    The hubs (B,) of bodies in their frames, complex, m, 0 for a body that has none.

    `window`, ns, is as long as that of the derivatives; `before` (B,) are the hubs up to now.
    """
    time = history['time'][: len(history) - UNSETTLED]
    ends = [len(time)]
    while ends[-1] and time[ends[-1] - 1] - time[0] >= window:
        ends.append(int(time.searchsorted(time[ends[-1] - 1] - window)))
    if len(ends) == 1:
        return np.zeros(bodies.count, complex)
    first, end = np.array(ends[1:]), np.array(ends[:-1])
    # Rows (W, N) of the windows, as many as the largest has.
    rows = end[:, None] - np.arange((end - first).max(), 0, -1)
    within = rows >= first[:, None]
    rows = np.maximum(rows, 0)
    information = history['information'][rows] * bodies.scale
    seen = (information > 0).all(axis=2) & within[..., None]
    number = seen.sum(axis=1)
    enough = np.maximum(_DEGREES[-1] + 1, _PRESENT * (end - first)[:, None])
    known = number > enough
    if not known.any():
        return np.zeros(bodies.count, complex)
    seen &= known[:, None]
    position = history['position'][rows]
    start = np.take_along_axis(position, seen.argmax(axis=1)[:, None], axis=1)
    values = np.where(seen, (position - start, np.exp(1j * history['angle'][rows])), 0.0)
    times = (time[rows] - time[first][:, None]) / window
    moves, turns, product = np.where(known, _rests(times, values, seen), 0.0)  # (D, W, B)
    moves, turns = moves.real, turns.real
    with np.errstate(divide='ignore', invalid='ignore'):
        variance = np.where(seen[:, :, None], bodies.error / information, 0.0)
    mean = variance.sum(axis=1) / np.maximum(number, 1)[:, None]
    counts = np.where(known, number - 1 - _DEGREES[..., None], 0)
    even, still = 2 * counts * mean[:, 1], counts * mean[:, 0]
    wrong = np.abs(product + before * turns) ** 2 > np.abs(product) ** 2
    wrong = (wrong & (turns > _CLEAR * still))[_WHETHER, 0] & (before != 0)
    # A window that no arm explains, such as one with a jump, counts for less.
    own = np.abs(product[_WHETHER]) ** 2 / np.where(turns[_WHETHER] > 0, turns[_WHETHER], 1.0)
    rest = (moves[_WHETHER] - own) / np.maximum(counts[_WHETHER], 1)
    usual = np.maximum(medians(np.where(known, rest, np.nan).T), np.finfo(float).tiny)
    weights = 1 / np.maximum(rest / (_UNEXPLAINED * usual), 1.0)
    moves, turns, product, even, still, counts = (
        weights * part for part in (moves, turns, product, even, still, counts)
    )
    squares = (turns[_WHETHER] ** 2).sum(axis=0)
    both = product.sum(axis=1)
    moves, turns, even, still, counts = (
        part.sum(axis=1) for part in (moves, turns, even, still, counts)
    )
    counts = np.maximum(counts, 1.0)
    clear = turns > _CLEAR * still
    turns = np.where(clear, turns - still, 1.0)
    best = np.where(clear, -both / turns, 0.0)
    gained = np.abs(both * best)
    left = np.maximum(moves - gained, 0.0) / counts
    enough = np.maximum(_SHARE * (moves - even), _CLEAR * even / counts)
    taken = (gained > enough) & (turns**2 > _WINDOWS * squares)
    degree = np.where(clear, left / turns, np.inf).argmin(axis=0), np.arange(bodies.count)
    moved = clear[degree] & taken[_WHETHER] & ~wrong
    return np.where(moved, best[degree], 0.0)


def _arm(z: Complex, e: Complex, weights: Real) -> tuple[Complex, Complex, Complex, Real]:
    """
    The arms (b,) to the pins of bodies at poses `z`, turned by `e` (T, b).

    Also the means of both, and the spread of the turns; the `weights` (T, b) add up to 1.
    """
    z_mean, e_mean = (weights * z).sum(axis=0), (weights * e).sum(axis=0)
    around = e - e_mean
    spread = (weights * np.abs(around) ** 2).sum(axis=0)
    return -(weights * (z - z_mean) * around.conj()).sum(axis=0) / spread, z_mean, e_mean, spread


def _spaced(angles: list[float]) -> list[int]:
    """Places of the first angle, and of each that is a step off the last one kept."""
    kept, last = [0], angles[0]
    for k, angle in enumerate(angles):
        if abs((angle - last + np.pi) % (2 * np.pi) - np.pi) > _STEP:
            kept.append(k)
            last = angle
    return kept


def _rests(times: Real, values: Complex, seen: np.ndarray) -> Complex:
    """
    Sums (3, D, W, B) over what polynomials of each degree leave of paths and turns (2, W, N, B).

    Of |path|^2, of |turn|^2 and of conj(turn) path, in windows of frames at `times` (W, N), with
    values of 0 where they are not `seen` (W, N, B).
    """
    powers = (times - 0.5)[..., None] ** np.arange(int(_DEGREES[-1, 0]) + 1)
    if (seen == seen[..., :1]).all():
        seen = seen[..., :1]
    powers = powers[:, None] * seen.swapaxes(1, 2)[..., None]
    basis, _ = np.linalg.qr(powers)  # (W, 1 or B, N, P)
    columns = values.swapaxes(2, 3)[..., None]
    part = basis.swapaxes(2, 3) @ columns
    rest = (columns - basis @ part)[..., 0]
    part = np.moveaxis(part[..., 0], -1, 1)  # (2, P, W, B)
    # What the highest leaves, and what each lower one leaves more than that.
    found = []
    for one, other in ((0, 0), (1, 1), (1, 0)):
        product = part[one].conj() * part[other]
        sums = np.cumsum(product[:1:-1], axis=0)[::-1]
        sums = np.concatenate((sums, np.zeros_like(sums[:1])))
        found.append(sums + (rest[one].conj() * rest[other]).sum(axis=-1))
    return np.array(found)
