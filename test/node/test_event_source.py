"""What the node listens to while the graph around it changes; the graph and the time are fakes."""

import time

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")
pytest.importorskip("dvs_msgs.msg", reason="no dvs_msgs: run scripts/build_test_messages.sh")

from graph import DVS, Graph
from headers import message

from emoflow_ros.node.backlog import LeftOut
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_source import Callbacks, EventSource
from emoflow_ros.node.reports import Level
from emoflow_ros.node.tasks import Loss
from emoflow_ros.node.topic_search import SETTLING_S, EventTopic, TopicSearch

LENGTH_NS = 20_000_000
ONE, TWO, ASKED = "/one/events", "/two/events", "/events"


class Bench:
    """A source in a graph, with what it told."""

    def __init__(self, *topics: str, namespace: str = "/") -> None:
        self.graph = Graph(dict.fromkeys(topics, DVS), namespace=namespace)
        self.statistics = Statistics()
        self.taken: list[str] = []
        self.received: list[bytes] = []
        self.skips: list[LeftOut] = []
        self.pause_s = 0.0  # for each message
        self.obstacle = ""
        self.used = False
        self.source = EventSource(
            self.graph,  # type: ignore[arg-type]
            search=TopicSearch(self.graph, "", self.graph.clock),  # type: ignore[arg-type]
            obstacle=lambda: self.obstacle,
            is_used=lambda: self.used,
            length_ns=lambda: LENGTH_NS,
            callbacks=Callbacks(
                self._take, self._receive, lambda: None, self.skips.append, lambda info: None
            ),
            statistics=self.statistics,
        )

    def _take(self, topic: EventTopic) -> None:
        self.taken.append(topic.name)

    def _receive(self, data: bytes, part: int) -> None:
        assert part == 1
        time.sleep(self.pause_s)
        self.received.append(data)

    @property
    def problem(self) -> tuple[Level, str] | None:
        return self.statistics.problems.get("input")

    @property
    def listens(self) -> set[str]:
        return set(self.graph.callbacks)

    def look(self, seconds: float = SETTLING_S) -> None:
        """Look now, and again after some seconds."""
        for pause in (0.0, seconds):
            self.graph.now += pause
            if self.graph.tick is not None:
                self.graph.tick()


def test_nothing_is_taken_before_the_worker_is_ready() -> None:
    bench = Bench(ASKED)
    bench.obstacle = "the worker is starting"
    bench.look()
    assert bench.listens == set()
    assert bench.problem == (Level.WARN, "the worker is starting")
    bench.obstacle = "the worker died; it is started again"
    bench.statistics.add_loss(Loss(bench.obstacle, worker=True))
    bench.look()
    assert bench.problem == (Level.ERROR, "the worker died; it is started again")
    bench.obstacle = ""
    bench.look()
    assert bench.listens == {ASKED, "/camera_info"}
    assert bench.problem is None


def test_topic_that_was_asked_for_is_kept_whatever_appears() -> None:
    bench = Bench(ASKED)
    bench.look(0.0)
    bench.graph.topics[ONE] = DVS
    bench.look()
    assert bench.taken == [ASKED]
    assert bench.listens == {ASKED, "/camera_info"}


def test_second_topic_before_the_first_event_opens_the_choice_again() -> None:
    bench = Bench(ONE)
    bench.look()
    assert bench.listens == {ONE, "/one/camera_info"}
    bench.graph.topics[TWO] = DVS
    bench.look()
    assert bench.listens == set()
    assert bench.problem is not None
    assert bench.problem[0] is Level.ERROR
    assert bench.problem[1].startswith(f"events: 2 event topics: {ONE}, {TWO}; choose with")
    del bench.graph.topics[ONE]
    bench.look()
    assert bench.listens == {TWO, "/two/camera_info"}
    assert bench.taken == [ONE, TWO]
    assert bench.problem is None


def test_events_under_their_own_name_replace_a_topic_without_events_yet() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.graph.topics[ASKED] = DVS
    bench.look(0.0)
    assert bench.listens == {ASKED, "/camera_info"}


def test_topic_whose_publisher_went_is_kept_until_there_is_another() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.graph.topics.clear()
    bench.look()
    assert bench.listens == {ONE, "/one/camera_info"}
    bench.graph.topics[TWO] = DVS
    bench.look()
    assert bench.listens == {TWO, "/two/camera_info"}


