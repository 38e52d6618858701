"""Belts, Geneva drives and cams against their closed forms, and what is refused of them."""

from typing import Any

import numpy as np
import pytest
from hand_statics import freed_reactions

from kinpole_ros.mechanism import (
    LinkageError,
    Scene,
    SceneError,
    Statics,
    Torque,
    explain,
    instant_centers,
    load_scene,
    rotation_derivatives,
    transmission_angles,
)

TIMES = np.linspace(0, 1, 41)
EXACT = {'rtol': 1e-9, 'atol': 1e-9}


def moving(scene: Scene, name: str, times: np.ndarray = TIMES) -> np.ndarray:
    """A variable and its four derivatives (5, T)."""
    names = scene.mechanism.assembly.loops.variables
    return scene.mechanism.motion(times).values[:, names.index(name)]


def steady(start: float, rate: float, times: np.ndarray = TIMES) -> np.ndarray:
    found = np.zeros((5, len(times)))
    found[0], found[1] = start + rate * times, rate
    return found


# Belts


def two_wheels(**belt: Any) -> dict[str, Any]:
    return {
        'bodies': {
            'ground': {'H': [0, 0], 'K': [0.5, 0.2]},
            'motor': {'H': [0, 0]},
            'fan': {'K': [0, 0]},
        },
        'joints': [{'belt': ['motor.H', 'fan.K'], 'name': 'belt', **belt}],
        'drivers': [{'drive': 'motor', 'rate': 7.0, 'start': 0.3}],
    }


@pytest.mark.parametrize(
    ('radii', 'ratio'), [((0.03, 0.09), 1 / 3), ((0.03, -0.09), -1 / 3), ((-0.05, -0.05), 1.0)]
)
def test_a_belt_turns_wheels_by_the_ratio_of_their_radii(radii: Any, ratio: float) -> None:
    scene = load_scene(two_wheels(radii=list(radii)))
    np.testing.assert_allclose(moving(scene, 'fan'), steady(0.3 * ratio, 7 * ratio), **EXACT)
    hubs, step = abs(0.5 + 0.2j), radii[0] - radii[1]
    np.testing.assert_allclose(
        moving(scene, 'belt'), steady(np.sqrt(hubs**2 - step**2), 0.0), **EXACT
    )


@pytest.mark.parametrize('radii', ['5 cm @ 30 deg', '5 cm', ['3 cm'], ['3 cm', '9 cm', '1 cm']])
def test_radii_of_a_belt_are_two_lengths(radii: Any) -> None:
    with pytest.raises(SceneError, match=r'radii is .*: give both radii as \[3 cm, 9 cm\]'):
        load_scene(two_wheels(radii=radii))


@pytest.mark.parametrize('turn', [0.0, 200.0, -700.0])
@pytest.mark.parametrize('radii', [(0.04, 0.02), (0.04, -0.02)])
def test_a_belt_on_an_arm_is_a_planetary_gear(radii: tuple[float, float], turn: float) -> None:
    """By Willis: the wheels' angles as seen from the arm keep their ratio, wherever it starts."""
    start = np.radians(turn)
    scene = load_scene(
        {
            'bodies': {
                'ground': {'O': [0, 0]},
                'arm': {'O': [0, 0], 'P': [0.3, 0.1]},
                'sun': {'O': [0, 0]},
                'tool': {'P': [0, 0]},
            },
            'joints': [{'belt': ['sun.O', 'tool.P'], 'radii': list(radii), 'name': 'chain'}],
            'drivers': [
                {'drive': 'arm', 'rate': 6.0, 'start': start},
                {'drive': 'sun', 'mean': 0.2, 'amplitude': 0.7, 'frequency': 1.3},
            ],
        }
    )
    arm = steady(start, 6.0)
    sun = 0.7 * np.stack(
        [(2.6 * np.pi) ** k * np.sin(2.6 * np.pi * TIMES + k * np.pi / 2) for k in range(5)]
    )
    sun[0] += 0.2
    expected = arm + radii[0] / radii[1] * (sun - arm)
    np.testing.assert_allclose(moving(scene, 'tool'), expected, rtol=1e-9, atol=1e-8)


