"""The installed commands: each imports its module late, so that Ctrl-C before is one line, too."""

from collections.abc import Callable
from importlib import import_module

from emoflow_ros.cli import run


def _command(module: str) -> Callable[[], int]:
    def main() -> int:
        return run(lambda: import_module(f"emoflow_ros.{module}").main())

    return main


replay = _command("commands.replay")
evaluate = _command("evaluation.evaluate_command")
simulate = _command("simulation.simulate")
info = _command("commands.info")
label = _command("labels.label_command")
