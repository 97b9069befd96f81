"""A page of HTML taken apart, without a browser."""

from html.parser import HTMLParser

VOID = frozenset({"meta", "img", "br", "link", "hr", "input"})
LOADING = ("src", "srcset", "data", "poster", "action")
Attributes = dict[str, str | None]


class Page(HTMLParser):
    """Headings, ids, links, drawings and scripts of a page whose tags are balanced."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, Attributes]] = []
        self.headings: list[str] = []
        self.scripts: list[str] = []  # that run, not data
        self.texts: list[str] = []  # what a reader sees
        self._inside: Attributes = {}
        self.feed(html)
        self.close()

    @property
    def ids(self) -> list[str]:
        return [str(given["id"]) for _, given in self.elements if "id" in given]

    @property
    def links(self) -> list[str]:
        return [str(given["href"]) for tag, given in self.elements if tag == "a"]

    @property
    def loads(self) -> list[str]:
        """Whatever an element would fetch."""
        return [str(given[key]) for _, given in self.elements for key in LOADING if key in given]

    @property
    def drawings(self) -> list[str | None]:
        """What the figures are called for those who do not see them."""
        return [given.get("aria-label") for tag, given in self.elements if tag == "svg"]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = dict(attrs)
        self.elements.append((tag, self._inside))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        within = self.open[-1] if self.open else ""
        if within in ("h1", "h2", "h3"):
            self.headings.append(data.strip())
        if within == "script" and "type" not in self._inside:
            self.scripts.append(data)
        if within not in ("script", "style") and data.strip():
            self.texts.append(data.strip())
