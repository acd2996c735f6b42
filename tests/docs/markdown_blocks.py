"""Fenced blocks of Markdown pages, with the marks before them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_MARK = re.compile(r"<!--\s*not run:\s*(?P<reason>.*?)\s*-->\s*$")
_FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)\s*$")


@dataclass(frozen=True, slots=True)
class Block:
    """One fenced block."""

    page: Path
    line: int  # of its first line of text, from 1
    language: str
    text: str
    not_run: str | None  # the reason of the mark before it, "" if it gives none; None without mark

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page, in order."""
    found, lines = [], page.read_text("utf-8").splitlines()
    k = 0
    while k < len(lines):
        fence = _FENCE.match(lines[k])
        if fence is None:
            k += 1
            continue
        end = next(i for i in range(k + 1, len(lines)) if lines[i].strip() == "```")
        mark = _MARK.search(lines[k - 1]) if k else None
        text = "\n".join(line.removeprefix(fence["indent"]) for line in lines[k + 1 : end])
        found.append(Block(page, k + 2, fence["language"], text, mark and mark["reason"]))
        k = end + 1
    return found


def commands(text: str) -> list[str]:
    """Lines of a shell block without comments; continued lines are joined."""
    joined = re.sub(r"\s*\\\n\s*", " ", text)
    lines = (re.sub(r"(^|\s)#.*$", "", line).strip() for line in joined.splitlines())
    return [line for line in lines if line]
