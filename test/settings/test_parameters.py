"""Parameters: what is wrong is refused by name with what is allowed, from a file as set live."""

import re
from array import array
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from kinpole_ros.settings import (
    NODE_PARAMETERS,
    OWN_PARAMETERS,
    PARAMETERS,
    ParameterError,
    Settings,
    load_settings,
    settings_from,
)

CONFIG = Path(__file__).parents[2] / 'config'
DESIGNED = {
    'marker_topic': 'markers',
    'marker_type': 'auto',
    'marker_identity': 'auto',
    'plane': 'xy',
    'derivative_order': None,
    'noise': 0.0,
    'stamps': 'auto',
}


def refusal(values: dict[str, Any]) -> str:
    with pytest.raises(ParameterError) as error:
        settings_from(values)
    text = str(error.value)
    assert '\n' not in text
    return text


def file_refusal(path: Path) -> str:
    with pytest.raises(ParameterError) as error:
        load_settings(path)
    text = str(error.value)
    assert text.startswith(f'{path}: ')
    assert '\n' not in text
    return text


def written(folder: Path, text: str) -> Path:
    path = folder / 'config.yaml'
    path.write_text(text)
    return path


def test_nothing_given_is_one_body_of_all_markers_and_the_defaults() -> None:
    settings = settings_from({})
    assert settings == Settings()
    assert settings.bodies == {'body': ()}
    assert {name: getattr(settings, name) for name in DESIGNED} == DESIGNED


def test_every_setting_is_a_parameter_and_every_parameter_says_what_it_means() -> None:
    assert {field.name for field in fields(Settings)} - {'shapes', 'pins'} == set(PARAMETERS)
    for row in (PARAMETERS | NODE_PARAMETERS | OWN_PARAMETERS).values():
        assert row.description.endswith('.')
        assert row.kind.allowed


WRONG = [
    (
        'marker_topic',
        ['', ' ', 'two words', '/ends/', '//twice', '1st', '~', 5, None, 'ä'],
        'topic',
    ),
    ('marker_type', ['markers', 'MarkerArray', 1, None, ['marker']], 'auto, marker_array, marker'),
    ('marker_identity', ['name', 0, None], 'auto, index, id, ns, ns_id'),
    (
        'plane',
        ['zz', 'XY', '', 1, None, [0, 0, 0], [0.0, 1.0], [1.0] * 4, ['x', 'y', 'z'], [True, 0, 0]],
        'xy, yz, zx, fit, or a normal [x, y, z]',
    ),
    ('plane', [[float('nan'), 0, 1], [float('inf'), 0, 1], ['xy'], [0, [1], 0]], 'a normal'),
    ('stamps', ['camera', True, 0, None], 'auto, capture, arrival'),
    ('scale', [0, 0.0, -1, 1e10, 'mm', None, True, float('nan'), [1.0]], '1e-09 to 1e+09 m'),
    (
        'bodies',
        [[], [''], ['a', 'a'], 'body', ['a b'], ['1a'], ['a/b'], ['ä'], [1], 3],
        'a list of',
    ),
    ('window', [0, 0.0, -1, 1e9, '0.3', True, None, [0.3], 10**400], '1e-06 to 3600 s'),
    ('lag', [-0.1, 1e9, 'auto', False, float('nan'), float('inf')], '0 to 3600 s'),
    ('derivative_order', [0, 5, 2.0, 'all', True, None, -1, '²'], 'auto, 1, 2, 3 or 4'),
    ('noise', [-1e-9, 'low', float('nan'), float('-inf')], '0 to 1e+06 m'),
    ('stamps', ['arrivals', 0, None, True], 'auto, capture, arrival'),
    ('scene', [0, None, ['four_bar'], True], 'the name of a scene'),
    ('autostart', ['no', 0, 1, None], 'true or false'),
    ('executor', ['EventsExecutor', '', 1, None], 'one of lean, rclpy'),
    ('diagnostics_interval', [0.0, 0.01, 1e9, 'often', True, None], '0.05 to 3600 s'),
    ('joint_state_rate', [-1.0, 1001, 'fast', True, float('nan')], '0 to 1000 Hz'),
    ('publish_tf', ['yes', 0, None], 'true or false'),
    ('topics', ['some', '', 1, None], 'one of standard, all'),
    ('frame_prefix', ['a b', 3, None, 'é!', 'a\n'], 'letters, digits and any of _ / . -'),
    ('joints', [[''], ['a', 'a'], 'a', ['a b'], [1]], 'a list of different names'),
    (
        'body.shape',
        [[0, 0, 1], [0, 0, 0, 0], [0, 0], 'a', 7, ['a', 0, 1, 1], [0, 0, True, 1], [0, 0, 1e9, 1]],
        'a flat list of x, y of two or more markers',
    ),
    ('body.markers', [[1, 2], 'a', ['a', 'a'], [''], 7], "identities, as text, such as ['0', "),
]


