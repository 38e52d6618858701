"""Colors, line styles and shapes that the pictures share."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, in_place_of
from kinpole_ros.packages import install_command
from kinpole_ros.tools.record.lost import breaks_of, broken

BLACK, BLUE, GREEN, GRAY = '#000000', '#0060a8', '#00785a', '#777777'
# Markers and sizes; each surrounds the one before, so that poles at one point are all visible.
POLES = {'icr': ('o', 6.0), 'iap': ('^', 9.0), 'ijp': ('s', 11.0)}
# The centrodes differ in width and shade too, since the second turn fills the gaps between dashes.
PATH: dict[str, Any] = {'color': '#a0a0a0', 'linestyle': ':', 'linewidth': 1.2}
FIXED: dict[str, Any] = {'color': '#7db4e6', 'linestyle': '-', 'linewidth': 3.5}
MOVING: dict[str, Any] = {'color': '#a83200', 'linestyle': '--', 'linewidth': 1.3}
RELATIVE: dict[str, Any] = {'color': GREEN, 'linestyle': '-.', 'linewidth': 0.7}
BAND: dict[str, Any] = {'color': BLUE, 'alpha': 0.3, 'linewidth': 0.8}
EVENT: dict[str, Any] = {'color': '#c00000', 'linewidth': 1.6, 'zorder': 6}
LOST: dict[str, Any] = {'color': '#dddddd', 'linewidth': 0, 'zorder': 0.5}
THIN: dict[str, Any] = {'color': BLACK, 'linewidth': 0.7}
ESTIMATE: dict[str, Any] = {'color': '#4c9be0', 'linewidth': 2.6}
LINK: dict[str, Any] = {'facecolor': '#f2d9a0', 'edgecolor': '#8a6d00', 'linewidth': 1.2}
OTHER_LINK: dict[str, Any] = {'facecolor': '#eeeeee', 'edgecolor': '#b0b0b0', 'linewidth': 0.8}
LABEL_BOX: dict[str, Any] = {'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.75, 'pad': 1.0}


class Box(NamedTuple):
    """A rectangle of the plane, from its lower left to its upper right corner."""

    low: complex
    high: complex

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which complex points are in the box."""
        in_x = (points.real >= self.low.real) & (points.real <= self.high.real)
        return in_x & (points.imag >= self.low.imag) & (points.imag <= self.high.imag)

    def with_points(self, points: np.ndarray | Sequence[complex]) -> 'Box':
        """Return the box that contains the finite ones of these points too."""
        return box_of([*np.ravel(points), self.low, self.high])

    @property
    def size(self) -> float:
        """The longer side."""
        return max((self.high - self.low).real, (self.high - self.low).imag)

    @property
    def middle(self) -> complex:
        """The middle."""
        return (self.low + self.high) / 2


def box_of(points: np.ndarray | Sequence[complex]) -> Box:
    """Return the smallest box around the finite ones of complex points."""
    known = np.asarray(points, complex)
    known = known[np.isfinite(known)]
    low, high = (complex(f(known.real), f(known.imag)) for f in (np.min, np.max))
    return Box(low, high)


def picture_format(output: str | Path) -> str:
    """Return the format that a file's ending names; raise BagError for none, or no matplotlib."""
    try:
        from matplotlib.backend_bases import FigureCanvasBase
    except ImportError as error:
        raise BagError(
            f'drawing needs matplotlib; install it with {install_command("plot")}'
        ) from error
    formats = sorted(FigureCanvasBase.get_supported_filetypes())
    kind = Path(output).suffix[1:].lower()
    if kind not in formats:
        raise BagError(f'{output} is no picture; end its name in one of {", ".join(formats)}')
    return kind


@contextmanager
def saved_figure(output: str | Path, size: tuple[float, float], dpi: int) -> Iterator[Any]:
    """Yield a figure of a size in inches, and save it; raise BagError if that is impossible."""
    kind = picture_format(output)
    import warnings

    from matplotlib.figure import Figure

    # Without pyplot, whose state belongs to the caller.
    figure = Figure(figsize=size, layout='constrained')
    yield figure
    with in_place_of(output) as part, warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box.
        warnings.filterwarnings('ignore', 'Glyph .* missing from', UserWarning)
        figure.savefig(part, format=kind, dpi=dpi)


def line(
    axis: Any,
    stamp: np.ndarray,
    points: np.ndarray,
    style: dict[str, Any],
    rate: np.ndarray | None = None,
) -> None:
    """
    Draw a line through the finite ones of complex points (T,); it stops where frames are lost.

    It also stops where a rate (T,) changes its sign, since an ICR goes through infinity there.
    """
    known = np.isfinite(points)
    breaks = breaks_of(stamp, stamp[known])
    if rate is not None:
        breaks = np.union1d(breaks, np.flatnonzero(np.diff(np.sign(rate[known])) != 0))
    points, isolated = broken(points[known], breaks)
    axis.plot(points.real, points.imag, marker='.', markersize=3, markevery=isolated, **style)


def hull(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of complex points, counterclockwise (Andrew 1979)."""
    ordered = sorted({(float(z.real), float(z.imag)) for z in points if np.isfinite(z.real)})
    if len(ordered) < 3:
        return np.array([complex(*p) for p in ordered])

    def half(path: list[tuple[float, float]]) -> list[tuple[float, float]]:
        corners: list[tuple[float, float]] = []
        for x, y in path:
            while len(corners) > 1:
                (ax, ay), (bx, by) = corners[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                corners.pop()
            corners.append((x, y))
        return corners[:-1]

    return np.array([complex(*p) for p in half(ordered) + half(ordered[::-1])])


def draw_ground(axis: Any, z: complex, size: float) -> None:
    """Draw the symbol of a pin on the ground: a triangle on hatching."""
    foot = np.array([z, z + size * (-0.8 - 1.3j), z + size * (0.8 - 1.3j), z])
    axis.plot(foot.real, foot.imag, color='black', linewidth=1.2, zorder=5, gid='linkage')
    for k in range(-3, 4):
        ends = z + size * np.array([0.4 * k - 1.3j, 0.4 * k - 0.35 - 1.75j])
        axis.plot(ends.real, ends.imag, color='black', linewidth=0.9, zorder=5, gid='linkage')