def hoist(side: float = 1.0, guide: float | None = None) -> Scene:
    """
    A load that slides upright on a rope to the edge of a drum, r = 5 cm.

    The rope runs on the `side` of the drum, its load on that of the `guide`.
    """
    guide = side if guide is None else guide
    return load_scene(
        {
            'bodies': {
                'ground': {'O': [0, 0], 'G': [0.05 * guide, 0]},
                'drum': {'O': [0, 0]},
                'load': {'L': [0, 0]},
            },
            'joints': [
                {'prismatic': 'load.L', 'on': 'ground.G', 'along': '-90 deg', 'name': 'drop'},
                {
                    'belt': ['drum.O', 'load.L'],
                    'radii': [0.05 * side, 0],
                    'length': 0.4,
                    'direction': '-90 deg',
                    'name': 'rope',
                },
            ],
            'drivers': [{'drive': 'drum', 'from': 0, 'to': 2, 'duration': 1}],
            'loads': [{'force': [0, -80], 'at': 'load.L'}],
        }
    )


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_a_rope_to_a_load_unwinds_by_the_turn_of_its_drum(side: float) -> None:
    scene = hoist(side)
    drum, drop = moving(scene, 'drum'), moving(scene, 'drop')
    expected = -0.05 * side * drum
    expected[0] += 0.4
    np.testing.assert_allclose(drop, expected, **EXACT)


@pytest.mark.parametrize('guide', [-1.0, 0.5, 1.2])
def test_a_rope_that_cannot_start_in_its_direction_is_refused(guide: float) -> None:
    with pytest.raises(SceneError, match=r'joints: rope.*is -90 deg, but it leads to'):
        hoist(guide=guide)


def test_a_string_unwinds_along_an_involute() -> None:
    """The free end of a taut string from a fixed circle: a(cos φ + φ sin φ, sin φ - φ cos φ)."""
    a = 0.1
    scene = load_scene(
        {
            'bodies': {'ground': {'O': [0, 0]}, 'table': {'T': [0, 0]}, 'bob': {'B': [0, 0]}},
            'joints': [
                {'prismatic': 'table.T', 'on': 'ground.O', 'along': 0, 'name': 'x'},
                {'prismatic': 'bob.B', 'on': 'table.T', 'along': '90 deg', 'name': 'y'},
                {
                    'belt': ['ground.O', 'bob.B'],
                    'radii': [a, 0],
                    'length': 0.2,
                    'direction': 0,
                    'name': 'string',
                },
            ],
            'drivers': [{'drive': 'x', 'mean': 0.1, 'amplitude': 0.06, 'frequency': 1}],
            'start': {'string.angle': 0.5, 'y': 0.2},
        }
    )
    bob = scene.motion(TIMES)['bob'].position
    angle = moving(scene, 'string.angle')
    length = 0.2 + a * angle[0]
    np.testing.assert_allclose(bob[0], (1j * a + length) * np.exp(1j * angle[0]), **EXACT)
    # It moves at a right angle to the string, by the length of this.
    np.testing.assert_allclose(bob[1], 1j * length * angle[1] * np.exp(1j * angle[0]), **EXACT)


def test_a_belt_pulls_its_wheels_along_the_strand() -> None:
    scene = load_scene(two_wheels(radii=[0.03, 0.09]))
    values = scene.mechanism.motion(TIMES[:3]).values[0]
    loads = [Torque('fan', -1.8)]
    borne = Statics(scene.mechanism, values, loads)
    freed = freed_reactions(scene.mechanism, values, loads)
    np.testing.assert_allclose(borne.force, freed.force, rtol=1e-9)
    row = borne.joints.index('belt')
    # The tension, which is a negative thrust, is the torque over the radius.
    np.testing.assert_allclose(np.abs(borne.along[row]), 1.8 / 0.09, rtol=1e-9)
    np.testing.assert_allclose(Statics(scene.mechanism, values, loads).effort, 0.6, rtol=1e-9)
    rope = hoist()
    values = rope.mechanism.motion(TIMES[:3]).values[0]
    borne = Statics(rope.mechanism, values, rope.loads)
    np.testing.assert_allclose(borne.force[borne.joints.index('rope')], 80j, rtol=1e-9)
    np.testing.assert_allclose(borne.effort, 80 * 0.05, rtol=1e-9)


