"""The pipeline by its former name, for those who import it from here."""

from kinpole_ros.pipeline.frame import MarkerFrames
from kinpole_ros.pipeline.parameters import Settings, settings_from
from kinpole_ros.pipeline.tracker import Tracker

__all__ = ['MarkerFrames', 'Settings', 'Tracker', 'settings_from']
