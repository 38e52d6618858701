"""
The policy of the node for SROS2: its topics and services, and no others.

python -m kinpole_ros.ros.security [my_rig.yaml] > kinpole.policy.xml
"""

import sys
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from kinpole_ros.messages import RIG, TF, live_outputs
from kinpole_ros.ros.parameters import checked_theory
from kinpole_ros.settings import ParameterError, Settings, load_settings

# Services of every managed node of rclpy, and `relearn`.
_SERVICES = (
    'change_state',
    'describe_parameters',
    'get_available_states',
    'get_available_transitions',
    'get_parameter_types',
    'get_parameters',
    'get_state',
    'get_transition_graph',
    'get_type_description',
    'list_parameters',
    'relearn',
    'set_parameters',
    'set_parameters_atomically',
)
_PUBLISHED = ('/diagnostics', '/parameter_events', '/rosout', '~/transition_event', f'~/{RIG}')


def permitted(settings: Settings) -> dict[str, list[str]]:
    """
    Return the names that the node publishes, subscribes and replies to, as a policy has them.

    '~/' stands for the node's own name; a name without '/' is in its namespace. The keys are
    publish, subscribe and reply. Raises ParameterError as `checked_theory` does.
    """
    # All topics, since derivative_order and topics may be set while the node runs.
    outputs = live_outputs(
        replace(settings, derivative_order=4, topics='all'), checked_theory(settings)
    )
    results = [o.under('~') for o in outputs if o.topic != TF or settings.publish_tf]
    return {
        'publish': sorted([*_PUBLISHED, *results]),
        'subscribe': sorted(['/clock', settings.marker_topic]),
        'reply': [f'~/{service}' for service in _SERVICES],
    }


def policy(settings: Settings, node: str = 'kinpole', namespace: str = '/') -> str:
    """
    Return the policy of the node in the XML of SROS2, version 0.2.0, for the enclave of its name.

    Raises ParameterError as `permitted` does.
    """
    names = permitted(settings)
    root = Element('policy', version='0.2.0')
    enclaves, path = SubElement(root, 'enclaves'), f'{namespace.rstrip("/")}/{node}'
    profiles = SubElement(SubElement(enclaves, 'enclave', path=path), 'profiles')
    profile = SubElement(profiles, 'profile', ns=namespace, node=node)
    for group, verb in (('service', 'reply'), ('topic', 'subscribe'), ('topic', 'publish')):
        permission = SubElement(profile, f'{group}s', {verb: 'ALLOW'})
        for name in names[verb]:
            SubElement(permission, group).text = name
    indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, "unicode")}\n'


def main(words: list[str]) -> int:
    """Print the policy for a parameter file, or for the defaults; returns the exit status."""
    if len(words) > 1 or words[:1] in (['-h'], ['--help']):
        print('usage: python -m kinpole_ros.ros.security [PARAMETERS.yaml]', file=sys.stderr)
        return 0 if len(words) == 1 else 2
    try:
        print(policy(load_settings(words[0]) if words else Settings()), end='')
    except ParameterError as error:
        print(f'kinpole_ros.ros.security: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
