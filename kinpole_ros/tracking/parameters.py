"""The parameters are in `kinpole_ros.settings`; this name is kept for programs that import it."""

from kinpole_ros.settings import *  # noqa: F403
