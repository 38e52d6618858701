"""
How good the estimates are, measured against exact motions and against other ways to get them.

Nothing else depends on it. What is measured is the real tracker, run as replay runs it.
"""

from bench._atlas import survey
from bench._motions import Motion, motions
from bench._parts import PARTS, hindsight_table
from bench._report import bench, bench_long, bench_soak, make_pages

__all__ = [
    'PARTS',
    'Motion',
    'bench',
    'bench_long',
    'bench_soak',
    'hindsight_table',
    'make_pages',
    'motions',
    'survey',
]
