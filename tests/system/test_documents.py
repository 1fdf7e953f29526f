"""The documents are true: every command, program and file in them is run."""

import io
import os
import pkgutil
import re
import signal
from contextlib import ExitStack, closing, contextmanager, nullcontext, redirect_stdout, suppress
from pathlib import Path

import pytest
from tests.benchmarks.__main__ import available
from tests.host.experiments.one_process import run_here
from tests.system.document import REASONS, blocks_of, inline_commands, words_of
from tests.system.flashing.small_firmware import NEW, OLD
from tests.system.flashing.unix_board import boards_in
from tests.system.simulated_link import SimulatedLink
from tests.virtual_array import SimulatedArray, virtual_time

from mdms_array.source import open_program
from mdms_host.cli import main, reference_pages
from mdms_host.cli.exits import INTERRUPTED, ExitCode
from mdms_host.cli.verbs import VERBS, build_parser
from mdms_host.commissioning.array_file import (
    ArrayFile,
    FiledCell,
    FiledTable,
    array_document,
    read_array,
)
from mdms_host.programs.traffic.dispatch import VirtualExecutor
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob
from mdms_protocol.generators import generate
from mdms_sim.nodes.python_bank import PythonBank

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
#: With those of the folders, which are read beside the code.
FOLDERS = ("docs", "firmware", "host", "protocol", "sim_bus")
ALL = [*ROOT.glob("*.md"), *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.md"))]
#: The names that the changelog calls removed.
GONE = {"mdms flash --crash-log"}
RUN = [
    path.name for path in DOCUMENTS if any(block.language != "text" for block in blocks_of(path))
]
#: Verbs that look after cells.
ON_A_BUS = {"commission", "doctor", "identify", "jog", "scan", "configure", "stop"}
#: The reader's own table is empty until a person puts the box onto it, before a program runs.
EMPTY = "fault=[]"
#: Blocks that another test runs as they stand, with the call; nothing else goes on with them.
ELSEWHERE = {"mdms demo": ("host/cli/simulation/test_simulate.py", 'main(["demo", "--out"')}
#: The answers of a person at `mdms commission`: Enter to all questions but the yes.
CELLS, AXES_OF_ROWS = 18, 2 * 3
ANSWERS = CELLS * "\n" + "\n" + "y\n" + AXES_OF_ROWS * "\n"


#: The commands that the reader of a page has run before it.
BEFORE = {"updates.md": "mdms commission --columns 6 --rows 3"}


class Reader:
    """Somebody who follows a document, with a table, two boards and a terminal."""

    def __init__(self, folder, monkeypatch, capsys, stack):
        self._folder, self._patch, self._capsys, self._stack = folder, monkeypatch, capsys, stack
        self._boards = False
        self._table = None
        self._lifted = None
        # Documents are not about how long the animation of several parcels is.
        monkeypatch.setattr("mdms_sim.plots.animation.MOST_FRAMES", 5)
        # Nor about the processes of a sweep.
        run_here(monkeypatch)
        monkeypatch.chdir(folder)
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
        monkeypatch.setattr("mdms_array.operation.open_links", self._open_links)
        monkeypatch.setattr("mdms_array.operation.ThreadExecutor", VirtualExecutor)
        monkeypatch.setattr("mdms_host.cli.array.cells.open_bus", lambda _options: None)
        monkeypatch.setattr("mdms_host.cli.array.cells.open_links", self._open_link)

    def read(self, block):
        if block.name:
            (self._folder / block.name).write_text(block.text)
        elif block.language == "sh":
            for line in block.lines:
                self._type(line)
        elif block.language == "python" and "SCENARIO = " in block.text:
            (self._folder / "program.py").write_text(block.text)
            self.do("mdms simulate program.py")
        elif block.language == "python":
            exec(compile(block.text, "document", "exec"), {})
        elif block.language == "toml" and "[[cell]]" in block.text:
            (self._folder / "table.toml").write_text(block.text)
            read_array(self._folder / "table.toml")
        elif block.text.startswith("[stop]") and Path("array.toml").exists():
            with Path("array.toml").open("a") as file:
                file.write(block.text)
            read_array(Path("array.toml"))
        elif block.language == "toml":
            based = "" if "scenario = " in block.text else 'scenario = "array18"\n'
            (self._folder / "part.toml").write_text(based + block.text)
            load_scenario(self._folder / "part.toml")

    def _type(self, line):
        words, comment = words_of(line)
        if words[0] == "export":
            self._export(words[1:])
        elif words[0] == "make":
            self.do(recipe(words[1]))
        elif "until Ctrl-C" in comment:
            start_and_end(words)
        else:
            self.do(" ".join(line.partition("  #")[0].split()))

    def _export(self, assignments):
        """The bus of the document is the virtual one, under any name there."""
        named = dict(each.split("=") for each in assignments)
        assert named.keys() <= {"CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE"}
        for name, value in named.items():
            self._patch.setenv(name, value)

    def do(self, command):
        if command is None:
            return
        if command in ELSEWHERE:
            test, call = ELSEWHERE[command]
            assert call in (ROOT / "tests" / test).read_text()
            return
        command, _, target = command.partition(" > ")
        words, _ = words_of(command)
        assert words.pop(0) == "mdms", command
        verb = words[0]
        on_a_bus = verb in ON_A_BUS or "--bus" in words
        if verb == "flash" and on_a_bus:
            self._patch.setattr(
                "mdms_host.flashing.bundles.packed_firmware", lambda _bytecode: bytes(1000)
            )
        elif verb == "flash":
            self._plug_in()
            # The unix port does not report which board it is.
            words += ["--board", "pybv11"] if "--list" not in words else []
        if verb == "commission":
            terminal = io.StringIO(ANSWERS)
            terminal.isatty = lambda: True
            self._patch.setattr("sys.stdin", terminal)
        if "--array" in words and verb == "run" and self._table is None:
            write_array(Path(words[words.index("--array") + 1]))
        elif verb == "run" and self._lifted:
            self._put_down()
        with self._commissioned() if on_a_bus else nullcontext():
            code = main(words)
        printed = self._capsys.readouterr()
        assert code == ExitCode.OK, (command, printed)
        if target:
            Path(target).write_text(printed.out)

    def _plug_in(self):
        if not self._boards:
            self._boards = True
            plug_in = self._stack.enter_context(boards_in(self._folder / "boards"))
            ports = [Port(plug_in(files).port) for files in (OLD.files, {})]
            self._patch.setattr("mdms_host.flashing.board_link.list_ports", lambda: ports)
            self._patch.setattr(
                "mdms_host.flashing.firmware.compiled_firmware", lambda _machine: NEW
            )

    @contextmanager
    def _open_link(self, _options, _channels=()):
        with SimulatedLink.around(self._table.simulation) as link:
            yield link, link

    @contextmanager
    def _open_links(self, arguments, _channels=()):
        """The reader's own table if there is one, or else the table of the program."""
        if self._table is not None:
            with self._open_link(arguments) as opened:
                yield opened
            return
        changes = [*arguments.overrides, "run.fidelity=firmware"]
        with SimulatedLink(open_program(arguments.program, changes)[0]) as link:
            yield link, link

    def _commissioned(self):
        """Cells that are blank until they are commissioned, and the time that they live in."""
        if self._table is None:
            bank = self._stack.enter_context(closing(PythonBank([cob.NODE_NONE] * CELLS)))
            self._table = SimulatedArray(bank, EMPTY)
            faults = self._table.simulation.faults
            self._lifted = faults.begin(Fault("lift", parcel="box"))
        return virtual_time(self._table)

    def _put_down(self):
        self._table.simulation.faults.end(self._lifted)
        self._lifted = None


class Port:
    """A serial port with a board of MicroPython's behind it."""

    vid, pid, serial_number, product = 0xF055, 0x9800, None, None

    def __init__(self, device):
        self.device = device


def write_array(path):
    """The array file of the prototype, as `mdms commission` would have left it."""
    cells = tuple(FiledCell(number, number, {}, number=number) for number in range(1, 19))
    table = FiledTable(columns=6, rows=3)
    path.write_text(array_document(ArrayFile(path, table, cells)))


def recipe(target):
    """The command that `make` runs for a target, which is one of ours."""
    text = (ROOT / "Makefile").read_text()
    found = re.search(rf"^{target}: .*\n\t\$\(BIN\)/(mdms .*)$", text, re.MULTILINE)
    assert found, f"make {target} runs no command of ours"
    return found[1]


class UntilALine(io.StringIO):
    """The screen of a person that presses Ctrl-C as soon as there is a line."""

    def write(self, text):
        done = super().write(text)
        if "\n" in text and self.getvalue().count("\n") == text.count("\n"):
            os.kill(os.getpid(), signal.SIGINT)
        return done


def start_and_end(words):
    """Run a command that goes on until Ctrl-C, and press that when it has printed a line."""
    with redirect_stdout(UntilALine()) as shown, suppress(KeyboardInterrupt):
        assert main(words[1:]) in (ExitCode.OK, INTERRUPTED), words
    assert "\n" in shown.getvalue(), words


@pytest.mark.slow
@pytest.mark.parametrize("name", RUN)
def test_everything_in_a_document_runs(name, tmp_path, monkeypatch, capsys):
    path = next(path for path in DOCUMENTS if path.name == name)
    monkeypatch.setenv("BROWSER", "true")
    with ExitStack() as stack:
        reader = Reader(tmp_path, monkeypatch, capsys, stack)
        reader.do(BEFORE.get(name))
        for block in blocks_of(path):
            if not block.not_run:
                reader.read(block)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_block_that_is_not_run_is_marked_as_such(path):
    for block in blocks_of(path):
        assert block.language in ("sh", "python", "toml", "text"), block
        if block.not_run:
            pattern = REASONS[block.not_run]
            assert all(re.fullmatch(pattern, line) for line in block.lines), block


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_files_that_are_to_be_saved_are_used(path):
    blocks = blocks_of(path)
    for block in blocks:
        if block.name:
            assert any(block.name in each.text for each in blocks if each is not block), block.name


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_verbs_and_options_within_sentences_exist(path):
    for command in inline_commands(path) - GONE:
        words = command.split()
        if not words[1].startswith("-"):
            assert offered(words[1]) >= {word for word in words if word.startswith("--")}, command


def offered(verb):
    """The options of a verb and of its actions."""
    parser = build_parser()
    (choices,) = (
        each.choices for each in parser._actions if each.choices and not each.option_strings
    )
    options = {"--version", "--help"}
    for each in walk(choices[verb]):
        options |= {*each._option_string_actions}
    return options


def walk(parser):
    parser.add_late_options()
    yield parser
    for action in parser._actions:
        if isinstance(action.choices, dict):
            for inner in action.choices.values():
                yield from walk(inner)


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(path):
    for target, heading in re.findall(r"\]\(([^)#\s]*)#?([^)]*)\)", path.read_text()):
        if target.startswith("http"):
            continue
        file = path.parent / target if target else path
        assert file.exists(), target
        assert not heading or heading in headings(file), f"{target}#{heading}"


def headings(path):
    """The headings of a document as links call them."""
    found = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in found}