@pytest.mark.parametrize(('radii', 'share'), [((0.03, 0.09), -0.5), ((0.03, -0.09), 0.25)])
def test_the_center_of_two_wheels_is_where_the_strand_meets_the_line_of_hubs(
    radii: tuple[float, float], share: float
) -> None:
    scene = load_scene(two_wheels(radii=list(radii)))
    values = scene.mechanism.motion(TIMES[:2]).values[0]
    found = instant_centers(scene.mechanism, values)
    assert not found.by_rates.any()
    np.testing.assert_allclose(
        found.points[found.row('motor', 'fan')], share * (0.5 + 0.2j), rtol=1e-9
    )
    assert any('meets the strand of belt' in line for line in explain(scene.mechanism, found.steps))
    assert not transmission_angles(scene.mechanism, values)


@pytest.mark.parametrize(
    ('belt', 'says'),
    [
        ({}, "'radii' is missing"),
        ({'radii': [0.5, -0.5]}, 'no strand of radii 0.5 and -0.5 m fits'),
        ({'radii': 0.1}, r'give both radii as'),
        ({'radii': [0.1, 0.1], 'teeth': 3}, "unknown key 'teeth'"),
        ({'belt': ['motor.H'], 'radii': [0.1, 0.1]}, 'give its two ends'),
    ],
)
def test_a_belt_that_cannot_be_is_refused(belt: dict[str, Any], says: str) -> None:
    with pytest.raises(SceneError, match=says):
        load_scene(two_wheels(**belt))


def test_the_strand_of_a_belt_is_not_driven() -> None:
    data = two_wheels(radii=[0.03, 0.09])
    data['drivers'] = [{'drive': 'belt', 'rate': 0.1}]
    with pytest.raises(SceneError, match='only holds: drive a wheel'):
        load_scene(data)


@pytest.mark.parametrize('lacks', ['length', 'direction'])
def test_a_rope_without_a_carrier_says_how_long_it_is(lacks: str) -> None:
    data = two_wheels(radii=[0.03, 0.0], length=0.4, direction=0.0)
    del data['bodies']['ground']['K'], data['joints'][0][lacks]
    data['joints'].append({'slot': 'fan.K', 'on': 'ground.H', 'along': '90 deg'})
    with pytest.raises(SceneError, match=f"'{lacks}' is missing"):
        load_scene(data)


# Geneva drives and cams


def geneva(slots: Any = 4, **joint: Any) -> dict[str, Any]:
    return {
        'bodies': {
            'ground': {'O': [0, 0], 'W': '0.1 @ 30 deg'},
            'crank': {'O': [0, 0]},
            'wheel': {'W': [0, 0]},
        },
        'joints': [{'geneva': 'wheel.W', 'on': 'crank.O', 'slots': slots, **joint}],
        'drivers': [{'drive': 'crank', 'rate': 2.0, 'start': '-100 deg'}],
        'loads': [{'torque': -3, 'on': 'wheel'}],
    }


@pytest.mark.parametrize('slots', [3, 4, 6, 8])
def test_a_geneva_drive_is_its_series_and_stands_still_in_between(slots: int) -> None:
    """While engaged -Σ k^m sin(mψ) / m, k = sin(π / slots): the logarithm of 1 - k e^{iψ}."""
    times = np.linspace(-7, 9, 161)
    scene = load_scene(geneva(slots, pin='20 deg', slot='10 deg'))
    found = moving(scene, 'wheel', times)
    # The pin is on the line of centers where the crank is at 10 deg.
    psi = 2.0 * times + np.radians(-110)
    turns = np.round(psi / (2 * np.pi))
    psi -= 2 * np.pi * turns
    engaged = np.abs(psi) < np.pi / 2 - np.pi / slots
    assert engaged.any() and not engaged.all()
    m, k = np.arange(1, 400)[:, None], np.sin(np.pi / slots)
    for order in range(5):
        series = -(k**m * m ** (order - 1.0) * np.sin(m * psi + order * np.pi / 2)).sum(axis=0)
        still = -np.sign(psi) * np.pi / slots if order == 0 else 0.0
        expected = 2.0**order * np.where(engaged, series, still)
        if order == 0:
            expected += -turns * 2 * np.pi / slots
            first = np.radians(30 + 180 - 10)
            # One slot is as good as another.
            off = (found[0] - expected - first) / (2 * np.pi / slots)
            np.testing.assert_allclose(off, np.round(off[0]), atol=1e-9)
        else:
            np.testing.assert_allclose(found[order], expected, rtol=1e-9, atol=1e-9)


