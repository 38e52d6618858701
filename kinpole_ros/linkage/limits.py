"""Limits that steps of discovery and fitting share, none of them measured at half and double."""

GATE = 8.0
"""A point continues a track, or is a marker of a body, up to this many prediction errors away."""
OUTLIER_SIGMAS = 6.0
"""Standard deviations that a marker may be off its place: in normal noise 1 of 5e8 is farther."""
DEPENDENT = 1e-8
"""An unknown depends on those before it if they leave less than this share of its squared column.
Rounding leaves 2e-16."""

# Frames without which there is no statement.
RECORDING_FRAMES = 20
"""Frames of a recording."""
PAIR_FRAMES = 30
"""Common frames of two markers: fewer say nothing about their distance."""
JOINT_FRAMES = 50
"""Common frames of two bodies: fewer say nothing about their joint."""
