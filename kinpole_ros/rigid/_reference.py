"""
The point of each body whose path is simplest: the hub of a wheel, the pin of a rotor.

Any point of a body may stand for where it is: poles come out the same. But what is differentiated
is the sum of noise and motion, and a point that hardly moves, or straight on, is followed by a far
longer window than one on the rim. So the origin of a body's frame is left for another point where
what a parabola leaves of its path, over one window, is nearly all the body turning about that
point.
"""

from itertools import pairwise

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid.levels import SURE

# A window is looked at in which the body is seen in this share of the frames.
_PRESENT = 0.5
# Of polynomials whose rests are looked at: one says whether, the one that tells best where. That
# may be a line, as the hub of a wheel goes, of which a parabola takes half away.
_DEGREES = np.arange(1, 6)[:, None]
_WHETHER = 1
# A point is taken when turning about it explains this share of what moves, and far more than the
# noise would have it explain; the angle must turn by as many times its noise.
_SHARE, _CLEAR = 0.9, SURE**2
# Where stamps are late so many of the newest frames may turn out to have been at other times.
_SETTLED = 20
# So many windows must tell so, reckoned as many that turn alike; one counts for this share of the
# next, which makes 2.99 of three.
_WINDOWS, _FADING = 2.9, 0.95


class References:
    """
    The reference points of B bodies: `point` (B,), complex, m, in the bodies' own frames.

    `middle` (B,) is where the means of their markers were when the points were set; `span` is the
    length of a window in ns.
    """

    def __init__(self, bodies: int, span: int) -> None:
        self.point, self.middle = np.zeros((2, bodies), complex)
        self._span = span
        # The frames from the begin of the window on, as they are added.
        self._kept: list[tuple[np.ndarray, Complex, Real, Real]] = []
        # Sums over windows, by degree, of what polynomials leave of the origin's path z and of the
        # turns e = exp(i angle): conj(e) z; |z|^2, |e|^2, the noise in both, and how many.
        self._both = np.zeros((len(_DEGREES), bodies), complex)
        self._sums = np.zeros((5, len(_DEGREES), bodies))
        # Of the squares of |e|^2 by the first degree.
        self._squares = np.zeros(bodies)

    def add(
        self,
        stamps: np.ndarray,
        position: Complex,
        angle: Real,
        variance: Real,
        middle: Complex,
    ) -> None:
        """
        Take the poses (T, B) of some frames of `stamps` (T,), NaN where not known.

        `variance` (T, 2, B) is that of one coordinate of the position, m^2, and of the angle;
        `middle` (B,), m, are the means of their markers now, in their frames.
        """
        self._kept.append((stamps, position, angle, variance))
        stamps, position, angle, variance = map(np.concatenate, zip(*self._kept, strict=True))
        first = 0
        while True:
            # With the frame that ends the window.
            end = int(stamps.searchsorted(stamps[first] + self._span)) + 1
            if end + _SETTLED > len(stamps):
                break
            rows = slice(first, end)
            self._update(stamps[rows], position[rows], angle[rows], variance[rows], middle)
            first = end
        self._kept = [(stamps[first:], position[first:], angle[first:], variance[first:])]

    def were_at(self, times: np.ndarray) -> None:
        """The newest frames that were taken turned out to be at `times` (T,), ns."""
        for stamps, *_ in self._kept:
            here = min(len(stamps), len(times))
            stamps[len(stamps) - here :] = times[len(times) - here :]

    def forget(self, which: np.ndarray) -> None:
        """Look at the bodies `which` (B,) afresh."""
        for kept in (self.point, self.middle, self._both, self._sums, self._squares):
            kept[..., which] = 0.0
        for _, _, angle, _ in self._kept:
            angle[:, which] = np.nan

    def _update(
        self,
        stamps: np.ndarray,
        position: Complex,
        angle: Real,
        variance: Real,
        middle: Complex,
    ) -> None:
        """See what turning explains of one window of poses, and of those before."""
        seen = np.isfinite(angle)
        number = seen.sum(axis=0)
        # The first frames of all come before their noise is known.
        sure = seen & np.isfinite(variance).all(axis=1)
        known = sure.any(axis=0) & (number > np.maximum(_DEGREES[-1] + 1, _PRESENT * len(seen)))
        if not np.count_nonzero(known):
            return
        seen &= known
        # About the first, lest far ones lose digits.
        start = position[seen.argmax(axis=0), np.arange(len(known))]
        both = np.where(seen, (position - start, np.exp(1j * angle)), 0.0)
        moves, turns, both = _rests((stamps - stamps[0]) / self._span, both, seen)
        count = number - 1 - _DEGREES
        # The noise in both.
        mean = np.where(sure[:, None], variance, 0.0).sum(axis=0) / np.maximum(sure.sum(axis=0), 1)
        even, still = 2 * count * mean[0], count * mean[1]
        new = np.stack((moves, turns, even, still, np.where(known, count, 0)))
        # One that is no better than the origin now is left, and all begins anew.
        wrong = np.abs(both + self.point * turns) ** 2 > np.abs(both) ** 2
        wrong = (wrong & (turns > _CLEAR * still))[_WHETHER] & known & (self.point != 0)
        self.point = np.where(wrong, 0.0, self.point)
        kept = np.where(wrong, 0.0, _FADING)
        for sums, one, share in (
            (self._both, both, kept),
            (self._sums, new, kept),
            (self._squares, turns[_WHETHER] ** 2, kept**2),
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
        enough = np.maximum(_SHARE * (moves - even), _CLEAR * even / counts)
        taken = (gained > enough) & (turns**2 > _WINDOWS * self._squares)

        degree = np.where(clear, left / turns, np.inf).argmin(axis=0), np.arange(len(known))
        clear, best = clear[degree], best[degree]
        moved = clear & taken[_WHETHER]
        self.point = np.where(moved, best, self.point)
        self.middle = np.where(moved, middle, self.middle)


def _rests(times: Real, values: Complex, seen: np.ndarray) -> tuple[Real, Real, Complex]:
    """
    Sums (D, B) over what polynomials of each degree leave of paths and turns (2, N, B).

    Of |path|^2, of |turn|^2 and of conj(turn) path; they are at times (N,) and 0 where they are not
    `seen` (N, B).
    """
    powers = np.vander(times - 0.5, int(_DEGREES[-1, 0]) + 1, increasing=True)[None]
    if not seen.all():
        powers = powers * seen.T[..., None]
    basis, _ = np.linalg.qr(powers)  # (1 or B, N, P)
    columns = values.swapaxes(1, 2)[..., None]
    part = basis.swapaxes(1, 2) @ columns
    rest = (columns - basis @ part)[..., 0].swapaxes(1, 2)
    part = part[..., 0].swapaxes(1, 2)  # (2, P, B)
    # What the highest leaves, and what each lower one leaves product that.
    found = []
    for one, other in ((0, 0), (1, 1), (1, 0)):
        product = part[one].conj() * part[other]
        sums = np.cumsum(product[:1:-1], axis=0)[::-1]
        sums = np.concatenate((sums, np.zeros_like(sums[:1])))
        found.append(sums + (rest[one].conj() * rest[other]).sum(axis=0))
    return found[0].real, found[1].real, found[2]


def constant_segments(*known: np.ndarray) -> list[slice]:
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
