"""The cache of compiled code, as several processes use it at once."""

import numba
import numpy as np
import pytest

from mdms_model.compiled import CacheFile, compiled, for_types_of


def cache(path, version):
    return CacheFile(str(path), "module.function-1.py311", version)


def test_what_was_saved_is_found_by_others(tmp_path):
    cache(tmp_path, "new").save("int", "code of int")
    cache(tmp_path, "new").save("float", "code of float")
    assert cache(tmp_path, "new").load("int") == "code of int"
    assert cache(tmp_path, "new").load("float") == "code of float"
    assert cache(tmp_path, "old").load("int") is None


def test_a_reader_never_finds_code_of_another_version_however_a_writer_is_overtaken(tmp_path):
    cache(tmp_path, "old").save("int", "old code")
    writer, found = cache(tmp_path, "new"), []

    def overtaken(step):
        def slow(*arguments):
            found.append(cache(tmp_path, "new").load("int"))
            step(*arguments)
            found.append(cache(tmp_path, "new").load("int"))

        return slow

    writer._save_index = overtaken(writer._save_index)
    writer._save_data = overtaken(writer._save_data)
    writer.save("int", "new code")
    assert found == [None, None, None, "new code"]


def test_two_signatures_that_are_saved_at_once_do_not_change_places(tmp_path):
    one, other = cache(tmp_path, "new"), cache(tmp_path, "new")
    step = one._save_index
    one._save_index = lambda listed: (other.save("float", "code of float"), step(listed))
    one.save("int", "code of int")
    # What one of them did not know of is compiled again.
    assert cache(tmp_path, "new").load("int") in (None, "code of int")
    assert cache(tmp_path, "new").load("float") in (None, "code of float")


def test_files_of_an_older_version_do_not_pile_up(tmp_path):
    for version in range(5):
        for key in ("int", "float"):
            cache(tmp_path, version).save(key, "code")
    assert len(list(tmp_path.glob("*.nbc"))) == 2


@compiled
def total(values):
    result = 0.0
    for value in values:
        result += value
    return result


def test_code_for_given_types_gives_what_the_function_gives():
    quick = for_types_of(total, np.zeros(3))
    assert quick(np.array([1.0, 2.0, 3.5])) == total(np.array([1.0, 2.0, 3.5])) == 6.5


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_code_for_given_types_refuses_others():
    with pytest.raises(TypeError):
        for_types_of(total, np.zeros(3))([1.0, 2.0])