@pytest.mark.parametrize(
    'name, value, allowed',
    [(name, v, allowed) for name, values, allowed in WRONG for v in values],
    ids=lambda part: repr(part)[:20],
)
def test_a_bad_value_is_refused_with_its_name_and_what_is_allowed(
    name: str, value: Any, allowed: str
) -> None:
    text = refusal({name: value})
    assert text.startswith(f'parameter {name} is ')
    assert allowed in text


@pytest.mark.parametrize(
    ('values', 'told'),
    [
        ({'joints': ['j']}, 'parameter j.bodies is []; it must be two different names of bodies'),
        ({'joints': ['j'], 'j.bodies': ['body']}, 'two different names of bodies'),
        ({'joints': ['j'], 'j.bodies': ['body', 'body']}, 'two different names of bodies'),
        ({'joints': ['j'], 'j.bodies': ['body', 'b']}, 'j.bodies names b; a joint is between two'),
        ({'lagg': 0.1}, 'unknown parameter lagg; did you mean lag? known are'),
        ({'j.bodies': ['ground', 'body']}, 'unknown parameter j.bodies; j is not among the joints'),
    ],
)
def test_a_joint_is_between_two_bodies_or_the_ground(values: dict[str, Any], told: str) -> None:
    assert told in refusal(values)
    good = settings_from({'joints': ['j'], 'j.bodies': ['ground', 'body']})
    assert good.joints == {'j': ('ground', 'body')}


def test_a_value_or_name_of_any_length_is_refused_in_one_line() -> None:
    for values in ({'plane': 'é\n' * 9999}, {'b\n' * 9999: 1}, {f'{"c" * 9999}.markers': ['a']}):
        text = refusal(values)
        assert len(text) < 500
        assert '\n' not in text


def test_all_parameters_are_tried_with_bad_values() -> None:
    own = {*NODE_PARAMETERS, 'body.markers', 'body.shape'}
    assert {name for name, *_ in WRONG} == {*PARAMETERS, *own}


@pytest.mark.parametrize(
    'name, value, expected',
    [
        ('window', 1, 1.0),
        ('lag', 0, 0.0),
        ('window', 3600.0, 3600.0),
        ('derivative_order', 'auto', None),
        ('derivative_order', 4, 4),
        ('derivative_order', '2', 2),
        ('marker_topic', '/rig_1/Mocap/markers', '/rig_1/Mocap/markers'),
        ('marker_topic', '~/markers', '~/markers'),
        ('plane', 'zx', 'zx'),
        ('plane', 'fit', 'fit'),
        ('plane', [0, -1, 2.5], (0.0, -1.0, 2.5)),
        ('plane', array('d', (0.0, 3.0, 0.0)), (0.0, 3.0, 0.0)),
        ('scale', 1, 1.0),
        ('scale', 0.001, 0.001),
    ],
)
def test_good_values_are_taken_as_the_pipeline_needs_them(
    name: str, value: Any, expected: Any
) -> None:
    found = getattr(settings_from({name: value}), name)
    assert found == expected
    assert type(found) is type(expected)


