"""The gallery: what each script of examples/ prints, and a picture of what it computes."""

import contextlib
import io
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

COMMENT = '<!-- every example -->'
_EXAMPLES = Path(__file__).parents[1] / 'examples'
_BLUE, _RED, _GREEN = '#0060a8', '#a83200', '#00785a'


def every_example(folder: Path) -> str:
    """A section for each script, as Markdown; the pictures are written into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    return '\n'.join(_section(path, folder) for path in sorted(_EXAMPLES.glob('*.py')))


def _section(path: Path, folder: Path) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        found = runpy.run_path(str(path))
    title, _, what = found['__doc__'].strip().partition('\n')[0].partition(':')
    lines = [f'## {title}', '', f'{what.strip()}', '']
    if draw := _DRAWN.get(path.stem):
        figure = Figure(figsize=(7.5, 3.2), layout='constrained')
        draw(figure.add_subplot(), found)
        figure.savefig(folder / f'{path.stem}.svg')
        lines += [f'<img src="_gallery/{path.stem}.svg" alt="{title}">', '']
    lines += ['```text', out.getvalue().strip(), '```', '']
    code = path.read_text('utf-8').split('"""', 2)[2]
    return '\n'.join([*lines, '```python', code.strip(), '```', ''])


def _band(axis: Any, t: Any, value: Any, sigma: Any, name: str, color: str) -> None:
    axis.fill_between(t, value - 2 * sigma, value + 2 * sigma, color=color, alpha=0.3, linewidth=0)
    axis.plot(t, value, color=color, linewidth=1, label=name)
    axis.set_xlabel('t (s)')


def _against_theory(axis: Any, found: dict[str, Any]) -> None:
    motion, exact = found['motion'], found['exact']
    for name, color in (('coupler', _BLUE), ('rocker', _GREEN)):
        off = motion[name].angular_velocity - exact[name].angle[1]
        _band(axis, motion.t, off, motion[name].angular_velocity_sigma, name, color)
    axis.axhline(0, color='black', linewidth=0.6)
    axis.set(ylabel='ω less theory, with 2σ (rad/s)', ylim=(-0.1, 0.1))
    axis.legend()


def _centrodes(axis: Any, found: dict[str, Any]) -> None:
    axis.plot(*found['fixed'].T, color=_BLUE, label='fixed centrode')
    moving = found['moving'] + 1j * 0.25
    axis.plot(moving.real, moving.imag, color=_RED, label='moving centrode, in the wheel')
    axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal', xlim=(-0.3, 1.2))
    axis.legend(loc='upper right')


def _relative_motion(axis: Any, found: dict[str, Any]) -> None:
    for (j, i), color in ((('coupler', 'crank'), _BLUE), (('rocker', 'coupler'), _GREEN)):
        centers = found['motion'].pairs[j, i].icr
        axis.plot(*centers.T, '.', color=color, markersize=3, label=f'{j} with respect to {i}')
    axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal', xlim=(-0.2, 0.9), ylim=(-0.15, 0.35))
    axis.legend(loc='upper right')


def _replay_bag(axis: Any, found: dict[str, Any]) -> None:
    body, t = found['coupler'], found['motion'].t
    _band(axis, t, body.angular_acceleration, body.angular_acceleration_sigma, 'coupler', _BLUE)
    axis.set_ylabel('α, with 2σ (rad/s²)')


def _track_array(axis: Any, found: dict[str, Any]) -> None:
    body, t = found['body'], found['motion'].t
    _band(axis, t, body.angular_velocity, body.angular_velocity_sigma, 'measured, with 2σ', _BLUE)
    axis.plot(t, found['truth'], color='black', linewidth=0.6, label='truth')
    axis.set_ylabel('ω (rad/s)')
    axis.legend(loc='upper right')


_DRAWN: dict[str, Callable[[Any, dict[str, Any]], None]] = {
    'against_theory': _against_theory,
    'centrodes': _centrodes,
    'relative_motion': _relative_motion,
    'replay_bag': _replay_bag,
    'track_array': _track_array,
}
