"""The notebooks of examples/, executed, and as pages of the documentation site."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

TIMEOUT_S = 120
"""A cell that takes longer is stuck."""


@dataclass(frozen=True)
class NotebookPage:
    """A notebook as a page.

    Attributes:
        markdown: its text, with a mark in place of each HTML output.
        outputs: mark → HTML.
        files: name → bytes of pictures, which the text links to.
    """

    markdown: str
    outputs: dict[str, str]
    files: dict[str, bytes]


def executed(path: Path, folder: Path) -> Any:
    """A notebook after all its cells have run in a kernel of their own.

    Args:
        folder: where they run: files that they write land there.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell failed.
    """
    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(folder)}}
    errors_alone = ["--IPKernelApp.log_level=40"]  # else it warns of its ports, which are this machine's
    return NotebookClient(notebook, timeout=TIMEOUT_S, resources=where, extra_arguments=errors_alone).execute()


def page_of(path: Path) -> NotebookPage:
    """Execute a notebook and convert it to Markdown.

    HTML outputs (tables, stories to play) are taken out: a Markdown parser need not read them, and links in them are
    not those of the page.
    """
    with tempfile.TemporaryDirectory() as folder:
        notebook = executed(path, Path(folder))
    outputs: dict[str, str] = {}
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "text/html" in data:
                mark = f'<div class="notebook-output" id="output-{len(outputs)}"></div>'
                outputs[mark] = data["text/html"]
                data["text/html"] = mark
    notebook.cells[0].source = notebook.cells[0].source.partition("\n")[2]  # the page has a title
    markdown, resources = MarkdownExporter().from_notebook_node(notebook, {"unique_key": path.stem})
    return NotebookPage(markdown, outputs, dict(resources["outputs"]))
