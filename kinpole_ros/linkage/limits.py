"""Limits that several steps of discovery and fitting share, each with its reason."""

GATE = 8.0
"""Prediction errors that a point may be away: a track is lost more often at 4, exchanged at 16."""
OUTLIER_SIGMAS = 6.0
"""Standard deviations that a marker may be off its place: 1 of 5e8 in normal noise is farther."""
DEPENDENT = 1e-8
"""Share of the squared column of an unknown that those before it leave, if it depends on them: the
square root of the rounding of doubles, in which columns of the same unknowns end."""

# Frames without which there is no statement.
RECORDING_FRAMES = 20
"""Of a recording: its interval, and the pace of its markers."""
PAIR_FRAMES = 30
"""Common ones of two markers: the spread of their distance, to a quarter."""
JOINT_FRAMES = 50
"""Common ones of two bodies: a joint has up to 7 unknowns, and its residual is compared."""
