"""Several troubles of a rig at once: what is done about one must not undo what is about another."""

import numpy as np
import pytest
from fuzz_rigs import fuzz_rigs

from bench._outcome import FIGURES, run
from bench._rigs import record
from bench._spoil import Spoil, combined, exchanged, exponential, hidden, in_time, stamped, tilted


@pytest.mark.parametrize(
    ('rate', 'spoils'),
    [
        pytest.param(200, (exponential(3e-3), exchanged(1.0)), id='exchanged names, late stamps'),
        pytest.param(
            200, (exponential(3e-3), exchanged(2.5)), id='later exchanged names, late stamps'
        ),
        pytest.param(
            400,
            (stamped(in_time, 10**6), tilted(5.0, 'fit')),
            id='tilted plane, rounded stamps',
        ),
        pytest.param(
            200,
            (exponential(1e-3), hidden(0.1), tilted(20.0, 'fit')),
            id='tilted plane, hidden markers, late stamps',
        ),
    ],
)
def test_figures_hold_where_several_troubles_come_at_once(
    rate: float, spoils: tuple[Spoil, ...]
) -> None:
    r = record('four-bar links', rate, 4.0)
    found = run(r, combined(*spoils)(r, np.random.default_rng(0)))
    for name in FIGURES:
        known = np.isfinite(found.error[name])
        assert known.mean() > 0.5
        assert (found.square[name][known] > 100).mean() < 0.01


@pytest.mark.parametrize(
    ('rate', 'spoil'),
    [
        pytest.param(400.0, stamped(in_time, 10**6, lost=0.2), id='rounded to 1 ms'),
        pytest.param(200.0, exponential(1e-3, lost=0.2), id='late by exp(1 ms)'),
    ],
)
def test_a_fifth_of_the_frames_lost_is_counted_where_the_motion_does_not_tell(
    rate: float, spoil: Spoil
) -> None:
    r = record('two_sines, stop_and_go', rate, 4.0)
    found = run(r, spoil(r, np.random.default_rng(3)))
    for name in FIGURES:
        square = found.square[name]
        assert (square[np.isfinite(square)] < 36).all()


def test_no_troubles_at_once_make_it_fail_or_be_sure_of_what_is_wrong() -> None:
    assert all(one.far < 0.002 for one in fuzz_rigs(3))
