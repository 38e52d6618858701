"""Belts, Geneva drives and cams against their closed forms, and what is refused of them."""

from typing import Any

import numpy as np
import pytest

from kinpole_ros.mechanism import (
    Scene,
    SceneError,
    Torque,
    efforts,
    explain,
    freed_reactions,
    instant_centers,
    load_scene,
    reactions,
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


def hoist(side: float = 1.0) -> Scene:
    """A load that slides upright on a rope to the edge of a drum, r = 5 cm."""
    return load_scene(
        {
            'bodies': {
                'ground': {'O': [0, 0], 'G': [0.05 * side, 0]},
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
    borne = reactions(scene.mechanism, values, loads)
    freed = freed_reactions(scene.mechanism, values, loads)
    np.testing.assert_allclose(borne.force, freed.force, rtol=1e-9)
    row = borne.joints.index('belt')
    # The tension, which is a negative thrust, is the torque over the radius.
    np.testing.assert_allclose(np.abs(borne.along[row]), 1.8 / 0.09, rtol=1e-9)
    np.testing.assert_allclose(efforts(scene.mechanism, values, loads).effort, 0.6, rtol=1e-9)
    rope = hoist()
    values = rope.mechanism.motion(TIMES[:3]).values[0]
    borne = reactions(rope.mechanism, values, rope.loads)
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
        ({'radii': 0.1}, r'give \[x, y\]'),
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
