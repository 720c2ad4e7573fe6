"""Test cached properties, and a fork while another thread computes one."""

import os
import re
import threading
import time
from pathlib import Path

import pytest

import cvxshear
from cvxshear.util.decorators import cached_property


class Slow:
    """Count the computations of its value; wait meanwhile until `begun` is seen."""

    def __init__(self) -> None:
        self.computed, self.wait = 0, threading.Event()

    @cached_property
    def value(self) -> int:
        """Value that takes long to compute."""
        self.computed += 1
        self.wait.wait(5)
        return 7


def test_a_value_is_computed_once_and_kept():
    item = Slow()
    item.wait.set()
    assert (item.value, item.value, item.computed) == (7, 7, 1)
    assert Slow.value.__doc__ == Slow.__dict__["value"].func.__doc__


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_fork_during_a_computation_ends():
    first, second = Slow(), Slow()
    thread = threading.Thread(target=lambda: first.value)
    thread.start()
    while not first.computed:
        time.sleep(0.001)
    child = os.fork()
    if not child:
        second.wait.set()
        os._exit(0 if second.value == 7 else 1)
    for _ in range(500):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        time.sleep(0.01)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the child waits for a lock")
    first.wait.set()
    thread.join()
    assert status == 0


def test_no_module_takes_the_property_with_a_lock():
    sources = {path.name: path.read_text(encoding="utf-8") for path in Path(cvxshear.__file__).parent.rglob("*.py")}
    taken = re.compile(r"from functools import [\w, (\n]*cached_property")
    assert [name for name, text in sources.items() if taken.search(text)] == ["decorators.py"]
