"""The policy for SROS2 names what the running node uses; no name from outside is a path."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from test_node import Peer, node_words, process

from kinpole_ros.ros.security import main, permitted, policy
from kinpole_ros.settings import ParameterError, load_settings, settings_from

ROOT = Path(__file__).parents[1]
FOUR_BAR = ROOT / 'config' / 'four_bar.yaml'


def named(document: str, group: str, verb: str) -> set[str]:
    """Full names under one rule, as SROS2 makes them of what the policy says."""
    profile = ElementTree.fromstring(document).find('./enclaves/enclave/profiles/profile')
    assert profile is not None
    namespace, node = profile.attrib['ns'].rstrip('/'), profile.attrib['node']
    names = [e.text or '' for e in profile.iterfind(f"{group}[@{verb}='ALLOW']/*")]
    full = (n.replace('~', f'{namespace}/{node}') if n[0] == '~' else n for n in names)
    return {name if name[0] == '/' else f'{namespace}/{name}' for name in full}


def test_the_policy_in_the_package_is_that_of_the_four_bar() -> None:
    written = (ROOT / 'config' / 'security' / 'kinpole.policy.xml').read_text()
    assert written == policy(load_settings(FOUR_BAR))


@pytest.mark.parametrize('namespace', ['/', '/rig'])
def test_the_policy_names_all_that_the_running_node_uses(tmp_path: Path, namespace: str) -> None:
    document = policy(load_settings(FOUR_BAR), 'guarded', namespace)
    expected = [
        named(document, group, verb)
        for group, verb in (('topics', 'publish'), ('topics', 'subscribe'), ('services', 'reply'))
    ]
    words = node_words(FOUR_BAR, topics='all', use_sim_time=True, marker_type='marker_array')
    peer = Peer()
    try:
        with process(
            *words, '-r', f'__ns:={namespace}', '-r', '__node:=guarded', log=tmp_path / 'stderr'
        ):
            ask = peer.node

            def used() -> list[set[str]]:
                if ('guarded', namespace) not in ask.get_node_names_and_namespaces():
                    return []
                return [
                    {name for name, _ in found('guarded', namespace)}
                    for found in (
                        ask.get_publisher_names_and_types_by_node,
                        ask.get_subscriber_names_and_types_by_node,
                        ask.get_service_names_and_types_by_node,
                    )
                ]

            # The graph fills up bit by bit, and goes beyond only if the policy lacks something.
            peer.until(lambda: used() == expected, 'a graph as in the policy')
            assert ask.get_client_names_and_types_by_node('guarded', namespace) == []
    finally:
        peer.close()


def test_keys_that_are_not_there_are_told_in_one_line(tmp_path: Path) -> None:
    asked = {'ENABLE': 'true', 'STRATEGY': 'Enforce', 'KEYSTORE': str(tmp_path)}
    done = subprocess.run(
        ['timeout', '-k', '2', '30', sys.executable, '-m', 'kinpole_ros.tools.cli', 'node'],
        env={**os.environ, **{f'ROS_SECURITY_{key}': value for key, value in asked.items()}},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith('kinpole node: ')
    assert done.stderr.count('\n') == 1, done.stderr


def test_the_command_prints_a_policy_and_refuses_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(FOUR_BAR)]) == 0
    assert ElementTree.fromstring(capsys.readouterr().out).tag == 'policy'
    assert main([str(tmp_path / 'none.yaml')]) == 2
    told = capsys.readouterr().err
    assert told.count('\n') == 1
    assert 'none.yaml' in told


@pytest.mark.parametrize('name', ['../x', 'a/b', '~', 'a b', 'a<b', '$(id)', '', 'é', '1a'])
def test_no_name_of_a_body_or_topic_leads_out_of_its_place(name: str) -> None:
    with pytest.raises(ParameterError, match='bodies'):
        settings_from({'bodies': [name]})
    if name != 'a/b':
        with pytest.raises(ParameterError, match='marker_topic'):
            settings_from({'marker_topic': f'/rig/{name}'})


def test_a_config_makes_no_objects(tmp_path: Path) -> None:
    evil = tmp_path / 'evil.yaml'
    flag = tmp_path / 'flag'
    evil.write_text(
        f'/**: {{ros__parameters: {{lag: !!python/object/apply:os.mkdir ["{flag}"]}}}}\n'
    )
    # As a list, as ROS reads it.
    with pytest.raises(ParameterError, match='parameter lag is'):
        load_settings(evil)
    assert not flag.exists()
    assert 'publish' in permitted(load_settings(FOUR_BAR))
