"""Thresholds that several modules share."""

# Deviations beyond this many standard deviations are not noise.
N_SIGMA = 4.0
# Fewer frames, or degrees of freedom, give no usable variance.
MIN_SAMPLES = 20
# Fewer degrees of freedom do not even give the order of magnitude of a variance.
MIN_DOF = 6
# Frames that are remembered for a variance.
MEMORY_FRAMES = 512
# Frames from which a pose is predicted.
RECENT_FRAMES = 8
# Frames in a row that show a change of the body, and not a mistake of the tracker.
CONFIRMING_FRAMES = 3
# Share of the size of a body that does not matter.
NEGLIGIBLE = 0.01
# Share of the size of a body, or of a tick, that is rounding.
ROUNDED = 1e-6
