"""What a script imports from `desim` itself."""

import ast
import inspect
import subprocess
import sys
from importlib import import_module

import pytest

import desim


def test_dir_shows_the_public_names():
    assert dir(desim) == sorted(desim.__all__)
    with pytest.raises(AttributeError, match="module 'desim' has no attribute 'Taem'"):
        _ = desim.Taem


@pytest.mark.parametrize("name", desim.__all__)
def test_a_public_name_is_that_of_its_module(name):
    home = import_module(desim._HOMES[name])
    assert getattr(desim, name) is getattr(home, name)
    assert getattr(desim, name).__doc__


def test_type_checkers_see_the_same_names():
    (block,) = [node for node in ast.parse(inspect.getsource(desim)).body if isinstance(node, ast.If)]
    seen = {alias.asname: statement.module for statement in block.body for alias in statement.names}
    assert seen == desim._HOMES


def test_the_names_are_known_without_importing_their_modules():
    program = "import sys, desim; dir(desim); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
