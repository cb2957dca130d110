"""What tests read out of an HTML page: its tables' numbers, references, identifiers and labels."""

import json
from html.parser import HTMLParser

_VOID = {"meta", "br"}
_CLOSED = {*_VOID, "path", "use", "image", "rect", "g", "defs"}
"""What may end where it begins."""


class Page(HTMLParser):
    """Checks that tags are balanced; keeps the numbers of tables by their captions, figures' data, and labels."""

    def __init__(self, text):
        super().__init__()
        self.open, self.references, self.identifiers, self.tags = [], [], [], []
        self.tables, self.captions, self.labels, self.hidden = [], [], [], 0
        self.links, self.figures = [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.tags.append(tag)
        self.references += [attributes[key] for key in ("href", "src", "xlink:href", "action") if key in attributes]
        self.identifiers += [attributes["id"]] if "id" in attributes else []
        if tag == "table":
            self.tables.append([])
            self.captions.append("")
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append([])
        if tag == "data":
            self.tables[-1][-1][-1].append(float(attributes["value"]))
        if tag == "svg" and attributes.get("aria-hidden") == "true":  # what stands beside it says the same
            self.hidden += 1
        elif attributes.get("role") == "img":
            self.labels.append(attributes["aria-label"])
        if "data-figure" in attributes:
            self.figures.append(json.loads(attributes["data-figure"]))
        if tag == "a":
            self.links.append(attributes)
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        assert tag in _CLOSED, tag
        self.handle_starttag(tag, attributes)
        if tag not in _VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "caption":
            self.captions[-1] += data

    def table(self, words):
        """The table (rows of cells of numbers) whose caption begins so."""
        return next(t for t, text in zip(self.tables, self.captions, strict=True) if text.startswith(words))

    def whole(self, text, scripts=0):
        """Asserts that a page's text needs nothing else, and that all it holds has a name."""
        static = text.partition("<script>")[0]
        assert all(one.startswith(("#", "data:image/png;base64,")) for one in self.references)
        assert "http" not in static
        assert "@import" not in text
        assert self.tags.count("script") == scripts
        assert len(set(self.identifiers)) == len(self.identifiers)
        assert {one[1:] for one in self.references if one.startswith("#")} <= set(self.identifiers)
        assert all(self.labels)
        assert self.tags.count("svg") - self.hidden + len(self.figures) == len(self.labels)
        assert all(self.captions)
        assert text.count("<table") == text.count("<caption>") == len(self.tables)
        assert self.tags.count("figure") == self.tags.count("figcaption")
        assert self.tags.count("h1") == self.tags.count("main") == 1