def test_a_geneva_crank_bears_what_its_wheel_does_and_nothing_in_the_dwell() -> None:
    scene = load_scene(geneva())
    mechanism = scene.mechanism
    values = mechanism.motion(TIMES * np.pi).values
    found = Statics(mechanism, values[0], scene.loads).effort[0]
    rate = values[1, mechanism.assembly.loops.variables.index('wheel')]
    np.testing.assert_allclose(found, 3 * rate / 2.0, rtol=1e-9, atol=1e-12)
    assert (found[rate == 0] == 0).any()
    with pytest.raises(LinkageError, match='where a cam or a Geneva wheel is touched'):
        _ = Statics(mechanism, values[0], scene.loads).force


def test_a_geneva_drive_and_its_crank_have_their_center_where_the_rates_are_equal() -> None:
    """It divides the line of centers as the inverse ratio of the rates does."""
    scene = load_scene(geneva(pin='20 deg'))
    values = scene.mechanism.motion(np.radians([100, 125]) / 2.0).values
    found = instant_centers(scene.mechanism, values[0])
    ratio = values[1, scene.mechanism.assembly.loops.variables.index('wheel')] / 2.0
    expected = 0.1 * np.exp(1j * np.pi / 6) * ratio / (ratio - 1)
    np.testing.assert_allclose(found.points[found.row('crank', 'wheel')], expected, rtol=1e-9)


def valve(angles: Any, lift: Any, driver: Any = None, **cam: Any) -> dict[str, Any]:
    return {
        'bodies': {
            'ground': {'O': [0, 0], 'G': [0, 0.1]},
            'shaft': {'O': [0, 0]},
            'valve': {'V': [0, 0]},
        },
        'joints': [
            {'prismatic': 'valve.V', 'on': 'ground.G', 'along': '90 deg', 'name': 'stem'},
            {'cam': 'shaft', 'moves': 'stem', 'angles': angles, 'lift': lift, **cam},
        ],
        'drivers': [driver or {'drive': 'shaft', 'rate': 3.0, 'start': 0.05}],
    }


def test_a_harmonic_cam_that_rises_and_falls_is_an_eccentric() -> None:
    """Its lift h (1 - cos θ) / 2 over a shaft that swings, to the snap."""
    driver = {'drive': 'shaft', 'mean': 2, 'amplitude': 3, 'frequency': 0.8}
    scene = load_scene(valve(['0 deg', '180 deg', '360 deg'], [0, 0.02, 0], driver, law='harmonic'))
    turned = rotation_derivatives(moving(scene, 'shaft'))
    expected = -0.01 * turned.real
    expected[0] += 0.01
    np.testing.assert_allclose(moving(scene, 'stem'), expected, rtol=1e-9, atol=1e-9)


def rises(law: str, x: np.ndarray) -> list[np.ndarray]:
    """Rise, velocity, acceleration, jerk and ping over x from 0 to 1, as in textbooks."""
    s, c = np.sin(2 * np.pi * x), np.cos(2 * np.pi * x)
    return {
        'cycloidal': [
            x - s / (2 * np.pi),
            1 - c,
            2 * np.pi * s,
            4 * np.pi**2 * c,
            -8 * np.pi**3 * s,
        ],
        '3-4-5': [
            10 * x**3 - 15 * x**4 + 6 * x**5,
            30 * x**2 - 60 * x**3 + 30 * x**4,
            60 * x - 180 * x**2 + 120 * x**3,
            60 - 360 * x + 360 * x**2,
            -360 + 720 * x,
        ],
        '4-5-6-7': [
            35 * x**4 - 84 * x**5 + 70 * x**6 - 20 * x**7,
            140 * x**3 - 420 * x**4 + 420 * x**5 - 140 * x**6,
            420 * x**2 - 1680 * x**3 + 2100 * x**4 - 840 * x**5,
            840 * x - 5040 * x**2 + 8400 * x**3 - 4200 * x**4,
            840 - 10080 * x + 25200 * x**2 - 16800 * x**3,
        ],
    }[law]


