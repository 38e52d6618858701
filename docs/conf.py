"""
The site of the docs, as `make docs` builds it: these pages, and references made from the code.

A comment like `<!-- every parameter -->` in a page is where a reference goes (`_reference.py`).
Nothing is fetched while it is built, and nothing when it is read.
"""

import io
import re
import sys
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from matplotlib import rc_context
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image
from pygments.lexers.special import TextLexer
from sphinx.highlighting import lexers

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))

import _gallery
import _reference

import kinpole_ros

# The numbers of a command are none of the shell's: as text they keep one color.
lexers['bash'] = TextLexer()

project = 'kinpole_ros'
version = release = kinpole_ros.__version__
html_title = f'kinpole_ros {version}'
extensions = ['myst_parser', 'numpydoc', 'sphinx.ext.autodoc']
html_theme = 'furo'
html_show_copyright = html_show_sphinx = html_copy_source = False
html_theme_options = {'light_css_variables': {'font-stack': 'sans-serif'}}
html_static_path = ['_static']
html_css_files = ['site.css']
html_math_renderer = 'outlines'
exclude_patterns = ['_*']
smartquotes = False  # of --options
# In docstrings: `points` is a name.
default_role = 'code'
# Shapes and units are in the docstrings; the types of numpy say less, at greater length.
autodoc_typehints = 'none'
autodoc_member_order = 'bysource'
numpydoc_show_class_members = False
myst_enable_extensions = ['dollarmath', 'deflist']
myst_heading_anchors = 4

# Folders, and files outside of docs, are no pages.
_OUTSIDE = re.compile(r'\[([^\]]+)\]\((?:\.\./[^)]*|charts)\)')


def fill_in(app: Any, page: str, source: list[str]) -> None:
    """Put the references in the places of their comments, and take links to no page out."""
    source[0] = _OUTSIDE.sub(r'`\1`', source[0])
    for comment, make in _reference.MADE.items():
        if comment in source[0]:
            source[0] = source[0].replace(comment, make())
    if _gallery.COMMENT in source[0]:
        made = _gallery.every_example(Path(app.outdir) / '_gallery')
        source[0] = source[0].replace(_gallery.COMMENT, made)


def without_aliases(
    app: Any, what: str, name: str, thing: Any, skip: bool, options: Any
) -> bool | None:
    """Leave out the fields of named tuples, whose docstrings say only which number they are."""
    text = getattr(thing, '__doc__', None) or ''
    return True if text.startswith('Alias for field number') else None


def math(self: Any, node: nodes.math) -> None:
    """
    A formula as a picture of outlines, in the color of the text.

    Not as MathML: without a font for mathematics browsers lose bars and dots.
    """
    picture, block = io.BytesIO(), isinstance(node, nodes.math_block)
    formula = ' '.join(node.astext().split())
    if block:
        formula = formula.replace(r'\frac', r'\dfrac')
    with rc_context({'savefig.facecolor': 'none', 'mathtext.fontset': 'cm'}):
        font = FontProperties(size=14)
        depth = math_to_image(f'${formula}$', picture, font, dpi=72, format='svg')
    svg = picture.getvalue().decode().strip()
    svg = re.sub(r'<metadata>.*?</metadata>', '', svg[svg.index('<svg') :], flags=re.DOTALL)
    label = f'role="img" aria-label="{escape(formula)}" style="vertical-align: -{depth}pt"'
    svg = svg.replace('<svg', f'<svg {label}', 1)
    self.body.append(f'<div class="math">{svg}</div>' if block else svg)
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """What Sphinx calls."""
    app.connect('source-read', fill_in)
    app.connect('autodoc-skip-member', without_aliases)
    app.add_html_math_renderer('outlines', (math, None), (math, None))
    return {'parallel_read_safe': False, 'parallel_write_safe': True}
