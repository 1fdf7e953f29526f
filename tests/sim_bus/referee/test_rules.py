"""The table of rules in the folder's README is the referee's own."""

from pathlib import Path

from mdms_sim.referee.rules import RULES

README = Path(__file__).parents[3] / "sim_bus" / "README.md"


def test_readme_prints_the_rules_as_they_are():
    section = README.read_text("utf-8").split("## The referee\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    assert rows == [
        f"| `{rule.name}` | {'yes' if rule.safety else 'no'} | {rule.text} |"
        for rule in RULES.values()
    ]
