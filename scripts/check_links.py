"""Checks that links lead somewhere: `check_links.py FOLDER_OR_FILE ...`. In HTML, every internal link, picture and anchor; in Markdown, every
relative path. Nothing is fetched."""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """Ids and links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.ids.update(v for k in ("id", "name") if (v := values.get(k)))
        if tag != "link" or values.get("rel") == "stylesheet":
            self.links += [v for k in ("href", "src") if (v := values.get(k))]


def anchors_of_markdown(text: str) -> set[str]:
    """As GitHub makes them of headings."""
    headings = re.findall(r"^#+ +(.*?)\s*$", re.sub(r"^```.*?^```", "", text, flags=re.S | re.M), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def links_of_markdown(text: str) -> list[str]:
    text = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    text = re.sub(r"`[^`\n]*`", "", text)
    return re.findall(r"\]\(([^()\s]+)\)", text)


def main(places: list[str]) -> int:
    files = [f for p in map(Path, places) for f in (sorted(p.rglob("*.html")) if p.is_dir() else [p])]
    pages: dict[Path, Page] = {}

    def page(path: Path) -> Page:
        if path not in pages:
            pages[path] = Page(path.read_text(encoding="utf-8"))
        return pages[path]

    broken, count = [], 0
    for file in files:
        html = file.suffix == ".html"
        # What has no place of its own: 404.html stands for any address, and the print page repeats all others.
        if file.name in ("404.html", "print.html", "toc.html"):
            continue
        links = page(file).links if html else links_of_markdown(file.read_text(encoding="utf-8"))
        for link in links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            count += 1
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file.resolve()
            if target.is_dir() and html:
                target /= "index.html"
            if not target.exists():
                broken.append(f"{file}: {link}: no such file")
            elif parts.fragment and target.suffix == ".html" and parts.fragment not in page(target).ids:
                broken.append(f"{file}: {link}: no such place on the page")
            elif parts.fragment and target.suffix == ".md":
                if parts.fragment not in anchors_of_markdown(target.read_text(encoding="utf-8")):
                    broken.append(f"{file}: {link}: no such heading")
    print("\n".join(broken) if broken else f"{count} links of {len(files)} files lead somewhere")
    return 1 if broken or not files else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
