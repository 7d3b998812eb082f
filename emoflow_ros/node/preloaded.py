"""Imported by the process that workers are forked from: loads the compiled code for all of them.

A worker shares the pages of that code, and estimates from its first window on. Where code has to be
compiled first, no more is loaded: the compiler's memory would stay with every worker.
"""

import gc
from contextlib import suppress

from emoflow_ros.factory import make_estimator
from emoflow_ros.node.compilation import refused
from emoflow_ros.node.warm_up import warm_up

with suppress(Exception), refused():  # a worker's own warm-up says what is wrong
    warm_up(make_estimator)
gc.collect()
gc.freeze()  # else each worker's collector writes to all pages, and gets copies of them
