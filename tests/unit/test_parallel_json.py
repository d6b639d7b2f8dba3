"""Large JSON files are read in pieces, with the same plans, faults and notes as in one go."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petmjx.packers.sample_plans import generate_one
from petmjx.plans import parallel_json, plan_reader
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.plans.plan_set import PlanSet


def _file(folder: Path, plans: dict[str, Any], text: str | None = None) -> Path:
    path = folder / "plans.json"
    path.write_text(text if text is not None else json.dumps(plans))
    return path


def _both(path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[PlanSet, PlanSet, int]:
    """The plans of a file in one go and in pieces, and the number of pieces that were read and used."""
    uncut = load_plans(path)
    used = []
    answer = parallel_json._answer

    def counted(*some: Any) -> Any:
        reply = answer(*some)
        used.append(reply is not None)
        return reply

    monkeypatch.setattr(parallel_json, "_answer", counted)
    monkeypatch.setattr(plan_reader, "WORTH_BYTES", 1)
    monkeypatch.setattr(parallel_json, "PIECE_BYTES", 1)
    monkeypatch.setattr(parallel_json, "cpu_threads", lambda: 3)
    return uncut, load_plans(path), len(used) if used and all(used) else 0


def _same(one: PlanSet, other: PlanSet) -> None:
    assert [plan.plan_id for plan in one] == [plan.plan_id for plan in other]
    for plan, same in zip(one, other, strict=True):
        for field in fields(Plan):
            value, its = getattr(plan, field.name), getattr(same, field.name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(its, value, strict=True)
            else:
                assert its == value, field.name
    for name in ("skipped", "warnings", "notes", "conventions", "numbers"):
        assert getattr(one, name) == getattr(other, name), name


def test_pieces_have_the_same_plans_faults_and_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plans: dict[str, Any] = dict(generate_one(k, 7) for k in range(12))
    ids = list(plans)
    plans[ids[1]][0]["item"]["stiffness_n_mm"] = 200.0
    plans[ids[3]][2]["item"]["weight/kg"] = -1
    plans[ids[5]][0]["colour"] = "red"
    plans[ids[7]] = {"item_sequence": {}}
    plans[ids[8]][1]["flb_coordinates"][2] += 900  # floats
    text = json.dumps(plans)
    end = text.rindex("}")
    repeated = f"{text[:end]}, {json.dumps(ids[0])}: {json.dumps(plans[ids[2]])}}}\n"
    uncut, pieces, used = _both(_file(tmp_path, plans, repeated), monkeypatch)
    assert used == 3
    assert len(uncut.plans) == 10
    assert len(uncut.skipped) == 3
    assert uncut.notes
    assert uncut.warnings
    _same(uncut, pieces)


@pytest.mark.parametrize("what", ["lists of objects in placements", "no JSON near the end", "one plan"])
def test_what_cannot_be_cut_is_read_in_one_go(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plans: dict[str, Any] = dict(generate_one(k, 7) for k in range(4))
    text = json.dumps(plans)
    if what == "lists of objects in placements":
        for boxes in plans.values():
            boxes[:] = [{"parts": [{"part": 1}], **box} for box in boxes]
        text = json.dumps(plans)
    elif what == "no JSON near the end":
        text = text[:-150] + text[-149:].replace(":", "", 1)
    else:
        text = json.dumps(dict(list(plans.items())[:1]))
    uncut, pieces, used = _both(_file(tmp_path, plans, text), monkeypatch)
    assert not used
    _same(uncut, pieces)


@pytest.mark.parametrize("says", ["Loading", "(lp0"])
def test_what_interpreters_print_when_they_start_is_no_answer(
    says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(f"print({says!r})")
    monkeypatch.syspath_prepend(site)
    uncut, pieces, used = _both(_file(tmp_path, dict(generate_one(k, 7) for k in range(3))), monkeypatch)
    assert not used
    assert len(uncut.plans) == 3
    _same(uncut, pieces)


def test_ctrl_c_does_not_wait_for_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _file(tmp_path, dict(generate_one(k, 7) for k in range(3)))
    started: list[subprocess.Popen[bytes]] = []

    def slow() -> subprocess.Popen[bytes]:
        code = "import sys, time; sys.stdin.buffer.read(); time.sleep(30)"
        started.append(subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        return started[-1]

    monkeypatch.setattr(plan_reader, "WORTH_BYTES", 1)
    monkeypatch.setattr(parallel_json, "PIECE_BYTES", 1)
    monkeypatch.setattr(parallel_json, "cpu_threads", lambda: 2)
    monkeypatch.setattr(parallel_json, "_reader_process", slow)
    main = threading.main_thread().ident
    assert main is not None
    threading.Timer(0.5, signal.pthread_kill, (main, signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        load_plans(path)
    assert time.monotonic() - began < 10
    assert [process.poll() is not None for process in started] == [True, True]
