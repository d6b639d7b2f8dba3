"""Hooks of the documentation site (mkdocs.yml): pages made from the code, from files outside docs/, and by petmjx
itself."""

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
"""Documents outside docs/ that are also pages of the site, at the same path."""

MADE = {"options": reference.options, "commands": reference.commands}
"""Name in a ``made from the code`` comment of a page → function that makes the text in place of the comment."""

NOTEBOOKS = {path.stem: path for path in sorted((REPOSITORY / "examples").glob("*.ipynb"))}
"""Name in a ``notebook`` comment of a page → path of the notebook that replaces the comment, with its outputs."""

HEIGHTS = {"collapse": 760, "report": 900}
"""Name of an example → height of its frame, px."""

_PAGES: dict[str, notebooks.NotebookPage] = {}
"""Name of a notebook → its page, after its execution."""

LINK = re.compile(r"\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")
CODE = re.compile(r"^```.*?^```$|`[^`\n]+`", flags=re.DOTALL | re.MULTILINE)
CODE_WITH_PIPE = re.compile(r"`[^`\n]*\\\|[^`\n]*`")
"""Code with a pipe in a table. GitHub needs a backslash before the pipe, but this site would show the backslash."""

SHIM = re.compile(r'<script src="https://[^"]*/iframe-worker/shim"></script>')
"""A script with which the theme searches pages that are opened from a folder. docs/search-offline.js does this without
a server."""

ROLE = re.compile(r":(?:func|class|meth|mod|data|attr):<code>~?")


def on_config(config: Any) -> Any:
    """Change to the repository, so that mkdocstrings finds the source files wherever the build was started."""
    os.chdir(REPOSITORY)
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the documents outside docs/, the examples, and the notebooks' pictures. The notebooks are executed for
    this."""
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
    """Name of an example → HTML page of a story or of a report, made by the commands in docs/examples.md."""
    with tempfile.TemporaryDirectory() as folder:
        story, run, report = (str(Path(folder) / name) for name in ("story.html", "results", "report.html"))
        quiet("show", "s0-000016", "--engine", "mujoco", "--no-early-stop", "--html", story)
        quiet("score", "--engine", "mujoco", "--record", "failed", "--out", run)
        quiet("report", run, "-o", report)
        made = {"collapse": story, "report": report}
        texts = {name: Path(page).read_text(encoding="utf-8") for name, page in made.items()}
        # remove the paths of the machine on which the site is built
        return {name: text.replace(f"{folder}/", "").replace(f"{REPOSITORY}/", "") for name, text in texts.items()}


def quiet(*arguments: str) -> None:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = main(arguments)
    if code != 0:
        raise PluginError(f"petmjx {' '.join(arguments)}: exit code {code}: {printed.getvalue().strip()[-400:]}")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Insert the texts made from the code. Change links that lead out of docs/ into links to pages of the site or to
    the repository."""
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
        page.meta["search"] = {"boost": 0.3}  # long logs contain every word, so they get a low weight in the search
    address = config.extra["social"][0]["link"]
    markdown = CODE_WITH_PIPE.sub(lambda match: match[0].replace("\\|", "|"), markdown)
    return outside_code(markdown, lambda text: LINK.sub(lambda match: relinked(match, source, uri, address), text))


def outside_code(markdown: str, change: Any) -> str:
    """Apply a change to all text outside of code."""
    parts, end = [], 0
    for code in CODE.finditer(markdown):
        parts += [change(markdown[end : code.start()]), code[0]]
        end = code.end()
    return "".join([*parts, change(markdown[end:])])


def relinked(match: re.Match[str], source: str, uri: str, address: str) -> str:
    """A link in the file ``source`` as a link in the page ``uri``. If the text of the link is only a file name, it is
    replaced by the title of the page."""
    text, target, anchor = match[1], match[2], match[3] or ""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
    here = REPOSITORY / path
    if not here.exists():
        return match[0]  # mkdocs reports the missing file
    if path not in OUTSIDE and not path.startswith("docs/"):
        return f"[{text}]({address}/{'tree' if here.is_dir() else 'blob'}/HEAD/{path}{anchor})"
    if here.suffix == ".md" and text in (target, path):
        text = here.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
    page = path if path in OUTSIDE else path.removeprefix("docs/")
    return f"[{text}]({posixpath.relpath(page, posixpath.dirname(uri) or '.')}{anchor})"


def frame(name: str, height: int) -> str:
    page = f"examples/{name}.html"  # examples are in a folder beside docs/examples.md
    return (
        f'<iframe class="example" src="{page}" title="{name}" height="{height}" loading="lazy"></iframe>\n\n'
        f"[Open it alone]({page}){{ target=_blank }}"
    )


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Insert the outputs of notebooks. Roles in docstrings (:func:`petmjx.score`) are Sphinx markup; this site shows
    their names as code."""
    html = ROLE.sub("<code>", html)
    made = _PAGES.get(Path(page.file.src_uri).stem) if page.file.src_uri.startswith("notebooks/") else None
    for mark, output in made.outputs.items() if made else ():
        if html.count(mark) != 1:
            raise PluginError(f"{page.file.src_uri}: {mark} is there {html.count(mark)} times")
        html = html.replace(mark, f'<div class="notebook-output">{output}</div>')
    return html


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Replace a script that the page would load from a server."""
    to = posixpath.relpath("search-offline.js", posixpath.dirname(page.url) or ".")
    return SHIM.sub(f'<script src="{to}"></script>', output)


def on_post_template(output_content: str, **_: Any) -> str:
    """Replace the script also in the page of missing addresses (404.html), which only a server shows."""
    return SHIM.sub("", output_content)