def test_second_topic_after_the_first_event_is_named_once() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.graph.callbacks[ONE](b"events")
    bench.graph.topics[TWO] = DVS
    bench.look()
    bench.look()
    assert bench.received == [b"events"]
    assert bench.listens == {ONE, "/one/camera_info"}
    warnings = [line for level, line in bench.graph.log if level == "warning"]
    assert warnings == [
        f"listening to {ONE}; event topics besides it: {TWO}; "
        f"choose with --ros-args -r events:={TWO}"
    ]
    assert bench.problem is None


def test_events_under_their_own_name_replace_a_topic_until_its_events_are_used() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.graph.callbacks[ONE](b"events")
    bench.graph.topics[ASKED] = DVS
    bench.look(0.0)
    assert bench.taken == [ONE, ASKED]
    assert bench.listens == {ASKED, "/camera_info"}
    assert [level for level, _ in bench.graph.log if level == "warning"] == []


def test_events_under_their_own_name_do_not_mix_with_a_topic_in_use() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.graph.callbacks[ONE](b"events")
    bench.used = True
    bench.graph.topics[ASKED] = DVS
    bench.look()
    assert bench.listens == {ONE, "/one/camera_info"}
    assert bench.graph.log[-1] == (
        "warning",
        f"listening to {ONE}; event topics besides it: {ASKED}; "
        f"choose with --ros-args -r events:={ASKED}",
    )


def test_other_camera_s_topic_is_not_taken_in_a_namespace() -> None:
    bench = Bench("/left/events", namespace="/right")
    bench.look()
    assert bench.listens == set()
    waiting = (
        "waiting for events: nobody publishes /right/events; outside the node's namespace: "
        "/left/events; choose with --ros-args -r events:=/left/events"
    )
    assert bench.problem == (Level.WARN, waiting)
    bench.graph.topics["/right/events"] = DVS
    bench.look(0.0)
    assert bench.taken == ["/right/events"]
    assert bench.listens == {"/right/events", "/right/camera_info"}


def test_stop_leaves_no_subscription_and_looks_no_longer() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.source.stop()
    assert bench.listens == set()
    assert bench.graph.tick is None
    assert bench.graph.guards == []


def test_messages_that_wait_in_the_middleware_come_with_the_one_that_is_called_for() -> None:
    bench = Bench(ONE)
    bench.look()
    bench.graph.sent += [b"second", b"third"]
    bench.graph.callbacks[ONE](b"first")
    assert bench.graph.sent == []
    [go_on] = bench.graph.guards
    for _ in range(2):  # on a busy machine a turn may be over after each message
        go_on()
    assert bench.received == [b"first", b"second", b"third"]


@pytest.mark.parametrize("end", ["stop", "topic"])
def test_messages_that_wait_are_not_taken_after_the_end(end: str) -> None:
    bench = Bench(ONE)
    bench.look()
    bench.pause_s = 0.006  # longer than a turn
    bench.graph.sent += [b"second", b"third"]
    bench.graph.callbacks[ONE](b"first")
    [go_on] = bench.graph.guards
    if end == "stop":
        bench.source.stop()
    else:
        bench.graph.topics[ASKED] = DVS
        bench.look(0.0)
    go_on()
    assert bench.received == [b"first"]
    assert go_on not in bench.graph.guards


def test_messages_that_are_left_out_are_told_to_who_takes_the_others() -> None:
    bench = Bench(ONE)
    bench.look()
    messages = [message(t) for t in range(0, 61, 5)]
    for data in messages[:5]:  # 20 ms have been taken
        bench.graph.callbacks[ONE](data)
    bench.graph.sent += messages[6:]
    bench.graph.callbacks[ONE](messages[5])
    assert bench.received == [*messages[:5], messages[-1]]
    assert bench.skips == [LeftOut(7, jump=0)]
    assert bench.statistics.counts["messages_skipped"] == 7


def test_a_second_publisher_that_is_not_heard_is_no_lasting_problem() -> None:
    b = Bench("/events")
    b.look()
    b.source._take_events(b"", 1)
    b.statistics.set_problem("qos", Level.ERROR, "no event arrives")  # of the second publisher
    b.source._take_events(b"", 1)
    assert "qos" not in b.statistics.problems
