"""What the parts of a picture of results share: colors, signs of poles, lines that stop at gaps."""

from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.bags import BagError
from kinpole_ros.packages import install_command
from kinpole_ros.tools.plot._read import Body

# Longer than this many periods without a sample is a gap, not a lost frame.
_GAP = 2.5
BLACK, BLUE, GREEN, GRAY = '#000000', '#0060a8', '#00785a', '#777777'
# Each fits around the one before: where poles meet, all are still seen.
POLES = {'icr': ('o', 6.0), 'iap': ('^', 9.0), 'ijp': ('s', 11.0)}
# Widths and shades differ too: dashes of the second turn fill the gaps of the first.
PATH: dict[str, Any] = {'color': '#a0a0a0', 'linestyle': ':', 'linewidth': 1.2}
FIXED: dict[str, Any] = {'color': '#7db4e6', 'linestyle': '-', 'linewidth': 3.5}
MOVING: dict[str, Any] = {'color': '#a83200', 'linestyle': '--', 'linewidth': 1.3}
RELATIVE: dict[str, Any] = {'color': GREEN, 'linestyle': '-.', 'linewidth': 0.7}
BAND: dict[str, Any] = {'color': BLUE, 'alpha': 0.3, 'linewidth': 0.8}
TRUTH: dict[str, Any] = {'color': BLACK, 'linewidth': 0.7}
ERROR: dict[str, Any] = {'color': BLACK, 'linewidth': 0.7}
ESTIMATE: dict[str, Any] = {'color': '#4c9be0', 'linewidth': 2.6}
LINK: dict[str, Any] = {'facecolor': '#f2d9a0', 'edgecolor': '#8a6d00', 'linewidth': 1.2}
OTHER: dict[str, Any] = {'facecolor': '#eeeeee', 'edgecolor': '#b0b0b0', 'linewidth': 0.8}
HALO: dict[str, Any] = {'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.75, 'pad': 1.0}


def picture_format(output: str | Path) -> str:
    """Return the format that a file's ending names; BagError for none, or without matplotlib."""
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


def breaks_of(body: Body, stamp: np.ndarray) -> np.ndarray:
    """Indices after which a line through `stamp` has to stop: nothing is known in between."""
    period = np.median(np.diff(body.stamp)) if len(body.stamp) > 1 else np.inf
    return np.flatnonzero(np.diff(stamp) > _GAP * period)


def reversals(rate: np.ndarray) -> np.ndarray:
    """Indices after which the rate changes sign: there the ICR passes through infinity."""
    return np.flatnonzero(np.diff(np.sign(rate)) != 0)


def broken(values: np.ndarray, breaks: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """The values with NaN at each break, and where in them values stand alone."""
    values = np.insert(values, np.unique(breaks) + 1, np.nan)
    gap = np.concatenate([[True], np.isnan(values), [True]])
    alone = ~gap[1:-1] & gap[:-2] & gap[2:]
    return values, np.flatnonzero(alone).tolist()


def line(axis: Any, points: np.ndarray, breaks: np.ndarray, style: dict[str, Any]) -> None:
    """A line through complex points that stops at breaks."""
    points, alone = broken(points, breaks)
    axis.plot(points.real, points.imag, marker='.', markersize=3, markevery=alone, **style)
