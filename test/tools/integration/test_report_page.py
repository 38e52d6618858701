"""A browser shows the figures of a report, and its reader moves through them."""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, bodies_of
from pages import BLUE, GREEN, RED, cell, colored, drawn

from kinpole_ros import planar
from kinpole_ros.bags import (
    simulate,
)
from kinpole_ros.mechanism import load_scene
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.report import _record_page, report


@pytest.fixture(scope='module')
def long(tmp_path_factory) -> Path:
    """The report of seven bodies that swing 15 times in 30 s."""
    folder = tmp_path_factory.mktemp('long')
    bag, output = folder / 'eight.mcap', folder / 'eight.html'
    simulate(load_scene('eight_bar'), bag, rate=25.0, duration=30.0, noise=1e-4)
    report(bag, output, Settings(derivative_order=1, bodies=bodies_of('eight_bar')))
    return output


@pytest.fixture
def opened(browser, four_bar_page) -> Iterator[Any]:
    """`opened(width, height)` is a page with the report at 1.1 s; no error, no request."""
    troubles: list[str] = []
    contexts = []

    def open_page(
        width: int = 1280,
        height: int = 800,
        at: str = '#t=1.1',
        file: Path = four_bar_page,
        **more: Any,
    ) -> Any:
        context = browser.new_context(viewport={'width': width, 'height': height}, **more)
        contexts.append(context)
        page = context.new_page()
        page.on('console', lambda message: troubles.append(message.text))
        page.on('pageerror', lambda error: troubles.append(str(error)))
        page.on('request', lambda request: troubles.append(request.url))
        page.goto(file.as_uri() + at)
        page.wait_for_selector('html[data-ready]')
        drawn(page)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [text for text in troubles if not text.startswith('file://')] == []


def test_page_shows_the_linkage_its_curves_and_the_figures_at_the_cursor(opened) -> None:
    page = opened()
    assert page.locator('h1').inner_text() == 'four_bar.mcap'
    assert page.locator('#clock').inner_text() == 't = 1.100 s'
    for color in (BLUE, RED, GREEN):
        assert colored(page, '#stage canvas', color) > 100
        assert colored(page, '[data-name=angular_velocity] canvas', color) > 40
    # All of the first chart and the stage are on the first screen.
    for selector in ('#stage', '#transport', '.chart[data-name=angular_velocity]'):
        box = page.locator(selector).bounding_box()
        assert box['y'] + box['height'] <= 800, selector
    value, spread = cell(page, 'angular_velocity', 0).split('±')
    assert abs(float(value) - 2 * np.pi) < float(spread) < 0.1
    assert cell(page, 'icr', 2) == 'no rotation'
    assert cell(page, 'centrode_curvature', 0) == 'pinned: the ICR stands still'
    assert '1.8% lost in its noise' in page.locator('#withheld').inner_text()
    strips = page.locator('[data-name=withheld]')
    strips.scroll_into_view_if_needed()
    assert 'pinned: the ICR stands still' in strips.inner_text()
    assert 'at infinity: the inflection circle is a line' in strips.inner_text()
    # Two whole strips, of the crank and nearly of the rocker, each of curvature and circle.
    width = strips.bounding_box()['width'] - 58 - 92
    pinned = colored(page, '[data-name=withheld] canvas', '#98a1aa') / (13 * width)
    assert 3.8 < pinned <= 4


def test_charts_of_a_long_run_open_at_as_much_time_as_can_be_read(opened, long) -> None:
    """Twelve swings, about the cursor; all of the time is a key away."""
    page = opened(file=long)
    assert re.fullmatch(r'0\.0 to 2[34]\.\d of 30\.0 s; .*', page.locator('#range').inner_text())
    page.locator('#scrub').fill('1400')
    drawn(page)
    assert re.fullmatch(r'\d\.\d to 30\.0 of 30\.0 s; .*', page.locator('#range').inner_text())
    page.locator('#fit').click()
    assert page.locator('#range').inner_text() == ''
    assert opened().locator('#range').inner_text() == ''


@pytest.mark.parametrize('width', [1280, 390])
def test_a_table_that_is_cut_says_so(opened, long, width) -> None:
    hint = opened(width, file=long).locator('#values .cut')
    assert hint.is_visible()
    assert 'scroll' in hint.inner_text()
    assert opened(1280).locator('#values .cut').is_hidden()


