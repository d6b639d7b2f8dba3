"""Executes the notebooks of examples/, and converts them to pages of the documentation site."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

TIMEOUT_S = 120
"""Longest time that a cell may take, s. A cell that takes longer hangs."""


@dataclass(frozen=True)
class NotebookPage:
    """A notebook as a page of the site.

    Attributes:
        markdown: text of the page, with a mark in place of each HTML output.
        outputs: mark → HTML output.
        files: name → bytes of a picture to which the text links.
    """

    markdown: str
    outputs: dict[str, str]
    files: dict[str, bytes]


def executed(path: Path, folder: Path) -> Any:
    """A notebook after all its cells have run in a kernel of their own.

    Args:
        folder: working folder of the cells, in which they write files.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell failed.
    """
    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(folder)}}
    errors_alone = ["--IPKernelApp.log_level=40"]  # without this option, the kernel prints a warning about its ports
    return NotebookClient(notebook, timeout=TIMEOUT_S, resources=where, extra_arguments=errors_alone).execute()


def page_of(path: Path) -> NotebookPage:
    """Execute a notebook and convert it to Markdown.

    HTML outputs (tables, stories to play) are replaced by marks. A Markdown parser need not read these outputs, and
    their links are not links of the page.
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
    notebook.cells[0].source = notebook.cells[0].source.partition("\n")[2]  # the page already has a title
    markdown, resources = MarkdownExporter().from_notebook_node(notebook, {"unique_key": path.stem})
    return NotebookPage(markdown, outputs, dict(resources["outputs"]))
