"""
From frames of markers to estimates: the one pipeline that node and replay both call.

A clock for their stamps, the frames that are held, bodies, and the tracker that combines
these. Knows neither messages nor ROS.
"""
