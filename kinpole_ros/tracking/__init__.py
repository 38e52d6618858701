"""
From the markers of a frame to the motion of the bodies, one frame at a time.

`history` holds the frames of late, `bodies` what is learned of the bodies. `fit` finds the poses of
one frame, `learn` updates the bodies from the history, and `tracker` joins them.
"""
