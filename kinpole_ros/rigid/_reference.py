"""
The point of each body whose path is simplest: the hub of a wheel, the pin of a rotor.

Any point of a body may stand for where it is: poles come out the same. But what is differentiated
is noise and motion together, and a point that hardly moves, or straight on, is followed by a far
longer window than one on the rim. So the origin of a body's frame is left for another point where
what a parabola leaves of its path, over one window, is nearly all the body turning about that
point.
"""

from itertools import pairwise

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# Poses looked at in one window, and the fewest.
_KEPT, _FEWEST = 32, 8
# Of polynomials whose rests are looked at: the first says whether, the one that tells best where.
_DEGREES = np.arange(2, 6)[:, None]
# A point is taken when turning about it explains this share of what moves, and so many times what
# the noise would have it explain; the angle must turn by as many times its noise.
_SHARE, _CLEAR = 0.9, 25.0
# It is no farther from the middle of the markers than so many body sizes.
_FARTHEST = 30.0
# So many windows must tell so, reckoned as many that turn alike; one counts for this share of the
# next. A point is put right when it is off by so many deviations.
_WINDOWS, _FADING, _OFF = 3.0, 0.95, 3.0
# A window of which so many times more is left than of those before, as where a pose jumps, tells
# nothing unless the next is like it.
_OUT = 50.0


class References:
    """
    The reference points of B bodies: `point` (B,), complex, m, in the bodies' own frames.

    `middle` (B,) is where the means of their markers were when the points were set; `span` is the
    length of a window in ns.
    """

    def __init__(self, bodies: int, span: int) -> None:
        self.point, self.middle = np.zeros((2, bodies), complex)
        self._span = span
        # Where the window begins, its part of the last frame, and what is kept of its frames.
        self._start: int | None = None
        self._part = -1
        self._kept: list[tuple[np.ndarray, Complex, Real]] = []
        # Sums over windows, by degree, of what polynomials leave of the origin's path z and of the
        # turns e = exp(i angle): conj(e) z; |z|^2, |e|^2, the noise in both, and how many.
        self._both = np.zeros((len(_DEGREES), bodies), complex)
        self._sums = np.zeros((5, len(_DEGREES), bodies))
        # Of the squares of |e|^2 by the first degree.
        self._squares = np.zeros(bodies)
        # Whether the last window was far out of those before.
        self._out = np.zeros(bodies, bool)

    def add(
        self,
        stamps: np.ndarray,
        position: Complex,
        angle: Real,
        variance: Real,
        size: Real,
        middle: Complex,
    ) -> None:
        """
        Take the poses (T, B) of some frames of `stamps` (T,), NaN where not known.

        `variance` (T, 2, B) is that of one coordinate of the position, m^2, and of the angle;
        `size` (B,), m, is that of the bodies, and `middle` (B,) the mean of their markers now, in
        their frames.
        """
        first = 0
        while first < len(stamps):
            if self._start is None:
                self._start, self._part = int(stamps[first]), -1
            since = stamps[first:] - self._start
            # Up to the frame that ends the window, if it is there.
            count = int(since.searchsorted(self._span)) + 1
            part = since[:count] * _KEPT // self._span
            rows = first + (part > np.concatenate(((self._part,), part[:-1]))).nonzero()[0]
            self._kept.append((stamps[rows], position[rows], angle[rows]))
            self._part = int(part[-1])
            first += len(part)
            if len(part) == count:
                last = first - 1
                self._judge(variance[last, 0], variance[last, 1], size, middle)
                self._start, self._kept = None, []

    def forget(self, which: np.ndarray) -> None:
        """Look at the bodies `which` (B,) afresh."""
        for kept in (self.point, self.middle, self._both, self._sums, self._squares):
            kept[..., which] = 0.0
        for _, _, angle in self._kept:
            angle[:, which] = np.nan

    def _judge(self, variance: Real, of_angle: Real, size: Real, middle: Complex) -> None:
        """See what turning explains of one window of poses, and of those before."""
        stamps, z, angle = map(np.concatenate, zip(*self._kept, strict=True))
        if len(stamps) < _FEWEST:
            return
        known = np.isfinite(angle).all(axis=0) & np.isfinite(variance) & np.isfinite(of_angle)
        both = np.where(known, (z - z[0], np.exp(1j * angle)), 0.0)
        path, turn = _rests((stamps - stamps[0]) / self._span, both)
        count = len(z) - 1 - _DEGREES
        even, still = (count * np.where(known, part, 0.0) for part in (2 * variance, of_angle))
        counts = np.broadcast_to(count, even.shape)
        new = np.stack((_energy(path), _energy(turn), even, still, counts))
        usual = new[4] * self._sums[:2] / np.maximum(self._sums[4], 1)
        out = known & (self._sums[4] > new[4]).all(axis=0) & (new[:2] > _OUT * usual).any((0, 1))
        known &= ~out | self._out
        self._out = out
        both = (turn.conj() * path).sum(axis=1)
        # One that is no better than the origin now is left, and all begins anew.
        wrong = np.abs(both + self.point * new[1]) ** 2 > np.abs(both) ** 2
        wrong = wrong[0] & known & (new[1] > _CLEAR * new[3])[0] & (self.point != 0)
        self.point = np.where(wrong, 0.0, self.point)
        kept = np.where(wrong, 0.0, _FADING)
        for sums, one, share in (
            (self._both, both, kept),
            (self._sums, new, kept),
            (self._squares, new[1, 0] ** 2, kept**2),
        ):
            sums[..., known] = (share * sums + one)[..., known]
        moves, turns, even, still, counts = self._sums
        counts = np.maximum(counts, 1.0)
        clear = known & (turns > _CLEAR * still)
        # Noise in the turning would have the point nearer to the origin than it is.
        turns = np.where(clear, turns - still, 1.0)
        best = np.where(clear, -self._both / turns, 0.0)
        gained = np.abs(self._both * best)
        left = np.maximum(moves - gained, 0.0) / counts
        enough = np.maximum(_SHARE * (moves - even), _CLEAR * even / counts)[0]
        taken = (gained[0] > enough) & (turns[0] ** 2 > _WINDOWS * self._squares)

        square = np.where(clear, left / turns, np.inf)
        degree = square.argmin(axis=0), np.arange(len(known))
        clear, best, square = clear[degree], best[degree], _OFF**2 * square[degree]
        near = np.abs(best - middle) < _FARTHEST * size
        moved = clear & taken & near & (np.abs(self.point - best) ** 2 > square)
        self.point = np.where(moved, best, self.point)
        self.middle = np.where(moved, middle, self.middle)


