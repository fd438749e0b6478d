"""The errors of pydantic in words of this package.

Only the beginnings of messages are replaced, so that what a user wrote stays as it is.
"""

from collections.abc import Mapping
from typing import Any

from desim.config.arguments import without_addresses

OF_EXCEPTIONS = {"value_error", "assertion_error"}
"""Types of errors whose message is the text of an exception, after the words "Value error, " for instance."""
BEGINNINGS = {
    "Input should be a valid tuple": "should be a list",
    "Input should be a valid dictionary": "should be a table",
    "Input should be a valid integer": "should be an integer",
    "Input should be a valid boolean": "should be true or false",
    "Input should be a valid ": "should be a ",
    "Input should ": "should ",
    "Keys should be strings": "should be a text, the name of a key",
}
"""The beginnings of all other messages, and their replacements; the first that fits counts."""


def text_of(error: Mapping[str, Any]) -> str:
    """Return the message of a pydantic error in the words of this package."""
    text = str(error["msg"])
    if error["type"] in OF_EXCEPTIONS:
        return text.partition(", ")[2]
    if error["type"] == "union_tag_invalid":
        context = error["ctx"]
        tag = without_addresses(str(context["tag"]))
        return f"there is no {tag!r}; allowed: {context['expected_tags'].replace(chr(39), '')}"
    if error["type"] == "union_tag_not_found" and "ctx" in error:
        return f"should be a table with the key {error['ctx']['discriminator'].strip(chr(39))}"
    for machine, human in BEGINNINGS.items():
        if text.startswith(machine):
            return human + text.removeprefix(machine)
    return text