def test_sections_that_the_code_names_exist():
    """As `docs/cells.md, 'A beat'`, or 'A beat' in docs/cells.md."""
    found = 0
    for source in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        text = " ".join(re.sub(r"\n\s*(#:?)?", " ", source.read_text()).split())
        named = re.findall(r"([\w/-]+\.md)`?, '([^'`]+)'", text)
        named += [pair[::-1] for pair in re.findall(r"['`](\w[^'`]*)['`] in `?([\w/-]+\.md)", text)]
        for page, section in named:
            lines = (ROOT / page).read_text().splitlines()
            assert section in [each.lstrip("# ") for each in lines if each[:1] == "#"], source
            found += 1
    assert found > 5


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_lines_are_no_longer_than_120_but_rows_of_tables(path):
    if path not in {**reference_pages.outputs(), **generate.outputs()}:
        lines = path.read_text().splitlines()
        assert [each for each in lines if len(each) > 120 and not each.startswith("|")] == []


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_tests_and_benchmarks_that_are_named_exist(path):
    text = path.read_text()
    modules = [*(ROOT / "tests").rglob("test_*.py")]
    tests = {each.stem for each in modules}
    tests.update(*(re.findall(r"^def (test_\w+)", each.read_text(), re.M) for each in modules))
    assert {*re.findall(r"`(?:[\w/]+/)?(test_\w+)`", text)} <= tests
    benchmarks = {*available(), *available().values()}
    assert {*re.findall(r"tests\.benchmarks\s([a-z]\w*)", text)} <= benchmarks
    assert {*re.findall(r"tests\.benchmarks\.[\w.]+\w", text)} <= benchmarks


