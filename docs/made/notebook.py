"""A notebook as a page of the site: its cells are run, and what they show stands below them."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import tempfile
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

Shown = tuple[str, object]  # what a cell printed, and what its last line stands for


def run_cell(source: str, names: dict[str, Any]) -> Shown:
    """Run a cell as a notebook does; what it printed, and what its last line, if that is an expression, stands for."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, "cell", "exec"), names)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None
    return printed.getvalue(), value


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown with its answers, and its figures as SVG by their names."""
    lines: list[str] = []
    figures: dict[str, bytes] = {}
    names: dict[str, Any] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            source = "".join(cell["source"])
            if cell["cell_type"] != "code":
                lines.append(source)
                continue
            printed, value = run_cell(source, names)
            lines.append(f"```python\n{source}\n```")
            if printed:
                lines.append(f"```text\n{printed.rstrip()}\n```")
            if isinstance(value, Figure):
                name = f"{path.stem}-{len(figures) + 1}.svg"
                drawn = io.BytesIO()
                value.savefig(drawn, format="svg", metadata={"Date": None})
                figures[name] = drawn.getvalue()
                lines.append(f"![what the cell draws]({name})")
            elif hasattr(value, "_repr_html_"):
                table = value._repr_html_().replace(' border="1" class="dataframe"', "")
                lines.append(f"<div>{table}</div>")
            elif value is not None:
                lines.append(f"```text\n{value!r}\n```")
    return "\n\n".join(lines) + "\n", figures
