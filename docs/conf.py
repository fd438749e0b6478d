"""The configuration of Sphinx: `python -m sphinx -W --keep-going -b html docs docs/_build`."""

import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref, pending_xref_condition
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.transforms.post_transforms import SphinxPostTransform

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

import api  # noqa: E402  these lie in this folder
import dark  # noqa: E402
import notebooks  # noqa: E402
import pages  # noqa: E402
import trial  # noqa: E402

project = "desim"
author = "the authors of desim"
version = release = metadata.version("pursuit-desim")
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxcontrib.bibtex",
]
exclude_patterns = ["_build", notebooks.FOLDER, dark.FOLDER, "jupyter_execute", "**.ipynb_checkpoints", "paper"]

html_theme = "pydata_sphinx_theme"
html_title = "desim"
html_logo = html_favicon = "_static/desim.svg"
html_theme_options = {
    "logo": {"text": "desim", "alt_text": "desim, front page"},
    "navbar_start": ["navbar-logo", "navbar-release"],
    "icon_links": [
        {"name": "Repository", "url": "https://github.com/desim-project/desim", "icon": "fa-brands fa-github"},
    ],
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": False,
    "navbar_align": "left",
    "pygments_light_style": "friendly",
}
html_sidebars = {"index": [], "gallery/index": []}
html_static_path = ["_static"]
templates_path = ["_templates"]
html_extra_path = ["_extra"]
html_css_files = ["desim.css"]
html_js_files = ["desim.js", "try.js"]
html_search_scorer = str(DOCS / "search_scorer.js")
html_show_copyright = False

myst_enable_extensions = ["attrs_inline", "colon_fence", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_render_markdown_format = "myst"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}  # no page shows a widget, so none loads their scripts from elsewhere
bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "plain"
copybutton_prompt_text = "$ "

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_use_type_comments = False
autodoc_default_options = {
    "show-inheritance": True,
    "ignore-module-all": True,
    "exclude-members": "model_config,__new__",
}
default_role = "code"
napoleon_use_rtype = False
napoleon_use_ivar = True
# Sphinx has no page for the classes of other projects.
suppress_warnings = ["ref.python"]

FENCE = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
MARKUP = re.compile(r"[|*]|(?<=\w)_(?!\w)")
"""Characters of markup in reStructuredText that docstrings use literally."""


def _docstring(_app: Sphinx, what: str, _name: str, _thing: object, _options: object, lines: list[str]) -> None:
    """Turn a docstring into reStructuredText: code blocks, the list in a header, characters of markup."""
    parts = FENCE.split("\n".join(lines))
    text = ""
    for plain, language, code in zip(parts[::3], [*parts[1::3], ""], [*parts[2::3], ""], strict=True):
        quoted = plain.split("`")
        text += "`".join(each if k % 2 else MARKUP.sub(r"\\\g<0>", each) for k, each in enumerate(quoted))
        if code:
            text += f".. code-block:: {language or 'text'}\n\n" + re.sub("^", "    ", code, flags=re.MULTILINE)
    lines[:] = (pages.listed(text) if what == "module" else text).split("\n")


class _Elsewhere(SphinxPostTransform):
    """Link the names in annotations to the pages of the names that a script imports; the others are plain text.

    A name is sought only if an object has the same last part, because a search compares it with every object.
    """

    default_priority = 5  # before references are resolved

    def run(self, **_: Any) -> None:
        known = {name.rpartition(".")[2] for name in self.env.get_domain("py").objects}
        public = api.public_names()
        for node in list(self.document.findall(pending_xref)):
            if node.get("refdomain") == "py":
                node["reftarget"] = public.get(node["reftarget"], node["reftarget"])
            if node.get("refdomain") != "py" or node["reftarget"].removesuffix("()").rpartition(".")[2] in known:
                continue
            if not isinstance(node[0], pending_xref_condition):
                node.replace_self(node[0])


class _WithoutBars(SphinxPostTransform):
    """Remove the progress bars of the runs in notebooks: a page shows what they have computed."""

    default_priority = 6  # after the kind of each output is chosen

    def run(self, **_: Any) -> None:
        for node in list(self.document.findall(nodes.raw)):
            if "application/vnd.jupyter.widget-view+json" in node.astext():
                node.parent.remove(node)


class _Dark(SphinxTransform):
    """Show the figures of the studies in their dark variants, too; the theme chooses."""

    default_priority = 200

    def apply(self, **_: Any) -> None:
        for image in list(self.document.findall(nodes.image)):
            name = image["uri"].rpartition("/")[2]
            if (DOCS / dark.FOLDER / name).is_file():
                variant = image.deepcopy()
                variant["uri"] = f"/{dark.FOLDER}/{name}"
                variant["classes"].append("only-dark")
                image["classes"].append("only-light")
                image.parent.insert(image.parent.index(image) + 1, variant)


def _note_keys(app: Sphinx, _tree: object) -> None:
    """Register keys of scenario files and metrics, so that the search finds them by name and pages can link to them."""
    anchors = {"reference/keys": pages.key_anchors, "reference/metrics": pages.metric_anchors}
    for name, anchor in anchors[app.env.docname]().items() if app.env.docname in anchors else ():
        app.env.domains.standard_domain.note_object("confval", name, anchor)


def setup(app: Sphinx) -> None:
    """Write the generated pages before Sphinx reads any."""
    pages.write(DOCS)
    notebooks.write(DOCS)
    dark.write(DOCS, pages.SCENARIOS)
    trial.write(DOCS)
    app.add_transform(_Dark)
    app.connect("doctree-read", _note_keys)
    app.add_post_transform(_Elsewhere)
    app.add_post_transform(_WithoutBars)
    app.connect("autodoc-process-docstring", _docstring, priority=400)
