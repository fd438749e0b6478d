"""Golden files: what a test writes is compared with text in tests/golden; `RENEW=1 pytest` writes that text anew."""

import os
from pathlib import Path

FOLDER = Path(__file__).with_name("golden")


def golden(name: str, text: str) -> None:
    """Assert that a text is that of the golden file of a name, after writing it there if RENEW is set."""
    file = FOLDER / name
    if os.environ.get("RENEW"):
        FOLDER.mkdir(exist_ok=True)
        file.write_bytes(text.encode())
    assert file.is_file(), f"{file} is missing: RENEW=1 pytest ... writes it"
    wanted = file.read_bytes().decode()
    assert text.splitlines() == wanted.splitlines(), f"differs from {file}: if it should, RENEW=1 pytest ... and look"
    assert text == wanted
