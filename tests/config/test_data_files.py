"""Data files: what a model declares or opens, and which declarations are refused."""

import json
import re
import sys
from io import BytesIO
from pathlib import Path
from types import FunctionType, SimpleNamespace

import pytest

from desim.config.data_files import DataFileError, content_hash, declared, identified_run, open_data, opened_by


def test_a_module_has_the_files_that_it_opened(tmp_path, monkeypatch):
    file = tmp_path / "table.json"
    file.write_text("[1, 2]")
    monkeypatch.setattr(sys.modules[__name__], "__opened_data__", {}, raising=False)
    with open_data(file) as stream:
        assert isinstance(stream, BytesIO)
        assert json.load(stream) == [1, 2]
    assert opened_by(__name__) == {str(file): content_hash(b"[1, 2]")}
    assert opened_by("json") == opened_by("no.such.module") == {}


def test_a_file_that_cannot_be_opened_is_no_part_of_a_module(tmp_path):
    with pytest.raises(FileNotFoundError):
        open_data(tmp_path / "none.txt")
    with pytest.raises(IsADirectoryError):
        open_data(tmp_path)
    assert opened_by(__name__) == {}


def test_no_file_is_opened_during_a_run_that_is_identified():
    where = r"open it at the top level of the model's module, or list it in `depends_on`"
    with identified_run(), pytest.raises(DataFileError, match=where):
        open_data(__file__)
    assert opened_by(__name__) == {}


def test_a_model_declares_files_in_an_attribute_or_a_method(tmp_path):
    (tmp_path / "a").write_bytes(b"1")
    expected = {str(tmp_path / "a"): content_hash(b"1")}
    assert declared(SimpleNamespace(depends_on=(tmp_path / "a",))) == expected
    assert declared(SimpleNamespace(depends_on=lambda: [str(tmp_path / "a")])) == expected
    assert declared(SimpleNamespace()) == {}
    function = FunctionType((lambda: 1).__code__, {})
    function.depends_on = (tmp_path / "a",)
    assert declared(function) == expected


@pytest.mark.parametrize(
    ("paths", "why"),
    [
        ("table.txt", "depends_on: should be a tuple of paths (got 'table.txt')"),
        ((1,), "depends_on: should be a tuple of paths (got (1,))"),
        (None, "depends_on: should be a tuple of paths (got None)"),
        (("none.txt",), "depends_on: none.txt cannot be read: No such file or directory"),
        ((Path("/"),), "depends_on: / cannot be read: Is a directory"),
    ],
)
def test_a_declaration_that_names_no_readable_files_is_refused(paths, why):
    with pytest.raises(DataFileError, match=f"^{re.escape(why)}$"):
        declared(SimpleNamespace(depends_on=paths))
