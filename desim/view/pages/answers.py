"""The answers to the requests of a page of `desim play`: each is a JSON object."""

from collections.abc import Sequence
from typing import Any

from desim.config.json_numbers import to_json

Answer = dict[str, Any]
"""A JSON object."""
Changes = Sequence[str]
"""Changes of keys, each KEY=VALUE as in `--set`."""


def json_answer(answer: Answer) -> Answer:
    """Return an answer with infinity and NaN as strings."""
    return dict(to_json(answer))
