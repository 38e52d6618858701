"""Several troubles of a rig at once: what is done about one must not undo what is about another."""

import numpy as np
import pytest

from bench._outcome import FIGURES, Outcome, run
from bench._rigs import Recording, record
from bench._spoil import Spoil, exchanged, exponential, hidden, in_time, stamped, tilted


def outcome(r: Recording, *spoils: Spoil) -> Outcome:
    """What comes of a recording that is spoiled in several ways, stamps last."""
    rng = np.random.default_rng(0)
    turn, settings, points = np.eye(3), {}, r.points
    for spoil in spoils:
        sent = spoil(r._replace(points=points), rng)
        settings |= sent.settings
        turn = turn @ sent.turn
        points = sent.points
    return run(r, sent._replace(settings=settings, turn=turn))


@pytest.mark.parametrize(
    ('rate', 'spoils'),
    [
        pytest.param(200, (exchanged(1.0), exponential(3e-3)), id='exchanged names, late stamps'),
        pytest.param(
            200, (exchanged(2.5), exponential(3e-3)), id='later exchanged names, late stamps'
        ),
        pytest.param(
            400,
            (tilted(5.0, 'fit'), stamped(in_time, 10**6)),
            id='tilted plane, rounded stamps',
        ),
        pytest.param(
            200,
            (tilted(20.0, 'fit'), hidden(0.1), exponential(1e-3)),
            id='tilted plane, hidden markers, late stamps',
        ),
    ],
)
def test_figures_hold_where_several_troubles_come_at_once(
    rate: float, spoils: tuple[Spoil, ...]
) -> None:
    found = outcome(record('four-bar links', rate, 4.0), *spoils)
    for name in FIGURES:
        known = np.isfinite(found.error[name])
        assert known.mean() > 0.5
        assert (found.square[name][known] > 100).mean() < 0.01


@pytest.mark.parametrize(
    ('rate', 'spoil'),
    [
        pytest.param(400.0, stamped(in_time, 10**6, lost=0.2), id='rounded to 1 ms'),
        pytest.param(200.0, exponential(3e-3, lost=0.2), id='late by exp(3 ms)'),
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
