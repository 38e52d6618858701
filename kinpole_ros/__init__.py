"""Live planar kinematics of real mechanisms from tracked markers."""

# As in typing, whose import takes 5 ms in which Ctrl-C ends a command in a traceback.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from kinpole_ros.api import (
        BodyMotion,
        Events,
        PairMotion,
        Tracked,
        UnknownNameError,
        replay,
        track,
    )

__version__ = '0.1.0'
__all__ = ['BodyMotion', 'Events', 'PairMotion', 'Tracked', 'UnknownNameError', 'replay', 'track']


def __getattr__(name: str) -> 'Any':
    # Imported when asked for: the command line needs none of it to begin.
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from kinpole_ros import api

    return getattr(api, name)