def _rests(times: Real, values: Complex) -> Complex:
    """What polynomials of each degree leave (S, D, N, B) of values (S, N, B) at times (N,)."""
    basis, _ = np.linalg.qr(np.vander(times - 0.5, int(_DEGREES[-1, 0]) + 1, increasing=True))
    some = (basis[:, : degree + 1] for degree in _DEGREES[:, 0])
    return np.stack([values - part @ (part.T @ values) for part in some], axis=1)


def _energy(values: Complex) -> Real:
    """Sums (D, B) of the squares of values (D, N, B)."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=1))


def alike(*known: np.ndarray) -> list[slice]:
    """Stretches of instants for which the same is known of all bodies, each (T, B)."""
    if len(known[0]) == 1:
        return [slice(0, 1)]
    changed = np.logical_or.reduce([(each[1:] != each[:-1]).any(axis=1) for each in known])
    changes = (changed.nonzero()[0] + 1).tolist()
    return [slice(*ends) for ends in pairwise((0, *changes, len(known[0])))]


def seen_at(
    reference: Complex, middle: Complex, poses: Real, information: Real
) -> tuple[Real, Real]:
    """
    Poses of the points `reference` (B,), and their information, from those of the origins.

    `poses` (N, 2 B, 2) are angles, rad, then positions, m; `information` (N, 2 B) their inverse
    variances over that of a coordinate of a marker; `middle` (B,) as in `References`.
    """
    count = len(reference)
    poses, information = poses.copy(), information.copy()
    arm = reference * np.exp(1j * poses[:, :count, 0])
    poses[:, count:, 0] += arm.real
    poses[:, count:, 1] += arm.imag
    # Farther from the middle of the markers the angle's error tells more.
    nearer, farther = np.abs(middle) ** 2, np.abs(reference - middle) ** 2
    turned, placed = information[:, :count], information[:, count:]
    seen = placed > 0
    share = np.divide(placed, turned, out=np.zeros_like(placed), where=seen)
    left = np.maximum(1 - nearer * share, 0.0) + farther * share
    # Without its other markers a body that keeps its origin may seem to lie far from its middle.
    np.divide(placed, left, out=placed, where=seen & (left > 0) & (reference != 0))
    return poses, information
