"""Merged modules do what they did apart; what cannot be merged safely is refused."""

import importlib
import sys
from types import SimpleNamespace

import pytest

from mdms_image import ImageError, shed, sources
from mdms_image.merge import merge


@pytest.fixture
def merged(tmp_path, monkeypatch):
    """Merge modules given as text, run what came of it, and return its names."""

    def run(**modules):
        package = tmp_path / "toy"
        package.mkdir()
        (package / "__init__.py").write_text("")
        for name, text in modules.items():
            (package / f"{name}.py").write_text(text)
        (tmp_path / "main.py").write_text("from toy.entry import result\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.setattr(sources, "PACKAGES", ("toy",))
        monkeypatch.setattr(sources, "_FLASHED", tmp_path)
        made = merge("main", {"toy.entry.result": "result"}, emits=False)
        space = {}
        exec(made.sources["mdms"], space)
        return space, made

    return run


def test_names_of_two_modules_stay_two(merged):
    space, _ = merged(
        other="def value():\n    return 1\n\ndef twice():\n    return value() + value()\n",
        entry="from toy import other\n\ndef value():\n    return 10\n\n"
        "def result():\n    return other.twice() + value() + value()\n",
    )
    assert space["result"]() == 22


def test_constants_are_inlined_and_what_is_not_used_is_gone(merged):
    space, made = merged(
        other="A = 3\nB = A << 2\n\ndef unused():\n    return B\n",
        entry="from toy.other import B\n\ndef result():\n    return B\n",
    )
    assert space["result"]() == 12
    assert set(made.names) == {"toy.entry.result"}


def test_private_attributes_of_two_classes_do_not_meet(merged):
    space, _ = merged(
        entry=(
            "class A:\n"
            "    def __init__(self, other):\n        self._one = 1\n        self._other = other\n"
            "    def sum(self):\n        return self._one + self._other.sum()\n"
            "class B:\n"
            "    def __init__(self):\n        self._two = 20\n        self._one = 300\n"
            "    def sum(self):\n        return self._two + self._one\n"
            "def result():\n    return A(B()).sum()\n"
        )
    )
    assert space["result"]() == 321


FOLDED = """
class Thing:
    def __init__(self):
        self.log = []

    def run(self, value):
        self._note(value)
        low, high = self._split(value)
        value = self._twice(value)
        return self._last(low, high, value)

    def _note(self, value):
        if value < 0:
            return
        low = value
        self.log.append(low)

    def _split(self, number):
        high = number // 10
        low = number % 10
        value = [high for high in (low, high)]
        return value

    def _twice(self, low):
        low += low
        return low

    def _last(self, high, low, value):
        if value > 100:
            return "big"
        return [high, low, value, self.log]

def result():
    return [Thing().run(each) for each in (42, -3, 77)]
"""


def test_folded_functions_keep_their_own_names_apart(merged):
    space, made = merged(entry=FOLDED)
    assert space["result"]() == [[2, 4, 84, [42]], [7, -1, -6, []], "big"]
    assert made.sources["mdms"].count("def ") == 3


CALLED_ACROSS = """
class Store:
    def __init__(self):
        self._kept = [1]
    def save(self, value):
        from toy.seldom import doubled
        self._kept = self._kept + [doubled(value)]
    def kept(self):
        return self._kept
class Owner:
    def __init__(self, store):
        self._store = store
    def run(self, value):
        doubled = value + 1
        self._store.save(doubled)
        return doubled
def result():
    store = Store()
    return [Owner(store).run(5), store.kept()]
"""


def test_method_that_one_place_calls_is_folded_into_another_class(merged, tmp_path, monkeypatch):
    seldom = "def doubled(value):\n    return 2 * value\n"
    space, made = merged(entry=CALLED_ACROSS, seldom=seldom)
    assert "def save" not in made.sources["mdms"]
    unit = {}
    exec(made.sources["mdms_seldom"].partition("\n")[2], unit)
    monkeypatch.setitem(sys.modules, "mdms_seldom", SimpleNamespace(**unit))
    assert space["result"]() == [6, [1, 12]]


STARTED = """
class Base:
    def __init__(self, size):
        self.size = size
        self._fill()
    def _fill(self):
        self.items = [place for place in range(self.size)]
class Kept(Base):
    def __init__(self, size, *, extra):
        super().__init__(size)
        self._extra = extra
    def total(self):
        return sum(self.items) + self._extra
def made(size):
    return Kept(size, extra=100)
"""


def test_constructors_that_only_the_start_calls_are_in_its_file(merged, monkeypatch):
    monkeypatch.setattr(shed, "START_MODULE", "toy.start")
    space, made = merged(
        start=STARTED,
        entry="def result():\n    from toy.start import made\n\n    return made(4).total()\n",
    )
    assert "__init__" not in made.sources["mdms"].replace("not __name__", "")
    assert "def total" not in made.sources["mdms_start"]
    mdms = SimpleNamespace(**space)
    monkeypatch.setitem(sys.modules, "mdms", mdms)
    unit = {}
    exec(made.sources["mdms_start"], unit)
    monkeypatch.setitem(sys.modules, "mdms_start", SimpleNamespace(**unit))
    assert space["result"]() == 106
    assert "mdms_start" not in sys.modules


LOOPED = """
class Thing:
    def __init__(self, items):
        self.items = items
    @property
    def late(self):
        return any(each > 5 for each in self.items)
    def pairs(self, each):
        found = [(each, other) for each in self.items for other in self.items if each < other]
        return [found, each]
    def shadow(self, items):
        items = [items for items in items if items]
        return items
    def early(self):
        told = all(each < 3 for each in self.items)
        return told
def result():
    return [Thing(items).late for items in ([1, 7], [2])] + [
        Thing([1, 2]).pairs("own"), Thing([]).shadow([0, 3]), Thing([1]).early(), Thing([3]).early()
    ]
"""


def test_comprehensions_that_became_loops_tell_the_same(merged):
    plain = {}
    exec(LOOPED, plain)
    space, made = merged(entry=LOOPED)
    assert space["result"]() == plain["result"]()
    assert "any(" not in made.sources["mdms"]


def test_what_a_function_imports_is_a_file_that_is_forgotten(merged):
    _, made = merged(
        seldom="LIMIT = 5\n\ndef work(value):\n    return value + LIMIT\n",
        entry="def result(value):\n    from toy.seldom import work\n\n    return work(value)\n",
    )
    assert set(made.sources) == {"mdms", "mdms_seldom"}
    assert "del sys.modules" in made.sources["mdms"]


def test_file_of_another_image_refuses_to_be_loaded(merged, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    entry = "def result(value):\n    from toy.seldom import work\n\n    return work(value)\n"
    _, made = merged(seldom="def work(value):\n    return value + 1\n", entry=entry)
    for unit, source in made.sources.items():
        (tmp_path / f"{unit}.py").write_text(source)
    loaded = importlib.import_module("mdms")
    assert loaded.result(1) == 2
    (tmp_path / "toy" / "seldom.py").write_text("def work(value):\n    return value + 2\n")
    other = merge("main", {"toy.entry.result": "result"}, emits=False)
    (tmp_path / "mdms_seldom.py").write_text(other.sources["mdms_seldom"])
    importlib.invalidate_caches()
    try:
        with pytest.raises(ImportError):
            loaded.result(1)
    finally:
        del sys.modules["mdms"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("from toy import other\n\ndef result():\n    return other\n", "used as a value"),
        ("A = 1\nA = 2\n\ndef result():\n    return A\n", "bound twice"),
        ("N = []\n\ndef result():\n    global N\n    N = 1\n", "Global"),
        ("def result():\n    class A:\n        pass\n    return A\n", "inside a function"),
        ("for each in (1, 2):\n    print(each)\n\ndef result():\n    pass\n", "can be merged"),
        ("def result():\n    return other.missing\n\nfrom toy import other\n", "no missing"),
        ("class A:\n    x = late()\n\ndef late():\n    pass\n\nresult = A\n", "comes after"),
    ],
)
def test_what_cannot_be_merged_is_refused(merged, text, why):
    with pytest.raises(ImageError, match=why):
        merged(other="B = 1\n", entry=text)
