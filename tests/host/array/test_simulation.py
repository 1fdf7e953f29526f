from types import SimpleNamespace

from mdms_array.run import Finished
from mdms_array.simulation import timed
from mdms_host.clock import MonotonicClock


def compile_something():
    import numba

    numba.njit(lambda x: x + 1)(1)


def test_only_what_is_compiled_during_the_run_is_taken_off_its_time():
    worked_s = []

    def work():
        clock = MonotonicClock()
        clock.sleep(0.01)
        worked_s.append(clock.now_s())
        return Finished(SimpleNamespace(slip_m_s=0.0))

    def prepare():
        compile_something()
        return work

    finished = timed(None, prepare)
    assert finished.compile_s > 0
    assert finished.wall_s >= worked_s[0]


def test_compiling_during_the_run_is_told_apart():
    def work():
        compile_something()
        return Finished(SimpleNamespace(slip_m_s=0.0))

    clock = MonotonicClock()
    finished = timed(None, lambda: work)
    assert finished.compile_s > 0
    assert finished.wall_s + finished.compile_s <= clock.now_s()
