"""The page of the benchmarks, put together of figures that others have measured."""

import os
import platform
from typing import Any, NamedTuple

import numpy as np

from bench._page_accuracy import (
    bounds_part,
    chi_part,
    coverage_part,
    hindsight_part,
    others_part,
    peers_part,
    pendulum_part,
)
from bench._page_limits import (
    atlas_part,
    lag_part,
    live_part,
    long_part,
    soak_part,
    speed_part,
    time_part,
)
from bench._page_rigs import rigs_part
from bench._peers import Table

Rows = list[dict[str, Any]]


class Results(NamedTuple):
    """All that a page is made of: rows as in the CSV files, tables of RMS errors, times."""

    seconds: float
    quick: bool
    ratios: Rows
    others: Rows
    bounds: Rows
    coverage: Rows
    tables: dict[str, Table]
    offline: dict[str, Table]
    version: str
    pendulum: Rows
    rigs: Rows
    spent: dict[str, float]
    atlas: Rows
    speed: Rows
    live: Rows
    long: list[dict[str, float]]
    soak: list[dict[str, float]]


def make_page(results: Results) -> str:
    """The page as Markdown."""
    parts = [
        _head(results.seconds, results.quick),
        hindsight_part(results.ratios),
        others_part(results.others),
        bounds_part(results.bounds, results.ratios),
        coverage_part(results.coverage, results.bounds),
        chi_part(results.coverage),
        peers_part(results.tables, results.offline, results.version),
        pendulum_part(results.pendulum, results.quick),
        rigs_part(results.rigs),
        time_part(results.spent),
        speed_part(results.speed),
        live_part(results.live),
        lag_part(),
        atlas_part(results.atlas),
        long_part(results.long),
        soak_part(results.soak),
    ]
    return '\n\n'.join(parts) + '\n'


def _head(seconds: float, quick: bool) -> str:
    warning = '\n**Made with --quick: too little data for a judgment.**\n' if quick else ''
    return f"""# Benchmarks

Made by `kinpole bench`: figures as CSV next to each picture in [charts](charts), the same again
from the same code but for the times. This run took {seconds / 60:.1f} minutes on
{os.cpu_count()} cores (Python {platform.python_version()}, numpy {np.__version__}).
{warning}
Unless said otherwise: one body of 4 markers at 200 Hz, window 0.5 s, lag 0.1 s; noise is white,
its standard deviation per axis given in body sizes (twice the rms radius of the markers), and not
given to the tracker. Six motions: a four-bar's coupler at 1 rev/s; turning at a constant 5 rev/s
with the reference point on an orbit; two sines in angle, x and y; half a second of rest and half a
second of motion, over and over; a wheel that rolls at 1 rev/s; and a coupler that whips round at a
dead point, where its acceleration peaks for 0.06 s. The first 1.5 s of each record do not count.
Errors are RMS over the frames that ours calls determined, and of these over frames whose true pole
(for κ: the ICR) lies within 10 body sizes and whose true κ is below 10 per size."""
