"""Run the notebooks and store what their cells print and draw: python docs/notebooks/build.py [NAME ...]

Cells run in order in one namespace, without Jupyter, and hold plain Python. What a cell shows is what Jupyter
shows: the printed text, the value of a last line without an assignment, and the figures of matplotlib.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
NAMES = ("scan", "depth-camera", "codec-experiment", "study")

Notebook = dict[str, Any]


def read_notebook(name: str) -> Notebook:
    """Return a notebook of this folder."""
    notebook: Notebook = json.loads((HERE / f"{name}.ipynb").read_text("utf-8"))
    return notebook


def text_of(cell: dict[str, Any]) -> str:
    """Return the source of a cell."""
    return "".join(cell["source"])


def run_notebook(notebook: Notebook, name: str) -> Notebook:
    """Return a notebook with the outputs of its cells; restores the current folder."""
    import matplotlib

    matplotlib.use("agg")
    names: dict[str, Any] = {"__name__": "__main__"}
    cells, count, folder = [], 0, Path.cwd()
    try:
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                count += 1
                outputs = list(run_cell(text_of(cell), names, f"{name}.ipynb, cell {count}"))
                cell = cell | {"execution_count": count, "outputs": outputs}
            cells.append(cell)
    finally:
        os.chdir(folder)
    return notebook | {"cells": cells}


def run_cell(text: str, names: dict[str, Any], where: str) -> Iterator[dict[str, Any]]:
    """Run a cell and yield its outputs."""
    import matplotlib.pyplot as plt

    body = ast.parse(text, where).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), where, "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), where, "eval"), names)
    if printed.getvalue():
        yield {"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(True)}
    if value is not None:
        yield {"output_type": "display_data", "metadata": {}, "data": _data_of(value)}
    for number in plt.get_fignums():
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, format="png", dpi=80, metadata={"Software": None})
        yield {"output_type": "display_data", "metadata": {}, "data": _png_data(picture.getvalue())}
    plt.close("all")


def _data_of(value: Any) -> dict[str, str]:
    picture = getattr(value, "_repr_png_", lambda: None)()
    return {"text/plain": repr(value)} if picture is None else _png_data(picture)


def _png_data(picture: bytes) -> dict[str, str]:
    return {"image/png": base64.b64encode(picture).decode(), "text/plain": "<picture>"}


def main() -> None:
    """Run the notebooks that are named, by default all."""
    for name in sys.argv[1:] or NAMES:
        notebook = run_notebook(read_notebook(name), name)
        text = json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True)
        (HERE / f"{name}.ipynb").write_text(text + "\n", "utf-8")
        print(HERE / f"{name}.ipynb")


if __name__ == "__main__":
    main()
