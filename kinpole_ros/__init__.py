"""Live planar kinematics of real mechanisms from tracked markers."""

__version__ = '0.1.0'
