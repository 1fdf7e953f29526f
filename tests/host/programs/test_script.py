"""Coroutines go on when the awaited event has come, in the order in which they were started."""

import asyncio
import re

import pytest

from mdms_host.programs.script import Script, ScriptError, failure_text, until


def test_tasks_go_on_in_the_order_of_their_start_and_within_one_cycle():
    script, log, gate = Script(), [], []

    async def child(name):
        await until(lambda: bool(gate))
        log.append(name)
        return name

    async def parent():
        first, second = script.start(child("a")), script.start(child("b"))
        log.append(await second)
        log.append(await first)

    script.start(parent())
    script.step()
    assert log == []
    gate.append(True)
    script.step()
    assert log == ["a", "b", "b", "a"]


def test_an_error_reaches_the_task_that_awaits_it_and_else_the_driver():
    script, caught = Script(), []

    async def failing():
        await until(lambda: True)
        raise RuntimeError("no way")

    async def careful():
        try:
            await script.start(failing())
        except RuntimeError as error:
            caught.append(str(error))

    script.start(careful())
    assert script.step() is None
    assert caught == ["no way"]
    script.start(failing())
    assert str(script.step()) == "no way"


def test_a_program_that_ends_its_process_has_failed():
    script = Script()

    async def leaves():
        raise SystemExit(0)

    script.start(leaves())
    assert isinstance(script.step(), SystemExit)


def test_a_task_that_is_cancelled_tidies_up_and_goes_no_further():
    script, log = Script(), []

    async def working():
        try:
            await until(lambda: False)
        finally:
            log.append("tidy")
        log.append("never")

    task = script.start(working())
    script.step()
    task.cancel()
    script.step()
    assert task.done
    assert log == ["tidy"]


def test_a_task_that_cancels_itself_is_told_to_return():
    script, tasks = Script(), []

    async def quits():
        tasks[0].cancel()

    tasks.append(script.start(quits()))
    error = script.step()
    assert isinstance(error, ScriptError)
    assert re.match(r"quits \(test_script.py, line \d+\) breaks itself off", str(error))


def test_a_task_that_waits_on_though_it_is_cancelled_is_over_and_has_failed():
    script, log = Script(), []

    async def stubborn():
        try:
            await until(lambda: False)
        finally:
            await until(lambda: False)
            log.append("never")

    task = script.start(stubborn())
    script.step()
    task.cancel()
    error = script.step()
    assert isinstance(error, ScriptError)
    assert re.match(r"stubborn \(test_script.py, line \d+\) is broken off, and waits", str(error))
    assert script.step() is None
    assert log == []


def test_an_awaitable_of_another_loop_is_refused():
    script = Script()

    async def sleeping():
        await asyncio.sleep(1.0)

    async def foreign():
        await asyncio.Future(loop=loop)

    loop = asyncio.new_event_loop()
    try:
        script.start(foreign())
        assert isinstance(script.step(), ScriptError)
    finally:
        loop.close()


async def in_time(reached):
    async with asyncio.timeout(0):
        await until(lambda: bool(reached))


async def beside(reached):
    asyncio.get_running_loop().call_soon(reached.append, 1)
    await until(lambda: bool(reached))


async def within(reached):
    asyncio.run(until(lambda: bool(reached)))


@pytest.mark.parametrize("program", [in_time, beside, within])
def test_asyncio_in_a_task_is_refused_in_a_notebook_too(program):
    """A notebook's loop runs, but it stands as long as the table's time passes."""

    async def cell():
        script, reached = Script(), []
        script.start(program(reached))
        error = script.step()
        assert error is not None
        assert failure_text(error).startswith("asyncio is of no use in a program")
        await asyncio.sleep(0)
        assert asyncio.get_running_loop() is not None
        assert not reached

    asyncio.run(cell())


def test_a_task_that_waits_for_nothing_is_found():
    script = Script()

    async def spinning():
        while True:
            script.start(nothing())
            await until(lambda: True)

    async def nothing():
        script.start(nothing())

    script.start(nothing())
    with pytest.raises(ScriptError, match="without waiting"):
        script.step()


async def endless():
    yield 1


@pytest.mark.parametrize("wrong", [5, endless, endless()], ids=["number", "function", "generator"])
def test_what_is_no_coroutine_is_refused_where_it_is_started(wrong):
    script = Script()

    async def main():
        script.start(wrong)

    script.start(main())
    error = script.step()
    assert isinstance(error, TypeError)
    assert "in main (test_script.py" in failure_text(error)


def test_a_condition_that_fails_is_an_error_of_its_task_alone():
    script, log = Script(), []

    async def waits_for_nonsense():
        try:
            await until(lambda: bool(log) and log[0] < 1)
        finally:
            log.append("tidied up")

    task = script.start(waits_for_nonsense())
    task.heed()
    assert script.step() is None
    log.append("now")
    assert script.step() is None
    assert (task.done, task.cancelled, log) == (True, False, ["now", "tidied up"])
    with pytest.raises(TypeError):
        task.result()
