"""A table in a line: the options of `run` and `serve` for it, and the verb `line`."""

import os
import stat
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from mdms_array.extras import OPCUA, require
from mdms_array.host import programmed
from mdms_array.source import open_program
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.files import writing
from mdms_host.cli.streams import say
from mdms_host.line.attached import Line
from mdms_host.line.machine import Recipes
from mdms_host.line.plant import LONGEST
from mdms_host.page.live import LiveTable
from mdms_host.page.run_slot import RunSlot
from mdms_host.page.server import LOOPBACK
from mdms_host.programs.program import Main
from mdms_model.scenario.motion import Motion
from mdms_model.scenario.scenario import Run, Scenario

#: A scenario, and the program in Python to run on it, if any.
Job = tuple[Scenario, Main | None]
CERTIFICATE, KEY, USERS = "certificate.der", "key.pem", "users.txt"


def has_line(arguments: Namespace) -> bool:
    """Whether the table is to be a machine of a line."""
    return arguments.opcua is not None or arguments.modbus is not None


def folder_of(arguments: Namespace) -> Path:
    """The folder of the line's orders, key and users: `--state`, or one in the user's own."""
    base = os.environ.get("XDG_STATE_HOME")
    home = Path(base) if base else Path.home() / ".local" / "state"
    return Path(arguments.state) if arguments.state is not None else home / "mdms-array" / "line"


def made_folder(arguments: Namespace) -> Path:
    """`folder_of`, which is made if it is not there. Raises `CommandError`."""
    folder = folder_of(arguments)
    if folder.exists() and not folder.is_dir():
        raise CommandError(
            f"--state {folder}: is no folder; name a folder, or one that is to be made",
            ExitCode.USAGE,
        )
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
    except CommandError as error:
        raise CommandError(f"--state {error}; name another folder", error.code) from None
    return folder


def check_line(
    arguments: Namespace,
    scenario: Scenario,
    main: Main | None,
    option: str = "--opcua, --modbus",
) -> None:
    """Raises `CommandError` where a job cannot be that of a line as the options have it."""
    if main is not None:
        scenario = programmed(scenario)
    if arguments.opcua is not None:
        require(OPCUA, "--opcua")
    if scenario.motion.field != "program":
        raise CommandError(
            f"{option}: a line needs a program, but motion.field is "
            f"{scenario.motion.field!r}; take a file of tasks, or Python, or sort54",
            ExitCode.USAGE,
        )
    if scenario.motion.control == "cells":
        raise CommandError(
            f"{option}: cells that steer keep no orders; set motion.control=host",
            ExitCode.USAGE,
        )


def recipes_of(
    arguments: Namespace, source: str, job: Job, overrides: Sequence[str]
) -> Recipes[Job]:
    """The jobs that a line may be asked for: the command's own, of `source`, and `--recipe`.

    Raises `InputError`, and `CommandError` for a recipe that is not for the same table.
    """
    jobs = {Path(source).stem: job}
    if arguments.recipe and not has_line(arguments):
        raise CommandError("--recipe: is chosen by a line; add --opcua or --modbus", ExitCode.USAGE)
    if has_line(arguments):
        check_line(arguments, *job)
    for each in arguments.recipe:
        name, _, path = each.rpartition("=")
        name = name or Path(path).stem
        if name in jobs or len(name) > LONGEST or not name.isprintable():
            raise CommandError(
                f"--recipe {each}: {name!r:.70} is taken, or not {LONGEST} printable characters at "
                "most; give NAME=FILE",
                ExitCode.USAGE,
            )
        recipe = open_program(path, overrides)
        check_line(arguments, *recipe, f"--recipe {each}")
        _check_same_table(each, recipe[0], job[0])
        jobs[name] = recipe
    if has_line(arguments):
        made_folder(arguments)
    return Recipes(jobs)


def _check_same_table(recipe: str, scenario: Scenario, own: Scenario) -> None:
    one, other = _without_job(scenario), _without_job(own)
    for each in fields(Scenario):
        if getattr(one, each.name) != getattr(other, each.name):
            raise CommandError(
                f"--recipe {recipe}: `{each.name}` is not that of the table; a recipe has its own "
                "`task`, `motion`, `run` and kinds of exits, and nothing else",
                ExitCode.USAGE,
            )


def _without_job(scenario: Scenario) -> Scenario:
    """The scenario without its job: the table alone."""
    return replace(
        scenario,
        title="",
        parcel=tuple(replace(each, goal=None) for each in scenario.parcel),
        motion=Motion(),
        run=Run(),
        fault=(),
        exit=tuple(replace(each, kinds=()) for each in scenario.exit),
        task=(),
        signal=(),
    )


