"""A preprocessor of mdBook: links to items of the API, which only rustdoc can follow, become text; those to chapters of the guide become
links to pages."""

import json
import re
import sys

# Modules of `src/guide.rs`, and the pages that they include.
PAGES = {
    "first_registration": "tutorials/developer.md",
    "own_residual": "howto/own_residual.md",
    "own_model": "howto/own_model.md",
    "own_term": "howto/own_term.md",
    "reading_a_report": "reference/report.md",
}
LINK = re.compile(r"\[([^\]]+)\]\(crate::([\w:]+)\)")


def plain(match: re.Match[str], page: str) -> str:
    text, target = match.groups()
    if target.startswith("guide::"):
        up = "../" * page.count("/")
        return f"[{text}]({up}{PAGES[target.removeprefix('guide::')]})"
    if "`" in text:
        return text
    return f"{text} (`{'::'.join(target.split('::')[-2:])}`)"


def chapters(items: list) -> None:
    for item in items:
        if isinstance(item, dict) and "Chapter" in item:
            chapter = item["Chapter"]
            chapter["content"] = LINK.sub(lambda m: plain(m, chapter["path"] or ""), chapter["content"])
            chapters(chapter["sub_items"])


if __name__ == "__main__":
    if sys.argv[1:2] == ["supports"]:
        sys.exit(0)
    _context, book = json.load(sys.stdin)
    chapters(book.get("items", book.get("sections", [])))
    json.dump(book, sys.stdout)
