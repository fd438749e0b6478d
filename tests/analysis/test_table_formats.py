"""Tables as LaTeX and Markdown: numbers with intervals, and names that are printed as they are."""

import shutil
import subprocess

import pytest

from desim.analysis.table_formats import formatted, latex_text, markdown_text

ROWS = [
    ("key", "runs", "captured", "active time, s"),
    ("sap_1 & co", "30", "90.0% (74.4% .. 96.5%)", "1,234.5 +- 10.0 (29)"),
    ("a|b", "1", "-", "-0.250 +- -"),
    ("inf", "2", "$5", "+1.50e-04"),
    ("", "100", "x", "0.000 in all, others < 3.7%"),
    ("b", "3", "0.667 (0.208 .. 0.939)", "-0.2 (-0.3 .. -0.1)"),
]


def test_a_latex_table_has_the_rules_of_booktabs_and_numbers_as_mathematics():
    lines = formatted([("50 % of #1", ROWS)], ["a note\nof two"], "latex").splitlines()
    assert lines == [
        "% needs \\usepackage{booktabs}",
        "",
        "% 50 % of #1",
        r"\begin{tabular}{lrrr}",
        r"\toprule",
        r"key & runs & captured & active time, s \\",
        r"\midrule",
        r"sap\_1 \& co & $30$ & 90.0\% (74.4\%--96.5\%) & $1{,}234.5 \pm 10.0$ (29) \\",
        r"a\textbar{}b & $1$ & - & $-0.250$ \\",
        r"$\infty$ & $2$ & \$5 & $+1.50 \times 10^{-4}$ \\",
        r" & $100$ & x & $0.000$ in all, others \textless{} 3.7\% \\",
        r"b & $3$ & $0.667$ (0.208--0.939) & $-0.2$ ($-$0.3--$-$0.1) \\",
        r"\bottomrule",
        r"\end{tabular}",
        "",
        "% a note of two",
    ]


def test_a_markdown_table_has_as_many_cells_in_each_row():
    lines = formatted([("a *title*", ROWS)], ["a note"], "markdown", right_from=2).splitlines()
    assert lines[0] == r"a \*title\*"
    assert lines[3] == "| :--- | :--- | ---: | ---: |"
    assert lines[4] == r"| sap\_1 & co | 30 | 90.0% (74.4% .. 96.5%) | 1,234.5 ± 10.0 (29) |"
    assert {line.replace(r"\|", "").count("|") for line in lines[2:8]} == {5}
    assert lines[-1] == "a note"


@pytest.mark.parametrize("text", ["\\", "{}", "$x$", "a&b", "#1", "50%", "a_b", "a^b", "~", "<b>", "|", '"', "plain"])
def test_every_special_character_is_escaped(text):
    if shutil.which("pdflatex"):
        body = rf"\documentclass{{article}}\begin{{document}}{latex_text(text)}\end{{document}}"
        subprocess.run(["pdflatex", "-draftmode", "-halt-on-error"], input=body.encode(), check=True, cwd="/tmp")
    for special in r"{}$&#%_^~":
        plain = latex_text(text).replace("\\" + special, "").replace("{}", "")
        assert special not in plain
    assert (markdown_text(text) == text) == (text in {"a&b", "50%", '"', "plain", "a^b"} or text == "a^b")


def test_a_text_is_aligned_and_another_format_is_refused():
    assert formatted([("t", [("a", "b"), ("c", "10")])], ["n"], "text") == "t\na   b\nc  10\n\nn"
    with pytest.raises(ValueError, match="format should be text, latex, markdown, got 'latx', did you mean latex"):
        formatted([], [], "latx")
