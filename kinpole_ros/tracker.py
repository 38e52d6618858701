"""The pipeline by its former name, for those who import it from here."""

from kinpole_ros.settings import Settings, settings_from
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

__all__ = ['MarkerFrames', 'Settings', 'Tracker', 'settings_from']
