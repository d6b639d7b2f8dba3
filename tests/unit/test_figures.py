"""Tests of figures for papers: their content, the same bytes for the same results, and refused input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.outcomes import make_outcome
from unit.test_packer_comparison import write

import petmjx
from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.packer_comparison import pair_in_words
from petmjx.cli import main
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Reason, Verdict
from petmjx.show.figures.figure_style import WIDTH_IN
from petmjx.show.figures.sweep_figures import survival_curve

pytest.importorskip("matplotlib")
pytest.importorskip("scipy")


@pytest.fixture
def packers(tmp_path: Path) -> list[Path]:
    """Runs of two packers on 20 orders. All plans of the packer ``$b$`` stand, and 12 plans of the packer ``a``."""
    falls = {"verdict": Verdict.UNSTABLE, "reason": Reason.SHIFT, "culprit": 0}
    a = {f"o{k}": make_outcome(**(falls if k < 8 else {})) for k in range(20)}
    return [write(tmp_path / "a", a), write(tmp_path / "$b$", {f"o{k}": make_outcome() for k in range(20)})]


def test_a_figure_of_packers_says_who_stands_more_often(packers: list[Path]) -> None:
    comparison = petmjx.compare_packers(packers)
    (sentence,) = comparison.sentences
    assert sentence.startswith(
        "Plans of $b$ stand more often than plans of a: by 40.00 percentage points on 20 orders (95 %"
    )
    assert sentence.endswith("McNemar's exact test, p = 0.0078).")  # p = 2 / 2^8
    files = [packers[0].parent / name for name in ("a.svg", "b.svg", "a.pdf", "b.pdf")]
    assert petmjx.figure(comparison, *files) == files
    for one, same in zip(files[::2], files[1::2], strict=True):
        assert one.read_bytes() == same.read_bytes()
    drawn = files[0].read_text(encoding="utf-8")
    assert "Plans of $b$ stand more often" in drawn
    assert f'width="{WIDTH_IN * 72:g}pt"' in drawn
    assert "<dc:date>" not in drawn
    assert all(text in comparison._repr_html_() for text in ("Plans of $b$ stand", "<td>60.0</td>", "<td>100.0</td>"))


@pytest.mark.parametrize(
    ("difference", "low", "high", "p", "said"),
    [
        (-0.1, -0.2, -0.01, 0.01, "Plans of a stand more often than plans of b: by 10.00 percentage points"),
        (0.1, -0.01, 0.2, 0.2, "On these 50 orders plans of b stand more often than plans of a, by 10.00"),
        (0.0, -0.1, 0.1, 1.0, "stand equally often on 50 orders; a difference of -10.00 to +10.00"),
        (0.1, 0.0, 0.2, 1e-9, "p < 0.0001, corrected for 3 pairs"),
    ],
)
def test_sentences_about_two_packers(difference: float, low: float, high: float, p: float, said: str) -> None:
    row = {"a": "a", "b": "b", "n": 50, "difference": difference, "low": low, "high": high, "p_holm": p}
    sentence = pair_in_words(row, 0.95, pairs=3)
    assert said in sentence
    assert ("luck" in sentence) == (0.05 < p < 1)


def test_the_survival_curve_is_the_share_that_survives_each_level() -> None:
    levels, share = survival_curve(pd.Series([0.3, np.nan, 0.5, 0.3]))
    assert levels.tolist() == [0.0, 0.3, 0.5]
    assert share.tolist() == [1.0, 0.75, 0.25]


class _Summarised(petmjx.RunResults):
    """A run that has only a summary, and no files."""

    def __init__(self, summary: Any) -> None:
        object.__setattr__(self, "__dict__", {"summary": summary, "path": Path("run")})


LEVELS = pd.DataFrame(
    {"plan_id": ["p", "q"] * 2, "profile": "eumos-40509", "direction_deg": [0.0, 0.0, 90.0, 90.0],
     "largest_level_g": [0.3, np.nan, 0.5, 0.4]}
)  # fmt: skip
SHARES = pd.DataFrame(
    {"scope": "all", "plan_id": None, "axis": ["", "friction_factor", "friction_factor"], "value": [None, 0.2, 1.0],
     "share": [0.5, 0.25, 0.75], "low": np.nan, "high": np.nan}
)  # fmt: skip
PLANS = pd.DataFrame({"plan_id": ["p", "q"], "share": [0.5, 1.0], "low": [0.3, 0.8], "high": [0.7, 1.0]})
ARRIVALS = PLANS.assign(scope="plan", remedy="", leg="", weakest_leg="fork")


@pytest.mark.parametrize(
    ("summary", "texts"),
    [
        (LEVELS, (">level, g<", ">plans that survive it, %<", ">90°<", ">eumos-40509, 2 plans<")),
        (SHARES, (">factor on friction<", ">worlds that stand, %<")),
        (PLANS, (">p<", ">q<", ">worlds that stand, %; lines: 95 % intervals<")),
        (ARRIVALS, (">p<", ">q<", ">worlds that arrive, %; lines: 95 % intervals<")),
    ],
    ids=["levels", "shares", "plans", "arrivals"],
)
def test_figures_of_sweeps(summary: pd.DataFrame, texts: tuple[str, ...], tmp_path: Path) -> None:
    (file,) = petmjx.figure(_Summarised(summary), tmp_path / "x.svg")
    drawn = file.read_text(encoding="utf-8")
    assert [text for text in texts if text not in drawn] == []


def test_a_figure_of_criteria(tmp_path: Path) -> None:
    row = {f"{score}{end}": 0.5 for score in ("precision", "recall", "mcc") for end in ("", "_low", "_high")}
    judged = pd.DataFrame([{"criterion": name, "n_plans": 7, **row} for name in ("centre", "support_75")])
    results = CriteriaResults(pd.DataFrame(), pd.DataFrame(), judged, None, {"criteria": []})
    (file,) = petmjx.figure(results, tmp_path / "x.svg")
    drawn = file.read_text(encoding="utf-8")
    assert all(
        f">{text}<" in drawn for text in ("centre", "support_75", "recall", "7 plans; lines: 95 % bootstrap intervals")
    )


def test_what_has_no_figure_is_one_line(tmp_path: Path, packers: list[Path]) -> None:
    file = tmp_path / "x.svg"
    refused: list[tuple[Any, Path, str]] = [
        (_Summarised(None), file, "run: this run has no figure"),
        (
            CriteriaResults(pd.DataFrame(), pd.DataFrame(), None, None, {"criteria": []}),
            file,
            "not compared with a run",
        ),
        ("packers", file, "results must come from"),
        (petmjx.compare_packers(packers), tmp_path / "x.gif", "unknown ending; there are .pdf, .svg, .png"),
    ]
    for results, path, message in refused:
        with pytest.raises(InputError, match=message):
            petmjx.figure(results, path)
    assert not file.exists()


def test_the_command_line_draws_packers(packers: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    a, b = map(str, packers)
    file = packers[0].parent / "packers.pdf"
    assert main(["compare", "--packers", a, b, "--pdf", str(file)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "Plans of $b$ stand more often than plans of a" in out
    assert file.read_bytes().startswith(b"%PDF")
    again = ["compare", "--packers", a, b, "--pdf", str(file)]
    assert main(again) == 2
    assert "packers.pdf: exists already; name another file, or pass --overwrite" in capsys.readouterr().err
    assert main([*again, "--overwrite"]) == 0
    tables = ["compare", "--packers", a, b, "-o", str(file.parent / "tables")]
    assert [main(tables), main(tables), main([*tables, "--overwrite"])] == [0, 2, 0]
    assert "packers.parquet: exists already" in capsys.readouterr().err
    file = file.with_name("other.pdf")
    assert main(["compare", a, b, "--pdf", str(file)]) == 2
    assert "needs --packers" in capsys.readouterr().err
    assert main(["figure", a, "--pdf", "x.png"]) == 2
    assert "must end in .pdf" in capsys.readouterr().err
    assert main(["figure", a]) == 2
    assert main(["criteria", "--pdf", str(file)]) == 2
    assert "--run DIR" in capsys.readouterr().err
