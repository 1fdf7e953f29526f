"""A command line of verbs whose modules are imported only when they are used."""

import gc
from argparse import Action, ArgumentParser, Namespace
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import version
from typing import Any, NoReturn

from mdms_array.extras import Extra, require
from mdms_array.revision import git_revision
from mdms_host.cli.exits import ExitCode
from mdms_protocol.dictionary import REVISION


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb: its name and help, the function that runs it, and what adds its options.

    Functions are named as 'module:function', and imported when the verb is used. `late_options`
    adds options that are themselves costly to import. A verb with `actions` is followed by one.
    `extra` is the optional dependency of the verb.
    """

    name: str
    help: str
    function: str = ""
    options: Callable[[ArgumentParser], None] | None = None
    late_options: str | None = None
    actions: "tuple[Verb, ...]" = ()
    epilog: str | None = None
    extra: Extra | None = None


class Parser(ArgumentParser):
    """An argument parser that complains in one line.

    `late_options` names the function that adds its costly options, called when it is used.
    """

    def __init__(self, *args: Any, late_options: str | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._late_options = late_options

    def parse_known_args(self, *args: Any, **kwargs: Any) -> Any:
        """See `ArgumentParser`. Each verb refuses what it does not know, and names its own help."""
        self.add_late_options()
        known, unknown = super().parse_known_args(*args, **kwargs)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return known, unknown

    def add_late_options(self) -> None:
        """Add the costly options, once."""
        late_options, self._late_options = self._late_options, None
        if late_options is not None:
            _imported(late_options)(self)

    def error(self, message: str) -> NoReturn:
        """End with the exit code for bad usage."""
        self.exit(ExitCode.USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")


class ShowVersion(Action):
    """Prints the versions of package and protocol, and the revision of git."""

    def __call__(self, parser: ArgumentParser, *_: Any) -> NoReturn:
        """Print one line, as in 'mdms 0.1.0 (git 1a2b3c4, protocol 1.0)', and end."""
        protocol = f"protocol {REVISION >> 16}.{REVISION & 0xFFFF}"
        revision = git_revision()
        details = f"git {revision}, {protocol}" if revision else protocol
        print(f"mdms {version('mdms-array')} ({details})")
        parser.exit()


def add_verbs(parser: ArgumentParser, verbs: Iterable[Verb], title: str, metavar: str) -> None:
    """Add the verbs to a parser; each stores under `run` what runs it."""
    parsers = parser.add_subparsers(
        title=title, metavar=metavar, required=True, parser_class=Parser
    )
    for verb in verbs:
        own = parsers.add_parser(
            verb.name, help=verb.help, epilog=verb.epilog, late_options=verb.late_options
        )
        if verb.options is not None:
            verb.options(own)
        if verb.actions:
            add_verbs(own, verb.actions, "actions", "ACTION")
        else:
            own.set_defaults(run=partial(_run, verb))


def _run(verb: Verb, arguments: Namespace) -> int:
    if verb.extra is not None:
        require(verb.extra, f"mdms {verb.name}")
    run = _imported(verb.function)
    if not gc.isenabled():
        # The process began with this command, and all that it has loaded stays.
        gc.freeze()
        gc.enable()
    return int(run(arguments))


def _imported(function: str) -> Callable[..., Any]:
    """The function that 'module:function' names."""
    module, _, name = function.partition(":")
    imported: Callable[..., Any] = getattr(import_module(module), name)
    return imported
