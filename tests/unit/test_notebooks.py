"""The notebooks in examples/ run from top to bottom, show what they promise, and are committed without outputs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

SHOWN = {
    "score_and_see": ("RunResults(in memory: 14 plans", "<progress", "<iframe title=", "carton-400x300x200"),
    "sweep_and_confidence": ("coin_toss", "26.56", "largest_level_g", "<progress"),
    "packers": ("Plans of careful stand more often than plans of careless", "<iframe title=", "image/png"),
}
"""Name of a notebook → texts that its outputs must contain."""

LONGEST_TEXT = 3_000
"""Largest number of characters that a cell may print. (Only a story as HTML is longer.)"""


def read(path: Path) -> dict[str, Any]:
    notebook: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return notebook


def test_there_is_what_the_documents_promise() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(SHOWN)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_committed_without_outputs(path: Path) -> None:
    codes = [cell for cell in read(path)["cells"] if cell["cell_type"] == "code"]
    assert codes
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in codes)


@pytest.mark.slow
# warnings of the Jupyter kernel's client
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ipykernel", reason="ipykernel is not installed (extra: docs)")
    pytest.importorskip("scipy")
    notebooks = pytest.importorskip("tools.notebooks", reason="nbclient is not installed (extra: docs)")
    monkeypatch.setenv("PYTHONPATH", str(FOLDER.parent))
    done = notebooks.executed(path, tmp_path)
    outputs = [output for cell in done.cells for output in cell.get("outputs", [])]
    everything = json.dumps(outputs, ensure_ascii=False)
    assert [text for text in SHOWN[path.stem] if text not in everything.replace('\\"', '"')] == []
    texts = [output.get("text", "") or output.get("data", {}).get("text/plain", "") for output in outputs]
    assert [text for text in texts if len(text) > LONGEST_TEXT] == []
    assert not [output for output in outputs if output["output_type"] == "stream"], "progress shows as a bar"
    assert not re.search(r"Traceback", everything)
