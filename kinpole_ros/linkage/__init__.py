"""Linkages held against measured bodies: which bodies markers make, and what joins them."""

from kinpole_ros.linkage._check import Checked, check_draft, draft
from kinpole_ros.linkage._discover import discover
from kinpole_ros.linkage._lines import table
from kinpole_ros.linkage._model import Length, Linkage, Place
from kinpole_ros.linkage._record import UndiscoveredError
from kinpole_ros.linkage._rig import parameter_file

__all__ = [
    'Checked',
    'Length',
    'Linkage',
    'Place',
    'UndiscoveredError',
    'check_draft',
    'discover',
    'draft',
    'parameter_file',
    'table',
]