@pytest.mark.parametrize('law', ['cycloidal', '3-4-5', '4-5-6-7'])
def test_a_cam_rises_by_its_law_and_dwells_between(law: str) -> None:
    angles = ['-40 deg', '80 deg', '120 deg', '210 deg', '320 deg']
    lifts = [0.001, 0.021, 0.021, -0.004, 0.001]
    scene = load_scene(valve(angles, lifts, law=law))
    times = np.linspace(-3, 5, 400)
    at = np.degrees(0.05 + 3 * times + np.radians(40)) % 360 - 40
    expected = np.zeros((5, len(times)))
    knots = [-40, 80, 120, 210, 320]
    for k in range(4):
        here = (at >= knots[k]) & (at < knots[k + 1])
        width = np.radians(knots[k + 1] - knots[k])
        parts = rises(law, np.radians(at[here] - knots[k]) / width)
        for order in range(5):
            rise = (lifts[k + 1] - lifts[k]) * parts[order] * (3 / width) ** order
            expected[order, here] = rise + (lifts[k] if order == 0 else 0)
    np.testing.assert_allclose(moving(scene, 'stem', times), expected, rtol=1e-9, atol=1e-9)


def test_a_table_of_a_smooth_cam_is_followed_smoothly_all_round() -> None:
    angles = np.radians(np.arange(0, 361, 5))
    lifts = 0.01 * np.exp(np.sin(angles))
    lifts[-1] = lifts[0]
    scene = load_scene(valve(angles.tolist(), lifts.tolist(), law='spline'))
    at_knots = moving(scene, 'stem', (angles[:-1] - 0.05) / 3)
    np.testing.assert_allclose(at_knots[0], lifts[:-1], **EXACT)
    s, c = np.sin(angles[:-1]), np.cos(angles[:-1])
    slope = lifts[:-1] * np.stack([c, c**2 - s])
    np.testing.assert_allclose(at_knots[1], 3 * slope[0], rtol=0, atol=3e-8)
    np.testing.assert_allclose(at_knots[2], 9 * slope[1], rtol=0, atol=3e-6)
    seam = moving(scene, 'stem', (np.array([-1e-9, 1e-9]) - 0.05) / 3)
    np.testing.assert_allclose(seam[:, 0], seam[:, 1], rtol=0, atol=1e-7)


def rocking(driven: str) -> Scene:
    """A slider-crank whose crank swings: as a cam moves it, or as a driver does."""
    joints = [{'slot': 'rod.B', 'on': 'ground.O', 'along': 0, 'name': 'slider'}]
    drivers = [{'drive': 'rocker', 'mean': '90 deg', 'amplitude': '-20 deg', 'frequency': 1}]
    bodies = {
        'ground': {'O': [0, 0], 'S': [0, -0.1]},
        'shaft': {'S': [0, 0]},
        'rocker': {'O': [0, 0], 'A': [0.06, 0]},
        'rod': {'A': [0, 0], 'B': [0.18, 0]},
    }
    if driven == 'cam':
        joints.append(
            {
                'cam': 'shaft',
                'moves': 'rocker',
                'angles': ['90 deg', '270 deg', '450 deg'],
                'lift': ['70 deg', '110 deg', '70 deg'],
                'law': 'harmonic',
            }
        )
        drivers = [{'drive': 'shaft', 'rate': '1 rev/s'}]
    else:
        del bodies['shaft']
    return load_scene(
        {
            'bodies': bodies,
            'joints': joints,
            'drivers': drivers,
            'start': {'rod': '-20 deg'},
            'loads': [{'force': [-50, 0], 'at': 'rod.B'}],
        }
    )


def test_loops_behind_a_cam_move_as_if_the_follower_were_driven() -> None:
    by_cam, by_driver = rocking('cam'), rocking('driver')
    for name in ('rocker', 'rod', 'slider'):
        np.testing.assert_allclose(
            moving(by_cam, name), moving(by_driver, name), rtol=1e-9, atol=1e-8
        )
    # The power is the same.
    torque, own = (
        Statics(one.mechanism, one.mechanism.motion(TIMES).values[0], one.loads).effort[0]
        for one in (by_cam, by_driver)
    )
    rate = moving(by_driver, 'rocker')[1]
    np.testing.assert_allclose(torque * 2 * np.pi, own * rate, rtol=1e-9, atol=1e-9)
    swept = by_cam.mechanism.sweep(np.linspace(0, 2 * np.pi, 41))
    slider = by_cam.mechanism.assembly.loops.variables.index('slider')
    np.testing.assert_allclose(swept.values[0, slider], moving(by_cam, 'slider')[0], **EXACT)


