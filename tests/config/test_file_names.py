"""What a name ends in is what is made, and nothing of it is lost."""

from pathlib import Path

import pytest

from desim.config.file_names import PICTURE_SUFFIXES, files

USUAL = (".svg", ".png")


@pytest.mark.parametrize("name", ["x.svg", "x.pdf", "a.b/x.PNG", "v1.2.png"])
def test_a_suffix_that_is_allowed_is_the_one_file(name):
    assert files(Path(name), PICTURE_SUFFIXES, USUAL) == [Path(name)]


@pytest.mark.parametrize("name", ["x", "out/v1.2", "run.2026", "a.gif/x", "x.", "..2"])
def test_without_a_suffix_the_usual_ones_come_after_the_whole_name(name):
    assert [str(each) for each in files(Path(name), PICTURE_SUFFIXES, USUAL)] == [
        f"{Path(name)}.svg",
        f"{Path(name)}.png",
    ]


@pytest.mark.parametrize("name", ["x.gif", "x.svgz", "v1.2.jpg", "x.tar.gz", "x.p2", "x.GIF"])
def test_another_suffix_is_refused_with_what_is_allowed(name):
    with pytest.raises(ValueError, match=rf"^{name}: should end in \.svg or \.png or \.pdf, .*, got \.\w+$"):
        files(Path(name), PICTURE_SUFFIXES, USUAL)
