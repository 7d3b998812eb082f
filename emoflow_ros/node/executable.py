"""The executable `estimator`: heeds SIGINT and SIGTERM before it imports all the rest."""

from emoflow_ros.node.ending import Ending


def main(factory: str | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; `factory` takes the place of the usual estimator's."""
    ending = Ending()
    from emoflow_ros.node.estimator import run_node

    return run_node(ending, factory)