def test_names_at_the_ends_of_lines_keep_off_the_numbers_of_the_time_axis(opened, long) -> None:
    page = opened(file=long)
    # Pixels right of the lines and beside the numbers that are not gray, as only names are.
    code = """() => {
      const canvas = document.querySelector('[data-name=angular_velocity] canvas');
      const scale = canvas.width / canvas.clientWidth;
      const [left, top] = [canvas.clientWidth - 90, canvas.clientHeight - 14].map((v) => v * scale);
      const { data } = canvas.getContext('2d').getImageData(
        left, top, canvas.width - left, canvas.height - top);
      let colored = 0;
      for (let k = 0; k < data.length; k += 4) {
        const part = [data[k], data[k + 1], data[k + 2]];
        if (data[k + 3] > 100 && Math.max(...part) - Math.min(...part) > 60) colored++;
      }
      return colored;
    }"""
    assert page.evaluate(code) == 0


def test_keys_buttons_slider_and_chart_move_one_cursor(opened) -> None:
    page = opened()
    clock = page.locator('#clock')
    before = page.locator('#stage canvas').nth(1).screenshot()
    for keys, expected in (
        ('ArrowRight', 't = 1.110 s'),
        ('Shift+ArrowRight', 't = 1.210 s'),
        ('ArrowLeft', 't = 1.200 s'),
        ('End', 't = 3.990 s'),
        ('Home', 't = 0.000 s'),
    ):
        page.keyboard.press(keys)
        drawn(page)
        assert clock.inner_text() == expected
    assert page.locator('#stage canvas').nth(1).screenshot() != before
    page.locator('#next').click()
    page.locator('#scrub').evaluate("e => { e.value = 200; e.dispatchEvent(new Event('input')); }")
    drawn(page)
    assert clock.inner_text() == 't = 2.000 s'
    plot = page.locator('[data-name=angular_velocity] .plot').bounding_box()
    # In the middle of the time axis.
    page.mouse.click(plot['x'] + 58 + (plot['width'] - 58 - 92) / 2, plot['y'] + 40)
    drawn(page)
    assert clock.inner_text() in ('t = 1.990 s', 't = 2.000 s')
    page.locator('#play').focus()
    page.keyboard.press(' ')
    page.locator('#clock', has_text=re.compile('t = 2.[1-9]')).wait_for()
    page.keyboard.press(' ')
    assert page.locator('#play').inner_text() == 'play'


def test_bodies_and_layers_are_hidden_and_shown(opened) -> None:
    page = opened()
    page.keyboard.press('2')
    drawn(page)
    assert colored(page, '#stage canvas', RED) == 0
    assert colored(page, '[data-name=angular_velocity] canvas', RED) == 0
    assert page.locator('#bodies button').nth(1).get_attribute('aria-pressed') == 'false'
    page.keyboard.press('2')
    for layer in ('bodies', 'velocities', 'names', 'ICR', 'IAP', 'moving centrode'):
        page.locator('#layers button', has_text=layer).first.click()
    drawn(page)
    assert colored(page, '#stage canvas', BLUE) == 0
    assert colored(page, '[data-name=angular_velocity] canvas', RED) > 100


def test_wheel_drag_and_buttons_come_closer_and_fit_goes_back(opened) -> None:
    page = opened()
    stage, chart = (page.locator(f'{name} canvas').first for name in ('#stage', '.chart'))

    def pictures() -> tuple[str, str]:
        drawn(page)
        first, second = (one.evaluate('e => e.toDataURL()') for one in (stage, chart))
        return first, second

    seen = [pictures()]
    box = page.locator('#stage').bounding_box()
    page.mouse.move(box['x'] + 200, box['y'] + 200)
    page.mouse.wheel(0, -300)
    seen.append(pictures())
    page.mouse.down()
    page.mouse.move(box['x'] + 260, box['y'] + 230)
    page.mouse.up()
    seen.append(pictures())
    page.locator('#reduce').click()
    seen.append(pictures())
    pairs = itertools.pairwise(seen)
    assert all(one[0] != other[0] and one[1] == other[1] for one, other in pairs)
    page.locator('#zoom-in').click()
    assert pictures()[1] != seen[0][1]
    page.keyboard.press('f')
    assert pictures() == seen[0]


