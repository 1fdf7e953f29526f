"""`mdms help`, `mdms completion` and `mdms --version`."""

import io
import re
import shutil
import subprocess
from contextlib import redirect_stdout

import pytest

from mdms_host.cli import main
from mdms_host.cli.about import TOPICS
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.verbs import VERBS, build_parser


def test_version_names_package_revision_and_protocol(capsys):
    assert main(["--version"]) == ExitCode.OK
    line = capsys.readouterr().out
    pattern = r"mdms \d+\.\d+\.\d+ \((git [0-9a-f]{7,}(-dirty)?, )?protocol 1\.0\)\n"
    assert re.fullmatch(pattern, line), line


@pytest.mark.parametrize("topic", TOPICS)
def test_each_topic_is_a_document(topic, pytestconfig, capsys):
    assert main(["help", topic]) == ExitCode.OK
    assert capsys.readouterr().out == (pytestconfig.rootpath / TOPICS[topic][0]).read_text()


def test_each_page_of_the_guide_is_a_topic(pytestconfig):
    root = pytestconfig.rootpath
    pages = {str(page.relative_to(root)) for page in (root / "docs").rglob("*.md")}
    assert pages <= {name for name, _ in TOPICS.values()}


def test_topics_are_listed_and_others_refused(capsys):
    assert main(["help"]) == ExitCode.OK
    printed = capsys.readouterr().out
    assert all(topic in printed for topic in TOPICS)
    assert main(["help", "love"]) == ExitCode.USAGE
    assert "no such topic; there are start, newcomer, " in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["identify", "simulate array18", "configure show"])
def test_option_that_a_verb_does_not_know_leads_to_the_help_of_that_verb(verb, capsys):
    assert main([*verb.split(), "--wrong"]) == ExitCode.USAGE
    name = "mdms " + verb.removesuffix(" array18")
    said = f"{name}: unrecognized arguments: --wrong; see {name} --help\n"
    assert capsys.readouterr().err == said


def completed(script, *words):
    """The words that bash would offer for the last of these words."""
    line = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; COMP_TYPE=9; _shtab_mdms"
    done = subprocess.run(
        ["bash", "-c", f'source "$0"; {line}; echo "${{COMPREPLY[@]}}"', str(script)],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    path = tmp_path_factory.mktemp("completion") / "mdms.bash"
    with redirect_stdout(io.StringIO()) as printed:
        assert main(["completion", "bash"]) == ExitCode.OK
    path.write_text(printed.getvalue())
    return path


def test_bash_completes_verbs_actions_and_late_options(script):
    assert completed(script, "mdms", "comm") == ["commission"]
    assert {*completed(script, "mdms", "''")} >= {verb.name for verb in VERBS}
    assert completed(script, "mdms", "configure", "du") == ["dump"]
    assert "--bitrate" in completed(script, "mdms", "scan", "--b")


def test_bash_completes_the_options_of_every_verb(script, capsys):
    names = [verb.name for verb in VERBS]
    offer = "COMP_WORDS=(mdms $verb --); COMP_CWORD=2; COMP_TYPE=9; COMPREPLY=(); _shtab_mdms"
    loop = f'for verb in {" ".join(names)}; do {offer}; echo "$verb ${{COMPREPLY[@]}}"; done'
    done = subprocess.run(
        ["bash", "-c", f'source "$0"; {loop}', str(script)],
        capture_output=True,
        text=True,
        check=True,
    )
    offered = {line.split()[0]: {*line.split()[1:]} for line in done.stdout.splitlines()}
    for name in names:
        with pytest.raises(SystemExit):
            build_parser().parse_args([name, "--help"])
        options = {*re.findall(r"(?<![\w-])--[a-z][a-z-]*", usage(capsys.readouterr().out))}
        assert offered[name] >= options, name


def usage(text):
    """The first paragraph of a help text."""
    return text.split("\n\n", 1)[0]


@pytest.mark.parametrize("shell", ["zsh", "tcsh"])
def test_other_shells_have_a_script_too(shell, capsys):
    assert main(["completion", shell]) == ExitCode.OK
    assert "commission" in capsys.readouterr().out