def test_a_timing_belt_turns_a_camshaft() -> None:
    data = valve(['0 deg', '180 deg', '360 deg'], [0, 0.02, 0], law='harmonic')
    data['bodies']['ground']['C'], data['bodies']['crank'] = [0, -0.4], {'C': [0, 0]}
    data['joints'].append({'belt': ['crank.C', 'shaft.O'], 'radii': [0.03, 0.06], 'name': 'belt'})
    data['drivers'] = [{'drive': 'crank', 'rate': '600 rpm'}]
    expected = -0.01 * rotation_derivatives(steady(0.0, 10 * np.pi)).real
    expected[0] += 0.01
    found = moving(load_scene(data), 'stem')
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)


def test_a_geneva_wheel_may_carry_a_cam() -> None:
    data = geneva()
    data['bodies']['ground']['G'], data['bodies']['gate'] = [0, 0.3], {'V': [0, 0]}
    cam = {'cam': 'wheel', 'moves': 'gate', 'angles': [0, np.pi, 2 * np.pi], 'lift': [0, 0.5, 0]}
    data['bodies']['gate'] = {'G': [0, 0]}
    data['joints'].insert(0, {**cam, 'law': 'harmonic'})
    scene = load_scene(data)
    expected = -0.25 * rotation_derivatives(moving(scene, 'wheel')).real
    expected[0] += 0.25
    np.testing.assert_allclose(moving(scene, 'gate'), expected, **EXACT)


ROUND = ['0 deg', '90 deg', '360 deg']


@pytest.mark.parametrize(
    ('data', 'says'),
    [
        (geneva(2), 'slots is 2: give a whole number from 3'),
        (geneva(4.0), 'slots is 4.0: give a whole number'),
        (geneva(on='ground.O'), 'no body holds the distance of ground.O and wheel.W'),
        (geneva(on='nothing'), 'which is no point'),
        (geneva(inner=True), "unknown key 'inner'"),
        (valve(ROUND, [0, 1]), '3 angles and 2 lifts'),
        (valve(ROUND, [0, 0.01, 0.02]), 'a cam goes once round'),
        (valve(['0 deg', '90 deg', '200 deg'], [0, 0.01, 0]), 'a cam goes once round'),
        (valve(['0 deg', '200 deg', '100 deg', '360 deg'], [0, 1, 1, 0]), 'the angles rising'),
        (valve(ROUND, '1 cm'), "lift is '1 cm': give a list"),
        (valve(ROUND, [0, '10 deg', 0]), 'whose unit is none of length'),
        (valve(ROUND, [0, 0.01, 0], law='square'), 'give one of cycloidal, harmonic'),
        (valve(ROUND, [0, 0.01, 0], moves='rod'), "moves is 'rod': give one of stem, shaft, valve"),
        (valve(ROUND, [0, 0.01, 0], of='shaft'), 'are to be three'),
        (
            valve(ROUND, [0, 0.01, 0], {'drive': 'stem', 'rate': 1}),
            'drive a cam, not what follows it',
        ),
    ],
)
def test_what_no_law_carries_is_refused(data: dict[str, Any], says: str) -> None:
    with pytest.raises(SceneError, match=says):
        load_scene(data)


def test_a_cam_on_a_coupler_is_refused_with_the_reason() -> None:
    scene = {
        'bodies': {
            'ground': {'O': [0, 0], 'C': [0.4, 0], 'S': [0.2, 0.5]},
            'crank': {'O': [0, 0], 'A': [0.1, 0]},
            'coupler': {'A': [0, 0], 'B': [0.35, 0]},
            'rocker': {'B': [0, 0], 'C': [0.3, 0]},
            'pusher': {'S': [0, 0]},
        },
        'joints': [{'cam': 'coupler', 'moves': 'pusher', 'angles': ROUND, 'lift': [0, 0.1, 0]}],
        'drivers': [{'drive': 'crank', 'rate': 1.0}],
        'start': {'coupler': '50 deg', 'rocker': '-60 deg'},
    }
    with pytest.raises(SceneError, match=r'joints: 1, cam.*not known before loops are closed'):
        load_scene(scene)
