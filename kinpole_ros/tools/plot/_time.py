"""
Quantities of a body over time, each with a thin strip of its band of 2 deviations.

A band is mostly too narrow to be seen beside the curve, so the strip shows it at its own scale.
Where there is an exact answer, the strip also has the error.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tools.plot._read import Body, Series
from kinpole_ros.tools.plot._style import (
    BAND,
    BLUE,
    ERROR,
    ESTIMATE,
    GRAY,
    TRUTH,
    breaks_of,
    broken,
)

# What is positive and spreads over more than this factor goes on a logarithmic axis.
_LOG_FACTOR = 30
# The band as high as in this share of the instants fits into its strip.
_IN_STRIP = 90


class Panel(NamedTuple):
    """
    A quantity over time: its label, and the series if there is one.

    `least` is how much of it is worth seeing at all; `cut` the percentage of values at each end
    that may fall outside; `sigma` (T,) the standard deviation of the values, if known; `truth` the
    exact values, if known.
    """

    label: str
    series: Series | None
    least: float
    cut: float
    sigma: np.ndarray | None
    truth: Series | None


def rates(body: Body, truth: Mapping[str, Series]) -> list[Panel]:
    """The panels of the rates of turning."""
    covariance = np.full((len(body.stamp), 2, 2), np.nan)
    rate = Series(body.stamp, body.rate, covariance)
    # Measured by the turning itself: a steady wheel's acceleration is nothing, however jagged.
    least = [0.05 * float(np.median(np.abs(body.rate))) ** order for order in (1, 2, 3)]
    first = Panel('ω (rad/s)', rate, least[0], 0, body.rate_sigma, truth.get('angular_velocity'))
    more = (('α (rad/s²)', 'angular_acceleration'), ('jerk (rad/s³)', 'angular_jerk'))
    return [
        first,
        *(
            Panel(label, body.series.get(name), low, 2, _sigma(body, name), truth.get(name))
            for (label, name), low in zip(more, least[1:], strict=True)
        ),
    ]


def run(body: Body, truth: Mapping[str, Series]) -> list[Panel]:
    """The panels of how the ICR runs along the fixed centrode."""
    curvature, velocity = body.series.get('centrode_curvature'), body.series.get('icr_velocity')
    speed = exact = sigma = None
    if velocity is not None:
        speed = velocity._replace(value=np.abs(velocity.value))
        sigma = _sigma(body, 'icr_velocity', velocity.value)
    if 'icr_velocity' in truth:
        exact = truth['icr_velocity']._replace(value=np.abs(truth['icr_velocity'].value))
    least = 0.05 * float(np.median(speed.value)) if speed is not None else 0.0
    # A centrode of a radius of many body sizes is straight.
    straight = 0.5 / body.size if np.isfinite(body.size) and body.size else 0.0
    name = 'centrode_curvature'
    return [
        Panel(
            'κ of the fixed\ncentrode (1/m)',
            curvature,
            straight,
            4,
            _sigma(body, name),
            truth.get(name),
        ),
        Panel('speed |u| of\nthe ICR (m/s)', speed, least, 4, sigma, exact),
    ]


def _sigma(body: Body, name: str, along: np.ndarray | None = None) -> np.ndarray | None:
    """Deviations of a series, NaN where not published; of a vector's length, `along` it."""
    series, deviation = body.series.get(name), body.series.get(f'{name}/deviation')
    if series is None or deviation is None:
        return None
    found = np.full(len(series.stamp), np.nan)
    _, here, there = np.intersect1d(series.stamp, deviation.stamp, return_indices=True)
    values = deviation.value[there]
    if along is not None:
        length = np.abs(along[here])
        way = along[here] / np.where(length > 0, length, 1)
        values = np.hypot(values.real * way.real, values.imag * way.imag)
    found[here] = values.real
    return found


def _stands(body: Body) -> bool:
    """Whether the body is mostly held on a pin."""
    velocity = body.series.get('icr_velocity')
    return velocity is not None and bool(np.mean(velocity.value == 0) > 0.5)


def draw(axis: Any, strip: Any, body: Body, panel: Panel, start: int, instant: int) -> None:
    """A panel on `axis`, and the band of 2 deviations on `strip` below it."""
    for part in (axis, strip):
        part.grid(True, linewidth=0.3)
        part.axvline((instant - start) * 1e-9, color=GRAY, linestyle='--', linewidth=0.8)
        part.tick_params(labelsize=8)
    axis.ticklabel_format(useOffset=False)
    axis.set_ylabel(panel.label)
    share = len(panel.series.stamp) / len(body.stamp) if panel.series is not None else 0.0
    if share < 0.9:
        percent = f'{share:.0%}' if share >= 0.01 else 'less than 1%'
        text = f'determined at {percent} of the instants' if share else 'undetermined'
        if not share and _stands(body):
            text = 'none: the ICR is a pin, and stands still'
        axis.text(0.02, 0.94, text, transform=axis.transAxes, va='top', fontsize='small', zorder=5)
    if panel.series is None or not share:
        axis.set_yticks([])
        strip.set_yticks([])
        return
    breaks = breaks_of(body, panel.series.stamp)
    time, _ = broken((panel.series.stamp - start) * 1e-9, breaks)
    value, alone = broken(panel.series.value, breaks)
    axis.plot(time, value, '-', marker='.', markevery=alone, markersize=4, zorder=3, **ESTIMATE)
    if panel.truth is not None and len(panel.truth.stamp):
        within = (panel.truth.stamp >= body.stamp[0]) & (panel.truth.stamp <= body.stamp[-1])
        exact = panel.truth.value[within]
        axis.plot((panel.truth.stamp[within] - start) * 1e-9, exact, zorder=4, **TRUTH)
    least = panel.least
    if panel.sigma is not None:
        band, _ = broken(2 * panel.sigma, breaks)
        axis.fill_between(time, value - band, value + band, **BAND)
        _draw_strip(strip, panel, time, band, breaks)
        if len(known := band[np.isfinite(band)]):
            # The band is to be seen too, where there is nothing else.
            least = max(least, 3 * float(np.median(known)))
    else:
        strip.set_yticks([])
    low, high = np.percentile(panel.series.value, [panel.cut, 100 - panel.cut])
    if low > 0 and high > _LOG_FACTOR * low:
        axis.set_yscale('log')
        axis.set_ylim(low / 1.5, high * 1.5)
    elif (spare := max(0.12 * (high - low), (least - (high - low)) / 2)) > 0:
        axis.set_ylim(low - spare, high + spare)


def _draw_strip(
    strip: Any, panel: Panel, time: np.ndarray, band: np.ndarray, breaks: np.ndarray
) -> None:
    """The band about zero, and the error in it."""
    strip.fill_between(time, -band, band, **BAND)
    assert panel.series is not None
    if panel.truth is not None:
        error = np.full(len(panel.series.stamp), np.nan)
        _, here, there = np.intersect1d(panel.series.stamp, panel.truth.stamp, return_indices=True)
        error[here] = panel.series.value[here] - panel.truth.value[there]
        strip.plot(time, broken(error, breaks)[0], **ERROR)
    known = band[np.isfinite(band)]
    top = float(np.percentile(known, _IN_STRIP)) if len(known) else 0.0
    if top > 0:
        # The next number of one figure, so that its label is short.
        step = 10.0 ** np.floor(np.log10(top))
        height = float(np.ceil(1.05 * top / step) * step)
        strip.set_ylim(-height, height)
        strip.set_yticks([0], [f'±{height:g}'], color=BLUE)
