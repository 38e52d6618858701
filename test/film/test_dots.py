"""Dots without tags are followed to parts of a pixel, lost where hidden, and found again."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered import Camera, Film, Tag

from kinpole_ros import replay
from kinpole_ros.film import FilmError, FilmOptions, read_film
from kinpole_ros.film._dots import Dots
from kinpole_ros.mechanism import load_scene
from kinpole_ros.tools.cli import main

CAMERA = Camera((960, 540), 0.95, 0.15 + 0.1j, tilt=0.0)
PLACES = {
    'crank': (0.035 + 0j, 0.085 + 0j),
    'coupler': (0.07 + 0.1j, 0.25 + 0.03j),
    'rocker': (0.06 + 0j, 0.2 + 0j),
}
DOTS = tuple(
    Tag(-1 - k, body, center, size=0.02)
    for k, (body, center) in enumerate((body, at) for body, own in PLACES.items() for at in own)
)
HIDDEN = {-1: range(8, 14), -4: range(20, 26)}
NAMES = [f'{body}_{k}' for body in PLACES for k in (1, 2)]
FILM = Film(0.1 + np.arange(32) / 30, DOTS, CAMERA, hidden=HIDDEN)


def pixels(film: Film) -> np.ndarray:
    """The exact places (T, m, 2) of the middles of the dots."""
    return np.stack(
        [film.camera.pixels(place[0]) for place, _ in film.poses(film.times).values()], 1
    )


def clicked(film: Film) -> np.ndarray:
    """Where a user clicks (m, 2), up to two pixels beside the dots of the first picture."""
    return np.rint(pixels(film)[0] + np.random.default_rng(0).uniform(-2, 2, (len(NAMES), 2)))


@pytest.fixture(scope='module')
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return FILM.write(tmp_path_factory.mktemp('dots') / 'dots.mp4')


def words(film: Film) -> list[str]:
    """The options of the command line: dots, and the pins on the ground as scale."""
    places = [f'{x:.0f},{y:.0f}' for x, y in clicked(film)]
    bodies = [f'{body}={places[2 * k]} {places[2 * k + 1]}' for k, body in enumerate(PLACES)]
    (x, y), (u, v) = film.camera.pixels(np.array([0j, 0.4 + 0j]))
    return ['--points', '; '.join(bodies), '--scale', f'{x:.1f},{y:.1f} {u:.1f},{v:.1f}=400mm']


def test_dots_are_followed_and_hidden_ones_are_lost_and_found(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / 'dots.mcap'
    assert main(['film', str(video), *words(FILM), '--output', str(bag)]) == 0
    printed = capsys.readouterr().out
    assert 'dots: crank_1, crank_2, coupler_1, coupler_2, rocker_1, rocker_2, chosen' in printed
    assert 'the first end of --scale is the origin' in printed
    ends = tuple(CAMERA.pixels(np.array([0j, 0.4 + 0j])) @ (1, 1j))
    chosen = dict(zip(NAMES, clicked(FILM) @ (1, 1j), strict=True))
    filmed = read_film(video, FilmOptions(points=chosen, ruler=(*ends, 0.4)))
    assert filmed.names == NAMES
    exact = np.stack([place[0] for place, _ in FILM.poses(FILM.times).values()], axis=1)
    off = np.abs(filmed.places - exact) * CAMERA.size[0] / CAMERA.width
    assert np.nanmedian(off) < 0.15
    assert np.nanmax(off) < 0.7
    is_lost = np.isnan(off)
    for number, frames in HIDDEN.items():
        assert is_lost[list(frames), -number - 1].all()
    # A fast dot needs a picture or two to be found.
    assert is_lost.sum() <= 12 + 8
    parameters = {f'{body}.markers': [f'{body}_1', f'{body}_2'] for body in PLACES}
    result = replay(bag, bodies=list(PLACES), **parameters)
    motion = load_scene('four_bar').motion(result.t + FILM.times[0])['crank']
    error = result['crank'].angular_velocity / motion.angle[1] - 1
    assert np.nanmedian(np.abs(error)) < 0.02


def test_dots_are_chosen_in_a_later_picture_by_its_grid(video: Path, tmp_path: Path) -> None:
    shown = tmp_path / 'grid.png'
    assert main(['film', str(video), '--picture', str(shown), '--at', '0.5']) == 0
    assert cv2.imread(str(shown)).shape == (540, 960, 3)
    x, y = pixels(FILM)[15, 0]
    chosen = FilmOptions(points={'crank_1': x + 1j * y}, at=0.5, ruler=(0j, 96 + 0j, 0.095))
    place = read_film(video, chosen).dots['crank_1']
    assert np.isnan(place[:15]).all() and np.isfinite(place[15:20]).all()
    late = replace(chosen, at=9.0)
    with pytest.raises(FilmError, match=r'--at is 9 s, and .* ends before'):
        read_film(video, late)


def test_tags_on_the_ground_place_dots(tmp_path: Path) -> None:
    tilted = replace(CAMERA, tilt=12.0)
    ground = tuple(
        Tag(k, 'ground', at, size=0.05)
        for k, at in enumerate((-0.1 - 0.1j, 0.45 - 0.1j, 0.45 + 0.3j, -0.1 + 0.3j))
    )
    film = Film(0.1 + np.arange(5) / 30, (*ground, *DOTS), tilted)
    chosen = dict(zip(NAMES, pixels(film)[0, 4:] @ (1, 1j), strict=True))
    options = FilmOptions(size=0.05, ground=(0, 1), points=chosen)
    filmed = read_film(film.write(tmp_path / 'ground.mp4'), options)
    exact = [place[0] for place, _ in film.poses(film.times).values()][4:]
    found = np.stack(list(filmed.dots.values()), axis=1)
    assert np.nanmax(np.abs(found - np.stack(exact, axis=1) - 0.1 - 0.1j)) < 1e-3
    assert filmed.names[:2] == ['tag0_1', 'tag0_2'] and filmed.names[-6:] == NAMES


def moved(patch: np.ndarray, turn: float, place: tuple[float, float]) -> np.ndarray:
    """A picture with a patch, turned, at a place."""
    matrix = cv2.getRotationMatrix2D((20, 20), np.degrees(turn), 1)
    matrix[:, 2] += np.array(place) - 20
    picture = np.full((200, 320), 110, np.uint8)
    cv2.warpAffine(
        patch, matrix, (320, 200), picture, cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT
    )
    return picture


def test_a_place_beside_the_middle_of_what_turns_is_kept() -> None:
    """A bolt or a corner of paint has no middle, but shows its turn."""
    random = np.random.default_rng(4)
    patch = cv2.GaussianBlur(random.uniform(0, 255, (41, 41)), (0, 0), 2.5)
    patch = np.clip(110 + 4 * (patch - patch.mean()), 0, 255).astype(np.uint8)
    arm = 4 + 3j
    first = moved(patch, 0.0, (80, 80))
    dots = Dots(first, ['corner_1'], np.array([[80 + arm.real, 80 + arm.imag]]))
    for k in range(1, 25):
        turn, place = 0.15 * k, (80 + 4.0 * k, 80 + 1.0 * k)
        (found,) = dots.follow(moved(patch, turn, place))
        # A turn to the left in a picture, whose y points down.
        at = complex(*place) + arm * np.exp(-1j * turn)
        assert abs(complex(*found) - at) < 0.25


def test_a_dot_that_looks_like_two_others_is_not_guessed() -> None:
    def picture(*places: tuple[int, int]) -> np.ndarray:
        gray = np.full((200, 320), 180, np.uint8)
        for place in places:
            cv2.circle(gray, place, 6, 40, -1, cv2.LINE_AA)
        return gray

    dots = Dots(picture((100, 100)), ['a_1'], np.array([[100.0, 100]]))
    assert np.isfinite(dots.follow(picture((103, 100)))).all()
    assert np.isnan(dots.follow(picture())).all()
    assert np.isnan(dots.follow(picture((90, 100), (112, 100)))).all()
    assert dots.follow(picture((112, 100)))[0] == pytest.approx([112, 100], abs=0.2)


@pytest.mark.parametrize(
    ('given', 'text'),
    [
        (['--points', 'crank=1,2 3'], "is not as 'crank=120,340 132,360; rod=250,90'"),
        (['--scale', '1,2=3'], "is not as '120,340 520,338=0.35'"),
        (['--scale', '1,2 1,2=3'], '--scale is for --points; it must be two places'),
        (['--points', 'a=2000,5', '--scale', '1,2 3,2=3'], 'a_1 is at 2000,5, and the picture is'),
        (['--points', 'a=20,500', '--scale', '1,2 3,2=3'], 'shows nothing that can be followed'),
        (
            ['--points', 'crank={}'],
            'shows no tag: none was found in 5 or more of its 32 pictures; fix: give --scale',
        ),
    ],
)
def test_what_cannot_be_followed_is_refused_in_one_line(
    given: list[str], text: str, video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x, y = pixels(FILM)[0, 0]
    output = tmp_path / 'x.mcap'
    try:
        status = main(
            ['film', str(video), '--output', str(output), *(g.format(f'{x},{y}') for g in given)]
        )
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert text in capsys.readouterr().err.splitlines()[-1]
    assert not output.exists()
