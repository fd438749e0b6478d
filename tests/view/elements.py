"""What a browser would take a page for."""

import re
from html.parser import HTMLParser

LINKING = {"href", "src", "xlink:href", "srcset", "action"}
SPACES = re.compile(r"\s+")


class Elements(HTMLParser):
    """The tags, attributes, table cells, scripts and texts of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.references, self.rows, self.texts, self.scripts = [], [], [], [], [], []
        self.lines = []  # what is to be read outside of pictures, an element or a row of a table in each
        self.title, self._open, self._drawn = "", None, 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append(tag)
        self.ids += [given["id"]] if "id" in given else []
        for key, value in given.items():
            self.references += re.findall(r"url\(#([^)]*)\)", value or "") + ([value] if key in LINKING else [])
        self._drawn += tag == "svg"
        self._open = tag
        if tag == "script":
            self.scripts.append("")
        elif tag == "tr":
            self.rows.append([])
        elif tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        self._drawn -= tag == "svg"
        self._open = None if tag != "wbr" else self._open
        if tag == "tr":
            self.lines.append(" | ".join(self.rows[-1]))

    def handle_data(self, data):
        self.texts.append(data)
        if self._open in {"td", "th", "wbr"}:
            self.rows[-1][-1] += data
            return
        if self._open == "script":
            self.scripts[-1] += data
        if self._open == "title":
            self.title += data
        if self._open not in {"script", "style"} and not self._drawn and data.strip():
            self.lines.append(f"{self._open or ''}: {SPACES.sub(' ', data).strip()}")
