"""
What the node may do on the network, as a policy for SROS2: its topics and services and no others.

python -m kinpole_ros.ros.security [my_rig.yaml] > kinpole.policy.xml
"""

import sys
from collections.abc import Iterable
from dataclasses import replace
from xml.sax.saxutils import escape, quoteattr

from kinpole_ros.messages import TF, live_outputs, theory_of
from kinpole_ros.tracking.parameters import ParameterError, Settings, load_settings

# Of every node, or every managed one, by rclpy; and one of its own.
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
_PUBLISHED = ('/diagnostics', '/parameter_events', '/rosout', '~/transition_event')


def permitted(settings: Settings) -> dict[str, list[str]]:
    """
    Names the node uses with these parameters, by what it does with them, as a policy writes them.

    '~/' stands for the node's own name and a name without '/' for one in its namespace. The keys
    are publish, subscribe and reply. Raises ParameterError as theory_of does.
    """
    # Of all orders, since derivative_order may be set while the node runs.
    outputs = live_outputs(replace(settings, derivative_order=4), theory_of(settings))
    results = [o.under('~') for o in outputs if o.topic != TF or settings.publish_tf]
    return {
        'publish': sorted([*_PUBLISHED, *results]),
        'subscribe': sorted(['/clock', settings.marker_topic]),
        'reply': [f'~/{service}' for service in _SERVICES],
    }


def policy(settings: Settings, node: str = 'kinpole', namespace: str = '/') -> str:
    """
    The policy of the node in the XML of SROS2, version 0.2.0, for the enclave of its name.

    Raises ParameterError as `permitted` does.
    """
    names = permitted(settings)
    enclave = f'{namespace.rstrip("/")}/{node}'
    return '\n'.join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<policy version="0.2.0">',
            '  <enclaves>',
            f'    <enclave path={quoteattr(enclave)}>',
            '      <profiles>',
            f'        <profile ns={quoteattr(namespace)} node={quoteattr(node)}>',
            *_rule('services', 'service', 'reply', names['reply']),
            *_rule('topics', 'topic', 'subscribe', names['subscribe']),
            *_rule('topics', 'topic', 'publish', names['publish']),
            '        </profile>',
            '      </profiles>',
            '    </enclave>',
            '  </enclaves>',
            '</policy>',
            '',
        ]
    )


def _rule(group: str, one: str, verb: str, names: Iterable[str]) -> list[str]:
    inner = [f'            <{one}>{escape(name)}</{one}>' for name in names]
    return [f'          <{group} {verb}="ALLOW">', *inner, f'          </{group}>']


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
