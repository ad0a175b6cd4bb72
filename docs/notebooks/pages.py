"""Shows the notebooks on the site: a hook of mkdocs, which gives each notebook a page of its name.

A page has the cells of the notebook, and what they print and draw as stored in it. Nothing runs.
"""

from __future__ import annotations

import base64
import json
import re
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page and its pictures for each notebook."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        path = PurePosixPath(file.src_uri)
        text, pictures = page_of(json.loads(file.content_string), path.stem)
        files.append(File.generated(config, str(path.with_suffix(".md")), content=text))
        for name, picture in pictures.items():
            files.append(File.generated(config, str(path.with_name(name)), content=picture))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Let links to a notebook lead to its page; those to download it, named so, stay."""
    return re.sub(r"(?<!\[Download)\]\(([\w./-]+)\.ipynb\)", r"](\1.md)", markdown)


def page_of(notebook: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """Return the Markdown of a notebook, and its pictures by their file names."""
    blocks, pictures = [], {}
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            blocks.append(text)
            continue
        blocks.append(f"```python\n{text}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{name}-{len(pictures) + 1}.png"
                pictures[picture] = base64.b64decode(data["image/png"])
                blocks.append(f"![What the cell draws]({picture})")
            else:
                printed = "".join(output.get("text") or data["text/plain"]).rstrip()
                blocks.append(f"```text\n{printed}\n```")
    blocks.append(f"[Download]({name}.ipynb) this page as a notebook.")
    return "\n\n".join(blocks) + "\n", pictures
