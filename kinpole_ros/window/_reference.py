"""
The point of each body whose path is simplest: the hub of a wheel, the pin of a rotor.

Any point of a body may stand for where it is: poles come out the same. But what is differentiated
is noise and motion together, and a point that hardly moves, or straight on, is followed by a far
longer window than one on the rim. So the origin of a body's frame is left for another point where
what a parabola leaves of its path, over one window, is nearly all the body turning about that
point.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# Poses looked at in one window, and the fewest.
_KEPT, _FEWEST = 32, 8
# A point is taken when turning about it explains this share of what moves, and so many times what
# the noise would have it explain.
_SHARE, _CLEAR = 0.9, 25.0
# It is put right when it is off by so many deviations; a window counts for this share of the next.
_OFF, _FADING = 3.0, 0.9


class References:
    """
    The reference points of B bodies: `point` (B,), complex, m, in the bodies' own frames.

    `span` is the length of a window in ns.
    """

    def __init__(self, bodies: int, span: int) -> None:
        self.point = np.zeros(bodies, complex)
        self._span = span
        self._due: int | None = None
        self._stamps: list[int] = []
        self._poses: list[tuple[Complex, Real]] = []
        # Sums over windows of what a parabola leaves of the origin's path z and of the turns
        # e = exp(i angle): |z|^2, conj(e) z and |e|^2; and of how many there are, and of noise.
        self._path, self._turn, self._count, self._still, self._even = np.zeros((5, bodies))
        self._both = np.zeros(bodies, complex)

    def add(self, stamps: np.ndarray, position: Complex, angle: Real, variance: Real) -> None:
        """
        Take the poses (T, B) of some frames of `stamps` (T,), NaN where not known.

        `variance` (T, 2, B) is that of one coordinate of the position, m^2, and of the angle.
        """
        frame = 0 if self._due is None else int(stamps.searchsorted(self._due))
        while frame < len(stamps):
            stamp = int(stamps[frame])
            self._stamps.append(stamp)
            self._poses.append((position[frame], angle[frame]))
            if stamp - self._stamps[0] >= self._span:
                if len(self._stamps) >= _FEWEST:
                    self._judge(*variance[frame])
                self._stamps, self._poses = [], []
            self._due = stamp + self._span // _KEPT
            frame = int(stamps.searchsorted(self._due))

    def _judge(self, variance: Real, of_angle: Real) -> None:
        """See what turning explains of one window of poses, and of those before."""
        stamps = np.array(self._stamps)
        basis, _ = np.linalg.qr(np.vander((stamps - stamps[0]) / self._span - 0.5, 3))
        z, angle = (np.array(part) for part in zip(*self._poses, strict=True))
        z, e = z - z[0], np.exp(1j * angle)
        z, e = z - basis @ (basis.T @ z), e - basis @ (basis.T @ e)
        known = np.isfinite(z).all(axis=0) & np.isfinite(variance)
        count = len(stamps) - 3
        for sums, new in (
            (self._path, (z.real**2 + z.imag**2).sum(axis=0)),
            (self._both, (e.conj() * z).sum(axis=0)),
            (self._turn, (e.real**2 + e.imag**2).sum(axis=0)),
            (self._count, count),
            (self._even, 2 * count * variance),
            (self._still, count * of_angle),
        ):
            sums[known] = (_FADING * sums + new)[known]
        turns = known & (self._turn > _CLEAR * self._still)
        best = np.where(turns, -self._both / np.where(turns, self._turn, 1.0), 0.0)
        gained = np.abs(self._both * best)
        count = np.maximum(self._count, 1.0)
        taken = gained > np.maximum(_SHARE * (self._path - self._even), _CLEAR * self._even / count)
        # How much more than the best the present one leaves. One no better than the origin goes.
        more = np.abs(self.point - best) ** 2 * self._turn
        left = np.maximum(self._path - gained, 0.0) / count
        moved = taken & (more > _OFF**2 * left)
        gone = ~taken & (more > gained + _OFF**2 * left)
        self.point[turns & moved] = best[turns & moved]
        self.point[turns & gone] = 0.0
