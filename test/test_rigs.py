"""The benchmark of real rigs: input spoiled as it says, errors counted honestly, words quoted."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import _spoil
from bench._cases import CASES, Case
from bench._outcome import FIGURES, rig_rows, run
from bench._overview import troubles
from bench._page_rigs import rigs_part
from bench._parts import PARTS, Part
from bench._rigs import NOISE, Recording, record, rigs
from bench._rows import write_rows
from bench._spoil import Sent, ideal
from kinpole_ros.planar import to_complex
from kinpole_ros.settings import settings_from
from kinpole_ros.tools import cli

RIG = next(iter(rigs()))


def case(what: str) -> Case:
    (found,) = [case for case in CASES if case.what == what]
    return found


def sent(what: str, r: Recording, seed: int = 0) -> Sent:
    return case(what).spoil(r, np.random.default_rng(seed))


@pytest.fixture(scope='module')
def recording() -> Recording:
    return record(RIG, 200.0, 4.0)


def exact(r: Recording) -> np.ndarray:
    """The markers (T, N) without noise."""
    place, angle = r.position[0][:, r.owner], r.angle[0][:, r.owner]
    return np.asarray(place + r.shape * np.exp(1j * angle))


@pytest.mark.parametrize('rig', rigs())
def test_a_recording_is_the_exact_motion_and_noise(rig: str) -> None:
    r = record(rig, 100.0, 2.0)
    off = to_complex(r.points[..., :2]) - exact(r)
    for part in (off.real, off.imag, r.points[..., 2]):
        assert part.std() == pytest.approx(NOISE, rel=0.1)
    assert np.diff(r.stamps) == pytest.approx(1e7 * 1.0001, abs=2)
    assert [name.rpartition('_')[0] for name in r.names] == [r.bodies[b] for b in r.owner]
    uneven = record(rig, 100.0, 2.0, uneven=0.3)
    assert 2e6 < np.abs(np.diff(uneven.stamps) - 1e7).max() < 6.1e6
    assert to_complex(uneven.points[..., :2]) == pytest.approx(exact(uneven), abs=6 * NOISE)


@pytest.mark.parametrize('what', [case.what for case in CASES])
def test_what_is_sent_comes_in_order_with_known_parameters(what: str, recording: Recording) -> None:
    found = sent(what, recording)
    assert len(found.frames) == len(found.stamps) == len(found.points)
    assert found.points.shape[1] == len(found.names)
    assert (np.diff(found.stamps) > 0).all()
    assert settings_from(found.settings).bodies.keys() == set(recording.bodies)


def test_stamps_are_late_by_what_is_said(recording: Recording) -> None:
    def delays(what: str) -> np.ndarray:
        found = sent(what, recording)
        assert 0.95 < len(found.frames) / len(recording.times) < 0.995
        assert np.array_equal(found.points, recording.points[found.frames])
        return (found.stamps - recording.stamps[found.frames]) * 1e-6

    uniform = delays('late by 0.2 to 3 ms, uniform')
    assert (uniform.min(), uniform.max()) == pytest.approx((0.2, 3.0), abs=0.05)
    assert delays('late by exp(0.5 ms)').mean() == pytest.approx(0.5, rel=0.15)
    assert delays('late by exp(3 ms)').mean() > 2.7
    rounded = delays('rounded to 1 ms')
    assert np.abs(rounded).max() <= 0.5
    assert not (sent('rounded to 1 ms', recording).stamps % 10**6).any()


def test_a_tilted_plane_is_turned_about_an_axis_in_it(recording: Recording) -> None:
    turns = [_spoil.tilted(30.0, 'xy')(recording, np.random.default_rng(k)) for k in range(3)]
    for found in turns:
        assert found.turn @ found.turn.T == pytest.approx(np.eye(3))
        assert found.turn[2, 2] == pytest.approx(np.cos(np.pi / 6))
        assert found.points @ found.turn == pytest.approx(recording.points)
    assert len({found.turn[0, 2] for found in turns}) == 3


def test_names_fail_as_is_said(recording: Recording) -> None:
    r = recording
    swapped = sent('two exchanged for good at 2.5 s', r).points
    before = r.times < 2.5
    assert np.array_equal(swapped[before], r.points[before])
    assert np.array_equal(swapped[~before][:, [3, 4]], r.points[~before][:, [4, 3]])
    assert r.owner[3] != r.owner[4]
    back = sent('two gone for 0.3 s, back as new ones', r)
    seen = np.isfinite(back.points[..., 0])
    gone = (r.times >= 2.5) & (r.times < 2.8)
    assert (seen.sum(axis=1) == len(r.names) - 2 * gone).all()
    assert np.array_equal(back.points[~gone & ~before][:, -2:], r.points[~gone & ~before][:, 3:5])


def test_points_without_names_leave_no_gaps(recording: Recording) -> None:
    r = recording
    for what in 'none, 5% of the points absent', 'none, a ghost from 2.5 s on':
        found = sent(what, r)
        assert found.names == tuple(map(str, range(len(found.names))))
        seen = np.isfinite(found.points[..., 0])
        assert (seen[:, :-1] >= seen[:, 1:]).all()
        known = (found.points[:, :, None] == r.points[:, None]).all(axis=-1)
        if 'ghost' in what:
            assert np.array_equal(seen[:, -1], r.times >= 2.5)
            assert (known.any(axis=1)).all()
            # It stands still, and is anywhere in the order.
            ghost = seen & ~known.any(axis=2)
            assert found.points[ghost].std(axis=0) == pytest.approx([NOISE] * 3, rel=0.2)
            assert len(np.unique(np.nonzero(ghost)[1])) == len(r.names) + 1
        else:
            assert seen.mean() == pytest.approx(0.95, abs=0.01)
            assert known.any(axis=2)[seen].all()
    mixed = sent('none, any order, shapes given', r)
    assert np.array_equal(np.sort(mixed.points, axis=1), np.sort(r.points, axis=1))
    shape = mixed.settings[f'{r.bodies[0]}.shape']
    assert shape[:2] == [r.shape[0].real, r.shape[0].imag]
    assert len(shape) == 2 * (r.owner == 0).sum()


def test_markers_and_bodies_are_as_bad_as_is_said() -> None:
    r = record(RIG, 200.0, 20.0)

    def off(what: str) -> np.ndarray:
        return to_complex(sent(what, r).points[..., :2] - r.points[..., :2])

    noisy = sent('one of each body 10 times noisier', r).points[..., :2]
    spread = (to_complex(noisy) - exact(r)).real.std(axis=0)
    assert spread == pytest.approx(NOISE * np.where(np.arange(8) % 4, 1, 10), rel=0.1)
    slip = np.abs(off('one of each body slips by 2 mm'))
    assert slip.max(axis=0) == pytest.approx(0.002 * (np.arange(8) % 4 == 0), rel=0.01)
    wobble = off('soft tissue, 5 mm over 0.2 s').real
    assert wobble.std() == pytest.approx(0.005, rel=0.1)
    assert (wobble[40:] * wobble[:-40]).mean() / wobble.var() == pytest.approx(np.exp(-1), abs=0.1)
    bent = np.abs(off('barrel distortion of 5%'))
    flat = exact(r)
    edges = (
        (part.min() + part.max()) / 2 * axis for part, axis in ((flat.real, 1), (flat.imag, 1j))
    )
    assert bent.max() == pytest.approx(0.05 * np.abs(flat - sum(edges)).max(), rel=0.02)
    for what, turned in (
        ('one with a body turned by 0.3 rad', 2 * np.sin(0.15)),
        ('one with a body 20 mm off', 0.0),
    ):
        moved = off(what)
        wrong = np.abs(moved) > 1e-9
        assert (wrong.any(axis=1).sum() == wrong[:, ::4].sum()) or turned
        assert 25 < wrong.any(axis=1).sum() < 33
        assert not wrong[r.times < 2].any()
        if not turned:
            assert moved[wrong] == pytest.approx(0.02)


def test_ideal_input_is_as_good_as_itself() -> None:
    rows = rig_rows((RIG,), 3.5, (Case('stamps', 'as it is', 'nothing', 'none', ideal),), 1)
    assert [row['quantity'] for row in rows] == list(FIGURES)
    for row in rows:
        assert (row['ratio'], row['worst'], row['withheld']) == (1.0, 1.0, 0.0)
        assert row['covered'] == row['ideal_covered'] > 0.85
        assert row['said'] == ''


def test_what_is_wrong_shows_in_the_rows() -> None:
    cases = tuple(map(case, ['late by exp(3 ms)', 'two exchanged for good at 0.1 s', '90% hidden']))
    rows = rig_rows((RIG,), 3.5, cases, 1)
    late, swapped, hidden = (
        {row['quantity']: row for row in rows if row['what'] == c.what} for c in cases
    )
    assert late['ω']['bar'] == 1.3
    assert swapped['ω']['bar'] == 1.2
    assert np.isnan(swapped['ICR']['bar'])
    assert hidden['ω']['withheld'] > 0.9
    assert 'markers not seen' in hidden['ω']['said']
    for row in rows:
        assert not row['worst'] < row['ratio']
        assert not row['least_covered'] > row['covered']
    # The page takes them as they are.
    page = rigs_part(rows)
    assert '| 90% hidden | –, – |' in page
    assert 'nan' not in page


def test_a_tilt_is_taken_out_of_what_is_compared(recording: Recording) -> None:
    """An error along the normal of the true plane is none, whatever the frame of the markers."""
    flat = run(recording, ideal(recording))
    back = ideal(recording, turn=np.diag([-1.0, -1.0, 1.0]), points=recording.points * (-1, -1, 1))
    turned = run(recording, back)
    for name in FIGURES:
        known = np.isfinite(flat.error[name])
        assert np.array_equal(known, np.isfinite(turned.error[name]))
        assert turned.error[name][known] == pytest.approx(flat.error[name][known], abs=1e-6)
        assert turned.square[name][known] == pytest.approx(flat.square[name][known], rel=1e-3)


def made_up() -> list[dict[str, Any]]:
    figures = dict.fromkeys(
        (
            *('ratio', 'worst', 'covered', 'least_covered', 'ideal_covered'),
            *('beyond_5', 'beyond_10', 'withheld', 'most_withheld'),
        ),
        0.5,
    )
    return [
        {'part': one.part, 'what': one.what, 'trouble': one.trouble, 'level': one.level}
        | figures
        | {'quantity': name, 'worst': 7.0, 'bar': one.bar, 'said': ''}
        for one in CASES
        for name in FIGURES
    ]


def test_what_is_measured_again_is_quoted_beside_what_was_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seconds = PARTS['rigs'].seconds
    monkeypatch.setitem(PARTS, 'rigs', Part(seconds, lambda quick, tell: {'rigs': made_up()}))
    monkeypatch.setattr('bench._report.draw_charts', lambda tables, folder: [])
    before = [{'method': 'ours', 'lag': 0.0, 'ω': 1.0}]
    (tmp_path / 'charts').mkdir()
    write_rows(tmp_path / 'charts' / 'error_over_lag.csv', before)
    assert cli.main(['bench', '--rigs', '--quick', '--output', str(tmp_path)]) == 0
    pages = [tmp_path / name for name in ('benchmarks.md', 'benchmarks-tables.md')]
    for page in pages:
        assert f'written to {page}' in capsys.readouterr().out or page == pages[1]
        assert 'too little data for conclusions: rigs' in ' '.join(page.read_text().split())
    tables = pages[1].read_text()
    assert rigs_part(made_up()).splitlines()[-1] in tables
    assert '## Error by lag' in tables
    assert '## Stability atlas' not in tables
    written = [page.read_text() for page in pages]
    assert cli.main(['bench', '--pages', '--output', str(tmp_path)]) == 0
    assert [page.read_text() for page in pages] == written


def test_a_part_that_there_is_not_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(['bench', '--only', 'rigs', 'wheels', '--output', str(tmp_path)]) == 2
    assert "there is no part 'wheels'; parts: costs, " in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]
    with pytest.raises(SystemExit):
        cli.main(['bench', '--help'])
    words = ' '.join(capsys.readouterr().out.split())
    assert ', '.join(PARTS) in words


def test_the_strip_breaks_where_the_larger_error_passes_the_bound() -> None:
    rows = [
        row | {'trouble': 'late', 'level': level, 'what': level, 'said': said, 'ratio': ratio}
        for level, ratios, said in (
            ('1 ms', (1.0, 1.4), ''),
            ('3 ms', (1.1, 1.6), ''),
            ('9 ms', (7.0, np.nan), 'late'),
        )
        for row, ratio in zip(
            ({'quantity': 'ω', 'withheld': 0.0}, {'quantity': 'ICR', 'withheld': 0.2}),
            ratios,
            strict=True,
        )
    ]
    (trouble,) = troubles(rows)
    assert [level.broken for level in trouble.levels] == [False, True, True]
    assert [level.reported for level in trouble.levels] == [False, False, True]
    assert trouble.first_broken is not None
    assert (trouble.first_broken.name, trouble.first_broken.ratio) == ('3 ms', 1.6)
    for row in rows:
        row['withheld'] = 0.9
    (trouble,) = troubles(rows)
    assert trouble.first_broken is None


def test_cases_of_one_trouble_differ_in_how_much_there_is_of_it() -> None:
    named = [(case.trouble, case.level) for case in CASES]
    assert len({*named}) == len(named) == len({case.what for case in CASES})


def test_poses_are_predicted_from_when_frames_turned_out_to_be() -> None:
    # The clock moves frames by most of an interval when it is found.
    recording = record('four-bar links', 100.0, 4.0)
    late = next(case for case in CASES if 'uniform' in case.what)
    rng = np.random.default_rng((*late.what.encode(), *b'four-bar links', 100))
    found = run(recording, late.spoil(recording, rng))
    assert np.nanmax(np.abs(found.error['ω'])) < 1.0