def test_first_screen_of_a_telephone_has_the_linkage_and_figures_and_taps_work(opened) -> None:
    page = opened(390, 844, has_touch=True, is_mobile=True)
    assert page.evaluate('document.documentElement.scrollWidth') == 390
    heading = page.locator('#values thead').first
    box = heading.bounding_box()
    assert box['y'] + box['height'] < 844
    chart = page.locator('[data-name=angular_acceleration] .plot')
    chart.scroll_into_view_if_needed()
    plot = chart.bounding_box()
    page.touchscreen.tap(plot['x'] + plot['width'] - 93, plot['y'] + 40)
    drawn(page)
    assert page.locator('#clock').inner_text() > 't = 3.8'


def test_motion_starts_by_itself_unless_the_reader_asked_for_rest(opened) -> None:
    page = opened(at='')
    page.locator('#clock', has_text=re.compile(r't = (0\.[1-9]|[1-3])')).wait_for()
    assert page.locator('#play').inner_text() == 'pause'
    resting = opened(at='', reduced_motion='reduce')
    assert resting.locator('#play').inner_text() == 'play'


def test_print_holds_all_charts_and_no_buttons(opened) -> None:
    page = opened()
    page.emulate_media(media='print')
    drawn(page)
    assert not page.locator('#transport').is_visible()
    charts = page.locator('.chart')
    names = [charts.nth(k).get_attribute('data-name') for k in range(charts.count())]
    assert names.pop() == 'withheld'
    assert len(names) == 8
    for name in names:
        curves = sum(colored(page, f'[data-name={name}] canvas', c) for c in (RED, '#56a0d0'))
        assert curves > 50, name
    # Twice as fine as on the screen.
    canvas = page.locator('.chart canvas').first
    assert canvas.evaluate('e => e.width / e.getBoundingClientRect().width') > 1.9
    assert page.pdf(format='A4').startswith(b'%PDF')


def test_polygons_show_the_images_of_the_bodies_shown(opened) -> None:
    page = opened()
    canvases = page.locator('#polygons canvas')
    assert canvases.count() == 2
    before = [canvases.nth(k).screenshot() for k in (0, 1)]
    assert colored(page, '#polygons canvas', BLUE) > 50
    page.keyboard.press('Shift+ArrowRight')
    drawn(page)
    assert all(canvases.nth(k).screenshot() != before[k] for k in (0, 1))
    page.keyboard.press('1')
    drawn(page)
    assert colored(page, '#polygons canvas', BLUE) == 0


def test_images_of_points_are_their_velocities_and_accelerations(opened) -> None:
    """What the page's script makes of poles and rates, against the motion itself."""
    page = opened()
    scene = load_scene('four_bar')
    motion, point = scene.motion(0.3)['coupler'], 0.1 + 0.15j
    iap = planar.pole(2, motion.position, motion.angle).value
    z = motion.position
    body = {
        'points': [['P', point.real, point.imag]],
        'angle': [motion.angle[0]],
        **{name: [value] for name, value in zip('xy', (z[0].real, z[0].imag), strict=True)},
        **{name: [value] for name, value in zip(('vx', 'vy'), (z[1].real, z[1].imag), strict=True)},
        'angular_velocity': {'value': [motion.angle[1]]},
        'angular_acceleration': {'value': [motion.angle[2]]},
        'iap': {'x': [float(iap.real)], 'y': [float(iap.imag)]},
    }
    folder = Path(_record_page.__file__).parent / 'page'
    code = '\n'.join((folder / f'{name}.js').read_text() for name in ('data', 'motion', 'polygons'))
    found = page.evaluate(
        f'([body, orders]) => {{ {code}; return orders.map((n) => imagesOf(null, body, 0, n)); }}',
        [body, [1, 2]],
    )
    turn = np.exp(1j * motion.angle[0])
    w, alpha = motion.angle[1:3]
    for (image,), truth in zip(
        found,
        (z[1] + 1j * w * point * turn, z[2] + (1j * alpha - w**2) * point * turn),
        strict=True,
    ):
        assert image[0] == 'P'
        assert complex(*image[1:]) == pytest.approx(complex(truth), rel=1e-9)


