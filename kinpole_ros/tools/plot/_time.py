"""
Quantities of a body over time, each with a strip of its band of two standard deviations below.

A band is usually too narrow to be seen next to the curve, so the strip shows it at its own scale,
with the error where there is an exact value.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tools.plot import _style
from kinpole_ros.tools.record.lost import breaks_of, broken, lost_spans
from kinpole_ros.tools.record.record import MotionRecord, Series
from kinpole_ros.tracking.values import RATE_NAMES, sigma_along

# Positive values that spread over more than this factor have a logarithmic axis.
_LOG_FACTOR = 30
# The percentage of the instants whose band fits into the strip.
_STRIP_PERCENTILE = 90


class TimePanel(NamedTuple):
    """
    A number over time; `series` is None if the bag has none.

    `resolution` is the smallest height of the axis; `cut` the percentage of values at each end that
    may lie outside; `truth` the exact values, if known.
    """

    label: str
    series: Series | None
    resolution: float
    cut: float
    truth: Series | None


def rate_panels(record: MotionRecord, body: str, truth: Mapping[str, Series]) -> list[TimePanel]:
    """Return the panels of angular velocity, acceleration and jerk."""
    rate = float(np.nanmedian(np.abs(record.columns[body, 'angular_velocity'])))
    panels = []
    for order, label in enumerate(('ω (rad/s)', 'α (rad/s²)', 'jerk (rad/s³)'), 1):
        name, cut = RATE_NAMES[order - 1], 0 if order == 1 else 2
        # In powers of the rate: the acceleration of a steady wheel is flat, however noisy.
        height = 0.05 * rate**order
        panels.append(TimePanel(label, record.series(body, name), height, cut, truth.get(name)))
    return panels


def centrode_panels(
    record: MotionRecord, body: str, truth: Mapping[str, Series]
) -> list[TimePanel]:
    """Return the panels of the curvature of the fixed centrode and the speed of the ICR."""
    velocity, exact_velocity = record.series(body, 'icr_velocity'), truth.get('icr_velocity')
    speed = exact = None
    if velocity is not None:
        along = sigma_along(velocity.value, velocity.spread)
        speed = Series(velocity.stamp, np.abs(velocity.value), along)
    if exact_velocity is not None:
        exact = exact_velocity._replace(value=np.abs(exact_velocity.value))
    slow = 0.05 * float(np.median(speed.value)) if speed is not None and len(speed.value) else 0.0
    # A centrode with a radius above two body sizes counts as straight.
    size = record.sizes[body]
    straight = 0.5 / size if np.isfinite(size) and size else 0.0
    name = 'centrode_curvature'
    label = 'κ of the fixed\ncentrode (1/m)'
    return [
        TimePanel(label, record.series(body, name), straight, 4, truth.get(name)),
        TimePanel('speed |u| of\nthe ICR (m/s)', speed, slow, 4, exact),
    ]


def _is_pinned(record: MotionRecord, body: str) -> bool:
    """Return whether the ICR is at rest in most instants."""
    velocity = record.series(body, 'icr_velocity')
    return velocity is not None and 2 * np.count_nonzero(velocity.value == 0) > len(velocity.value)


def draw_panel(
    axes: tuple[Any, Any],
    record: MotionRecord,
    body: str,
    panel: TimePanel,
    start: int,
    instant: int,
) -> None:
    """Draw a panel on the first of two axes, and its band of two standard deviations below."""
    axis, strip = axes
    spans = (lost_spans(record.stamp) - [start, 0]) * 1e-9
    for one in axes:
        one.grid(True, linewidth=0.3)
        if len(spans):
            one.broken_barh(
                spans.tolist(), (0, 1), transform=one.get_xaxis_transform(), **_style.LOST
            )
        one.axvline((instant - start) * 1e-9, color=_style.GRAY, linestyle='--', linewidth=0.8)
        one.tick_params(labelsize=8)
    axis.ticklabel_format(useOffset=False)
    axis.set_ylabel(panel.label)
    for stamp, _ in record.events.get(body, []):
        axis.axvline((stamp - start) * 1e-9, 0.9, 1.0, **_style.EVENT)
    share = len(panel.series.stamp) / len(record.stamp) if panel.series is not None else 0.0
    if share < 0.9:
        percent = f'{share:.0%}' if share >= 0.01 else 'less than 1%'
        text = f'known at {percent} of instants' if share else 'undetermined'
        if not share and _is_pinned(record, body):
            text = 'none: the ICR is a pin, and stands still'
        axis.text(0.02, 0.94, text, transform=axis.transAxes, va='top', fontsize='small', zorder=5)
    if panel.series is None or not share:
        axis.set_yticks([])
        strip.set_yticks([])
        return
    breaks = breaks_of(record.stamp, panel.series.stamp)
    time, _ = broken((panel.series.stamp - start) * 1e-9, breaks)
    value, isolated = broken(panel.series.value, breaks)
    marker = {'marker': '.', 'markevery': isolated, 'markersize': 4, 'zorder': 3}
    axis.plot(time, value, '-', **marker, **_style.ESTIMATE)
    if panel.truth is not None and len(panel.truth.stamp):
        known = record.stamp[np.isfinite(record.columns[body, 'position'])]
        within = (panel.truth.stamp >= known[0]) & (panel.truth.stamp <= known[-1])
        exact = panel.truth.value[within]
        axis.plot((panel.truth.stamp[within] - start) * 1e-9, exact, zorder=4, **_style.THIN)
    height = panel.resolution
    band, _ = broken(2 * panel.series.spread, breaks)
    axis.fill_between(time, value - band, value + band, **_style.BAND)
    _draw_strip(strip, panel, panel.series, time, band)
    if len(finite := band[np.isfinite(band)]):
        height = max(height, 3 * float(np.median(finite)))
    low, high = np.percentile(panel.series.value, [panel.cut, 100 - panel.cut])
    if low > 0 and high > _LOG_FACTOR * low:
        axis.set_yscale('log')
        axis.set_ylim(low / 1.5, high * 1.5)
    elif (margin := max(0.12 * (high - low), (height - (high - low)) / 2)) > 0:
        axis.set_ylim(low - margin, high + margin)


def _draw_strip(
    strip: Any, panel: TimePanel, series: Series, time: np.ndarray, band: np.ndarray
) -> None:
    """Draw the band about zero, with the error in it."""
    strip.fill_between(time, -band, band, **_style.BAND)
    if panel.truth is not None:
        error = np.full(len(series.stamp), np.nan)
        _, own, its = np.intersect1d(series.stamp, panel.truth.stamp, return_indices=True)
        error[own] = series.value[own] - panel.truth.value[its]
        full_error = np.full(len(time), np.nan)
        full_error[np.isfinite(time)] = error
        strip.plot(time, full_error, **_style.THIN)
    finite = band[np.isfinite(band)]
    top = float(np.percentile(finite, _STRIP_PERCENTILE)) if len(finite) else 0.0
    if top > 0:
        # Rounded up to one digit, so that the label is short.
        step = 10.0 ** np.floor(np.log10(top))
        height = float(np.ceil(1.05 * top / step) * step)
        strip.set_ylim(-height, height)
        strip.set_yticks([0], [f'±{height:g}'], color=_style.BLUE)
