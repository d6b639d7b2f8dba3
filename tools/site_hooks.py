"""Hooks of the documentation site (mkdocs.yml): pages made from the code, from files outside docs/, and by petmjx."""

from __future__ import annotations

import contextlib
import io
import os
import posixpath
import re
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

import petmjx
from petmjx.cli.main import main
from tools import notebooks, reference

REPOSITORY = Path(__file__).resolve().parents[1]

OUTSIDE = (
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "benchmarks/README.md",
    "benchmarks/results/cpu-0.2.md",
    "benchmarks/results/h200-0.2.md",
)
"""Documents outside docs/ that are pages too, at the same path."""

MADE = {"options": reference.options, "commands": reference.commands}
"""Name in a ``made from the code`` comment → function that writes the text in its place."""

NOTEBOOKS = {path.stem: path for path in sorted((REPOSITORY / "examples").glob("*.ipynb"))}
"""Name in a ``notebook`` comment → the notebook that is shown there, with its outputs."""

HEIGHTS = {"collapse": 760, "report": 900}
"""Example → height of its frame, px."""

_PAGES: dict[str, notebooks.NotebookPage] = {}
"""The notebooks, after their execution."""

LINK = re.compile(r"\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")
CODE = re.compile(r"^```.*?^```$|`[^`\n]+`", flags=re.DOTALL | re.MULTILINE)
CODE_WITH_PIPE = re.compile(r"`[^`\n]*\\\|[^`\n]*`")
"""GitHub needs a backslash before a pipe in a table's code, and this site would show it."""

SHIM = re.compile(r'<script src="https://[^"]*/iframe-worker/shim"></script>')
"""The theme's way to search pages that were opened from a folder; docs/search-offline.js does it without a server."""

ROLE = re.compile(r":(?:func|class|meth|mod|data|attr):<code>~?")


def on_config(config: Any) -> Any:
    """Read the source files of mkdocstrings from the repository, wherever the build was started."""
    os.chdir(REPOSITORY)
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the documents outside docs/, the examples, and the pictures of notebooks, which are executed for it."""
    for name in OUTSIDE:
        files.append(File.generated(config, name, content=(REPOSITORY / name).read_text(encoding="utf-8")))
    for name, text in examples().items():
        files.append(File.generated(config, f"examples/{name}.html", content=text))
    for name, path in NOTEBOOKS.items():
        _PAGES[name] = notebooks.page_of(path)
        for picture, content in _PAGES[name].files.items():
            files.append(File.generated(config, f"notebooks/{picture}", content=content))
    return files


def examples() -> dict[str, str]:
    """Name → page of a story and of a report, made as docs/examples.md says."""
    with tempfile.TemporaryDirectory() as folder:
        story, run, report = (str(Path(folder) / name) for name in ("story.html", "results", "report.html"))
        quiet("show", "s0-000016", "--engine", "mujoco", "--no-early-stop", "--html", story)
        quiet("score", "--engine", "mujoco", "--record", "failed", "--out", run)
        quiet("report", run, "-o", report)
        made = {"collapse": story, "report": report}
        texts = {name: Path(page).read_text(encoding="utf-8") for name, page in made.items()}
        # where the site was built concerns nobody
        return {name: text.replace(f"{folder}/", "").replace(f"{REPOSITORY}/", "") for name, text in texts.items()}


def quiet(*arguments: str) -> None:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = main(arguments)
    if code != 0:
        raise PluginError(f"petmjx {' '.join(arguments)}: exit code {code}: {printed.getvalue().strip()[-400:]}")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Fill in the texts made from the code, and lead links out of docs/ to pages or to the repository."""
    for name, make in MADE.items():
        mark = f"<!-- made from the code: {name} -->"
        if mark in markdown:
            markdown = markdown.replace(mark, make())
    for name, height in HEIGHTS.items():
        markdown = markdown.replace(f"<!-- example: {name} -->", frame(name, height))
    for name, made in _PAGES.items():
        markdown = markdown.replace(f"<!-- notebook: {name} -->", made.markdown)
    if page.file.src_uri == "reference/python.md":
        missing = [name for name in petmjx.__all__ if name != "__version__" and f"::: petmjx.{name}\n" not in markdown]
        if missing:
            raise PluginError(f"docs/reference/python.md lacks {', '.join(missing)}")
    uri = page.file.src_uri
    source = uri if uri in OUTSIDE else f"docs/{uri}"
    if uri in OUTSIDE:
        page.meta["search"] = {"boost": 0.3}  # long logs, which have every word
    address = config.extra["social"][0]["link"]
    markdown = CODE_WITH_PIPE.sub(lambda match: match[0].replace("\\|", "|"), markdown)
    return outside_code(markdown, lambda text: LINK.sub(lambda match: relinked(match, source, uri, address), text))


def outside_code(markdown: str, change: Any) -> str:
    """Apply a change to all text that is not code."""
    parts, end = [], 0
    for code in CODE.finditer(markdown):
        parts += [change(markdown[end : code.start()]), code[0]]
        end = code.end()
    return "".join([*parts, change(markdown[end:])])


def relinked(match: re.Match[str], source: str, uri: str, address: str) -> str:
    """A link of the file ``source`` as one of the page ``uri``. A link called by its file gets the page's title."""
    text, target, anchor = match[1], match[2], match[3] or ""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
    here = REPOSITORY / path
    if not here.exists():
        return match[0]  # mkdocs reports it
    if path not in OUTSIDE and not path.startswith("docs/"):
        return f"[{text}]({address}/{'tree' if here.is_dir() else 'blob'}/HEAD/{path}{anchor})"
    if here.suffix == ".md" and text in (target, path):
        text = here.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
    page = path if path in OUTSIDE else path.removeprefix("docs/")
    return f"[{text}]({posixpath.relpath(page, posixpath.dirname(uri) or '.')}{anchor})"


def frame(name: str, height: int) -> str:
    page = f"examples/{name}.html"  # beside docs/examples.md
    return (
        f'<iframe class="example" src="{page}" title="{name}" height="{height}" loading="lazy"></iframe>\n\n'
        f"[Open it alone]({page}){{ target=_blank }}"
    )


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Fill in the outputs of notebooks. Roles in docstrings (:func:`petmjx.score`) are Sphinx's; on this site they are
    code."""
    html = ROLE.sub("<code>", html)
    made = _PAGES.get(Path(page.file.src_uri).stem) if page.file.src_uri.startswith("notebooks/") else None
    for mark, output in made.outputs.items() if made else ():
        if html.count(mark) != 1:
            raise PluginError(f"{page.file.src_uri}: {mark} is there {html.count(mark)} times")
        html = html.replace(mark, f'<div class="notebook-output">{output}</div>')
    return html


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """No page asks anything of a server."""
    to = posixpath.relpath("search-offline.js", posixpath.dirname(page.url) or ".")
    return SHIM.sub(f'<script src="{to}"></script>', output)


def on_post_template(output_content: str, **_: Any) -> str:
    """Nor does the page of an address that is none (404.html), which only a server shows."""
    return SHIM.sub("", output_content)
