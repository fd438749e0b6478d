"""Files are written whole, also by several programs at once."""

from desim.config.whole_files import replacing


def test_two_programs_that_replace_one_file_at_once_both_write_it_whole(tmp_path):
    path = tmp_path / "means.svg"
    with replacing(path) as first, replacing(path) as second:
        first.write_text("one")
        second.write_text("another")
    assert path.read_text() == "one"  # that ends last
    assert [*tmp_path.iterdir()] == [path]
