"""
The configuration of the site that `make docs` builds.

A comment such as `<!-- every parameter -->` in a page is replaced by a reference generated from the
code (`_reference.py`). Neither the build nor the site loads anything from the network.
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

# The lexer of bash colors the numbers in arguments; plain text has one color.
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
smartquotes = False  # they change --options
# In docstrings, `points` is code.
default_role = 'code'
# The docstrings have shapes and units; the type hints of numpy are longer and say less.
autodoc_typehints = 'none'
autodoc_member_order = 'bysource'
numpydoc_show_class_members = False
myst_enable_extensions = ['dollarmath', 'deflist']
myst_heading_anchors = 4

_DOCS = Path(__file__).parent
# Links that may lead out of docs.
_LINK = re.compile(r'\[([^\]]+)\]\((\.\./[^)#]*|charts)(?:#[^)]*)?\)')


def insert_references(app: Any, page: str, source: list[str]) -> None:
    """Replace the comments by references, and remove links that do not lead to a page."""

    def unlink(link: re.Match[str]) -> str:
        target = (_DOCS / page).parent.joinpath(link[2]).resolve()
        is_page = target.is_relative_to(_DOCS) and target.is_file()
        return link[0] if is_page else f'`{link[1]}`'

    source[0] = _LINK.sub(unlink, source[0])
    for comment, reference in _reference.REFERENCES.items():
        if comment in source[0]:
            source[0] = source[0].replace(comment, reference())
    if _gallery.COMMENT in source[0]:
        sections = _gallery.gallery_markdown(Path(app.outdir) / '_gallery')
        source[0] = source[0].replace(_gallery.COMMENT, sections)


def skip_alias(app: Any, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """Skip the fields of named tuples, whose docstrings contain only their index."""
    text = getattr(thing, '__doc__', None) or ''
    return True if text.startswith('Alias for field number') else None


def escape_bars(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Escape the bars of |u| outside of code, because reStructuredText would substitute u."""
    for k, line in enumerate(lines):
        text = line.split('`')
        text[::2] = [part.replace('|', r'\|') for part in text[::2]]
        lines[k] = '`'.join(text)


def draw_formula(self: Any, node: nodes.math) -> None:
    """
    Draw a formula as an SVG picture in the color of the text.

    MathML needs a font for mathematics, without which browsers lose bars and dots.
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
    """Register the functions above; called by Sphinx."""
    app.connect('source-read', insert_references)
    app.connect('autodoc-skip-member', skip_alias)
    app.connect('autodoc-process-docstring', escape_bars)
    app.add_html_math_renderer('outlines', (draw_formula, None), (draw_formula, None))
    return {'parallel_read_safe': False, 'parallel_write_safe': True}
