"""The editor in the page of `kinpole solve --html`: its solver against ours, and its pointer."""

import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import data_of, options_of

from kinpole_ros.mechanism import load_scene, scene_names, scene_text
from kinpole_ros.tools.solve import solve_scene

SOLVER = Path(__file__).parents[3] / 'kinpole_ros' / 'tools' / 'report' / 'page' / 'solver.js'
NUMBER = r'-?\d+(?:\.\d+)?'
# Belts, a Geneva drive, a cam and a rack: all that no scene of the package has.
DRIVES = """bodies:
  ground: {O: [0, 0], W: [100 mm, 0], G: [-50 mm, 0], K: [0, 200 mm], R: [0, -100 mm]}
  crank: {O: [0, 0]}
  wheel: {W: [0, 0]}
  valve: {V: [0, 0]}
  pulley: {K: [0, 0]}
  load: {L: [0, 0]}
joints:
  - {geneva: wheel.W, on: crank.O, slots: 4}
  - {prismatic: valve.V, on: ground.G, along: 90 deg, name: lift}
  - {cam: pulley, moves: lift, angles: [0, 1, 2, 6.283185307179586], lift: [0, 1 cm, 1 cm, 0]}
  - {belt: [crank.O, pulley.K], radii: [2 cm, -5 cm], name: belt}
  - {prismatic: load.L, on: ground.R, along: -90 deg, name: drop}
  - {belt: [crank.O, load.L], radii: [1 cm, 0], length: 1, direction: -90 deg, name: rope}
drivers: [{drive: crank, rate: 1 rev/s, start: 10 deg}]
start: {drop: 90 cm}
"""


@pytest.fixture
def page(browser) -> Iterator[Any]:
    """A page without errors."""
    troubles: list[str] = []
    context = browser.new_context(viewport={'width': 1280, 'height': 800})
    page = context.new_page()
    page.on('console', lambda message: troubles.append(message.text))
    page.on('pageerror', lambda error: troubles.append(str(error)))
    yield page
    context.close()
    assert troubles == []


@pytest.fixture(scope='module')
def page_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """`page_of('four_bar')` is the page of that scene, made once."""
    folder = tmp_path_factory.mktemp('pages')

    @cache
    def made(source: str) -> Path:
        file = folder / f'{Path(source).stem}.html'
        solve_scene(options_of('solve', source, html=file))
        return file

    return made


def solved(page: Any, data: dict[str, Any], every: int = 1) -> np.ndarray:
    """All variables with four derivatives by the page's solver (T, 5, n); NaN where it is open."""
    code = (
        '([edit, times, every]) => {'
        + SOLVER.read_text()
        + """
        const found = times.map(() => null);
        const solver = makeSolver(edit, times);
        const take = (k) => { found[k] = solver.u.map((row) => [...row]); };
        if (!solver.solveAll(edit.at, take, () => {}, every))
          throw new Error('it does not close');
        return found;
    }"""
    )
    found = page.evaluate(code, [data['edit'], data['t'], every])
    none = [[np.nan] * data['edit']['size']] * 5
    return np.array([none if one is None else one for one in found], float)


def expected(source: str, data: dict[str, Any], found: np.ndarray) -> np.ndarray:
    """The same by ours, at the inputs of the page where it `found` that the loops close."""
    at = np.isfinite(found[:, 0, 0])
    scene = load_scene(source)
    drivers = len(scene.mechanism.drivers)
    ties = len(scene.mechanism.linkage.loops.ties)
    inputs = np.zeros((5, drivers, len(data['t'])))
    for k, parts in enumerate(data['edit']['inputs'][ties : ties + drivers]):
        for order, part in enumerate(parts):
            inputs[order, k] = 0.0 if part is None else part
    times = np.array(data['t'])[at]
    found = scene.mechanism.at_inputs(inputs[:, :, at], times)
    values = np.full((len(at), 5, len(scene.mechanism.start)), np.nan)
    # About change points rounding drowns the snap first.
    sound = np.convolve(found.sound < 5, np.ones(21), 'same') == 0
    values[np.flatnonzero(at)[sound]] = np.moveaxis(found.values, -1, 0)[sound]
    return values


