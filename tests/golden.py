"""Golden files: what a test writes is compared with text in tests/golden; `RENEW=1 pytest` writes that text anew."""

import os
from collections.abc import Mapping
from pathlib import Path

FOLDER = Path(__file__).with_name("golden")


def golden(name: str, text: str | Mapping[str, str]) -> None:
    """Assert that a text, or parts with their titles, is that of the golden file of a name.

    If RENEW is set, it is written there before.
    """
    file = FOLDER / name
    if isinstance(text, Mapping):
        text = "\n\n".join(f"# {title}\n{part}" for title, part in text.items()) + "\n"
    if os.environ.get("RENEW"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode())
    assert file.is_file(), f"{file} is missing: RENEW=1 pytest ... writes it"
    wanted = file.read_bytes().decode()
    assert text.splitlines() == wanted.splitlines(), f"differs from {file}: if it should, RENEW=1 pytest ... and look"
    assert text == wanted
