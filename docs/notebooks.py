"""The tutorials as notebooks that can be downloaded.

A tutorial is Markdown with code cells. In the notebook its links to other pages lead to the published site.
"""

import json
import re
import tomllib
from pathlib import Path
from posixpath import join, normpath
from typing import Any

CELL = re.compile(r"^```\{code-cell\} python\n(.*?)^```$\n?", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!\w+:|#)([^)#]+)\.md((?:#[^)]*)?)\)")
"""A link to another page: its path without suffix, and its fragment."""
FOLDER = "_notebooks"


def site(root: Path) -> str:
    """Return the address of the published site."""
    project: dict[str, Any] = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["urls"]["Documentation"])


def notebook(text: str, folder: str, address: str) -> dict[str, Any]:
    """Return a page as a notebook (nbformat 4.5) without outputs.

    Args:
        text: the page, with a front matter.
        folder: the folder of the page, relative to the documentation.
        address: the address of the published site.
    """
    body = text.split("---\n", 2)[2]
    shown = "\n\n".join(part for part in body.split("\n\n") if "{download}" not in part)
    absolute = LINK.sub(lambda link: f"]({join(address, normpath(join(folder, link[1])))}.html{link[2]})", shown)
    cells = [
        {"id": f"cell-{k}", "metadata": {}, "source": source.strip("\n")}
        | ({"cell_type": "code", "execution_count": None, "outputs": []} if k % 2 else {"cell_type": "markdown"})
        for k, source in enumerate(CELL.split(absolute))
        if source.strip()
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def write(docs: Path) -> None:
    """Write the notebook of each tutorial into the folder `_notebooks`."""
    (docs / FOLDER).mkdir(exist_ok=True)
    for page in docs.glob("tutorials/*.md"):
        text = page.read_text(encoding="utf-8")
        if CELL.search(text):
            path = docs / FOLDER / f"{page.stem}.ipynb"
            made = notebook(text, "tutorials", site(docs.parent))
            path.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
