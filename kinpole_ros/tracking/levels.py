"""
Levels that much goes by: what is sure, what is few, what is remembered, what is little.

A number that says the same in several places is one, so that it is changed and tried as one.
"""

import numpy as np

# So many standard deviations are no chance.
SURE = 4.0
# Fewer frames, or degrees of freedom, than these do not tell how large errors are for sure.
FEW = 20
# Fewer degrees of freedom than these do not even tell an order of magnitude.
FEWEST = 6
# So many frames are remembered to tell it by.
KEPT = 512
# What was seen so many frames ago says where a body is to be expected now.
RECENT = 8
# So many frames running are no mistake of the tracker.
RUNNING = 3
# Share of a body's size that matters to nobody.
LITTLE = 0.01
# Share of a body's size, or of a tick, that is as good as nothing.
TINY = 1e-6
# Coordinates, and rad, are known no better than to a few units of their last place.
ROUNDING = 4 * np.finfo(float).eps
