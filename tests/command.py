"""The command, called in the process of a test, and what it prints."""

import json
import re

from click.testing import CliRunner, Result

from desim.cli import main

WRONG_INPUT = 2
JARGON = re.compile(r"Traceback|Input should|Value error|[Tt]uple|\bvalid\b|pydantic|Keys should be strings")
"""Internal terms, of no use to a person who writes a scenario file."""


def desim(*args: object) -> Result:
    """Call the command in this process; an exception that it lets through fails the test."""
    return CliRunner().invoke(main, [str(each) for each in args], catch_exceptions=False)


def accepted(*args: object) -> Result:
    """Call the command, and see that it takes what it is given."""
    result = desim(*args)
    assert result.exit_code == 0, result.output
    return result


def strict_json(text: str):
    """Parse JSON and nothing else: the Infinity and NaN that Python also reads are errors."""

    def refuse(constant: str):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def refused(*args: object) -> str:
    """Call the command, see that it ends as it should on wrong input, and return what it tells on stderr."""
    result = desim(*args)
    assert result.exit_code == WRONG_INPUT, result.output
    assert result.stdout == ""
    assert not JARGON.search(result.stderr), result.stderr
    return result.stderr