def test_modules_in_the_map_of_the_code_exist():
    """A name without a folder is in the folder of the name before it."""
    for table in (ROOT / "docs" / "code.md").read_text().split("| module | noun |")[1:]:
        for row in table.split("\n\n")[0].splitlines()[2:]:
            folder = ROOT / "host" / "mdms_host"
            for name in re.findall(r"`([\w/]+)`", row.split("|")[1]):
                path = (ROOT / "host" / "mdms_host" if "/" in name else folder) / name
                assert path.is_dir() or path.with_suffix(".py").exists(), row
                folder = path.parent


def test_functions_of_the_equations_exist():
    table = (ROOT / "docs" / "researcher.md").read_text().split("## Equations")[1]
    names = re.findall(r"`([a-z_]\w*(?:\.\w+)+)`", table.split("\n\n")[1])
    assert len(names) > 10
    for name in names:
        packages = ("", "mdms_model.", "mdms_sim.")
        assert any(leads_somewhere(f"{package}{name}") for package in packages), name


def leads_somewhere(name):
    """Whether a dotted name is that of a module, or of something in one."""
    with suppress(ImportError, AttributeError):
        return pkgutil.resolve_name(name) is not None
    return False


def test_every_verb_is_in_the_table_of_the_command():
    table = (ROOT / "docs" / "command.md").read_text().split("| verb | does |\n")[1]
    rows = table.split("\n\n")[0]
    assert all(f"`mdms {verb.name}" in rows for verb in VERBS)