def assert_alike(found: np.ndarray, ours: np.ndarray) -> None:
    """To 1e-9 of the largest, next to no limit or change point, where both lose digits."""
    size = np.abs(ours).max(axis=2)
    usual = (size <= 50 * np.nanmedian(size, axis=0)).all(axis=1)
    usual &= np.isfinite(found).all(axis=(1, 2))
    assert usual.mean() > 0.6
    for order in range(5):
        largest = max(1.0, float(np.nanmax(np.abs(ours[usual, order]))))
        off = np.abs(found[usual, order] - ours[usual, order]).max()
        assert off < 1e-9 * largest, (order, off, largest)


VECTORS = [name for name in scene_names() if 'vectors:' in scene_text(name)]


# The half turn of elliptic_gears ends at change points, where both lose digits.
@pytest.mark.parametrize(
    'name', [n for n in scene_names() if n not in (*VECTORS, 'elliptic_gears')]
)
def test_the_page_solves_every_scene_as_we_do(page, page_of, tmp_path: Path, name: str) -> None:
    data = data_of(page_of(name))
    found = solved(page, data)
    assert_alike(found, expected(name, data, found))


def test_the_page_solves_belts_cams_and_geneva_drives_as_we_do(
    page, page_of, tmp_path: Path
) -> None:
    source = tmp_path / 'drives.yaml'
    source.write_text(DRIVES)
    data = data_of(page_of(str(source)))
    assert data['edit']['fixed'] == ['K', 'L', 'O', 'W']
    found = solved(page, data)
    assert_alike(found, expected(str(source), data, found))


def handles(page: Any) -> list[tuple[int, int]]:
    """The middles of the red squares on the stage, CSS pixels."""
    code = """() => {
      const canvas = document.querySelectorAll('#stage canvas')[1];
      const { width, height } = canvas;
      const context = new OffscreenCanvas(width, height)
        .getContext('2d', { willReadFrequently: true });
      context.drawImage(canvas, 0, 0);
      const { data } = context.getImageData(0, 0, width, height);
      const red = (x, y) => {
        const at = 4 * (y * width + x);
        return data[at] > 150 && data[at + 1] < 90 && data[at + 2] < 110 && data[at + 3] > 150;
      };
      const edge = [[-7, -7], [-7, 0], [-7, 7], [0, -7], [0, 7], [7, -7], [7, 0], [7, 7]];
      const found = [];
      for (let y = 8; y < height - 8; y++) {
        for (let x = 8; x < width - 8; x++) {
          const near = found.some(([a, b]) => Math.hypot(a - x, b - y) < 6);
          if (!near && edge.every(([a, b]) => red(x + a, y + b))) found.push([x, y]);
        }
      }
      return found;
    }"""
    found: list[tuple[int, int]] = page.evaluate(code)
    return found


def drawn(page: Any) -> None:
    """Wait until all is drawn that was asked for."""
    page.evaluate('new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))')


def saved(page: Any, file: Path) -> str:
    with page.expect_download() as download:
        page.click('#save')
    download.value.save_as(file)
    return file.read_text(encoding='utf-8')


def cells(page: Any) -> list[str]:
    found: list[str] = page.locator('#values tbody').first.locator('td').all_inner_texts()
    return [text.replace('−', '-') for text in found]


def drag(page: Any, at: tuple[int, int], by: tuple[int, int]) -> None:
    box = page.locator('#stage').bounding_box()
    left, top = box['x'] + at[0], box['y'] + at[1]
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move(left + by[0], top + by[1], steps=5)
    page.mouse.up()
    drawn(page)


def edited(page: Any, file: Path, instant: float) -> None:
    page.goto(f'{file.as_uri()}#t={instant}')
    page.wait_for_selector('html[data-ready]')
    page.click('#edit')
    drawn(page)


@pytest.mark.parametrize('name', ['four_bar', 'eight_bar', 'slider_crank'])
def test_a_dragged_point_changes_rates_poles_and_centrodes_and_is_saved(
    page, page_of, tmp_path: Path, name: str
) -> None:
    file = page_of(name)
    data = data_of(file)
    k = len(data['t']) // 3
    edited(page, file, data['t'][k])
    before, text = cells(page), scene_text(name)
    picture = page.locator('#stage canvas').first.screenshot()
    assert saved(page, tmp_path / 'same.yaml') == text
    # The point that is highest in the picture, a little aside.
    drag(page, handles(page)[0], (9, 6))
    assert cells(page) != before
    assert page.locator('#stage canvas').first.screenshot() != picture
    new = saved(page, tmp_path / 'moved.yaml')
    changed = [line for line in new.splitlines() if line not in text.splitlines()]
    assert changed and any('start:' in line for line in changed)
    # What is shown is what the saved scene does there.
    scene = load_scene(tmp_path / 'moved.yaml')
    at = data['edit']['inputs'][0][0][k]
    rates = scene.mechanism.sweep(np.array([at])).angle[1, :, 0]
    drives = data['edit']['inputs'][0][1][k]
    for text_shown, rate in zip(cells(page), rates * drives, strict=False):
        assert float(text_shown) == pytest.approx(rate, rel=2e-3, abs=1e-3)
    page.click('#undo')
    drawn(page)
    for again, once in zip(cells(page), before, strict=True):
        # What a page comes with is rounded to five digits.
        numbers = [[float(x) for x in re.findall(NUMBER, words)] for words in (again, once)]
        assert numbers[0] == pytest.approx(numbers[1], rel=2e-3, abs=1e-3)
    assert saved(page, tmp_path / 'undone.yaml') == text
    assert page.locator('#undo').is_disabled()


