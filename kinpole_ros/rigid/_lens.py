"""
Whether a lens moves the markers of rigid bodies against each other, or a view at a slant does.

A radial lens moves a point z to z + k (z - c) |z - c|^2 (Brown 1971), a view at a slant, or axes of
two scales, to z plus a multiple of its conjugate. Both are the same for all bodies at all times, a
function of where a point is, which soft tissue and loose markers are not. So what the rigid fits
leave is fitted by what they would leave of such a field, of all bodies at once.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid.levels import FEW, KEPT

# One in so many frames is looked at.
_EACH = 4
# A field is the cause where it explains this share of what is beyond the noise.
_EXPLAINED = 0.8
LENS, SLANT, TISSUE = 'lens', 'slant', 'tissue'


class _Sums(NamedTuple):
    """Sums over frames: how many (B,), fields (F, B, n) and residuals (B, n), and products."""

    frames: Real
    field: Complex
    residual: Complex
    squares: Real  # (F, F, B)
    along: Real  # (F, B)
    left: Real  # (B,)


class Fields:
    """What fields of displacement explain of the residuals of B bodies."""

    def __init__(self) -> None:
        self._sums: _Sums | None = None
        self._center, self._scale = 0j, 1.0

    def forget(self) -> None:
        """Begin anew."""
        self._sums = None

    def add(self, position: Complex, angle: Real, residual: Complex, shape: Complex) -> None:
        """
        Take fits of some frames: poses (T, B), residuals (T, B, n), m, and the shapes (B, n), m.

        Frames count in which all markers of a body are seen that its shape has.
        """
        position, angle, residual = (part[::_EACH] for part in (position, angle, residual))
        has = ~np.isnan(shape)
        there = (~np.isnan(residual) == has).all(axis=-1) & np.isfinite(angle)
        if not there.any():
            return
        turn = np.exp(1j * np.where(there, angle, 0.0))[..., None]
        arms = np.where(has, shape, 0.0)
        left = np.where(there[..., None] & has, residual, 0.0)
        z = np.where(there, position, 0.0)[..., None] + turn * (arms + left)
        if self._sums is None or self._sums.residual.shape != shape.shape:
            self._sums = None
            self._center = z[there].mean()
            self._scale = float(np.abs(z[there] - self._center).max())
        z = (z - self._center) / self._scale
        square, both = z * z, 2 * z * z.conj()
        fields = np.stack(
            (z.conj(), 1j * z.conj(), square * z.conj(), square + both, 1j * (both - square))
        )
        fields = _left(fields * turn.conj(), arms, has) * there[..., None]
        new = _Sums(
            there.sum(axis=0),
            fields.sum(axis=1),
            left.sum(axis=0),
            np.einsum('ftbn,gtbn->fgb', fields.conj(), fields).real,
            np.einsum('ftbn,tbn->fb', fields.conj(), left).real,
            np.einsum('tbn,tbn->b', left.conj(), left).real,
        )
        if self._sums is not None:
            kept = np.clip(KEPT / np.maximum(self._sums.frames, 1), 0, 1)
            by_marker = kept[:, None]
            old, factors = self._sums, (kept, by_marker, by_marker, kept, kept, kept)
            parts = zip(old, factors, new, strict=True)
            new = _Sums(*(before * factor + now for before, factor, now in parts))
        self._sums = new

    def cause(self, bodies: np.ndarray, noise: Real, freedom: Real) -> list[str]:
        """
        What moves the markers of each of the `bodies` (B,) that are deformed: LENS, SLANT or ''.

        By the `noise` (B,), m, of a coordinate of a marker and the `freedom` (B,) of the residuals.
        """
        found = [''] * len(bodies)
        if self._sums is None or not bodies.any():
            return found
        frames, field, left, squares, along, total = self._sums
        count = np.maximum(frames, 1)
        # The mean of what is left is of the shape.
        squares = squares - np.einsum('fbn,gbn->fgb', field.conj(), field).real / count
        along = along - np.einsum('fbn,bn->fb', field.conj(), left).real / count
        total = total - (left.real**2 + left.imag**2).sum(axis=-1) / count
        beyond = total - np.where(frames > 0, freedom * frames * noise**2, 0.0)
        beyond = np.maximum(beyond, np.finfo(float).tiny)
        # Of what is left, for each parameter of a field.
        if (freedom * frames)[bodies].sum() < FEW * len(field):
            return found
        for parameters, name in ((2, SLANT), (5, LENS)):
            some = slice(parameters)
            matrix, right = squares[some, some][..., bodies].sum(-1), along[some][:, bodies].sum(-1)
            by = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
            explained = 2 * by @ along[some] - np.einsum('f,g,fgb->b', by, by, squares[some, some])
            # Of all bodies where it is so of them in all: one camera sees them.
            every = explained[bodies].sum() > _EXPLAINED * beyond[bodies].sum()
            for b in np.flatnonzero(bodies & (every | (explained > _EXPLAINED * beyond))):
                found[b] = found[b] or name
        return found


def _left(fields: Complex, arms: Complex, has: np.ndarray) -> Complex:
    """What rigid fits leave of fields (F, T, B, n) at `arms` (B, n), in the bodies' axes."""
    count = np.maximum(has.sum(axis=-1, keepdims=True), 1)
    fields = np.where(has, fields, 0.0)
    arms = np.where(has, arms - arms.sum(axis=-1, keepdims=True) / count, 0.0)
    fields = np.where(has, fields - fields.sum(axis=-1, keepdims=True) / count, 0.0)
    spread = np.maximum((arms.real**2 + arms.imag**2).sum(axis=-1), np.finfo(float).tiny)
    turned = (arms.conj() * fields).imag.sum(axis=-1) / spread
    return np.asarray(fields - 1j * turned[..., None] * arms)
