"""`mdms scenarios`: what comes with the package."""

import json
from argparse import Namespace

from mdms_host.cli.exits import Exit
from mdms_host.cli.options import Verbs, add_json


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("scenarios", help="list the built-in scenarios")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Print the built-in scenarios, a name and a title each."""
    from mdms_model.scenario.file import builtin_names, load_scenario

    titles = {name: load_scenario(name).title for name in builtin_names()}
    if arguments.json:
        print(json.dumps({"scenarios": [{"name": n, "title": t} for n, t in titles.items()]}))
    else:
        width = max(map(len, titles), default=0)
        for name, title in titles.items():
            print(f"{name:{width}}  {title}")
    return Exit.OK
