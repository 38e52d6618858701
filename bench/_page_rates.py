"""The tables of the benchmarks, by rate and lag: with and without events, and near them."""

from collections.abc import Iterable

from bench._markdown import number, table
from bench._rates import LAGS, QUANTITIES, RATES_HZ, RIVALED, SIZE
from bench._record import NOISES, WINDOW
from bench._rivals import RIVALS
from bench._rows import Rows

_KINDS = {'smooth': 'Motions without events', 'events': 'Motions with events'}
_COMPARED = ('ω', 'α', 'jerk', 'ICR')


def rates_part(rows: Rows, near: Rows) -> str:
    if not rows:
        return ''
    cells = {(row['kind'], row['rate'], row['lag'], row['quantity']): row for row in rows}
    found = {row['kind'] for row in rows}
    kinds = [kind for kind in _KINDS if kind in found]
    noises = ', '.join(f'{noise:g}' for noise in NOISES)
    return '\n\n'.join(
        (
            f"""## Errors by rate and lag

Poses with white noise of {noises} body sizes ({SIZE:g} m), window {WINDOW:g} s, straight to the
estimator: the 15 motions above, and ten with events, at which a derivative steps (bounce,
stick-slip, Geneva drive, backlash, Coulomb friction, trapezoid and S-curve drive, impact, ratchet,
reversing drive). An entry has the error over that of the best fixed window and degree in hindsight
(median, 90th percentile of the cells); the share within 95% intervals; the share beyond 10 standard
deviations. Poles whose standard deviation exceeds half the body size are left out.""",
            *(_rates_table(cells, kind) for kind in kinds),
            """## Other methods that set themselves

Their error over ours, geometric mean; above 1 ours is better. Each has the poses of the same
windows and sets itself by them alone. Segments and total variation are given the true noise. An
error below a hundredth of the best fixed window's counts as that.""",
            *(_rivals_table(cells, kind) for kind in kinds),
            """## Near events

The share within 95% intervals, and the share beyond 10 standard deviations, by the distance of an
instant from the nearest event.""",
            _near_table(near),
            '`kinpole bench --only rates` makes these tables again.',
        )
    )


def spectra_part(rows: Rows) -> str:
    if not rows:
        return ''
    title = """## What the spectrum of a body changes

Poses with white noise of 1e-4, 1e-3 and 1e-2 rad, window 0.3 s (0.5 s at 30 Hz), in the windows
after 2,048 frames: errors with the spectrum of these over those without (geometric mean of the
cells); cells of which less than 85% is within two standard deviations; the share beyond 10. The 15
smooth motions above, ten with events, and fast ones: rods at 6 and 15 rev/s, torsions of 7 Hz, a
ripple on turning, a sine of 0.8 Hz, and steady turning. An error below 0.3 of what a polynomial in
the window has counts as that."""
    places = list(dict.fromkeys((row['kind'], row['rate'], row['lag']) for row in rows))
    lines = []
    for place in places:
        own = [row for row in rows if (row['kind'], row['rate'], row['lag']) == place]
        cells = sum(row['cells'] for row in own)
        low = [sum(row[f'low_{name}'] for row in own) for name in ('without', 'with')]
        beyond = [
            sum(row[f'beyond_{name}'] for row in own) / len(own) for name in ('without', 'with')
        ]
        lines.append(
            (
                '{}, {:g} Hz, {:g} s'.format(*place),
                *(number(row['ratio']) for row in own),
                f'{low[0]:g} → {low[1]:g} of {cells:g}',
                f'{beyond[0]:.2%} → {beyond[1]:.2%}',
            )
        )
    head = 'motions, rate, lag', 'ω', 'α', 'jerk', 'under 85%', 'beyond 10σ'
    return f'{title}\n\n{table(head, lines)}\n\n`kinpole bench --only spectra` makes it again.'


def _rates_table(cells: dict, kind: str) -> str:
    def entry(rate: int, lag: float, quantity: str) -> str:
        row = cells.get((kind, rate, lag, quantity))
        if row is None:
            return '–'
        return (
            f'{number(row["median"])}, {number(row["ninetieth"])}; {row["covered"]:.0%}; '
            f'{row["beyond"]:.2%}'
        )

    lines = (
        (f'{rate} Hz, {lag:g} s', *(entry(rate, lag, quantity) for quantity in QUANTITIES))
        for lag in LAGS
        for rate in RATES_HZ
    )
    return f'{_KINDS[kind]}:\n\n' + table(('rate, lag', *QUANTITIES), lines)


def _rivals_table(cells: dict, kind: str) -> str:
    def lines() -> Iterable[tuple[str, ...]]:
        for rate in RIVALED:
            for lag in LAGS:
                for rival in RIVALS:
                    rows = [cells.get((kind, rate, lag, name), {}) for name in _COMPARED]
                    ratios = (number(row.get(rival, float('nan'))) for row in rows)
                    yield f'{rate} Hz, {lag:g} s: {rival}', *ratios

    return f'{_KINDS[kind]}:\n\n' + table(('', *_COMPARED), lines())


def _near_table(rows: Rows) -> str:
    spans = list(dict.fromkeys((row['from'], row['to']) for row in rows))
    found = {(row['rate'], row['lag'], row['quantity'], row['from']): row for row in rows}

    def entry(rate: int, lag: float, name: str, low: float) -> str:
        row = found.get((rate, lag, name, low))
        return '–' if row is None else f'{row["covered"]:.0%}; {row["beyond"]:.1%}'

    head = [f'{low * 1e3:g} to {high * 1e3:g} ms' for low, high in spans[:-1]]
    head.append(f'over {spans[-1][0] * 1e3:g} ms')
    lines = (
        (f'{rate} Hz, {lag:g} s: {name}', *(entry(rate, lag, name, low) for low, _ in spans))
        for rate in RIVALED
        for lag in LAGS
        for name in QUANTITIES
    )
    return table(('', *head), lines)