def opened_line(
    slot: RunSlot,
    scenario: Scenario,
    arguments: Namespace,
    table: LiveTable,
    recipes: Recipes[Any],
) -> Line:
    """The line of a table as the options have it. Raises LineError and `CommandError`."""
    folder = folder_of(arguments)
    host = arguments.line_host or LOOPBACK
    settings = {
        "title": scenario.title,
        "cells": scenario.array.columns * scenario.array.rows,
        "folder": str(folder),
        "host": host,
        "modbus": arguments.modbus,
        "opcua": arguments.opcua,
        "anonymous": arguments.anonymous,
        "kinds": tuple(dict.fromkeys(each.kind for each in scenario.parcel if each.kind)),
    }
    if arguments.opcua is not None:
        settings |= _security(folder, arguments)
    if arguments.modbus is not None and host != LOOPBACK:
        say(f"mdms: whoever reaches {host} moves the table by Modbus, which has no passwords")
    exits = tuple(each.name for each in scenario.exit)
    line = Line(slot, exits, settings, recipes, table)
    for address in line.addresses:
        print(address, flush=True)
    return line


def _security(folder: Path, arguments: Namespace) -> dict[str, object]:
    certificate, key = folder / CERTIFICATE, folder / KEY
    for path in (certificate, key):
        if not path.is_file():
            raise CommandError(
                f"--opcua: there is no {path}; `mdms line certificate` makes it", ExitCode.USAGE
            )
    _check_readable(certificate, key)
    if arguments.anonymous and (arguments.line_host or LOOPBACK) != LOOPBACK:
        raise CommandError(
            "--anonymous: nothing is encrypted, so it is for this machine only; leave --line-host "
            "out",
            ExitCode.USAGE,
        )
    users = _users(folder / USERS)
    if not users and not arguments.anonymous:
        raise CommandError(
            f"--opcua: {folder / USERS} has no users; write a line NAME:PASSWORD into it, "
            "or give --anonymous to read only",
            ExitCode.USAGE,
        )
    return {"certificate": str(certificate), "key": str(key), "users": users}


def _check_readable(certificate: Path, key: Path) -> None:
    # The extra has been asked for by the option.
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415
    from cryptography.x509 import load_der_x509_certificate  # noqa: PLC0415

    for path, load, kind in (
        (certificate, load_der_x509_certificate, "certificate in DER"),
        (key, partial(load_pem_private_key, password=None), "key in PEM without a password"),
    ):
        try:
            load(path.read_bytes())
        except (ValueError, TypeError):
            raise CommandError(
                f"{path}: is no {kind}; `mdms line certificate --force` makes a new pair, and "
                "clients have to trust it",
                ExitCode.USAGE,
            ) from None


def _users(path: Path) -> dict[str, str]:
    """Passwords by user, from a file that its owner alone may read."""
    if not path.is_file():
        return {}
    # Elsewhere than on POSIX these bits say nothing.
    if os.name == "posix" and path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise CommandError(f"{path}: others may read it; run chmod 600 {path}", ExitCode.USAGE)
    users = {}
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise CommandError(f"{path}: is not UTF-8; save it as that", ExitCode.USAGE) from None
    for number, line in enumerate(text.splitlines(), 1):
        name, colon, password = line.partition(":")
        if line.strip() and not (name and colon and password):
            raise CommandError(f"{path}, line {number}: is not NAME:PASSWORD", ExitCode.USAGE)
        if line.strip():
            users[name] = password
    return users


def make_certificate(arguments: Namespace) -> ExitCode:
    """`mdms line certificate`: a key and a certificate for OPC UA, signed by itself."""
    # The extra has been asked for by the verb.
    from mdms_host.line.opcua import certificate_of  # noqa: PLC0415

    folder = made_folder(arguments)
    key_path, path = folder / KEY, folder / CERTIFICATE
    if not arguments.force and (key_path.exists() or path.exists()):
        raise CommandError(
            f"{folder} has a key or a certificate already, which clients may trust; give --force "
            "to replace it",
            ExitCode.FAILURE,
        )
    key, certificate, until = certificate_of(arguments.host_name, arguments.days)
    descriptor = os.open(key_path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with open(descriptor, "wb") as file:
        key_path.chmod(0o600)
        file.write(key)
    path.write_bytes(certificate)
    print(f"{path}: valid until {until}; have clients trust it")
    print(f"{key_path}: its key, which nobody else may have")
    return ExitCode.OK
