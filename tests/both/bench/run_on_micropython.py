"""Runs the tests of one module on MicroPython: `run(name)` calls every `test_*` of it in turn.

The last line printed is `passed N`, `failed M of N`, or `next K` when the heap is filled as far as
allowed: another interpreter may then go on with test K. Before it, the traceback of every failure.
"""

import gc
import sys


def run(name, first=0, heap_limit=None):
    """Import the module and call its tests in the order of their names, beginning with `first`."""
    module = __import__(name)
    tests = sorted(each for each in dir(module) if each.startswith("test_"))
    failed = 0
    for place in range(first, len(tests)):
        if heap_limit and place > first and gc.mem_alloc() > heap_limit:
            print("next", place)
            return
        try:
            getattr(module, tests[place])()
        except Exception as error:
            failed += 1
            print(name, tests[place])
            sys.print_exception(error, sys.stdout)
    print("failed", failed, "of", len(tests)) if failed else print("passed", len(tests))
