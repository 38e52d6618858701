"""
Start the node in a ROS installation, for one tracker or, with namespaces, for several.

ros2 launch kinpole_ros kinpole.launch.py params_file:=my_rig.yaml markers:=/mocap/markers
and rviz:=true frame:=FRAME, that of the markers, to see it.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the node, which configures and activates itself."""
    config = PathJoinSubstitution([FindPackageShare('kinpole_ros'), 'config'])
    defaults = PathJoinSubstitution([config, 'kinpole.yaml'])
    drawings = PathJoinSubstitution([config, 'kinpole.rviz'])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file',
                default_value=defaults,
                description='ROS 2 parameter file. By default all markers make one body.',
            ),
            DeclareLaunchArgument(
                'namespace', default_value='', description='Namespace of the node.'
            ),
            DeclareLaunchArgument(
                'markers',
                default_value='markers',
                description='Topic of the markers, if params_file does not set marker_topic.',
            ),
            DeclareLaunchArgument(
                'use_sim_time',
                default_value='false',
                description='Whether the clock is /clock, of a simulation or a bag.',
            ),
            DeclareLaunchArgument(
                'rviz', default_value='false', description='Whether to start RViz too.'
            ),
            DeclareLaunchArgument(
                'frame', default_value='world', description='Frame of the markers, for RViz.'
            ),
            # Managed: it configures and activates itself, unless autostart is false.
            LifecycleNode(
                package='kinpole_ros',
                executable='kinpole_node',
                name='kinpole',
                namespace=LaunchConfiguration('namespace'),
                parameters=[
                    LaunchConfiguration('params_file'),
                    {'use_sim_time': LaunchConfiguration('use_sim_time')},
                ],
                remappings=[('markers', LaunchConfiguration('markers'))],
                output='screen',
            ),
            Node(
                package='rviz2',
                executable='rviz2',
                namespace=LaunchConfiguration('namespace'),
                arguments=['-d', drawings, '-f', LaunchConfiguration('frame')],
                # The topic that kinpole.rviz names, in the namespace.
                remappings=[('/kinpole/visualization', 'kinpole/visualization')],
                condition=IfCondition(LaunchConfiguration('rviz')),
            ),
        ]
    )
