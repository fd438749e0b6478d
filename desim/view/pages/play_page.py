"""The page of `desim play`: its style sheet, which the widget of notebooks shares."""

from importlib.resources import files

from desim.analysis.drawing import palette
from desim.view.pages.playground import Playground


def style() -> str:
    """Return the style sheet of the page and of the widget."""
    hues = (
        f".play {{ --active: {palette.ACTIVE}; --better: #00694a; --worse: #a33f00; }}\n"
        f':is([data-theme="dark"], [data-theme="dark"] .play) {{ --active: {palette.SKY}; --better: #2ecc9b;'
        " --worse: #ff8534; }\n"
    )
    return hues + files("desim.view.pages").joinpath("play.css").read_text(encoding="utf-8")


def play_page(playground: Playground) -> str:
    """Return the page of a playground; needs jinja2 (the extra `plot`)."""
    from jinja2 import Environment

    template, script = (
        files("desim.view.pages").joinpath(f"play.{suffix}").read_text(encoding="utf-8") for suffix in ("html", "js")
    )
    environment = Environment(autoescape=True, keep_trailing_newline=True)
    return environment.from_string(template).render(
        name=playground.name, start=list(playground.start), values=playground.values, style=style(), script=script
    )
