"""`kinpole solve --animate`: frames that are the motion, in the formats that can be written."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from kinpole_ros.mechanism import load_scene, scene_names
from kinpole_ros.tools import cli
from kinpole_ros.tools.solve import _animation
from kinpole_ros.tools.solve._solution import SolvedScene, over_full_motion, point_motions

SVG = '{http://www.w3.org/2000/svg}'


def values_of(element: ET.Element) -> list[str]:
    return element.attrib['values'].split(';')


def drawn_points(file: Path, motion: SolvedScene) -> dict[str, np.ndarray]:
    """Named points over all frames, px, as the groups of the bodies move them."""
    found = {}
    for group in ET.parse(file).getroot().iter(f'{SVG}g'):
        moves = {one.attrib['type']: one for one in group.iter(f'{SVG}animateTransform')}
        if not moves:
            continue
        shift = np.array([complex(*map(float, v.split())) for v in values_of(moves['translate'])])
        turn = np.exp(1j * np.radians([float(v) for v in values_of(moves['rotate'])]))
        assert moves['rotate'].attrib['additive'] == 'sum'
        for dot in group.iter(f'{SVG}circle'):
            at = complex(float(dot.attrib['cx']), float(dot.attrib['cy']))
            found[dot[0].text or ''] = shift + turn * at
    return found


@pytest.mark.parametrize('name', scene_names())
def test_the_points_of_an_animation_move_as_those_of_the_scene(name: str, tmp_path: Path) -> None:
    file = tmp_path / 'a.svg'
    motion = over_full_motion(load_scene(name), 361)
    about = _animation.write_animation(file, 'svg', motion)
    found = drawn_points(file, motion)
    frames = _animation._frames(motion, 121)
    if motion.limits != (None, None):
        frames = frames.at([*range(121), *range(119, 0, -1)])
    panel = _animation._panel(motion)
    exact = point_motions(frames)
    assert found.keys() == exact.keys()
    assert about.startswith(f'{frames.inputs.shape[1]} frames in ')
    for point, path in found.items():
        np.testing.assert_allclose(path, panel.pixels(exact[point][0]), atol=0.03)
    # Springs, cylinders, belts and vectors are moved point by point.
    lines = ET.parse(file).getroot().iter(f'{SVG}animate')
    counts = {len(values_of(line)) for line in lines}
    assert counts <= {frames.inputs.shape[1]}
    has_spans = name in ('pool_lift', 'bike_suspension', 'slider_crank') or name.startswith(
        'loader_'
    )
    assert bool(counts) == has_spans


def test_an_animation_ends_where_it_began(tmp_path: Path) -> None:
    """A crank goes around; a cylinder goes back from its limit."""
    for name in ('four_bar', 'pool_lift'):
        motion = over_full_motion(load_scene(name), 361)
        _animation.write_animation(tmp_path / 'a.svg', 'svg', motion)
        for path in drawn_points(tmp_path / 'a.svg', motion).values():
            steps = np.abs(np.diff(np.append(path, path[0])))
            assert steps[-1] <= 1.01 * max(steps[0], steps[-2]) + 0.03


def test_the_command_writes_an_svg_that_needs_no_script(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'four_bar.svg'
    assert cli.main(['solve', 'four_bar', '--animate', str(file)]) == 0
    assert f'written to {file}: 121 frames in 2 s, for 1 s of motion' in capsys.readouterr().out
    text = file.read_text(encoding='utf-8')
    assert '<script' not in text
    assert not re.search(r'(href|src|url)', text)


def test_the_command_writes_a_gif(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = pytest.importorskip('PIL.Image')
    pytest.importorskip('matplotlib')
    file = tmp_path / 'gears.gif'
    words = ['solve', 'double_pendulum', '--time', '0.4', '--animate', str(file)]
    assert cli.main(words) == 0
    assert '51 frames in 2 s, for 0.4 s of motion' in capsys.readouterr().out
    assert [*tmp_path.iterdir()] == [file]
    with image.open(file) as film:
        assert (film.n_frames, film.size, film.info['duration']) == (51, (640, 560), 40)
        first = np.asarray(film.convert('L'), float)
        film.seek(25)
        assert np.abs(np.asarray(film.convert('L'), float) - first).max() > 100


@pytest.mark.parametrize(
    ('file', 'says'),
    [
        ('a.foo', 'is no animation; end its name in .gif, .mp4, .svg'),
        ('a', 'is no animation'),
        ('a.mp4', 'films need the program ffmpeg; install it, or write a .gif'),
    ],
)
def test_what_cannot_be_animated_is_refused_in_one_line(
    file: str,
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('PATH', '')
    assert cli.main(['solve', 'four_bar', '--animate', str(tmp_path / file)]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert len(err.splitlines()) == 1
    assert not [*tmp_path.iterdir()]
