"""A running node that several tests use one after another, each with a configuration of its own."""

from collections.abc import Mapping
from typing import Any

from harness import Peer, Processes
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter

type Values = Mapping[str, str | int | float]

# Not the name of the nodes that tests start for themselves, whose services are thus their own.
NAME = "shared"


class SharedNode:
    """A node whose process is started once, and configured anew by every test that uses it.

    Between tests it is unconfigured: it has no worker, no topics and no memory of the test
    before but the throttling of its log. One that has died is started again.

    Args:
        processes: what it is started with; it starts nothing else.
        factory: `module:function` that makes the estimator in the worker.
        *parameters: as in `name:=value`, for all tests.
    """

    def __init__(self, processes: Processes, factory: str, *parameters: str) -> None:
        self._processes = processes
        self._factory = factory
        self._parameters = ("output.diagnostics_s:=0.1", *parameters, "autostart:=false")
        self._peer: Peer | None = None
        self._before = 0  # length of the output of the tests before
        self._changed: dict[str, ParameterMessage] = {}

    @property
    def pid(self) -> int:
        """Process id of the node."""
        return self._processes.started[-1].pid

    @property
    def is_running(self) -> bool:
        """Whether there is a process."""
        started = self._processes.started
        return bool(started) and started[-1].poll() is None

    @property
    def output(self) -> str:
        """What the node has written since `start`."""
        return self._processes.output(self._processes.started[-1])[self._before :]

    def start(self, peer: Peer, values: Values | None = None) -> None:
        """Configure the node with these parameters for one test, and activate it."""
        if not self.is_running:
            name = ("-r", f"__node:={NAME}")
            self._processes.start_node(self._factory, self._parameters, *name)
            self._before = 0
        self._before += len(self.output)
        self._peer = peer
        self.set(values or {})
        self._change(Transition.TRANSITION_CONFIGURE)
        self._change(Transition.TRANSITION_ACTIVATE)

    def set(self, values: Values) -> None:
        """Set parameters, which the node must accept, until `stop`."""
        names = list(values)
        if not names:
            return
        old = self._call(GetParameters, "get_parameters", names=names).values
        for name, value in zip(names, old, strict=True):
            self._changed.setdefault(name, ParameterMessage(name=name, value=value))
        self._set([Parameter(name, value=values[name]).to_parameter_msg() for name in names])

    def activate_again(self) -> None:
        """Deactivate the node, and activate it."""
        assert self._peer is not None
        events = self._peer.events
        self._change(Transition.TRANSITION_DEACTIVATE)
        self._peer.spin_until(lambda: not events.get_subscription_count(), "it listens no more")
        self._change(Transition.TRANSITION_ACTIVATE)
        self._peer.spin_until(events.get_subscription_count, "it listens again")

    def stop(self) -> None:
        """Take the configuration back; a node that cannot do that is not used again."""
        if self._peer is None:
            return
        print(self.output)  # shown if the test fails
        changed, self._changed = self._changed, {}
        try:
            assert self.is_running, "the node has ended"
            self._change(Transition.TRANSITION_DEACTIVATE)
            self._change(Transition.TRANSITION_CLEANUP)
            self._set(list(changed.values()))
        except AssertionError:
            self._processes.started[-1].kill()
            self._processes.started[-1].wait()
            raise
        finally:
            self._peer = None

    def _set(self, wish: list[ParameterMessage]) -> None:
        answer = self._call(SetParameters, "set_parameters", parameters=wish)
        assert [r.reason for r in answer.results if not r.successful] == []

    def _change(self, transition: int) -> None:
        wish = Transition(id=transition)
        assert self._call(ChangeState, "change_state", transition=wish).success

    def _call(self, service_type: Any, name: str, **request: Any) -> Any:
        assert self._peer is not None
        return self._peer.call(service_type, f"/{NAME}/{name}", **request)