def test_the_saved_scene_moves_as_the_page_has_it(page, page_of, tmp_path: Path) -> None:
    file = page_of('eight_bar')
    data = data_of(file)
    edited(page, file, data['t'][180])
    for way in ((12, 4), (-5, 9), (3, -8)):
        drag(page, handles(page)[2], way)
    saved(page, tmp_path / 'moved.yaml')
    scene = load_scene(tmp_path / 'moved.yaml')
    for point in data['edit']['points']:
        body = [*scene.mechanism.bodies, 'ground'][min(point[0], len(scene.mechanism.bodies))]
        place = scene.points[f'{body}.{point[1]}'][1]
        point[2:4] = place.real, place.imag
    names = scene.mechanism.assembly.loops.variables
    data['edit']['values'] = [
        float(scene.mechanism.sweep(np.array([at])).values[0, names.index(name), 0])
        for at in [data['edit']['inputs'][0][0][data['edit']['at']]]
        for name in names
    ]
    found = solved(page, data)
    assert_alike(found, expected(str(tmp_path / 'moved.yaml'), data, found))
    # While a point is dragged two of three instants follow from derivatives.
    rough = solved(page, data, every=3)
    off = np.abs(rough[:, 0] - found[:, 0])
    assert np.quantile(off[np.isfinite(off)], 0.9) < 1e-4


def test_a_point_stays_where_the_loops_would_not_close(page, page_of, tmp_path: Path) -> None:
    file = page_of('slider_crank')
    data = data_of(file)
    edited(page, file, data['t'][100])
    before = saved(page, tmp_path / 'before.yaml')
    # The piston, far off its line: beyond the reach of crank and rod.
    right = max(handles(page))
    drag(page, right, (-20, 390))
    assert 'do not close' in page.locator('#state').inner_text()
    page.click('#undo')
    drawn(page)
    assert saved(page, tmp_path / 'after.yaml') == before


def test_hubs_of_wheels_stay(page, page_of, tmp_path: Path) -> None:
    source = tmp_path / 'drives.yaml'
    source.write_text(DRIVES)
    file = page_of(str(source))
    data = data_of(file)
    assert data['edit']['fixed'] == ['K', 'L', 'O', 'W']
    edited(page, file, 0.3)
    page.mouse.move(0, 0)
    assert page.locator('#edit').get_attribute('aria-pressed') == 'true'
    # The valve and its guide are next to each other.
    assert len(handles(page)) in (2, 3)


def test_scenes_of_vectors_and_reports_have_no_editor(page, page_of, tmp_path: Path) -> None:
    file = page_of(VECTORS[0])
    data = data_of(file)
    assert 'edit' not in data
    page.goto(file.as_uri())
    page.wait_for_selector('html[data-ready]')
    assert page.locator('#edit').is_hidden()
    assert 'makeSolver' not in file.read_text()


def test_belts_are_drawn_between_their_wheels(page, page_of, tmp_path: Path) -> None:
    source = tmp_path / 'drives.yaml'
    source.write_text(DRIVES)
    file = page_of(str(source))
    data = data_of(file)
    belt, rope = data['belts']
    assert belt['closed'] and not rope['closed']
    assert [end['radius'] for end in (*belt['ends'], *rope['ends'])] == [0.02, -0.05, 0.01, 0.0]
    page.goto(file.as_uri())
    page.wait_for_selector('html[data-ready]')
    with_belts = page.locator('#stage canvas').nth(1).screenshot()
    page.get_by_role('button', name='bodies', exact=True).click()
    drawn(page)
    assert page.locator('#stage canvas').nth(1).screenshot() != with_belts