def test_an_unknown_parameter_is_refused_with_the_known_ones() -> None:
    text = refusal({'windows': 0.3})
    assert text.startswith('unknown parameter windows;')
    assert all(name in text for name in PARAMETERS)


@pytest.mark.parametrize('name', ['effort', 'method'])
def test_a_parameter_of_old_files_is_refused_with_the_advice_to_leave_it_out(name: str) -> None:
    text = refusal({name: 'low'})
    assert text.startswith(f'unknown parameter {name}; leave it out, as it has no effect; known')


def test_markers_of_a_body_that_is_not_there_are_told_apart_from_a_misspelt_name() -> None:
    text = refusal({'bodies': ['crank', 'rocker'], 'coupler.markers': ['a', 'b']})
    assert 'coupler.markers' in text
    assert 'not among the bodies crank, rocker' in text


def test_a_body_needs_two_markers_and_several_bodies_each_their_own() -> None:
    assert 'parameter a.markers names one marker' in refusal({'bodies': ['a'], 'a.markers': ['1']})
    text = refusal({'bodies': ['a', 'b'], 'a.markers': ['1', '2']})
    assert 'parameter b.markers is missing' in text


def test_bodies_keep_their_order_and_may_share_a_marker() -> None:
    values = {'bodies': ['b', 'a'], 'a.markers': ['1', '2'], 'b.markers': ['2', '3']}
    assert list(settings_from(values).bodies.items()) == [('b', ('2', '3')), ('a', ('1', '2'))]


@pytest.mark.parametrize('lag, window', [(0.3, 0.3), (0.5, 0.3), (0.1, 0.05)])
def test_lag_must_be_less_than_window(lag: float, window: float) -> None:
    text = refusal({'lag': lag, 'window': window})
    assert text.startswith(f'parameter lag is {lag:g} s; it must be less than window')


def test_what_ros_puts_into_the_same_file_is_left_to_it() -> None:
    settings = settings_from(
        {
            'use_sim_time': True,
            'start_type_description_service': False,
            'qos_overrides./markers.subscription.reliability': 'reliable',
            'autostart': False,
            'executor': 'rclpy',
        }
    )
    assert settings == Settings()


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
    max_leaves=5,
)
names = st.sampled_from([*PARAMETERS, *NODE_PARAMETERS, 'body.markers', 'a.markers']) | st.text()


@given(st.dictionaries(names, junk | st.just(['a', 'b']) | st.integers(10**300, 10**400)))
def test_whatever_is_given_is_taken_or_refused_in_words(values: dict[str, Any]) -> None:
    try:
        settings = settings_from(values)
    except ParameterError as error:
        assert str(error)
        return
    assert 0 <= settings.lag < settings.window <= 3600
    assert settings.bodies
    assert settings.derivative_order in (None, 1, 2, 3, 4)


# Files


def test_dotted_and_nested_names_mean_the_same(tmp_path: Path) -> None:
    nested = load_settings(
        written(
            tmp_path,
            '/**:\n  ros__parameters:\n    bodies: [a, b]\n'
            '    a: {markers: [p, q]}\n    b: {markers: [r, s]}\n    lag: 0.05\n',
        )
    )
    dotted = load_settings(
        written(
            tmp_path,
            '/**:\n  ros__parameters:\n    bodies: [a, b]\n'
            '    a.markers: [p, q]\n    b.markers: [r, s]\n    lag: 0.05\n',
        )
    )
    assert nested == dotted
    assert nested.bodies == {'a': ('p', 'q'), 'b': ('r', 's')}
    assert nested.lag == 0.05


@pytest.mark.parametrize('section', ['/**', 'kinpole', '/kinpole'])
def test_the_sections_of_this_node_are_read_and_those_of_others_left(
    tmp_path: Path, section: str
) -> None:
    path = written(
        tmp_path,
        'driver:\n  ros__parameters: {rate: 240}\n'
        f'{section}:\n  ros__parameters: {{lag: 0.02}}\n',
    )
    assert load_settings(path).lag == 0.02


