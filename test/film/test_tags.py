"""Tags of all families are found, and a line says which tags are seen and not used."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered import Camera, Film, bits

from kinpole_ros.film import FilmError, FilmOptions, LiveTags, print_sheet, read_film
from kinpole_ros.film._families import FAMILIES, largest, smallest
from kinpole_ros.film._film import gather
from kinpole_ros.film._placing import place_seen
from kinpole_ros.film._tags import TagFinder

HEIGHT, WIDTH, SIDE = 120, 160, 48  # pixels
MOVE = np.array([[0.96, -0.28], [0.28, 0.96]])


def picture(numbers: tuple[int, ...] = (0, 1, 2), family: str = '36h11') -> np.ndarray:
    """Return a picture in which a tag of each number is beside the other, turned and blurred."""
    code = [bits(k, FAMILIES[family]) for k in numbers]
    modules = len(code[0])
    scale = SIDE / (modules - 2)
    move = np.column_stack((scale * MOVE, (WIDTH / 2, HEIGHT / 2)))
    move[:, 2] -= move[:, :2] @ (modules / 2 - 0.5, modules / 2 - 0.5)
    fine = move * 4 + [[0, 0, 1.5], [0, 0, 1.5]]
    size = 4 * WIDTH, 4 * HEIGHT
    drawn = [
        cv2.warpAffine(one, fine, size, flags=cv2.INTER_NEAREST, borderValue=120) for one in code
    ]
    small = [cv2.resize(one, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for one in drawn]
    return np.rint(cv2.GaussianBlur(np.hstack(small), (0, 0), 0.7)).astype(np.uint8)


def found_in(shown: list[np.ndarray], family: str = 'auto') -> tuple[TagFinder, list]:
    finder = TagFinder(family)
    return finder, [finder.find(gray) for gray in shown]


@pytest.mark.parametrize(
    ('family', 'numbers'),
    [
        *((name, (0, 1, 29)) for name in ('36h11', '36h10', '25h9', '16h5', 'mip_36h12')),
        ('original', (0, 451, 952)),
        *((f'{n}x{n}_{size}', (0, 7, size - 1)) for n in (4, 5, 6, 7) for size in (50, 1000)),
    ],
)
def test_the_family_is_found_from_one_picture(family: str, numbers: tuple[int, ...]) -> None:
    finder, [(tags, _)] = found_in([picture(numbers, family)])
    assert (finder.name(tags), sorted(tags)) == (family, sorted(numbers))
    assert not any(finder.others.values())


def test_each_family_of_opencv_can_be_named() -> None:
    known = {getattr(cv2.aruco, name) for name in dir(cv2.aruco) if name.startswith('DICT_')}
    assert set(FAMILIES.values()) == known
    assert (largest('4x4_50'), largest('36h11'), largest('mip_36h12')) == (
        '4x4_1000',
        '36h11',
        'mip_36h12',
    )
    assert [smallest('6x6_1000', [3, last]) for last in (49, 50, 250)] == [
        '6x6_50',
        '6x6_100',
        '6x6_1000',
    ]


def test_white_tags_on_black_paper_are_read() -> None:
    gray = picture()
    black, [(tags, corners)] = found_in([gray])
    white, [(same, others)] = found_in([255 - gray])
    assert (black.is_inverse, white.is_inverse) == (False, True)
    assert white.name(same) == '36h11, white on black'
    assert sorted(tags) == [0, 1, 2]
    assert np.abs(corners - others[[same.index(tag) for tag in tags]]).max() < 0.02


def test_a_mirrored_film_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    mirrored = np.ascontiguousarray(picture()[:, ::-1])
    monkeypatch.setattr(Film, 'pictures', lambda _: iter([mirrored] * 6))
    film = Film(np.arange(6) / 30, camera=Camera(mirrored.shape[::-1]))
    path = film.write(tmp_path / 'mirrored.mp4')
    with pytest.raises(FilmError, match='shows tags of family 36h11 as in a mirror; fix: mirror'):
        read_film(path)


def test_a_live_camera_that_mirrors_is_named() -> None:
    live, mirrored = LiveTags(FilmOptions()), np.ascontiguousarray(picture()[:, ::-1])
    with pytest.raises(FilmError, match='the camera shows tags of family 36h11 as in a mirror'):
        for _ in range(60):
            live.find(mirrored)


def test_tags_that_are_seen_and_not_used_are_named() -> None:
    """A number that two links have, one that is seen in a few pictures, and another family."""
    wide = np.hstack((picture((0, 1, 2, 0)), picture((3, 4, 5), '5x5_100')))
    hidden = wide.copy()
    hidden[:, WIDTH : 2 * WIDTH] = 120
    finder, found = found_in([wide] * 3 + [hidden] * 5)
    seen = gather(list(range(8)), found, wide.shape[::-1], finder)
    assert seen.tags == [2]
    assert tuple(one.sentence() for one in seen.unused) == (
        '0 (at two places at once)',
        '1 (in 3 pictures only)',
        '3, 4, 5 (of family 5x5_50)',
    )
    assert 'seen and not used: 0 (at two' in place_seen(seen, FilmOptions()).assumed[0]


def test_a_given_family_has_no_tags_beyond_its_size() -> None:
    finder, found = found_in([picture((0, 7, 250), '6x6_1000')] * 6, '6x6_250')
    seen = gather(list(range(6)), found, (3 * WIDTH, HEIGHT), finder)
    assert (seen.tags, seen.family) == ([0, 7], '6x6_250')
    (unused,) = seen.unused
    assert unused.code == 'tag_of_no_family'
    assert unused.values == {'tag': 250, 'family': '6x6_250'}


def test_a_misread_tag_does_not_settle_the_family() -> None:
    """One picture of a film shows what looks like a tag of another family."""
    finder, found = found_in([picture((3, 4, 5), '4x4_50'), *[picture()] * 7])
    assert finder.name([0, 1, 2]) == '36h11'
    assert sorted(found[-1][0]) == [0, 1, 2]


def test_a_sheet_has_no_more_tags_than_its_family(tmp_path: Path) -> None:
    assert print_sheet(tmp_path / 'sheet.svg', 0.015, '16h5') == 29
