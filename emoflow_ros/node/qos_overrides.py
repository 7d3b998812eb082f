"""ROS's parameters qos_overrides, for subscriptions whose own choice may change."""

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions

_POLICIES = QoSOverridingOptions.with_default_policies().policy_kinds


def given_overrides(node: Node, topic: str) -> QoSOverridingOptions:
    """Return which policies of subscriptions to a topic (its full name) the user has given.

    rclpy declares a parameter for every policy that may be overridden, read-only and with the
    choice of the first subscription, which all later ones to that topic would take over.
    """
    names = {p: f"qos_overrides.{topic}.subscription.{p.name.lower()}" for p in _POLICIES}
    return QoSOverridingOptions([p for p, name in names.items() if _is_given(node, name)])


def _is_given(node: Node, name: str) -> bool:
    if node.has_parameter(name):  # by a subscription before, since it was given
        return True
    node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True))
    given = node.get_parameter(name).value is not None
    node.undeclare_parameter(name)
    return given
