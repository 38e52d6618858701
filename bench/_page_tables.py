"""The second page of the benchmarks: the tables, for who looks something up."""

from bench._markdown import table, wrapped
from bench._page import Tables, warnings
from bench._page_accuracy import (
    bounds_part,
    chi_part,
    coverage_part,
    hindsight_part,
    others_part,
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
from bench._page_peers import peers_part, pendulum_part
from bench._page_rates import rates_part, spectra_part
from bench._page_rigs import rigs_part

# Parts by what they are made of; they are left out where any of it lacks.
_PARTS = (
    (('hindsight',), hindsight_part),
    (('hindsight_others',), others_part),
    (('bounds', 'hindsight'), bounds_part),
    (('coverage', 'bounds', 'coverage_others'), coverage_part),
    (('coverage',), chi_part),
    (('peers', 'pynumdiff'), peers_part),
    (('rates', 'near_events'), rates_part),
    (('spectra',), spectra_part),
    (('pendulum',), pendulum_part),
    (('rigs',), rigs_part),
    (('costs',), time_part),
    (('speed', 'start'), speed_part),
    (('live',), live_part),
    (('error_over_lag',), lag_part),
    (('atlas',), atlas_part),
    (('long',), long_part),
    (('soak',), soak_part),
)


def make_tables(tables: Tables) -> str:
    """The page as Markdown, from rows by the name of their table."""
    parts = [
        '# Tables of the benchmarks',
        *warnings(tables),
        _INTRODUCTION,
        *(make(*(tables.get(name, []) for name in names)) for names, make in _PARTS),
        _runs(tables),
    ]
    return wrapped('\n\n'.join(part for part in parts if part))


_INTRODUCTION = """[Benchmarks](benchmarks.md) is the summary. "Ours" is kinpole. A "bar" is a limit
that the project aims for; values in bold miss it.

## Motions

| motion | description |
| --- | --- |
| four-bar coupler | at 1 rev/s |
| fast rotation | a constant 5 rev/s, with the reference point on an orbit |
| two sines | in angle, x and y |
| stop and go | half a second of rest, half a second of motion |
| rolling wheel | at 1 rev/s |
| dead point | a coupler that turns quickly at a dead point: its acceleration peaks for 0.06 s |
| rod | of a slider-crank, at 2 to 15 rev/s; its harmonics reach the noise one after the other |
| Jansen leg | its last link, at 1 rev/s |
| cam with dwells | a rocker that rises, dwells and returns in a second |
| decaying pendulum | loses a third of its swing in a second |
| random | all frequencies up to 3 Hz |
| turning with a ripple | 2 rev/s, with 0.1% of a turn six times in each |

The estimator was developed on all of these motions ([experiments](estimator.md)).

## How are errors computed?

One body of 4 markers at 200 Hz, window 0.5 s, lag 0.1 s. Noise is white, in body sizes per axis,
and not given to the tracker. A body size is twice the rms radius of the markers. The first 1.5 s
are left out. Errors are RMS over the frames that ours determines, in which the true pole (for κ:
the ICR) is within 10 body sizes and the true κ is below 10 per body size."""


def _runs(tables: Tables) -> str:
    runs = tables.get('run', [])
    lines = (
        (
            row['part'],
            row['day'],
            f'{row["seconds"]:.0f}',
            f'{row["load"]:.1f} on {row["cores"]:.0f} cores',
            'yes' if row['quick'] else '',
        )
        for row in runs
    )
    head = ('part', 'measured on', 'duration, s', 'load before', 'quick')
    noted = table(head, lines) if runs else 'Not recorded.'
    return f"""## Runs

{noted}

`kinpole bench --only PART` measures one part again."""
