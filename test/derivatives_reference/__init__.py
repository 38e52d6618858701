"""
What the compiled library does, with numpy: to read, and to test it by.

All signals of a kind are treated at once, and models are arrays that are stacked.
"""

from derivatives_reference._poses import derive_poses

__all__ = ['derive_poses']