@pytest.mark.parametrize('text, value', [('1e-3', 1e-3), ('2E-4', 2e-4), ('1.e-3', 1e-3), ('0', 0)])
def test_numbers_are_read_as_ros_reads_them(tmp_path: Path, text: str, value: float) -> None:
    # YAML 1.1 takes 1e-3 for text, ROS for a number; the same file must serve both.
    path = written(tmp_path, f'/**:\n  ros__parameters:\n    noise: {text}\n')
    assert load_settings(path).noise == value


def test_a_number_in_quotes_stays_text(tmp_path: Path) -> None:
    path = written(tmp_path, '/**:\n  ros__parameters:\n    noise: "1e-3"\n')
    assert "parameter noise is '1e-3'" in file_refusal(path)


@pytest.mark.parametrize(
    'text, complaint',
    [
        ('', 'no section for this node'),
        ('# nothing\n', 'no section for this node'),
        ('just text', 'no section for this node'),
        ('[1, 2]', 'no section for this node'),
        ('driver:\n  ros__parameters: {rate: 1}\n', 'no section for this node'),
        ('/**:\n', 'ros__parameters'),
        ('/**: {lag: 0.1}\n', 'ros__parameters'),
        ('/**:\n  ros__parameters:\n', 'ros__parameters'),
        ('/**: {ros__parameters: {windows: 1}}\n', 'unknown parameter windows'),
        ('/**: {ros__parameters: {window: -1}}\n', 'parameter window is -1'),
        ('/**: {ros__parameters: {window: 2001-99-99}}\n', "window is '2001-99-99'"),
        ('/**: {ros__parameters: {window: 1\n', 'not YAML'),
        ('a: b: c\n', 'not YAML'),
        ('\t- x', 'not YAML'),
        ('[' * 5000, 'not YAML'),
        ('/**: {ros__parameters: {window: !!int ""}}\n', "window is ''"),
        ('/**: {ros__parameters: {window: !!bool x}}\n', "window is 'x'"),
        ('/**: {ros__parameters: {window: !!timestamp x}}\n', "window is 'x'"),
        ('/**: {ros__parameters: {window: !!float [1]}}\n', 'window is [1]'),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_reason(
    tmp_path: Path, text: str, complaint: str
) -> None:
    assert complaint in file_refusal(written(tmp_path, text))


def test_a_file_that_is_no_text_or_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / 'config.yaml'
    assert 'No such file' in file_refusal(path)
    assert 'directory' in file_refusal(tmp_path)
    path.write_bytes(b'\xff\xfe\x00')
    assert 'not YAML' in file_refusal(path)


@pytest.mark.parametrize('path', sorted(CONFIG.glob('*.yaml')), ids=lambda path: path.name)
def test_the_files_that_come_along_are_good(path: Path) -> None:
    load_settings(path)


def test_the_commented_file_holds_every_parameter_with_default_unit_and_choices() -> None:
    text = (CONFIG / 'kinpole.yaml').read_text()
    assert load_settings(CONFIG / 'kinpole.yaml') == Settings()
    values = yaml.safe_load(text)['/**']['ros__parameters']
    # An empty list is no value in such a file: the joints are in a comment.
    rows = {n: row for n, row in (PARAMETERS | NODE_PARAMETERS).items() if row.default != []}
    assert values == {name: row.default for name, row in rows.items()}
    for name, row in rows.items():
        # The comment of a parameter goes on to the next one.
        [comment] = re.findall(rf'^    {name}: .*?#(.*?)(?:^    \w|\Z)', text, re.M | re.S)
        if row.kind.unit:
            assert re.search(rf'^ {row.kind.unit}\b', comment), name
        choices = re.match(r'one of (.+?)(?:, or|$)', row.kind.allowed)
        for choice in choices[1].split(', ') if choices else ():
            assert re.search(rf'\b{choice}\b', comment), (name, choice)
    assert all(f'    {name}: [' in text for name in ('# joints', '#   markers', '#   shape'))
