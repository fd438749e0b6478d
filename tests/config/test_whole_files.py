"""Files are written whole, also by several programs at once."""

import pytest

from desim.config import whole_files
from desim.config.whole_files import replacing, write_whole


def test_two_programs_that_replace_one_file_at_once_both_write_it_whole(tmp_path):
    path = tmp_path / "means.svg"
    with replacing(path) as first, replacing(path) as second:
        first.write_text("one")
        second.write_text("another")
    assert path.read_text() == "one"  # that ends last
    assert [*tmp_path.iterdir()] == [path]


def test_a_symbolic_link_is_replaced_and_not_followed(tmp_path):
    secret, path = tmp_path / "secret", tmp_path / "means.svg"
    secret.write_text("kept")
    path.symlink_to(secret)
    write_whole(path, b"new")
    assert (path.read_bytes(), path.is_symlink(), secret.read_text()) == (b"new", False, "kept")


def test_a_link_with_the_name_of_a_part_is_refused(tmp_path, monkeypatch):
    """Somebody has guessed the random part of the name."""
    secret, path = tmp_path / "secret", tmp_path / "means.svg"
    secret.write_text("kept")
    monkeypatch.setattr(whole_files, "token_hex", lambda _: "01234567")
    (tmp_path / "means.svg.01234567.part").symlink_to(secret)
    with pytest.raises(OSError, match=r"means\.svg\.01234567\.part exists already, and is not followed") as refused:
        write_whole(path, b"new")
    assert refused.value.filename == str(path)
    assert secret.read_text() == "kept"
    assert not path.exists()
    assert (tmp_path / "means.svg.01234567.part").is_symlink()
