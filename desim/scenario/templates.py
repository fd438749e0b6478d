"""Commented starting files: a scenario, or a user's own model or metric with a test of it and a scenario that uses it.

The template of a protocol is `my_protocol.py`, `test_my_protocol.py` and `my_protocol.toml` in `scenarios/templates`,
with the class `MyProtocol`. A copy has another name in place of `my_protocol` and `MyProtocol`.
"""

import ast
import re
import sys
from importlib.util import find_spec
from keyword import iskeyword

from desim.config.packages import package_folder

_FOLDER = package_folder("scenarios") / "templates"
TEMPLATES = ("scenario", "protocol", "latency", "evader", "metric")
"""The names of the templates."""


def starting_files(template: str, name: str) -> dict[str, str]:
    """Return the text of each starting file by file name, the scenario file last.

    Args:
        template: one of `TEMPLATES`.
        name: the name of the scenario and of the module; an identifier.

    Raises:
        ValueError: if the name is a keyword or not an identifier; for any template but "scenario", also if an installed
            module has this name or the code of the template uses it.
    """
    if iskeyword(name):
        raise ValueError(f"{name!r} is a word of Python itself, which no module can have; choose another, my_{name}")
    if not name.isidentifier():
        usable = re.sub(r"\W", "_", name)
        instance = usable if usable.isidentifier() else f"my_{template}"
        raise ValueError(f"{name!r} should be an identifier: letters, digits and _, {instance} for instance")
    files = (f"my_{template}.py", f"test_my_{template}.py", f"my_{template}.toml")
    texts = {file: (_FOLDER / file).read_text(encoding="utf-8") for file in files if (_FOLDER / file).exists()}
    module = texts.get(f"my_{template}.py")
    if module and _is_installed(name):
        raise ValueError(f"{name!r} is the name of an installed module, which would hide {name}.py; choose another")
    if module and name in _names_in(module) - {f"my_{template}"}:
        raise ValueError(f"{name!r} is the name of a function or class that {name}.py uses; choose another")
    class_in_template, class_name = f"My{template.title()}", _class_name(name)
    return {
        file.replace(f"my_{template}", name): text.replace(class_in_template, class_name).replace(
            f"my_{template}", name
        )
        for file, text in texts.items()
    }


def _is_installed(name: str) -> bool:
    """Return whether an installed module of this name would hide one in the folder of a scenario."""
    if name in sys.stdlib_module_names:
        return True
    spec = find_spec(name)
    return spec is not None and spec.origin is not None


def _names_in(module: str) -> set[str]:
    """Return the names that the source of a module imports, defines or reads."""
    nodes = list(ast.walk(ast.parse(module)))
    defined = {node.name for node in nodes if isinstance(node, ast.alias | ast.FunctionDef | ast.ClassDef)}
    return defined | {node.id for node in nodes if isinstance(node, ast.Name)}


def _class_name(name: str) -> str:
    """Return the name of a class for a module: my_rule becomes MyRule."""
    camel = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    return camel if camel.isidentifier() and not iskeyword(camel) else name
