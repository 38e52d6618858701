"""
The parts of the benchmarks: what each measures, as rows by the name of their CSV file.

Seeds are fixed: except for the times everything comes out the same again.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from bench._atlas import survey
from bench._bounds import bounds
from bench._costs import cost_rows
from bench._hindsight import best_fixed, counted, coverage, own_errors, pooled_rms
from bench._live import live_rows, measure_live, start_rows
from bench._model import model_over_time, model_rows
from bench._motions import motions, other_motions
from bench._outcome import rig_rows
from bench._peers import OURS, Table, equal_lag, over_lag
from bench._pendulum import TABLE, pendulum
from bench._pynumdiff import pynumdiff_errors
from bench._rates import rate_rows
from bench._record import (
    NOISES,
    QUANTITIES,
    RATE,
    RATES,
    UNITS,
    Recording,
    make_recording,
    measure,
)
from bench._rigs import rigs
from bench._rows import Rows
from bench._spectra import spectra_rows
from bench._speed import speed_rows

# Seeds and s of a record, quick.
_LITTLE = 1, 3.0
Progress: TypeAlias = Callable[[float], None]


class Part(NamedTuple):
    """
    What is measured: with quick or not, calling progress with the share done.

    `seconds` is what it takes on two cores, in full and quick, for whoever watches it go on:
    measured, or reckoned from how much of it is measured with quick.
    """

    seconds: tuple[float, float]
    rows: Callable[[bool, Progress], dict[str, Rows]]


def hindsight_table(
    names: tuple[str, ...], noises: tuple[float, ...], seeds: int, seconds: float
) -> tuple[Rows, Rows, Rows]:
    """
    Rows of our errors over the best fixed (window, degree) in hindsight, of coverage and of bounds.

    By motion, noise and quantity; ratio NaN where too few frames are determined.
    """
    recording = make_recording(names, noises, seeds, seconds)
    ours = measure(recording)
    where = counted(recording, ours)
    own = own_errors(recording, ours)
    errors = pooled_rms(recording, own, where)
    best = best_fixed(recording, ours.frames, where)
    scales = _scales(recording)
    rows = []
    for (motion, noise, quantity), error in errors.items():
        least, samples, degree, _ = best.get((motion, noise, quantity), (np.nan, 0, 0, None))
        rows.append(
            {
                'motion': motion,
                'noise': noise,
                'quantity': quantity,
                'unit': UNITS[quantity],
                'scale': scales[motion, quantity],
                'ours': error,
                'best': least,
                'samples': samples,
                'degree': degree,
                'ratio': error / least,
            }
        )
    return rows, coverage(recording, ours), bounds(recording, ours.frames, own, where, best)


def _scales(recording: Recording) -> dict[tuple[str, str], float]:
    """What errors are held against, by motion and quantity: rms of rates, size, one over it."""
    found = {}
    for k, case in enumerate(recording.cases):
        size = float(recording.size[k])
        for name in QUANTITIES:
            scale = 1 / size if name == 'κ' else size
            if name in RATES:
                scale = float(np.sqrt(np.mean(recording.truth[name][:, k] ** 2)))
            found[case.motion, name] = scale
    return found


def _hindsight(quick: bool, progress: Progress) -> dict[str, Rows]:
    six = hindsight_table(tuple(motions()), NOISES, *(_LITTLE if quick else (9, 6.0)))
    progress(0.6)
    others = hindsight_table(tuple(other_motions()), NOISES, *(_LITTLE if quick else (3, 6.0)))
    names = ('hindsight', 'coverage', 'bounds')
    return dict(zip(names, six, strict=True)) | {
        f'{name}_others': rows for name, rows in zip(names[:2], others[:2], strict=True)
    }


def _peers(quick: bool, progress: Progress) -> dict[str, Rows]:
    names = tuple(motions()) + (() if quick else tuple(other_motions()))
    tables = equal_lag(make_recording(names, NOISES, *(_LITTLE if quick else (2, 6.0))))
    return {'peers': _table_rows(tables)}


def _costs(quick: bool, progress: Progress) -> dict[str, Rows]:
    return {'costs': cost_rows(1 if quick else 5)}


def _lag(quick: bool, progress: Progress) -> dict[str, Rows]:
    lags = (0, 20) if quick else (0, 2, 5, 10, 20, 40)
    found = over_lag(tuple(motions()), lags, *(_LITTLE if quick else (2, 6.0)))
    return {'error_over_lag': _lag_rows(found)}


def _model(quick: bool, progress: Progress) -> dict[str, Rows]:
    names = tuple(motions()) + tuple(other_motions())
    return {
        'model': model_rows(names, *(_LITTLE if quick else (2, 6.0))),
        'model_over_time': model_over_time(),
    }


def _pynumdiff(quick: bool, progress: Progress) -> dict[str, Rows]:
    names = tuple(motions())[: 1 if quick else None]
    tables, spent, version = pynumdiff_errors(make_recording(names, NOISES[1:2], 1, 4.5))
    return {
        'pynumdiff': [
            row | {'cpu': spent.get(row['method'], np.nan), 'version': f'v{version}'}
            for row in _table_rows(tables)
        ]
    }


def _live(quick: bool, progress: Progress) -> dict[str, Rows]:
    little: dict[str, Any] = {'seconds': 1.0, 'runs': 1, 'step_up': 4.0} if quick else {}
    live = measure_live(**little, progress=progress)
    return {'live': live_rows(live), 'start': start_rows(live)}


def _rates(quick: bool, progress: Progress) -> dict[str, Rows]:
    return dict(zip(('rates', 'near_events'), rate_rows(quick, progress), strict=True))


def _pendulum(quick: bool, progress: Progress) -> dict[str, Rows]:
    # Its data do not come with the project, and it takes long.
    return {'pendulum': pendulum()} if TABLE.exists() and not quick else {}


def _rigs(quick: bool, progress: Progress) -> dict[str, Rows]:
    """All cases: with `quick` of one rig at one rate, and shorter."""
    names = tuple(rigs())
    if quick:
        return {'rigs': rig_rows(names[:1], 3.0, rates=1, progress=progress)}
    return {'rigs': rig_rows(names, 4.0, progress=progress)}


PARTS = {
    'costs': Part((20, 3), _costs),
    'speed': Part((125, 16), lambda quick, tell: {'speed': speed_rows(quick, tell)}),
    'live': Part((270, 86), _live),
    'hindsight': Part((55, 5), _hindsight),
    'peers': Part((60, 5), _peers),
    'lag': Part((14, 3), _lag),
    'model': Part((15, 4), _model),
    'pynumdiff': Part((60, 10), _pynumdiff),
    'rates': Part((300, 20), _rates),
    'spectra': Part((60, 2), lambda quick, tell: {'spectra': spectra_rows(quick, tell)}),
    'atlas': Part((98, 11), lambda quick, tell: {'atlas': survey(quick, tell)}),
    'pendulum': Part((10, 0), _pendulum),
    'rigs': Part((170, 14), _rigs),
}


def _table_rows(tables: dict[str, Table]) -> Rows:
    return [
        {
            'method': method,
            'motion': motion,
            'noise': noise,
            'quantity': quantity,
            'unit': UNITS[quantity],
            'error': error,
        }
        for method, table in tables.items()
        for (motion, noise, quantity), error in table.items()
    ]


def _lag_rows(lagged: dict[tuple[str, int], Table]) -> Rows:
    ours = lagged[OURS, 20]
    rows = []
    order = sorted(lagged, key=lambda key: (key[0] != OURS, key))
    for method, lag in order:
        table = lagged[method, lag]
        row: dict[str, Any] = {'method': method, 'lag': lag / RATE}
        for name in QUANTITIES:
            ratios = [
                error / ours[key]
                for key, error in table.items()
                if key[2] == name and ours[key] > 0 and np.isfinite(error / ours[key])
            ]
            row[name] = float(np.median(ratios)) if ratios else float('nan')
        rows.append(row)
    return rows
