"""
PyNumDiff on the same recordings: offline, of one signal, and set by its own optimizer.

It sees the whole record and is given the true derivative, so it is no peer in use.
"""

import time
import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version

import numpy as np

from bench._hindsight import best_fixed, counted, own_errors, pooled_rms
from bench._peers import FIXED, OURS, Table
from bench._record import QUANTITIES, RATE, RATES, Recording, fit_poses, measure

# The methods and where PyNumDiff's optimizer starts its search (a set: each; a list: near each).
PYNUMDIFF = {
    'savgoldiff': {'degree': {4, 7}, 'window_size': [21, 61, 101], 'smoothing_win': {3}},
    'splinediff': {'degree': {5}, 's': [0.9, 0.1]},
    'rtsdiff': {'order': {3}, 'log_qr_ratio': [4.0, 10.0], 'forwardbackward': {False}},
    'butterdiff': {'filter_order': {3}, 'cutoff_freq': [0.02, 0.1], 'num_iterations': {1}},
}


def pynumdiff_errors(recording: Recording) -> tuple[dict[str, Table], dict[str, float], str]:
    """
    RMS errors of PyNumDiff's methods in ω, α and jerk, their time in s per frame, and its version.

    Offline: they see the whole record, so lag does not bind them. Each order of derivative comes
    from the one before, each with the settings that PyNumDiff's own optimizer finds when it is told
    the true derivative. The time is that of these three. The table 'ours' and that of the best
    fixed window are of the same frames.
    All are empty where the package is missing.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            pynumdiff = import_module('pynumdiff')
            optimize = import_module('pynumdiff.optimize').optimize
    except ImportError:
        return {}, {}, ''
    ours = measure(recording)
    where, frames = counted(recording, ours), ours.frames
    _, angle = fit_poses(recording)
    tables = {OURS: pooled_rms(recording, own_errors(recording, ours), where)}
    tables[FIXED] = {key: best.error for key, best in best_fixed(recording, frames, where).items()}
    costs = {}
    for name, space in PYNUMDIFF.items():
        method: Callable[..., tuple[np.ndarray, np.ndarray]] = getattr(pynumdiff, name)
        errors = {quantity: np.full(ours.values['ω'].shape, np.nan) for quantity in QUANTITIES}
        spent = 0.0
        for column in range(len(recording.cases)):
            signal = angle[:, column]
            for quantity in RATES:
                exact = recording.truth[quantity]
                with warnings.catch_warnings(), np.errstate(all='ignore'):
                    warnings.simplefilter('ignore')
                    try:
                        chosen, _ = optimize(
                            method,
                            signal,
                            1 / RATE,
                            dxdt_truth=exact[:, column],
                            search_space_updates=space,
                            padding='auto',
                            parallel=False,
                            maxiter=5,
                        )
                        start = time.process_time()
                        _, signal = method(signal, 1 / RATE, **chosen)
                        spent += time.process_time() - start
                    except (ValueError, ArithmeticError, np.linalg.LinAlgError):
                        # It has no answer to a record like this: no figure, here and above.
                        break
                errors[quantity][:, column] = (signal - exact[:, column])[frames]
        tables[f'PyNumDiff {name}'] = pooled_rms(recording, errors, where)
        costs[f'PyNumDiff {name}'] = spent / angle.size
    return tables, costs, version('pynumdiff')