def test_curvature_layers_draw_and_the_pointer_shows_its_path(opened) -> None:
    page = opened()
    for name in ('crank', 'rocker'):
        page.locator('#bodies button', has_text=name).click()
    for layer in ('bodies', 'tracks', 'fixed centrode', 'moving centrode', 'velocities'):
        page.locator('#layers button', has_text=layer).first.click()
    drawn(page)
    for layer in ('inflection circle', 'cubic'):
        button = page.locator('#layers button', has_text=layer)
        assert button.get_attribute('aria-pressed') == 'false'
        before = colored(page, '#stage canvas', RED)
        button.click()
        drawn(page)
        assert colored(page, '#stage canvas', RED) > before + 50, layer
    box = page.locator('#stage').bounding_box()
    before = colored(page, '#stage canvas', '#1c2127')
    page.mouse.move(box['x'] + 0.4 * box['width'], box['y'] + 0.4 * box['height'])
    drawn(page)
    assert colored(page, '#stage canvas', '#1c2127') > before + 100
    page.mouse.move(box['x'] - 5, box['y'] - 5)
    drawn(page)
    assert colored(page, '#stage canvas', '#1c2127') <= before
    value, spread = cell(page, 'inflection_diameter', 1).split('±')
    assert float(value) > 0 and float(spread) > 0
    assert cell(page, 'inflection_diameter', 0) == 'pinned: the ICR stands still'


def test_circle_of_a_path_and_the_cubic_are_those_of_the_theory(opened) -> None:
    """What the page's script makes of the ICR and Ball's point, of a body that turns either way."""
    page = opened()
    folder = Path(_record_page.__file__).parent / 'page'
    scripts = ('data', 'drawing', 'motion', 'curvature')
    code = '\n'.join((folder / f'{name}.js').read_text() for name in scripts)
    for time in (0.1, 0.6):
        motion = load_scene('four_bar').motion(time)['coupler']
        position, angle = motion.position, motion.angle
        icr, u, du = (
            planar.to_plane(one.value)
            for one in (
                planar.pole(1, position, angle),
                planar.icr_velocity(position, angle),
                planar.icr_acceleration(position, angle),
            )
        )
        about = angle[1], angle[2], icr, u, du
        ball, circle = planar.ball_point(*about), planar.inflection_circle(angle[1], icr, u)
        curvature = planar.centrode_curvature(position, angle).value.real
        body = {
            'angular_velocity': {'value': [float(angle[1])]},
            'icr': {'x': [icr[0]], 'y': [icr[1]]},
            'icr_velocity': {'x': [u[0]], 'y': [u[1]], 'value': [float(np.linalg.norm(u))]},
            'inflection_diameter': {'value': [float(circle.diameter)]},
            'ball_point': {'x': [ball[0]], 'y': [ball[1]]},
            'centrode_curvature': {'value': [float(curvature)]},
        }
        point = [0.2, 0.1]
        path, cubic = page.evaluate(
            f'([body, point]) => {{ {code}; '
            'return [pathAt(body, 0, point), cubicAt(body, 0, poleMotion(body, 0))]; }',
            [body, point],
        )
        expected = planar.path_curvature(point, angle[1], icr, u)
        assert path['radius'] == pytest.approx(1 / expected.curvature, rel=1e-9)
        assert path['center'] == pytest.approx(expected.center, rel=1e-9)
        theory = planar.stationary_curvature(*about)
        assert cubic == pytest.approx([theory.over_m, theory.over_n], rel=1e-9)


def test_page_shows_lost_frames_apart_from_undetermined_ones(opened, gappy_bag, tmp_path) -> None:
    output = tmp_path / 'gap.html'
    report(gappy_bag, output, load_settings(ROOT / 'config' / 'four_bar.yaml'))
    page = opened(file=output, at='#t=1.8')
    assert '171 frames lost' in page.text_content('body')
    assert {cell(page, name, 1) for name in ('angular_velocity', 'icr')} == {
        'lost: no result of these frames'
    }
    # Of the frames that are there, all have a pose.
    shares = page.locator('td', has_text='100%')
    assert shares.count() >= 3
    assert page.locator('figure[data-name=withheld] .unit', has_text='lost: no result').count() == 1
