"""Tests of films need the extra `film`."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec('av') and find_spec('cv2') else ['test_*.py']
