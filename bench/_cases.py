"""
The cases of the benchmark of real rigs: ways to spoil the input, how strongly, and the bars.

Cases of one trouble come with more and more of it, to see where it breaks.
"""

from typing import Any, NamedTuple

import numpy as np

from bench._spoil import (
    EARLY,
    LATE,
    Spoil,
    absent,
    any_order,
    barrel,
    exchanged,
    exponential,
    ghost,
    hidden,
    ideal,
    in_mm,
    in_time,
    misplaced,
    noisier,
    renamed,
    slipping,
    soft,
    stamped,
    tilted,
)


class Case(NamedTuple):
    """
    One way to spoil a recording, at frame rates in Hz.

    `trouble` is what it is and `level` how much of it; `what` is both. `bar` is the most that
    errors over the ideal ones of the quantities `on` may be. Frames are `uneven` by so many
    intervals; `ideal` are parameters of the ideal run.
    """

    part: str
    what: str
    trouble: str
    level: str
    spoil: Spoil
    bar: float = np.nan
    on: tuple[str, ...] = ('ω', 'α', 'jerk', 'ICR')
    rates: tuple[float, ...] = (100.0, 200.0)
    uneven: float = 0.0
    ideal: dict[str, Any] = {}  # noqa: RUF012 - nobody writes to it


_POINTS = ('ω', 'ICR')
# For cases that only show where it breaks.
_ONE = (200.0,)
_STAMPS, _ROUNDED = 'late stamps (mean)', 'rounded stamps'
_NAMES = 'points without names'


def _late(ms: float, bar: float, rates: tuple[float, ...] = (100.0, 200.0)) -> Case:
    what = f'late by exp({ms:g} ms)'
    return Case('stamps', what, _STAMPS, f'{ms:g} ms', exponential(ms / 1e3), bar, rates=rates)


def _rounded(ms: int, bar: float, rates: tuple[float, ...] = (100.0, 200.0)) -> Case:
    spoil = stamped(in_time, ms * 10**6)
    what = f'rounded to {ms} ms'
    return Case('stamps', what, _ROUNDED, f'{ms} ms', spoil, bar, rates=rates)


CASES = (
    Case(
        'stamps',
        'late by 0.2 to 3 ms, uniform',
        'late stamps (at most)',
        '3 ms',
        stamped(lambda g, n: g.uniform(2e-4, 3e-3, n)),
        1.1,
    ),
    _late(0.5, 1.1),
    _late(1, 1.1),
    _late(3, 1.3),
    _late(10, np.nan, _ONE),
    _late(30, np.nan, _ONE),
    Case(
        'stamps',
        'in µs, 120 Hz',
        _ROUNDED,
        '1 µs (120 Hz)',
        stamped(in_time, 1000),
        1.1,
        rates=(120.0,),
    ),
    _rounded(1, 1.1),
    Case(
        'stamps',
        'rounded to 1 ms, 240 Hz',
        _ROUNDED,
        '1 ms (240 Hz)',
        stamped(in_time, 10**6),
        1.1,
        rates=(240.0,),
    ),
    _rounded(5, np.nan, _ONE),
    Case(
        'stamps',
        'true, uneven by 0.3 intervals',
        'uneven frames, true stamps',
        '0.3 intervals',
        ideal,
        1.05,
        uneven=0.3,
        ideal={'stamps': 'capture'},
    ),
    *(
        Case(
            'stamps',
            f'{share:.0%} of the frames lost',
            'lost frames',
            f'{share:.0%}',
            stamped(in_time, lost=share),
            rates=_ONE,
        )
        for share in (0.1, 0.3, 0.5, 0.7)
    ),
    *(
        Case(
            'plane',
            f'tilt {tilt}°, plane: {plane}',
            f'tilted plane (plane: {plane})',
            f'{tilt}°',
            tilted(tilt, plane),
            bar,
            ('ICR',),
        )
        for plane, bar in (('fit', 1.1), ('xy', np.nan))
        for tilt in (3, 10, 20, 30, 90)
    ),
    Case('plane', 'in mm', 'markers in mm', 'no scale', in_mm()),
    Case(
        'plane', 'in mm, scale: 0.001', 'markers in mm', 'scale: 0.001', in_mm(scale=0.001), 1.001
    ),
    *(
        Case(
            'names',
            f'two exchanged for good at {since:g} s',
            'exchanged names',
            f'at {since:g} s',
            exchanged(since),
            1.2,
            ('ω',),
        )
        for since in (EARLY, LATE)
    ),
    Case(
        'names',
        'two gone for 0.3 s, back as new ones',
        'replaced names',
        'for good',
        renamed,
        1.2,
        ('ω',),
    ),
    Case('names', 'none, any order, shapes given', _NAMES, 'any order', any_order, 1.2, ('ω',)),
    Case('names', 'none, a ghost from 2.5 s on', _NAMES, 'a ghost', ghost, 1.2, ('ω',)),
    Case('names', 'none, 5% of the points absent', _NAMES, '5% absent', absent(0.05), 1.2, ('ω',)),
    Case('names', 'none, 20% of the points absent', _NAMES, '20% absent', absent(0.2), rates=_ONE),
    *(
        Case(
            'markers',
            f'one of each body {times} times noisier',
            'one noisier marker',
            f'{times} times',
            noisier(times),
            bar,
            _POINTS,
            rates,
        )
        for times, bar, rates in (
            (3, np.nan, _ONE),
            (10, 1.25, (100.0, 200.0)),
            (30, np.nan, _ONE),
            (100, np.nan, _ONE),
        )
    ),
    *(
        Case(
            'markers',
            f'one of each body slips by {mm} mm',
            'one slipping marker',
            f'{mm} mm',
            slipping(mm / 1e3),
            bar,
            _POINTS,
            rates,
        )
        for mm, bar, rates in (
            (1, np.nan, _ONE),
            (2, 1.25, (100.0, 200.0)),
            (5, np.nan, _ONE),
            (20, np.nan, _ONE),
        )
    ),
    *(
        Case(
            'markers',
            f'{share:.0%} hidden',
            'hidden markers',
            f'{share:.0%}',
            hidden(share),
            rates=rates,
        )
        for share, rates in ((0.1, _ONE), (0.3, _ONE), (0.6, _ONE), (0.9, (100.0, 200.0)))
    ),
    *(
        Case('frames', f'one with a body {what}', 'misplaced bodies', level, spoil)
        for what, level, spoil in (
            ('turned by 0.3 rad', 'by 0.3 rad', misplaced(0.3, 0.0)),
            ('turned by 2 rad', 'by 2 rad', misplaced(2.0, 0.0)),
            ('20 mm off', 'by 20 mm', misplaced(0.0, 0.02)),
        )
    ),
    *(
        Case(
            'bodies',
            f'soft tissue, {mm:g} mm over 0.2 s',
            'soft tissue',
            f'{mm:g} mm',
            soft(mm / 1e3),
            rates=rates,
        )
        for mm, rates in ((0.2, _ONE), (1, _ONE), (5, (100.0, 200.0)))
    ),
    *(
        Case(
            'bodies',
            f'barrel distortion of {share:.1%}'.replace('.0%', '%'),
            'barrel distortion',
            f'{share:.1%}'.replace('.0%', '%'),
            barrel(share),
            rates=rates,
        )
        for share, rates in (
            (0.002, _ONE),
            (0.01, (100.0, 200.0)),
            (0.05, (100.0, 200.0)),
        )
    ),
)
