"""The gallery: the picture, output and code of each script in examples/, and the notebook."""

import base64
import contextlib
import io
import json
import re
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

COMMENT = '<!-- every example -->'
_EXAMPLES = Path(__file__).parents[1] / 'examples'
_BLUE, _RED, _GREEN = '#0060a8', '#a83200', '#00785a'
Names = dict[str, Any]


def gallery_markdown(folder: Path) -> str:
    """Return the sections of all scripts and notebooks; write their pictures into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    sections = [_script_section(path, folder) for path in sorted(_EXAMPLES.glob('*.py'))]
    sections += [_notebook_section(path, folder) for path in sorted(_EXAMPLES.glob('*.ipynb'))]
    return '\n'.join(sections)


def _script_section(path: Path, folder: Path) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        names = runpy.run_path(str(path))
    title, _, description = names['__doc__'].strip().partition('\n')[0].partition(': ')
    lines = [f'## {title}', '', description, '']
    if draw := _PICTURES.get(path.stem):
        figure = Figure(figsize=(7.5, 3.2), layout='constrained')
        draw(figure.add_subplot(), names)
        figure.savefig(folder / f'{path.stem}.svg')
        lines += [f'<img src="_gallery/{path.stem}.svg" alt="{title}">', '']
    code = path.read_text('utf-8').split('"""', 2)[2].strip()
    lines += ['```text', out.getvalue().strip(), '```', '', '```python', code, '```', '']
    return '\n'.join(lines)


def _notebook_section(path: Path, folder: Path) -> str:
    """Return the cells of a notebook with their stored outputs, and a link to the file."""
    shutil.copy(path, folder)
    lines = []
    for number, cell in enumerate(json.loads(path.read_text('utf-8'))['cells']):
        source = ''.join(cell['source'])
        if cell['cell_type'] == 'markdown':
            lines += [re.sub('^#', '##', source, flags=re.M), '']
            continue
        lines += ['```python', source, '```', '']
        for output in cell['outputs']:
            data = output.get('data', {'text/plain': output.get('text', '')})
            if 'image/png' in data:
                name = f'{path.stem}_{number}.png'
                (folder / name).write_bytes(base64.b64decode(data['image/png']))
                lines += [f'<img src="_gallery/{name}" alt="Output of the code above">', '']
            else:
                lines += ['```text', ''.join(data['text/plain']).strip(), '```', '']
    link = f'<a href="_gallery/{path.name}" download>Download this notebook</a>'
    return '\n'.join([lines[0], '', link, '', *lines[1:]])


def _plot_band(
    axis: Axes, t: Any, value: Any, sigma: Any, *, label: str, color: str = _BLUE
) -> None:
    axis.fill_between(t, value - 2 * sigma, value + 2 * sigma, color=color, alpha=0.3, linewidth=0)
    axis.plot(t, value, color=color, linewidth=1, label=label)
    axis.set_xlabel('t (s)')


def _draw_against_theory(axis: Axes, names: Names) -> None:
    motion, exact = names['motion'], names['exact']
    for body, color in (('coupler', _BLUE), ('rocker', _GREEN)):
        error = motion[body].angular_velocity - exact[body].angle[1]
        sigma = motion[body].angular_velocity_sigma
        _plot_band(axis, motion.t, error, sigma, label=body, color=color)
    axis.axhline(0, color='black', linewidth=0.6)
    axis.set(ylabel='error of ω, with 2σ (rad/s)', ylim=(-0.1, 0.1))
    axis.legend()


def _draw_centrodes(axis: Axes, names: Names) -> None:
    axis.plot(*names['fixed'].T, color=_BLUE, label='fixed centrode')
    # The moving centrode is in the frame of the wheel; draw it above the fixed one.
    moving = names['moving'] + 1j * 0.25
    axis.plot(moving.real, moving.imag, color=_RED, label='moving centrode, in the wheel')
    axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal', xlim=(-0.3, 1.2))
    axis.legend(loc='upper right')


def _draw_relative_motion(axis: Axes, names: Names) -> None:
    for (j, i), color in ((('coupler', 'crank'), _BLUE), (('rocker', 'coupler'), _GREEN)):
        centers = names['motion'].pairs[j, i].icr
        axis.plot(*centers.T, '.', color=color, markersize=3, label=f'{j} relative to {i}')
    axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal', xlim=(-0.2, 0.9), ylim=(-0.15, 0.35))
    axis.legend(loc='upper right')


def _draw_replay_bag(axis: Axes, names: Names) -> None:
    body, t = names['coupler'], names['motion'].t
    sigma = body.angular_acceleration_sigma
    _plot_band(axis, t, body.angular_acceleration, sigma, label='coupler')
    axis.set_ylabel('α, with 2σ (rad/s²)')


def _draw_track_array(axis: Axes, names: Names) -> None:
    body, t = names['body'], names['motion'].t
    sigma = body.angular_velocity_sigma
    _plot_band(axis, t, body.angular_velocity, sigma, label='measured, with 2σ')
    axis.plot(t, names['exact'], color='black', linewidth=0.6, label='exact')
    axis.set_ylabel('ω (rad/s)')
    axis.legend(loc='upper right')


_PICTURES: dict[str, Callable[[Axes, Names], None]] = {
    'against_theory': _draw_against_theory,
    'centrodes': _draw_centrodes,
    'relative_motion': _draw_relative_motion,
    'replay_bag': _draw_replay_bag,
    'track_array': _draw_track_array,
}