def test_every_benchmark_is_on_the_page_of_experiments():
    table = (ROOT / "docs" / "experiments.md").read_text().split("| name | measures |\n")[1]
    rows = table.split("\n\n")[0].splitlines()[1:]
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])} == {
        *available()
    }


def test_pins_in_the_drawing_are_those_of_the_board():
    drawn = re.findall(r">(D\d+)<", (ROOT / "docs" / "wiring-cell.svg").read_text())
    module = (ROOT / "firmware" / "boards" / "teensy41.py").read_text()
    assert sorted(drawn) == sorted({*re.findall(r'"(D\d+)"', module), "D22", "D23"})


@pytest.mark.parametrize(
    ("heading", "folder"),
    [
        ("Model", "mdms_model"),
        ("Simulator", "mdms_sim"),
        ("Physics", "mdms_sim/physics"),
        ("Bus", "mdms_sim"),
    ],
)
def test_the_map_of_the_virtual_array_names_modules_that_there_are(heading, folder):
    package = ROOT / "sim_bus" / folder
    section = (ROOT / "sim_bus" / "README.md").read_text().split(f"\n## {heading}\n")[1]
    table = section.split("|---|---|\n")[1].split("\n\n")[0]
    for row in table.splitlines():
        names, told = row.strip("| ").split(" | ", 1)
        places = [package / name.rstrip("/") for name in re.findall("`([^`]+)`", names)]
        for place in places:
            assert place.is_dir() or place.with_suffix(".py").is_file(), row
        within = [path for place in places if place.is_dir() for path in place.rglob("*")]
        modules = {path.stem for path in within}
        if within:
            # Tables of a scenario stand there too.
            words = [name.rstrip("/") for name in re.findall("`([^`\\[]+)`", told)]
            assert {*words} <= modules, row
