"""A page of the documentation, followed word for word: files written, commands and Python run, answers compared."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
SHOWN = re.compile(r"^!\[[^\]]*\]\(shown/(\S+)\)$", re.MULTILINE)
VERDICTS = {"validate": (0, 3, 4), "drift": (0, 3, 4), "next": (0, 4)}  # exit codes that are answers
PAPER = 595  # pt, the width of an A4 page


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, with the text between it and the block before."""

    kind: str
    text: str
    before: str


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page's Markdown in their order."""
    end, answer = 0, []
    for match in BLOCK.finditer(page):
        answer.append(Block(match[1], match[2], page[end : match.start()]))
        end = match.end()
    return answer


def ended_well(line: str, code: int) -> bool:
    """Whether a command's exit code is one that a page may lead to."""
    return code in VERDICTS.get(line.split()[1], (0,))


def follow(page: str, run: Callable[[str], str]) -> dict[str, str]:
    """Do all that a page's Markdown says in the working folder; what was printed at each line.

    A `text` block with nothing between it and the `sh` block before is what that block's commands print: its lines, in this
    order, `…` standing for anything. Any other `text` block is not looked at, nor is a `bash` block (to install things).

    Raises:
        AssertionError: something else was printed.
    """
    said: dict[str, str] = {}
    latest: str | None = None
    read = ""
    for block in blocks(page):
        read += block.before
        if block.kind == "sh":
            answers = {line: run(line) for line in block.text.splitlines()}
            latest = "\n".join(answers.values())
            said |= answers
        elif block.kind == "python":
            exec(compile(block.text, "page", "exec"), {})
        elif block.kind == "text" and latest is not None and not block.before.strip():
            compare(block.text, latest)
        elif block.kind not in ("text", "bash"):
            write(block.text, read)
        if block.kind != "sh":
            latest = None
    return said


def write(block: str, before: str) -> None:
    """Write a block into the file that the text before it names; in the place of the table that it names, if it does."""
    named = re.findall(r"`([^`\n]+)`", before)
    path = Path([name for name in named if re.fullmatch(r"[\w/-]+(\.\w+)+", name)][-1])
    if named[-1].startswith("["):
        head, table, _ = path.read_text(encoding="utf-8").partition(named[-1])
        assert table, f"{path} has no {named[-1]}"
        block = head + block
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(block, encoding="utf-8")


def compare(quoted: str, printed: str) -> None:
    """Hold what a page quotes against what was printed, whatever the blanks.

    Raises:
        AssertionError: a line of the quotation is not there, or not in this order.
    """
    rest = [_plain(line) for line in printed.splitlines()]
    for line in filter(None, map(_plain, quoted.splitlines())):
        wanted = re.compile(".*".join(map(re.escape, line.split("…"))))
        at = next((k for k, other in enumerate(rest) if wanted.fullmatch(other)), None)
        assert at is not None, f"the page quotes\n{line}\nand this was printed:\n" + "\n".join(rest)
        rest = rest[at + 1 :]


def _plain(line: str) -> str:
    return re.sub(r"[\s─]+", " ", line).strip()


def pictures(page: str) -> list[str]:
    """Return the paths of the pictures that a page shows of what it has made, such as `runs/NAME/report.pdf.1.png` (page 1)."""
    return SHOWN.findall(page)


def picture(path: str) -> bytes:
    """Return a picture that lies in the working folder, or is a page of a PDF there."""
    pdf = re.fullmatch(r"(.+\.pdf)\.(\d+)\.png", path)
    if not pdf:
        return Path(path).read_bytes()
    import typst

    said = f'#set page(width: auto, height: auto, margin: 0pt)\n#image("/{pdf[1]}", page: {pdf[2]}, width: {PAPER}pt)'
    drawn = typst.compile(said.encode(), root=".", format="png", ppi=110.0)
    return drawn[0] if isinstance(drawn, list) else drawn
