"""The page of a report as one HTML file, from the files in page/."""

import html
import re
from pathlib import Path
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.tools.report._page_data import embedded

_FOLDER = Path(__file__).parent / 'page'
# In this order: each script uses those before it.
_SCRIPTS = (
    'data',
    'drawing',
    'motion',
    'instant',
    'stage',
    'table',
    'charts',
    'polygons',
    'input',
    'live',
    'solver',
    'editor',
    'page',
)
# The page loads nothing; a live page reads its stream of events.
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def page(data: dict[str, Any]) -> str:
    """
    Return the HTML of a page with the data of `pack`, and the titles that `report` adds.

    With `live` in the data, it is the page of a stream of events next to it.
    """
    is_live, has_editor = 'live' in data, 'edit' in data
    needed = {'live': is_live, 'solver': has_editor, 'editor': has_editor}
    scripts = [f'{name}.js' for name in _SCRIPTS if needed.get(name, True)]
    values = {
        'POLICY': f"{_POLICY}; connect-src 'self'" if is_live else _POLICY,
        'TITLE': html.escape(printable(data['title'])),
        'STYLE': _read('style.css'),
        'SCRIPT': '\n'.join(map(_read, scripts)),
        'DATA': embedded(data),
    }
    return re.sub('@([A-Z]+)@', lambda match: values[match[1]], _read('page.html'))


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding='utf-8')
